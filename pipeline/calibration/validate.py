"""Check the numbers of a camera in a calibration file, and build the camera; all problems are reported at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.calibration.camera_names import name_problem
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.core import parsing
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, LensModel
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import Problem
from pipeline.core.problems import session_codes
from pipeline.geometry.fisheye import NUM_COEFFICIENTS

MAX_CAMERAS = 128
_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
_FISHEYE_LENGTHS = (0, NUM_COEFFICIENTS)
# The last two of 14 coefficients tilt the sensor.
_MAX_UNTILTED = 12
_INVALID = {
    "name": session_codes.INVALID_NAME,
    "size": session_codes.INVALID_SIZE,
    "matrix": session_codes.INVALID_MATRIX,
    "distortion": session_codes.INVALID_DISTORTION,
    "rotation": session_codes.INVALID_ROTATION,
    "translation": session_codes.INVALID_TRANSLATION,
}
# Files have 5 to 7 digits: a correct rotation is far within this tolerance, a mistake far outside.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class RawCamera:
    """Unchecked values of a camera in a file.

    Parameters
    ----------
    name, section
        Name of the camera, and name of its section in the file.
    size_px
        Width and height of the picture; ``UNKNOWN_SIZE``: the format does not contain them.
    matrix
        Camera matrix K, 3 x 3.
    distortion
        OpenCV's coefficients; none count as four zeros for a fisheye lens.
    rotation, translation_m
        Transform from world to camera.
    lens
        Distortion model.

    Examples
    --------
    >>> import numpy as np
    >>> raw = RawCamera("left", (1920, 1080), np.eye(3), np.zeros(4), np.eye(3), np.zeros(3), "cam_0")
    >>> raw.section
    'cam_0'
    """

    name: Any
    size_px: Any
    matrix: Any
    distortion: Any
    rotation: Any
    translation_m: Any
    section: str = ""
    lens: LensModel = "standard"

    @property
    def is_posed(self) -> bool:
        """A rotation and a translation are there, right or wrong."""
        return self.rotation is not None and self.translation_m is not None


def _numbers(value: Any, shapes: Sequence[tuple[int, ...]]) -> np.ndarray | str:
    """Convert a value to a finite array of one of the shapes; return the end of a message if that fails."""
    if value is None:
        return "is missing."
    wanted = " or ".join(" x ".join(str(n) for n in shape) for shape in shapes)
    try:
        array = parsing.read_numbers(value)
    except parsing.UnreadableError:
        return f"is not a list of {wanted} numbers."
    if not array.shape:
        return f"is one number instead of {wanted} numbers."
    if array.shape not in shapes:
        return f"has {' x '.join(str(n) for n in array.shape)} numbers instead of {wanted}."
    if not np.isfinite(array).all():
        return "has a number that is not finite."
    return array


def _matrix_problem(matrix: np.ndarray) -> str | None:
    if not np.allclose(matrix[2], [0.0, 0.0, 1.0], atol=1e-9) or matrix[1, 0] != 0:
        return "is not a camera matrix: it must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]]."
    if not parsing.FOCAL_LENGTH_PX.holds(matrix.diagonal()[:2]):
        return f"has a focal length that is not {parsing.FOCAL_LENGTH_PX}."
    if not parsing.PRINCIPAL_POINT_PX.holds(matrix[:2, 2]):
        return f"has a principal point that is not at {parsing.PRINCIPAL_POINT_PX}."
    if not parsing.SKEW_PX.holds(matrix[0, 1]):
        return f"has a skew that is not {parsing.SKEW_PX}."
    return None


def _size_problem(size_px: np.ndarray) -> str | None:
    if not parsing.SIDE_PX.holds(size_px):
        return f"must be {parsing.SIDE_PX}."
    if (size_px != np.floor(size_px)).any():
        return "must be whole numbers of pixels."
    return None


def nearest_rotation(matrix: np.ndarray) -> np.ndarray | str:
    """Find the rotation nearest to a 3 x 3 matrix; return the end of a message if the matrix is not a rotation."""
    # Large numbers are refused first: their products would overflow.
    if np.abs(matrix).max() > 1 + _ROTATION_TOLERANCE or (
        np.abs(matrix @ matrix.T - np.eye(3)).max() > _ROTATION_TOLERANCE
    ):
        return "is not a rotation: its rows are not orthonormal."
    if np.linalg.det(matrix) < 0:
        return "is not a rotation: it mirrors (determinant -1)."
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def _tilt_problems(distortion: np.ndarray | None, file: str, camera: str) -> list[Problem]:
    if distortion is None or not distortion[_MAX_UNTILTED:].any():
        return []
    message = "A tilted sensor, coefficients 13 and 14 of the distortion, is not supported."
    return [Problem(session_codes.UNSUPPORTED_LENS, message, file=file, camera=camera, field="distortion")]


def build_camera(raw_camera: RawCamera, position: int, file: str) -> Camera | list[Problem]:
    """Check the values of a camera and build it; return all problems of a camera that has some."""
    problems: list[Problem] = []
    fault = name_problem(raw_camera.name)
    label = f"number {position + 1}" if fault else str(raw_camera.name)

    def complain(field: str, message: str) -> None:
        problems.append(Problem(_INVALID[field], f"The {field} {message}", file=file, camera=label, field=field))

    if fault:
        complain("name", fault)
    values: dict[str, np.ndarray] = {}
    lengths = _FISHEYE_LENGTHS if raw_camera.lens == "fisheye" else _DISTORTION_LENGTHS
    for field, value, shapes in (
        ("size", raw_camera.size_px, [(2,)]),
        ("matrix", raw_camera.matrix, [(3, 3)]),
        ("distortion", raw_camera.distortion, [(n,) for n in lengths]),
        ("rotation", raw_camera.rotation, [(3, 3)]),
        ("translation", raw_camera.translation_m, [(3,)]),
    ):
        checked = _numbers(value, shapes)
        if isinstance(checked, str):
            complain(field, checked)
        else:
            values[field] = checked
    if "size" in values and raw_camera.size_px is not UNKNOWN_SIZE and (message := _size_problem(values["size"])):
        complain("size", message)
    if "matrix" in values and (message := _matrix_problem(values["matrix"])):
        complain("matrix", message)
    if "rotation" in values:
        rotation = nearest_rotation(values["rotation"])
        if isinstance(rotation, str):
            complain("rotation", rotation)
        else:
            values["rotation"] = rotation
    problems += _tilt_problems(values.get("distortion"), file, label)
    for field, plausible in (("distortion", parsing.DISTORTION), ("translation", parsing.TRANSLATION)):
        if field in values and not plausible.holds(values[field]):
            complain(field, f"has a number that is not {plausible}.")
    if problems:
        return problems
    return Camera(
        name=raw_camera.name,
        size_px=(int(values["size"][0]), int(values["size"][1])),
        matrix=read_only(values["matrix"]),
        distortion=read_only(_coefficients(values["distortion"], raw_camera.lens)),
        cam_from_world=Rigid3(read_only(values["rotation"]), read_only(values["translation"])),
        section=raw_camera.section,
        lens=raw_camera.lens,
    )


def _coefficients(distortion: np.ndarray, lens: LensModel) -> np.ndarray:
    """Coefficients of a camera, without a tilted sensor's; four of a fisheye lens, zeros if it has none."""
    if lens == "fisheye" and not distortion.size:
        return np.zeros(NUM_COEFFICIENTS)
    return distortion[:_MAX_UNTILTED].copy()
