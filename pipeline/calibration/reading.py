"""Reading of a calibration file: problems, notes for the user, and at the end the contents.

Programs add fields to their formats, and rigs have cameras that film nothing. Both are noted, so that the rest of the
file serves. The fields that decide about a usable camera are checked in full.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.calibration.advice import SUPPORTED
from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile, scaled
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera, build_camera
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.options.job_choices import UNITS_M, Units
from pipeline.core.parsing import SIDE_PX, UnreadableError, read_numbers
from pipeline.core.problems import session_codes
from pipeline.core.problems.code_group import Code

_NAME_HINT = "Name it as the format does (`multicap help reader-tables` has the names), or remove it."


class Reading:
    """Problems and notes that a reader finds in a file.

    Parameters
    ----------
    file
        Base name of the file.

    Examples
    --------
    >>> reading = Reading("rig.toml")
    >>> reading.leave_out(["left"], "it has no pose")
    >>> reading.notes
    ['rig.toml: camera left is left out: it has no pose.']
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.problems: list[Problem] = []
        self.notes: list[str] = []
        self._unread: dict[str, None] = {}
        # Cameras by the field that may decide, and the code of its problem.
        self._doubts: dict[tuple[str, Code], list[str]] = {}

    def complain(
        self, code: Code, message: str, camera: str | None = None, field: str | None = None, hint: str | None = None
    ) -> None:
        """Add a problem of the file."""
        self.problems.append(Problem(code, message, file=self.file, camera=camera, field=field, hint=hint))

    def pass_over(self, fields: Mapping[str, Any], known: frozenset[str], raw: RawCamera | None = None) -> None:
        """Note the fields that are not ``known``: newer versions of a program write more than the calibration.

        A field that may hold the distortion decides, and so does one that may hold the size of the picture where no
        other field does: it is a problem, one for all cameras that have it.

        ``raw``: camera of the fields; ``None``: the fields stand beside the cameras.
        """
        self._unread |= {field: None for field in fields if field not in known}
        doubts = dict.fromkeys(lens_fields(fields, known, raw and raw.distortion), session_codes.UNSUPPORTED_LENS)
        if raw is not None and raw.size_px is UNKNOWN_SIZE:
            doubts |= dict.fromkeys(size_fields(fields, known, raw.matrix), session_codes.INVALID_SIZE)
        for field, code in doubts.items():
            self._doubts.setdefault((field, code), []).append("" if raw is None else str(raw.name))

    def note_about(self, cameras: Sequence[object], statement: str) -> None:
        """Note something about cameras, as the end of the sentence "camera left is ..."; nothing if there are none."""
        if cameras:
            noun, verb = ("cameras", "are") if len(cameras) > 1 else ("camera", "is")
            self.notes.append(f"{self.file}: {noun} {listed_names(cameras)} {verb} {statement}.")

    def leave_out(self, cameras: Sequence[object], reason: str) -> None:
        """Note cameras that can't serve, with the reason in a few words."""
        self.note_about(cameras, f"left out: {reason}")

    def contents(self, format_name: str, raw: Sequence[RawCamera], unit: Units | None, **statements: Any) -> CameraFile:
        """Check all cameras and build the contents of the file.

        ``raw``: cameras in the unit of the file. Cameras without a matrix are left out if others have one. ``unit``:
        unit of lengths; ``None``: the format does not determine it. ``statements``: further fields of ``CameraFile``.
        Raises ``InputError``: with all problems of all cameras.
        """
        for (field, code), cameras in self._doubts.items():
            content = "distortion" if code == session_codes.UNSUPPORTED_LENS else "size of the picture"
            owners = f" of {listed_names(cameras)}" if any(cameras) else ""
            message = f"The field is not read, and may hold the {content}{owners}."
            self.complain(code, message, None, field, _NAME_HINT)
        known = [each for each in raw if each.matrix is not None]
        if known:
            self.leave_out([each.name for each in raw if each.matrix is None], "no camera matrix in the file")
        posed = [each for each in known if each.is_posed]
        unposed = [replace(each, rotation=np.eye(3), translation_m=np.zeros(3)) for each in known if not each.is_posed]
        if posed:
            self.leave_out([each.name for each in unposed], "no pose in the file")
        if self._unread:
            self.notes.append(f"{self.file}: fields that are not read: {listed_names(list(self._unread))}.")
        built = self._build(posed or unposed or raw)
        factor = 1.0 if unit is None else UNITS_M[unit]
        return CameraFile(
            format_name,
            tuple(scaled(camera, factor) for camera in built) if posed else (),
            unit,
            notes=tuple(self.notes),
            unposed=self._serving(unposed) if posed else built,
            **statements,
        )

    def _serving(self, raw: Sequence[RawCamera]) -> tuple[Camera, ...]:
        built = [build_camera(raw_camera, position, self.file) for position, raw_camera in enumerate(raw)]
        return tuple(camera for camera in built if isinstance(camera, Camera))

    def _build(self, raw: Sequence[RawCamera]) -> tuple[Camera, ...]:
        """Check cameras and build them; raises ``InputError`` with all problems of the file."""
        if not raw and not self.problems:
            self.complain(
                session_codes.CALIBRATION_EMPTY,
                " ".join(["The calibration has no camera.", *self.notes]),
                hint=SUPPORTED,
            )
        if len(raw) > MAX_CAMERAS:
            self.complain(session_codes.TOO_MANY_CAMERAS, f"The calibration has more than {MAX_CAMERAS} cameras.")
        cameras: list[Camera] = []
        for position, raw_camera in enumerate(raw[:MAX_CAMERAS]):
            built = build_camera(raw_camera, position, self.file)
            if isinstance(built, Camera):
                cameras.append(built)
            else:
                self.problems.extend(built)
        names = Counter(raw_camera.name for raw_camera in raw if isinstance(raw_camera.name, str))
        for name in sorted(name for name, count in names.items() if count > 1):
            self.complain(session_codes.DUPLICATE_CAMERA, "Two cameras have this name.", name, hint="Rename one.")
        if self.problems:
            raise InputError(self.problems)
        return tuple(cameras)


