"""Joints from named 3D points: our names, keypoint layouts, bones of characters, Plug-in Gait, Theia's segments.

Names of Plug-in Gait: Vicon Nexus, "Plug-in Gait Reference Guide" (markers; origins of the segments are joint centres).
Names of Theia's segments: https://docs.theiamarkerless.com. Hip centres from markers of the pelvis: Harrington et al.,
"Prediction of the hip joint centre in adults, children, and patients with cerebral palsy", J. Biomech. 40 (2007).
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.capture.keypoint_files.people import JOINT_SETS
from pipeline.capture.keypoint_files.points import match_joint
from pipeline.core.joints import SIDES, JointSet

# Names of the left side's points of a joint, in small letters and digits alone, the best first; + is a mean. Before
# ``|`` centres of joints: origins of Plug-in Gait's and Theia's segments, and bones of characters; after it markers.
_POINTS: Mapping[str, str] = {
    "shoulder": "lclo luarm4x4 leftarm leftupperarm upperarml | lsho lac lacr lacromion lacromium",
    "elbow": "lhuo llarm4x4 leftforearm leftlowerarm lowerarml forearml "
    "| lelb+lelbm lelb+lmel llel+lmel lelbowlat+lelbowmed lelb lelbowlat",
    "wrist": "lrao lhand4x4 lefthand handl | lwra+lwrb lwrl+lwrm lwristlat+lwristmed lwri",
    "hip": "lfep lthigh4x4 leftupleg leftupperleg upperlegl thighl lhjc |",
    "knee": "lfeo lshank4x4 leftleg leftlowerleg lowerlegl calfl shinl lkjc "
    "| lkne+lknem lkne+lknm lkne+lmkne lkneelat+lkneemed lkne lkneelat",
    "ankle": "ltio lfoot4x4 leftfoot footl lajc | lank+lankm lank+lmed lank+lmma lanklelat+lanklemed lank lanklelat",
    "heel": "| lhee lheel",
    "big_toe": "leftfootend lefttoebase lefttoes balll toel toesl ltoes4x4 | ltoe lphal1 lmt1",
    "ear": "| lfhd+lbhd",
}
_OTHERS = {
    "neck": "neck",
    "midhip": "mid_hip",
    "pelvis": "mid_hip",
    "lsmalltoe": "left_small_toe",
    "rsmalltoe": "right_small_toe",
}
_NECK_SETS = sorted(JOINT_SETS.values(), key=lambda joints: len(joints.names))
OWN_NAMES = {name for joints in _NECK_SETS for name in joints.names}
_PELVIS = (
    ("lasi", "rasi", "lpsi", "rpsi"),
    ("lasis", "rasis", "lpsis", "rpsis"),
    ("lasis", "rasis", "lbackasis", "rbackasis"),
)


def find_joints(names: Sequence[str], table: Mapping[str, str]) -> tuple[dict[str, list[int]], list[str]]:
    """Points whose mean each joint is, by the joint's name, and joints that are markers on the skin.

    ``table`` has joints by the user's names, and comes first.
    """
    index: dict[str, int] = {}
    for k, name in enumerate(names):
        index.setdefault(_plain(name), k)
    found: dict[str, list[int]] = {}
    marks = []
    for k, name in enumerate(names):
        if name in table or (name in OWN_NAMES and name not in table.values()):
            found.setdefault(table.get(name, name), []).append(k)
    for is_marker in (False, True):
        for part, choices in _POINTS.items():
            for side in SIDES:
                options = choices.split("|")[is_marker].split()
                chosen = next((points for option in options if (points := _indices(option, side, index))), None)
                if chosen and f"{side}_{part}" not in found:
                    found[f"{side}_{part}"] = chosen
                    marks += [f"{side}_{part}"] * is_marker
        if not is_marker:
            for k, name in enumerate(names):
                joint = match_joint(name) or _OTHERS.get(_plain(name))
                if joint is not None:
                    found.setdefault(joint, [k])
    return found, marks


def joint_set(found: Mapping[str, object]) -> JointSet:
    """Smallest joint set of keypoint files that has the found joints."""
    return next((joints for joints in _NECK_SETS if set(found) <= set(joints.names)), _NECK_SETS[-1])


def pelvis_points(names: Sequence[str]) -> list[int] | None:
    """Points of the pelvis of Plug-in Gait: front left and right, back left and right."""
    plain = [_plain(name) for name in names]
    known = next((pelvis for pelvis in _PELVIS if set(pelvis) <= set(plain)), None)
    return None if known is None else [plain.index(name) for name in known]


def hip_centers_m(points_m: Float[np.ndarray, "frames 4 3"]) -> Float[np.ndarray, "2 frames 3"]:
    """Centres of the left and the right hip from the points of the pelvis in metres (Harrington et al. 2007)."""
    front, back = points_m[:, :2].mean(1), points_m[:, 2:].mean(1)
    width = np.linalg.norm(points_m[:, 1] - points_m[:, 0], axis=-1, keepdims=True)
    depth = np.linalg.norm(front - back, axis=-1, keepdims=True)
    right = (points_m[:, 1] - points_m[:, 0]) / width
    up = np.cross(right, front - back)
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    ahead = np.cross(up, right)
    middle = front - (0.24 * depth + 0.0099) * ahead - (0.30 * width + 0.0109) * up
    aside = (0.33 * width + 0.0073) * right
    return np.stack([middle - aside, middle + aside])


def _plain(name: str) -> str:
    return re.sub("[^a-z0-9]", "", name.lower().removeprefix("mixamorig"))


def _indices(option: str, side: str, index: Mapping[str, int]) -> list[int]:
    """Points of an option for a side; none if one is missing."""
    names = [_of_side(name, side) for name in option.split("+")]
    return [index[name] for name in names] if all(name in index for name in names) else []


def _of_side(name: str, side: str) -> str:
    if side == "left":
        return name
    if name.startswith("left"):
        return f"right{name.removeprefix('left')}"
    return f"r{name[1:]}" if name.startswith("l") else f"{name[:-1]}r"
