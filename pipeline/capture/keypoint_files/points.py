"""Points in the order of a file, as joints in the order of a joint set; names of points as joints of ours."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from pipeline.capture.keypoint_files.own_points import OwnPoints, point_names
from pipeline.capture.keypoint_files.people import (
    MAX_PEOPLE,
    CrowdError,
    KeypointsError,
    People,
    is_detected,
    with_detected_joints,
)
from pipeline.core.joints import BODY_FEET, COCO_17, SIDES, without_hands
from pipeline.core.layouts import FILE_LAYOUTS, LAYOUTS, KeypointLayout
from pipeline.core.parsing import KEYPOINT_PX

# Layouts with hands: points of fingers have names of each file's own, so that the number tells the layout.
_WHOLE = {len(LAYOUTS[name].points): LAYOUTS[name] for name in ("coco-wholebody-133", "halpe-136")}
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+", re.ASCII)
# In MPII's order, which human models of DeepLabCut follow, the right side is first: ankle1 is the right ankle.
_SIDE: Mapping[str, str] = {"left": "left", "l": "left", "2": "left", "right": "right", "r": "right", "1": "right"}
_PARTS: Mapping[str, str] = {
    **{name.removeprefix("left_"): name.removeprefix("left_") for name in BODY_FEET.names if name.startswith("left_")},
    **dict.fromkeys(("bigtoe", "greattoe", "footindex", "toe"), "big_toe"),
}
# Further words of names of human points: points of layouts of people alone, without a shoulder or a hip, are an error.
_HUMAN = {
    *("head", "face", "neck", "chin", "forehead", "mouth", "lip", "jaw", "top"),
    *("of", "mid", "center", "middle", "small"),
    *("chest", "thorax", "sternum", "torso", "trunk", "spine", "pelvis", "hips", "shoulders", "hand", "palm", "thumb"),
    *("index", "ring", "pinky", "finger", "fingers", "fingertip", "tip", "mcp", "pip", "dip", "foot", "toes", "midhip"),
}
_MAX_NAME, _MAX_POINTS = 100, 1000
REQUIRED = tuple(f"{side}_{part}" for part in ("shoulder", "hip") for side in SIDES)
"""Joints without which there is no trunk, and so no skeleton."""


def layout_of_names(names: Sequence[str], field: str) -> KeypointLayout:
    """Layout of points with names; raises ``KeypointsError`` if they are not a body's."""
    return _WHOLE.get(len(names)) or named_layout(names, field)


def arranged(points: People, layout: KeypointLayout) -> People:
    """Points of people as the joints of their layout; joints without a point, and hands alone, are not detected.

    Axes are people, points of the layout, and x, y and score; axes of the result are people, joints of
    ``layout.joints`` (without fingers if no person has a finger), and x, y and score.
    """
    joints, taken = _chosen(layout)
    people = np.zeros((len(points), len(layout.joints.names), 3))
    people[:, joints] = points[:, taken]
    num_body = len(without_hands(layout.joints).names)
    return people if people[:, num_body:].any() else people[:, :num_body]


@lru_cache(maxsize=64)
def _chosen(layout: KeypointLayout) -> tuple[list[int], list[int]]:
    """Joints that have a point, and their points."""
    joints = [k for k, name in enumerate(layout.joints.names) if name in layout.points]
    return joints, [layout.points.index(layout.joints.names[k]) for k in joints]


def match_joint(name: str) -> str | None:
    """Joint of ``BODY_FEET`` that a point is named after; ``None`` if it is none of them.

    The side is a word or a letter, before or after the part: ``left_shoulder``, ``LShoulder``, ``shoulder_l``,
    ``lshoulder``; or 1 (right) or 2 (left) after it.

    >>> [match_joint(name) for name in ("LShoulder", "rknee", "ankle1", "Left big toe", "Nose", "tail")]
    ['left_shoulder', 'right_knee', 'right_ankle', 'left_big_toe', 'nose', None]
    """
    words = _words(name)
    if words == ["nose"]:
        return "nose"
    sides = [_SIDE[word] for word in words if word in _SIDE]
    part = "".join(word for word in words if word not in _SIDE)
    if not sides and part not in _PARTS:
        prefix = next((side for side in ("left", "right", "l", "r") if part.removeprefix(side) in _PARTS), "")
        sides, part = [_SIDE[prefix]] if prefix else [], part.removeprefix(prefix)
    return f"{sides[0]}_{_PARTS[part]}" if len(sides) == 1 and part in _PARTS else None


def _words(name: str) -> list[str]:
    return [word.lower() for word in _WORD.findall(name[:_MAX_NAME])]


def _is_human(name: str) -> bool:
    return (
        match_joint(name) is not None or {*filter(str.isalpha, _words(name))} <= _HUMAN | _PARTS.keys() | _SIDE.keys()
    )