# Fields of a camera that no reader knows: which of them may hold the distortion, or the size of the picture. The values
# tell, whatever the names: 4, 5, 8, 12 or 14 numbers with fractions may be a lens of OpenCV, two whole numbers around
# the principal point a size. Names tell of other numbers: `k1`, `RadialDistortion`.
_LENS_LENGTHS = frozenset({4, 5, 8, 12, 14})
# Names of a single coefficient, and of several, whatever their number.
_COEFFICIENT = re.compile(r"(k|p|kappa|radial\w*|tangential\w*)_?\d+|(?!undist).*dist(ort|coef|_coef).*", re.IGNORECASE)
_COEFFICIENTS = re.compile(r"k|p|kc|(radial|tangential).*|.*(coe?ff?(s|ic)|(?<!un)dist(?!anc)).*", re.IGNORECASE)
# Names of lists that are no lens: how well something is known, whatever it is; and boxes, points, times, colours.
_STATISTICS = re.compile(
    "(?<![a-z])(err|rms|std|cov)|error|rmse|resid|reproj|sigma|deviat|std(?![a-z])|covar", re.IGNORECASE
)
_NO_LENS = re.compile(
    "box|roi(?![a-z])|(?<!cor)rect|crop|corner|point|time|stamp|colou?r|rgb|gain|white", re.IGNORECASE
)
_LENS_WORD = re.compile("lens|dist|coef", re.IGNORECASE)
_SIDE = re.compile(r"w|h|.*(width|height|cols|rows)", re.IGNORECASE)
_MIN_SIDE_PX = 16.0
_UNIT_TOLERANCE = 1e-3
_MAX_DEPTH = 4


