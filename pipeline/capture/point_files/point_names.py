"""Joints from named 3D points: our names, keypoint layouts, bones of characters, marker sets, Theia's segments.

Names of Plug-in Gait: Vicon Nexus, "Plug-in Gait Reference Guide" (markers; origins of the segments are joint centres).
Other sets of markers as in public files: Helen Hayes of Cortex and OpenSim, van Sint Jan's landmarks of Qualisys,
Rajagopal's, OpenCap's, and Vicon's of the CMU database.
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

# Points of a joint in small letters and digits alone, the best first. L is the letter of the side, LEFT its word, + a
# mean. Before ``|`` centres of joints: origins of Plug-in Gait's and Theia's segments, bones of characters, and centres
# that laboratories add; after it markers on the skin.
_POINTS: Mapping[str, str] = {
    "shoulder": "Lclo Luarm4x4 LEFTarm LEFTupperarm upperarmL Lsjc Lgh "
    "| Lsho Lac Lacr Lacromion Lacromium Lsae Lacp Lfsh+Lbsh Lshouldertop Lshould Lshoulder",
    "elbow": "Lhuo Llarm4x4 LEFTforearm LEFTlowerarm lowerarmL forearmL Lejc "
    "| Lelb+Lelbm Lelb+Lmel Lelb+Liel Llel+Lmel Llelbow+Lmelbow Lelbow+Lmelbow Lelbowlat+Lelbowmed Lelbowout+Lelbowin "
    "Lhle+Lhme Lepilat+Lepimed Lcubl+Lcubm Lelb Lelbowlat Lelbowout Lhle Llel Lelbow",
    "wrist": "Lrao Lhand4x4 LEFThand handL Lwjc "
    "| Lwra+Lwrb Lwrl+Lwrm Lwristlat+Lwristmed Lwristout+Lwristin Lwristradius+Lwristulna Lwristrad+Lwristuln "
    "Llwrist+Lmwrist Lrsp+Lusp Lwrr+Lwru Lowr+Liwr Lfaradius+Lfaulna Lwri Lwr Lwrist",
    "hip": "Lfep Lthigh4x4 LEFTupleg LEFTupperleg upperlegL thighL Lhjc LEFThipcenter |",
    "knee": "Lfeo Lshank4x4 LEFTleg LEFTlowerleg lowerlegL calfL shinL Lkjc Lkneejoint "
    "| Lkne+Lknem Lkne+Lknm Lkne+Lmkne Lkne+Lkni Lkne+Lknein Lknel+Lknem Lknee+Lmknee Lknee+Lkneemedial "
    "Lkneelat+Lkneemed Lkneeout+Lkneein Lfle+Lfme Llfc+Lmfc Llkn+Lmkn "
    "Lkne Lkneelat Lkneeout Lfle Llfc Llepi Lknel Lknee Lknee1",
    "ankle": "Ltio Lfoot4x4 LEFTfoot footL Lajc Lanklejoint "
    "| Lank+Lankm Lank+Lmed Lank+Lmma Lank+Lankin Lankle+Lmankle Lankle+Lanklemedial Lanklelat+Lanklemed "
    "Lankleout+Lanklein Lfal+Ltam Llmal+Lmmal Lmall+Lmalm Llak+Lmak "
    "Lank Lanklelat Lankleout Lfal Llmal Lmall Llak Lankle",
    "heel": "| Lhee Lheel Lhel Lcal Lcalc Lfcc Lheelback Lcalca",
    "big_toe": "LEFTfootend LEFTtoebase LEFTtoes ballL toeL toesL Ltoes4x4 | Ltoe Lphal1 Lmt1 Lfm1 Ltoetip",
    "ear": "| Lfhd+Lbhd Ltemple",
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
# Points of the pelvis: pairs in front, pairs behind, and single points in the middle behind
_FRONT = ("Lasi", "Lasis", "Lias", "Lfwt", "waistLfront", "Leias")
_BACK = ("Lpsi", "Lpsis", "Lips", "Lbackasis", "Lbwt", "waistLback", "Leips")
_SACRUM = ("sacr", "sacrum", "sacral", "vsacral", "vsac")


def find_joints(names: Sequence[str], table: Mapping[str, str]) -> tuple[dict[str, list[int]], list[str]]:
    """Points whose mean each joint is, by the joint's name, and joints that are markers on the skin.

    ``table`` has joints by the user's names, and comes first.
    """
    index: dict[str, int] = {}
    # OpenCap's markers have the names of its keypoints and a suffix.
    for k in sorted(range(len(names)), key=lambda k: not names[k].endswith("_study")):
        index.setdefault(_plain(names[k]), k)
    found: dict[str, list[int]] = {}
    marks = []
    for k, name in enumerate(names):
        if name in table or (name in OWN_NAMES and name not in table.values()):
            found.setdefault(table.get(name, name), []).append(k)
    has_markers = pelvis_points(names) is not None
    for is_marker in (False, True):
        for part, choices in _POINTS.items():
            for side in SIDES:
                options = choices.split("|")[is_marker].split()
                chosen = next((points for option in options if (points := _indices(option, side, index))), None)
                if chosen and f"{side}_{part}" not in found:
                    found[f"{side}_{part}"] = chosen
                    marks += [f"{side}_{part}"] * is_marker
        if is_marker != has_markers:
            continue
        for k, name in enumerate(names):
            joint = match_joint(name) or _OTHERS.get(_plain(name))
            # A hip beside the points of the pelvis is a marker on the thigh.
            if joint is not None and not (has_markers and joint.endswith("hip")):
                found.setdefault(joint, [k])
    return found, marks


def joint_set(found: Mapping[str, object]) -> JointSet:
    """Smallest joint set of keypoint files that has the found joints."""
    return next((joints for joints in _NECK_SETS if set(found) <= set(joints.names)), _NECK_SETS[-1])


def pelvis_points(names: Sequence[str]) -> list[int] | None:
    """Markers of the pelvis: front left and right, back left and right, which are one if it is in the middle."""
    plain = [_plain(name) for name in names]
    pairs = [[_of_side(name, side) for side in SIDES] for name in _FRONT]
    behind = [[_of_side(name, side) for side in SIDES] for name in _BACK] + [[name, name] for name in _SACRUM]
    ends = [next((pair for pair in options if {*pair} <= {*plain}), None) for options in (pairs, behind)]
    return None if None in ends else [plain.index(name) for pair in ends if pair for name in pair]


def hip_centers_m(points_m: Float[np.ndarray, "frames 4 3"]) -> Float[np.ndarray, "2 frames 3"]:
    """Centres of the left and the right hip from the points of the pelvis in metres (Harrington et al. 2007)."""
    front, back = points_m[:, :2].mean(1), points_m[:, 2:].mean(1)
    width = np.linalg.norm(points_m[:, 1] - points_m[:, 0], axis=-1, keepdims=True)
    depth = np.linalg.norm(front - back, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):  # points in one place have no direction
        right = (points_m[:, 1] - points_m[:, 0]) / width
        up = np.cross(right, front - back)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
    ahead = np.cross(up, right)
    middle = front - (0.24 * depth + 0.0099) * ahead - (0.30 * width + 0.0109) * up
    aside = (0.33 * width + 0.0073) * right
    return np.stack([middle - aside, middle + aside])


def _plain(name: str) -> str:
    return re.sub("[^a-z0-9]", "", name.lower().removeprefix("mixamorig").removesuffix("_study"))


def _indices(option: str, side: str, index: Mapping[str, int]) -> list[int]:
    """Points of an option for a side; none if one is missing."""
    names = [_of_side(name, side) for name in option.split("+")]
    return [index[name] for name in names] if all(name in index for name in names) else []


def _of_side(name: str, side: str) -> str:
    return name.replace("LEFT", side).replace("L", side[0])
