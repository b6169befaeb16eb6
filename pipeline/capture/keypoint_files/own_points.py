"""Points of the user's own in keypoint files: their names, and their way beside the joints of people.

Until scores and positions have their units, own points of a frame are columns behind the joints of its people, and
points of no person are a last row, behind rows of animals, which have no joints.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.capture.keypoint_files.people import KeypointsError, People, is_detected
from pipeline.core.joints import BODY_25, WHOLE_BODY

MAX_OWN = 200
"""Limit on the names of own points of a session."""
_MAX_NAME = 60
_TAKEN = {*BODY_25.names, *WHOLE_BODY.names, "center_of_mass", "extrapolated_center_of_mass"}


class OwnPoints(NamedTuple):
    """Points of the user's own in a frame: x, y and score."""

    names: tuple[str, ...]
    of_people: Float[np.ndarray, "people points 3"]  # Points of the people with a detected joint
    of_scene: Float[np.ndarray, "rows points 3"]  # Points of rows without a detected joint
    of_animals: Float[np.ndarray, "rows points 3"]  # Points of rows whose points are all own points


def point_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names that every result file can hold: letters and digits of ASCII, and underscores, each name once.

    >>> point_names(["Racket tip", "racket-tip", "Schläger", "neck", "2nd"])
    ('Racket_tip', 'racket_tip', 'Schlager', 'neck_point', 'p2nd')
    """
    found: dict[str, None] = {}
    for number, name in enumerate(names, 1):
        plain = unicodedata.normalize("NFKD", name[:_MAX_NAME]).encode("ascii", "ignore").decode()
        plain = re.sub(r"\W+", "_", plain).strip("_") or f"point_{number}"
        plain = f"p{plain}" if plain[0].isdigit() else plain
        plain = f"{plain}_point" if plain in _TAKEN else plain
        k = 1
        while (unique := plain if k == 1 else f"{plain}_{k}") in found:
            k += 1
        found[unique] = None
    return tuple(found)


def with_own(
    frames: Mapping[int, People], own: Mapping[int, Sequence[OwnPoints]]
) -> tuple[dict[int, People], tuple[str, ...]]:
    """People of a camera's frames with own points behind their joints, and the points' names; see the module.

    Without own points the frames stay as they are. Raises ``KeypointsError`` if there are too many names.
    """
    names = tuple(dict.fromkeys(name for of_frame in own.values() for points in of_frame for name in points.names))
    if len(names) > MAX_OWN:
        message = f"The files name {len(names)} points that are no joints; at most {MAX_OWN} are followed."
        raise KeypointsError(message)
    if not names:
        return dict(frames), names
    extended: dict[int, People] = {}
    for number, people in frames.items():
        num_animals = sum(len(points.of_animals) for points in own.get(number, ()))
        joined = np.zeros((len(people) + num_animals + 1, people.shape[1] + len(names), 3))
        joined[: len(people), : people.shape[1]] = people
        places, row_of_animal = joined[:, people.shape[1] :], len(people)
        for points in own.get(number, ()):
            columns = [names.index(name) for name in points.names]
            if len(points.of_people):
                places[: len(people), columns] = points.of_people
            rows = slice(row_of_animal, row_of_animal + len(points.of_animals))
            places[rows, columns] = points.of_animals
            row_of_animal = rows.stop
            for row in points.of_scene:
                is_better = is_detected(row) & (row[:, 2] > places[-1, columns, 2])
                places[-1, columns] = np.where(is_better[:, None], row, places[-1, columns])
        extended[number] = joined
    return extended, names


class OwnFrames(NamedTuple):
    """Own points of a camera's frames, in the order of the frames."""

    of_people: Sequence[People]
    of_scene: Sequence[People]
    of_animals: Sequence[People]


def split_own(
    frames: Mapping[int, People], names: Sequence[str], all_names: Sequence[str]
) -> tuple[dict[int, People], OwnFrames]:
    """People of a camera's frames of ``with_own``, and their own points in the order of all cameras' names."""
    columns = [all_names.index(name) for name in names]
    people: dict[int, People] = {}
    own: list[tuple[People, People, People]] = []
    for number, joined in frames.items():
        num_joints, num_rows = joined.shape[1] - len(names), len(joined) - bool(names)
        points = np.zeros((len(joined), len(all_names), 3))
        points[:, columns] = joined[:, num_joints:]
        rows, scene = points[:num_rows], points[num_rows:]
        is_person = is_detected(joined[:num_rows, :num_joints]).any(-1)
        people[number] = joined[:num_rows, :num_joints][is_person]
        own.append((rows[is_person], scene[is_detected(scene).any(-1)], rows[~is_person]))
    return people, OwnFrames(*(list(part) for part in zip(*own, strict=True))) if own else OwnFrames((), (), ())