def lens_fields(fields: Mapping[str, Any], known: frozenset[str], distortion: Any = None) -> Iterator[str]:
    """Names of fields that are not ``known`` and may hold the distortion; ``a.b`` is the field b of the field a.

    ``distortion`` is the distortion that is read: fields that repeat it don't count.
    """
    read = _numbers(distortion)
    for path, name, value in _leaves(fields, known):
        numbers = _numbers(value) if isinstance(value, list) else None
        if numbers is None:
            # A number, a text or a table under the name of a coefficient or of a distortion decides, too.
            is_lens = bool(value) and not isinstance(value, bool) and _COEFFICIENT.fullmatch(name) is not None
        elif numbers.size == max(numbers.shape):
            # Lists of whole numbers are indices, pixels or counts.
            is_like_lens = numbers.size in _LENS_LENGTHS and bool((numbers != np.round(numbers)).any())
            is_lens = is_like_lens or _COEFFICIENTS.fullmatch(name) is not None
        else:
            is_lens = _COEFFICIENT.fullmatch(name) is not None
        if is_lens and (numbers is None or not _is_other(name, numbers.ravel(), read)):
            yield path


def size_fields(fields: Mapping[str, Any], known: frozenset[str], matrix: Any) -> Iterator[str]:
    """Names of fields that are not ``known`` and may hold the size of the picture, or a side of it.

    ``matrix`` is the camera matrix: its principal point is near the middle of the picture.
    """
    camera_matrix = _numbers(matrix)
    if camera_matrix is None or camera_matrix.shape != (3, 3):
        return
    focal_px, point_px = camera_matrix.diagonal()[:2], camera_matrix[:2, 2]

    def is_size(sides_px: np.ndarray, middle_px: np.ndarray) -> bool:
        return bool((np.abs(2 * middle_px - sides_px) < sides_px / 2).all())

    for path, name, value in _leaves(fields, known):
        sides_px = _numbers(value)
        if (
            sides_px is None
            or sides_px.size > 2
            or not SIDE_PX.holds(sides_px)
            or (sides_px != np.round(sides_px)).any()
        ):
            continue
        sides_px = sides_px.ravel()
        if sides_px.min() < _MIN_SIDE_PX or any(np.array_equal(sides_px, pair) for pair in (focal_px, point_px)):
            continue
        is_pair = sides_px.size == 2 and (is_size(sides_px, point_px) or is_size(sides_px[::-1], point_px))
        is_side = sides_px.size == 1 and _SIDE.fullmatch(name) and any(is_size(sides_px, middle) for middle in point_px)
        if is_pair or is_side:
            yield path


def _leaves(fields: Mapping[str, Any], known: frozenset[str], depth: int = 0) -> Iterator[tuple[str, str, Any]]:
    """Path, name and value of the fields that are not known, and of the fields inside them."""
    for name, value in fields.items():
        if name in known:
            continue
        if isinstance(value, dict) and value and depth < _MAX_DEPTH and not _COEFFICIENT.fullmatch(name):
            for path, inner, leaf in _leaves(value, frozenset(), depth + 1):
                yield f"{name}.{path}", inner, leaf
        else:
            yield name, name, value


def _numbers(value: Any) -> np.ndarray | None:
    """Array of a number or of nested lists; ``None`` for other values, and for lists without a number."""
    try:
        numbers = read_numbers(value)
    except UnreadableError:
        return None
    return None if np.isnan(numbers).all() else numbers


def _is_other(name: str, numbers: np.ndarray, read: np.ndarray | None) -> bool:
    """Return whether a list is no distortion, or one without an effect."""
    if not numbers.any() or _STATISTICS.search(name) or (_NO_LENS.search(name) and not _LENS_WORD.search(name)):
        return True
    if read is not None and np.array_equal(numbers, read.ravel()):
        return True
    # A quaternion, a plane, or the last row of a transform or of a projection.
    directions = {4: (numbers, numbers[:3]), 12: (numbers[8:11],)}.get(numbers.size, ())
    return any(
        np.abs(direction).max() < 1.0 + _UNIT_TOLERANCE and abs(np.linalg.norm(direction) - 1.0) < _UNIT_TOLERANCE
        for direction in directions
    )
