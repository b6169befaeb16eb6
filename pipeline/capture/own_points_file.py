"""File about the user's own points, YAML or JSON: rigid objects by places or distances of their points, and bones.

    objects:
      racket:
        points: {racket_tip: [0, 0, 0.68], racket_left: [-0.12, 0, 0.5], racket_right: [0.12, 0, 0.5]}
      box:
        distances: [[corner_a, corner_b, 0.4], [corner_b, corner_c, 0.3], [corner_a, corner_c, 0.5]]
    bones: [[nose, neck], [neck, tail_base]]

Lengths are metres. Places are in any axes of the object. Names are the names of the keypoint files.

Places follow from distances by classical scaling (Torgerson 1952) and least squares by majorization (de Leeuw 1977),
whose steps are products of matrices. Distances leave the axes open, and which of two mirror images it is.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.calibration.readers.file_storage import read_yaml
from pipeline.capture.keypoint_files.own_points import point_names
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import Session
from pipeline.core.data.own_points import RigidShape
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.findings import Finding
from pipeline.core.parsing import UnreadableError, in_utf_8
from pipeline.core.paths import StrPath
from pipeline.core.problems.finding_codes import KEYPOINTS_FORM
from pipeline.core.problems.session_codes import OWN_POINTS_INVALID

_MAX_BYTES, _MAX_POINTS, _MAX_COMPLAINTS = 2**18, 50, 50
# Extent across the longest line of an object, and across its plane, as shares of the extent along the line, below which
# it turns unseen about the line, and is its own mirror image.
_THIN, _FLAT = 0.05, 1e-3

_Coordinate = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
_Length = Annotated[float, Field(gt=0.0, le=100.0)]


class _Object(BaseModel):
    model_config = ConfigDict(extra="forbid")

    points: dict[str, tuple[_Coordinate, _Coordinate, _Coordinate]] = Field({}, max_length=_MAX_POINTS)
    distances: list[tuple[str, str, _Length]] = Field([], max_length=_MAX_POINTS**2)


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    objects: dict[str, _Object] = Field({}, max_length=_MAX_POINTS)
    bones: list[tuple[str, str]] = Field([], max_length=1000)


def with_own_points(session: Session, path: StrPath) -> KeypointSession:
    """Session whose own points are parts of rigid objects, or ends of bones, as a file says.

    Parameters
    ----------
    session
        Session of keypoints with points that are no joints of people.
    path
        YAML or JSON with ``objects`` (places or distances of their points, in metres) and ``bones`` (pairs of points).

    Returns
    -------
    KeypointSession
        The session; its takes have the pose of each object, NaN in frames without one.

    Raises
    ------
    InputError
        With all problems of the file: unknown points, distances that contradict each other or fix no shape.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> _ = (folder / "racket.yaml").write_text("bones: [[tip, grip]]")
    >>> try:
    ...     multicap.with_own_points(session, folder / "racket.yaml")
    ... except multicap.InputError as error:
    ...     print(error.problems[0].message)
    The keypoint files have no points tip, grip; points of your own are none.
    """
    path = Path(path)
    known = session.own.names if isinstance(session, KeypointSession) else ()

    def refuse(complaints: list[tuple[str, str]]) -> InputError:
        hint = "See `multicap help own-points`."
        return InputError(
            [
                Problem(OWN_POINTS_INVALID, text, file=path.name, field=field or None, hint=hint)
                for field, text in complaints
            ]
        )

    try:
        with path.open("rb") as file:
            stated = _File.model_validate(read_yaml(in_utf_8(file.read(_MAX_BYTES))))
    except (OSError, UnreadableError) as error:
        reason = error.strerror if isinstance(error, OSError) else f"it is no YAML or JSON of {_MAX_BYTES >> 10} KiB"
        raise refuse([("", f"The file can't be read: {reason}.")]) from None
    except ValidationError as error:
        found = error.errors()[:_MAX_COMPLAINTS]
        raise refuse([(".".join(map(str, each["loc"])), f"{each['msg']}.") for each in found]) from None
    complaints = list(_complaints(stated, known))
    shapes = []
    for name, entry in stated.objects.items():
        try:
            shapes.append(_shape(name, entry, known))
        except DistancesError as error:
            complaints.append((f"objects.{name}", f"Of this object, {error}."))
    if complaints or not isinstance(session, KeypointSession):
        raise refuse(complaints)
    bones = tuple((_as_known(first, known), _as_known(second, known)) for first, second in stated.bones)
    parts = [f"{shape.name} of {listed_names(shape.points)}" for shape in shapes]
    message = f"{path.name} has {'; '.join([*parts, f'{len(bones)} bones'])}."
    finding = Finding(KEYPOINTS_FORM, message, severity="info")
    own = replace(session.own, shapes=tuple(shapes), bones=bones)
    return replace(session, own=own, findings=(*session.findings, finding))


def _as_known(name: str, known: tuple[str, ...]) -> str:
    """Name of a point as the session has it."""
    return name if name in known else point_names([name])[0]


def _complaints(stated: _File, known: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Fields that can't be used whatever the lengths are, each with a sentence."""
    if not stated.objects and not stated.bones:
        yield "", "The file has no objects and no bones."
    of_objects = [name for entry in stated.objects.values() for name in _points(entry)]
    used = dict.fromkeys([*of_objects, *chain(*stated.bones)])
    if unknown := [name for name in used if _as_known(name, known) not in known]:
        shown = listed_names(known) or "none"
        yield "", f"The keypoint files have no points {listed_names(unknown)}; points of your own are {shown}."
    times = Counter(_as_known(name, known) for name in of_objects)
    if twice := sorted(name for name, number in times.items() if number > 1):
        yield "objects", f"Points are named twice: {listed_names(twice)}."
    if len(set(map(_object_name, stated.objects))) < len(stated.objects):
        yield "objects", "Two objects have the same letters and digits in their names."
    if alone := [first for first, second in stated.bones if _as_known(first, known) == _as_known(second, known)]:
        yield "bones", f"Bones begin and end at one point: {listed_names(alone)}."


