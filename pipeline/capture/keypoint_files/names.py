"""Names of points, which files or their users choose, as joints of ours."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.joints import BODY_FEET, COCO_17, SIDES
from pipeline.layouts import Layout

_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+", re.ASCII)
# In MPII's order, which human models of DeepLabCut follow, the right side is first: ankle1 is the right ankle.
_SIDE: Mapping[str, str] = {"left": "left", "l": "left", "2": "left", "right": "right", "r": "right", "1": "right"}
_PARTS: Mapping[str, str] = {
    **{name.removeprefix("left_"): name.removeprefix("left_") for name in BODY_FEET.names if name.startswith("left_")},
    **dict.fromkeys(("bigtoe", "greattoe", "footindex", "toe"), "big_toe"),
}
_MAX_NAME, _MAX_POINTS = 100, 1000
REQUIRED = tuple(f"{side}_{part}" for part in ("shoulder", "hip") for side in SIDES)
"""Joints without which there is no trunk, and so no skeleton."""


def joint_of(name: str) -> str | None:
    """Joint of ``BODY_FEET`` that a point is named after; ``None`` if it is none of them.

    The side is a word or a letter, before or after the part: ``left_shoulder``, ``LShoulder``, ``shoulder_l``,
    ``lshoulder``; or 1 (right) or 2 (left) after it.

    Examples
    --------
    >>> [joint_of(name) for name in ("LShoulder", "rknee", "ankle1", "Left big toe", "Nose", "tail")]
    ['left_shoulder', 'right_knee', 'right_ankle', 'left_big_toe', 'nose', None]
    """
    words = [word.lower() for word in _WORD.findall(name[:_MAX_NAME])]
    if words == ["nose"]:
        return "nose"
    sides = [_SIDE[word] for word in words if word in _SIDE]
    part = "".join(word for word in words if word not in _SIDE)
    if not sides and part not in _PARTS:
        prefix = next((one for one in ("left", "right", "l", "r") if part.removeprefix(one) in _PARTS), "")
        sides, part = [_SIDE[prefix]] if prefix else [], part.removeprefix(prefix)
    return f"{sides[0]}_{_PARTS[part]}" if len(sides) == 1 and part in _PARTS else None


def named_layout(names: Sequence[str], field: str) -> Layout:
    """Layout of points with these names: joints of ``COCO_17``, with heels and big toes if one of them is named.

    Raises
    ------
    KeypointsError
        If there are too many points, if two of them are one joint, or if a shoulder or a hip is missing.
    """
    if len(names) > _MAX_POINTS:
        raise KeypointsError(f"There are names of {len(names)} points; at most {_MAX_POINTS} are allowed.", field)
    points = tuple(joint_of(name) for name in names)
    used = [point for point in points if point is not None]
    for joint, count in Counter(used).items():
        if count > 1:
            twice = ", ".join([name for name, point in zip(names, points, strict=True) if point == joint][:3])
            raise KeypointsError(f"Several points are the joint {joint}: {twice}.", field)
    if missing := [joint for joint in REQUIRED if joint not in used]:
        message = f"No point is named after the joints {', '.join(missing)}; shoulders and hips are required."
        raise KeypointsError(message, field)
    joints = COCO_17 if set(used) <= set(COCO_17.names) else BODY_FEET
    return Layout(f"named-{len(points)}", points, joints)