def named_layout(names: Sequence[str], field: str) -> KeypointLayout:
    """Layout of points with these names: joints of ``COCO_17``, with heels and big toes if one of them is named.

    Other points are the user's own. Without any shoulder, or any hip, all points are the user's own, of animals, unless
    the names are a person's.

    Raises ``KeypointsError`` if there are too many points, if two of them are one joint, or if a shoulder or a hip of a
    person is missing.
    """
    if len(names) > _MAX_POINTS:
        raise KeypointsError(f"There are names of {len(names)} points; at most {_MAX_POINTS} are allowed.", field)
    points = tuple(match_joint(name) for name in names)
    has_trunk = len({joint.partition("_")[2] for joint in {*REQUIRED} & {*points}}) == len(REQUIRED) // len(SIDES)
    if names and not has_trunk and not (any(points) and all(map(_is_human, names))):
        name, count = Counter(names).most_common(1)[0]
        if count > 1:
            raise KeypointsError(f"Several points have the name {name[:_MAX_NAME]!r}.", field)
        return KeypointLayout(f"named-{len(points)}", (None,) * len(points), COCO_17, _own(names, range(len(names))))
    used = [point for point in points if point is not None]
    for joint, count in Counter(used).items():
        if count > 1:
            twice = ", ".join([name for name, point in zip(names, points, strict=True) if point == joint][:3])
            raise KeypointsError(f"Several points are the joint {joint}: {twice}.", field)
    if missing := [joint for joint in REQUIRED if joint not in used]:
        message = f"No point is named after the joints {', '.join(missing)}; shoulders and hips are required."
        if not has_trunk:
            message += " Add them; for animals, add a point that people lack, such as tail."
        raise KeypointsError(message, field)
    joints = COCO_17 if set(used) <= set(COCO_17.names) else BODY_FEET
    others = [place for place, point in enumerate(points) if point is None]
    return KeypointLayout(f"named-{len(points)}", points, joints, _own(names, others))


def _own(names: Sequence[str], places: Sequence[int]) -> tuple[tuple[int, str], ...]:
    return tuple(zip(places, point_names([names[place] for place in places]), strict=True))


CANDIDATES: Mapping[int, tuple[KeypointLayout, ...]] = {
    count: tuple(layout for layout in FILE_LAYOUTS.values() if len(layout.points) == count)
    for count in sorted({len(layout.points) for layout in FILE_LAYOUTS.values()})
}
"""Layouts by number of points, the usual one first: of several it has all joints in the order of its points."""


class KeypointReading:
    """Reading of the keypoint files of a camera.

    Parameters
    ----------
    size_px
        Width and height of the camera's images; ``None`` if unknown.

    Attributes
    ----------
    forms
        Names of the formats that were read.
    counts
        Numbers of points of a person in files that do not name the points.

    Examples
    --------
    >>> reading = KeypointReading((1920, 1080))
    >>> reading.layout(17, "points").name, reading.counts
    ('coco-17', {17})
    """

    def __init__(self, size_px: tuple[int, int] | None) -> None:
        self.size_px = size_px
        self.forms: set[str] = set()
        self.counts: set[int] = set()
        self._own: list[OwnPoints] = []

    def layout(self, points: int | Sequence[str], field: str) -> KeypointLayout:
        """Layout of points by their names or, if a file does not name them, by their number.

        By the number it is the first of ``CANDIDATES``, until ``layout_choice`` tells the right one. Raises
        ``KeypointsError`` if there is none; ``field`` is the name of the points' field.
        """
        if not isinstance(points, int):
            return layout_of_names(points, field)
        if points not in CANDIDATES:
            known = ", ".join(FILE_LAYOUTS)
            raise KeypointsError(f"A person has {points} points; layouts that are read are {known}.", field)
        self.counts.add(points)
        return CANDIDATES[points][0]

    def people(self, points: People, layout: KeypointLayout) -> People:
        """People with a detected joint, by the points of all listed people in the order of a layout; see ``arranged``.

        Points of the user's own are noted for ``take_own``. Raises ``KeypointsError`` if a joint is not within the
        limits, ``CrowdError`` if there are too many people.
        """
        people = arranged(points, layout)
        if layout.own:
            places, names = zip(*layout.own, strict=True)
            own, is_person = points[:, places], is_detected(people).any(-1)
            others, nothing = own[~is_person], own[:0]
            others = others[is_detected(others).any(-1)]
            self.add_own(names, own[is_person], *((others, nothing) if layout.has_people else (nothing, others)))
        return with_detected_joints(people)

    def add_own(self, names: Sequence[str], of_people: People, of_scene: People, of_animals: People) -> None:
        """Note points of the user's own in the frame that is read.

        Raises ``KeypointsError`` if a point is not within the limits, ``CrowdError`` if there are too many animals.
        """
        if len(of_animals) > MAX_PEOPLE:
            raise CrowdError(len(of_animals))
        for own in (of_people, of_scene, of_animals):
            if not KEYPOINT_PX.holds(own[is_detected(own), :2]):
                raise KeypointsError(f"A coordinate of a point is not within {KEYPOINT_PX}.")
        self._own.append(OwnPoints(tuple(names), of_people, of_scene, of_animals))

    def take_own(self) -> Sequence[OwnPoints]:
        """Points noted since the last call, each once."""
        taken, self._own = self._own, []
        return taken