def _points(entry: _Object) -> list[str]:
    """Names of the points of an object, each once among its distances."""
    return [*entry.points, *dict.fromkeys(name for row in entry.distances for name in row[:2])]


def _object_name(name: str) -> str:
    return point_names([name])[0]


def _shape(name: str, entry: _Object, known: tuple[str, ...]) -> RigidShape:
    """Shape of an object; raises ``DistancesError`` if it is none that has poses."""
    if bool(entry.points) == bool(entry.distances):
        raise DistancesError("either points or distances are to be stated")
    points = _points(entry)
    if not 3 <= len(points) <= _MAX_POINTS:
        raise DistancesError(f"3 to {_MAX_POINTS} points are needed; there are {len(points)}")
    xyz_m = np.array(list(entry.points.values()))
    if entry.distances:
        distances_m = np.where(np.eye(len(points)), 0.0, np.nan)
        for first, second, length_m in entry.distances:
            pair = points.index(first), points.index(second)
            if not np.isnan(distances_m[pair]):
                raise DistancesError(f"the distance of {first} and {second} is stated twice, or of one point")
            distances_m[pair] = distances_m[pair[::-1]] = length_m
        xyz_m = places_from_distances(points, distances_m)
    extents_m = np.linalg.svd(xyz_m - xyz_m.mean(0), compute_uv=False)
    if extents_m[1] <= _THIN * extents_m[0]:
        raise DistancesError("the points are on one line, about which it can turn unseen: add a point beside it")
    has_sides = bool(entry.points) or bool(extents_m[2] <= _FLAT * extents_m[0])
    return RigidShape(_object_name(name), tuple(_as_known(point, known) for point in points), xyz_m, has_sides)


# Error of a measured distance, as a share of the largest one.
_MAX_ERROR = 0.03
# Steps of least squares at most, and the largest way of a point in the last one, as a share of the largest distance.
_MAX_STEPS, _LAST_STEP = 500, 1e-7


class DistancesError(ValueError):
    """Distances contradict each other, or do not fix a shape; the message says which."""


def places_from_distances(
    names: Sequence[str], distances_m: Float[np.ndarray, "points points"]
) -> Float[np.ndarray, "points 3"]:
    """Places (metres) of points around their middle from all their distances; symmetric, NaN where one is not stated.

    Raises ``DistancesError`` if a distance is missing, or no points have the distances within 3 % of the largest.

    Examples
    --------
    >>> places_m = places_from_distances("abc", np.array([[0.0, 3.0, 4.0], [3.0, 0.0, 5.0], [4.0, 5.0, 0.0]]))
    >>> float(np.linalg.norm(places_m[0] - places_m[2]).round(6))
    4.0
    """
    pairs = list(combinations(range(len(names)), 2))
    if missing := [f"{names[i]} to {names[j]}" for i, j in pairs if np.isnan(distances_m[i, j])]:
        raise DistancesError(f"several shapes have these distances; state {', '.join(missing[:8])}, too")
    centring = np.eye(len(names)) - 1.0 / len(names)
    values, vectors = np.linalg.eigh(-0.5 * centring @ distances_m**2 @ centring)
    places_m = vectors[:, :-4:-1] * np.sqrt(np.maximum(values[:-4:-1], 0.0))
    for _ in range(_MAX_STEPS):
        before_m, found_m = places_m, _apart_m(places_m)
        share = np.divide(distances_m, found_m, out=np.zeros_like(found_m), where=found_m > 0)
        places_m = (share.sum(1, keepdims=True) * before_m - share @ before_m) / len(names)
        if np.abs(places_m - before_m).max() <= _LAST_STEP * distances_m.max():
            break
    found_m = _apart_m(places_m)
    miss_m = np.abs(found_m - distances_m)
    if miss_m.max() > _MAX_ERROR * distances_m.max():
        worst = sorted(pairs, key=lambda pair: -miss_m[pair].round(4))[:3]
        shown = [f"{names[i]} to {names[j]} is {distances_m[i, j]:g} (fits {found_m[i, j]:.3g})" for i, j in worst]
        raise DistancesError(f"the distances contradict each other, in metres: {', '.join(shown)}")
    return places_m


def _apart_m(places_m: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points points"]:
    return np.linalg.norm(places_m[:, None] - places_m, axis=-1)
