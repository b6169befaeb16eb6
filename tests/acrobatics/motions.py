"""Acrobatic motions as key poses.

The angles are ``anatomy.ANGLE_NAMES`` in degrees; angles of limbs hold for both sides unless a side is named.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tests.acrobatics.key_poses import KeyPose

_LEFT_FOOT, _RIGHT_FOOT = ("left_heel", "left_big_toe"), ("right_heel", "right_big_toe")
_FEET = (*_LEFT_FOOT, *_RIGHT_FOOT)
_TOES = ("left_big_toe", "right_big_toe")
_HANDS = ("left_wrist", "right_wrist")
_INSTEPS = ("left_ankle", "right_ankle")
_KNEES = ("left_knee", "right_knee")
_BACK = ("left_hip", "right_hip", "left_shoulder", "right_shoulder")


@dataclass(frozen=True, slots=True)
class ActingPart:
    """Key poses of a person, the middle of the way of the hips, and the heading in degrees."""

    keys: tuple[KeyPose, ...]
    center_m: tuple[float, float] = (0.0, 0.0)
    facing_deg: float = 0.0


_STAND = {"arm_raise": 8.0, "arm_aside": 10.0, "elbow": 12.0, "leg_raise": 2.0, "knee": 4.0}
_ARMS_UP = {**_STAND, "arm_raise": 172.0, "arm_aside": 6.0, "elbow": 8.0}
_SUPINE = {"pitch": -90.0, "arm_aside": 22.0, "elbow": 12.0, "leg_aside": 7.0, "knee": 4.0, "point_toes": 35.0}
_CURLED = {
    "spine_bend": 70.0, "nod": 45.0, "arm_raise": 55.0, "elbow": 70.0, "leg_raise": 115.0, "knee": 115.0,
    "point_toes": 10.0,
}  # fmt: skip
_ON_KNEES = {"leg_raise": 3.0, "knee": 92.0, "point_toes": 76.0, "arm_aside": 10.0, "elbow": 25.0}
_ON_HEELS = {
    "leg_raise": 75.0, "knee": 165.0, "point_toes": 76.0, "arm_raise": 25.0, "elbow": 45.0, "spine_bend": 8.0,
}  # fmt: skip
_HANGING = {"arm_raise": 176.0, "arm_aside": 10.0, "elbow": 4.0, "knee": 12.0, "point_toes": 35.0}
_ALL_FOURS = {
    "pitch": 78.0, "spine_bend": 8.0, "nod": -35.0, "arm_raise": 82.0, "elbow": 8.0, "leg_raise": 80.0, "knee": 92.0,
    "point_toes": 65.0,
}  # fmt: skip


def _crawl(num_steps: int) -> tuple[KeyPose, ...]:
    """Crawl on hands and knees; a hand and the knee of the other side move together."""
    keys = [KeyPose(0.0, _ALL_FOURS, (*_HANDS, *_KNEES))]
    for step in range(num_steps):
        ahead, behind = ("left", "right") if step % 2 else ("right", "left")
        reached = {
            **_ALL_FOURS,
            f"{ahead}_arm_raise": 104.0, f"{behind}_arm_raise": 66.0,
            f"{ahead}_leg_raise": 64.0, f"{behind}_leg_raise": 94.0,
        }  # fmt: skip
        standing = f"{behind}_wrist", f"{ahead}_knee"
        lifted = {**reached, f"{ahead}_elbow": 50.0, f"{behind}_knee": 100.0}
        keys.append(KeyPose(0.4 + 0.9 * step, {**_between(keys[-1].angles_deg, lifted)}, standing))
        keys.append(KeyPose(0.75 + 0.9 * step, reached, (*_HANDS, *_KNEES)))
        keys.append(KeyPose(0.9 + 0.9 * step, reached, (*_HANDS, *_KNEES)))
    return tuple(keys)


def _between(first: Mapping[str, float], second: Mapping[str, float]) -> dict[str, float]:
    """Pose half-way between two poses."""
    return {name: (_angle(first, name) + _angle(second, name)) / 2 for name in {**first, **second}}


def _angle(pose: Mapping[str, float], name: str) -> float:
    return pose.get(name, pose.get(name.partition("_")[2], 0.0))


_LYING = (
    KeyPose(0.0, _SUPINE, _BACK),
    KeyPose(1.2, _SUPINE, _BACK),
    KeyPose(2.4, {**_SUPINE, "arm_raise": 168.0, "arm_aside": 10.0}, _BACK),
    KeyPose(3.6, {**_SUPINE, "arm_raise": 168.0, "leg_raise": 50.0, "knee": 100.0, "point_toes": 8.0}, _BACK),
    KeyPose(4.8, {**_SUPINE, "arm_aside": 70.0, "leg_raise": 50.0, "knee": 100.0, "point_toes": 8.0}, _BACK),
    KeyPose(6.0, _SUPINE, _BACK),
)
# To the left: the left hand, the right hand, then the right foot and the left foot.
_CARTWHEEL = (
    KeyPose(0.0, {**_ARMS_UP, "leg_aside": 12.0}, _FEET),
    KeyPose(0.8, {**_ARMS_UP, "leg_aside": 14.0}, _FEET),
    KeyPose(
        1.4,
        {
            **_ARMS_UP, "roll": -68.0, "spine_side": -15.0, "left_knee": 45.0, "left_leg_raise": 30.0,
            "left_leg_aside": 55.0, "right_leg_aside": 60.0, "right_point_toes": 50.0, "left_point_toes": -5.0,
        },
        (*_LEFT_FOOT, "left_wrist"),
    ),
    KeyPose(
        1.9, {**_ARMS_UP, "roll": -140.0, "leg_aside": 70.0, "point_toes": 50.0}, _HANDS,
    ),
    KeyPose(
        2.3, {**_ARMS_UP, "roll": -205.0, "leg_aside": 70.0, "point_toes": 50.0}, _HANDS,
    ),
    KeyPose(
        2.8,
        {
            **_ARMS_UP, "roll": -292.0, "spine_side": 15.0, "right_knee": 45.0, "right_leg_raise": 30.0,
            "right_leg_aside": 55.0, "left_leg_aside": 60.0, "left_point_toes": 50.0, "right_point_toes": -5.0,
        },
        (*_RIGHT_FOOT, "right_wrist"),
    ),
    KeyPose(3.45, {**_ARMS_UP, "roll": -360.0, "leg_aside": 14.0}, _FEET),
    KeyPose(4.4, {**_STAND, "roll": -360.0, "leg_aside": 12.0}, _FEET),
)  # fmt: skip
_BENT_OVER = {
    "pitch": 62.0, "spine_bend": 60.0, "arm_raise": 150.0, "elbow": 6.0, "leg_raise": 62.0, "knee": 25.0, "nod": -20.0,
}  # fmt: skip
_UPSIDE_DOWN = {"pitch": 180.0, "arm_raise": 178.0, "elbow": 3.0, "nod": -30.0, "point_toes": 60.0}
_HANDSTAND = (
    KeyPose(0.0, _STAND, _FEET),
    KeyPose(0.6, _ARMS_UP, _FEET),
    KeyPose(1.5, _BENT_OVER, (*_FEET, *_HANDS)),
    KeyPose(1.7, _BENT_OVER, (*_FEET, *_HANDS)),
    KeyPose(
        2.2,
        {**_UPSIDE_DOWN, "pitch": 140.0, "left_leg_raise": -30.0, "right_leg_raise": 75.0, "right_knee": 20.0},
        _HANDS,
    ),
    KeyPose(2.8, _UPSIDE_DOWN, _HANDS),
    KeyPose(4.0, _UPSIDE_DOWN, _HANDS),
    KeyPose(
        4.6,
        {**_UPSIDE_DOWN, "pitch": 140.0, "left_leg_raise": 75.0, "right_leg_raise": -30.0, "left_knee": 20.0},
        _HANDS,
    ),
    KeyPose(5.2, _BENT_OVER, (*_FEET, *_HANDS)),
    KeyPose(5.4, _BENT_OVER, (*_FEET, *_HANDS)),
    KeyPose(6.2, _STAND, _FEET),
)
_KNEELING = (
    KeyPose(0.0, _ON_KNEES, (*_KNEES, *_INSTEPS)),
    KeyPose(0.6, _ON_KNEES, (*_KNEES, *_INSTEPS)),
    KeyPose(1.8, _ON_HEELS, (*_KNEES, *_INSTEPS)),
    KeyPose(3.2, _ON_HEELS, (*_KNEES, *_INSTEPS)),
    KeyPose(
        4.2,
        {**_ON_HEELS, "pitch": 45.0, "leg_raise": 119.0, "spine_bend": 45.0, "arm_raise": 100.0, "nod": 20.0},
        (*_KNEES, *_INSTEPS),
    ),
    KeyPose(5.4, _ON_HEELS, (*_KNEES, *_INSTEPS)),
)
_PULLED_UP = {**_HANGING, "arm_raise": 60.0, "arm_aside": 30.0, "elbow": 132.0, "leg_raise": 12.0, "knee": 35.0}
_PULL_UP = tuple(
    KeyPose(time_s, pose, _HANDS, bar_m=2.35)
    for time_s, pose in ((0.0, _HANGING), (0.8, _HANGING), (1.8, _PULLED_UP), (3.0, _HANGING), (4.0, _PULLED_UP),
                         (5.2, _HANGING))
)  # fmt: skip
_CROUCH = {
    "pitch": 35.0, "spine_bend": 35.0, "leg_raise": 118.0, "knee": 128.0, "point_toes": -20.0, "arm_raise": 75.0,
    "elbow": 15.0,
}  # fmt: skip
_ROLL = (
    KeyPose(0.0, _STAND, _FEET),
    KeyPose(0.9, _CROUCH, _FEET),
    KeyPose(1.3, {**_CROUCH, "pitch": 75.0, "spine_bend": 60.0, "nod": 40.0, "arm_raise": 110.0}, (*_TOES, *_HANDS)),
    KeyPose(1.65, {**_CURLED, "pitch": 145.0, "yaw": 12.0, "arm_raise": 100.0}, _HANDS),
    KeyPose(1.95, {**_CURLED, "pitch": 210.0, "yaw": 16.0}, travel_m=(0.35, 0.0)),
    KeyPose(2.25, {**_CURLED, "pitch": 285.0, "yaw": 10.0}, travel_m=(0.40, 0.0)),
    KeyPose(2.6, {**_CROUCH, "pitch": 385.0, "yaw": 4.0}, _FEET, travel_m=(0.40, 0.0)),
    KeyPose(3.5, {**_STAND, "pitch": 360.0}, _FEET),
)
# One person on the back with raised knees, the other one kneels at the feet, leans over and pushes from side to side.
_GUARD = {
    **_SUPINE, "leg_raise": 75.0, "leg_aside": 28.0, "knee": 100.0, "point_toes": 10.0, "arm_raise": 70.0,
    "arm_aside": 15.0, "elbow": 60.0,
}  # fmt: skip
_OVER = {
    "pitch": 48.0, "leg_raise": 95.0, "knee": 130.0, "point_toes": 76.0, "spine_bend": 30.0, "arm_raise": 85.0,
    "arm_aside": 15.0, "elbow": 50.0, "nod": -20.0,
}  # fmt: skip
_LOW_ON = ("left_hip", "right_hip")
_GRAPPLED = (
    KeyPose(0.0, _GUARD, _LOW_ON),
    KeyPose(1.0, {**_GUARD, "roll": 18.0, "left_arm_raise": 100.0, "right_elbow": 100.0}, _LOW_ON),
    KeyPose(2.0, {**_GUARD, "roll": -20.0, "spine_side": 15.0, "left_leg_raise": 100.0}, _LOW_ON),
    KeyPose(3.0, {**_GUARD, "spine_bend": 30.0, "leg_raise": 95.0, "right_arm_raise": 110.0}, _LOW_ON),
    KeyPose(4.2, {**_GUARD, "roll": 15.0, "knee": 80.0}, _LOW_ON),
    KeyPose(5.2, _GUARD, _LOW_ON),
)
_GRAPPLING = (
    KeyPose(0.0, _OVER, (*_KNEES, *_INSTEPS)),
    KeyPose(1.1, {**_OVER, "spine_twist": 20.0, "left_elbow": 85.0, "right_arm_raise": 105.0}, (*_KNEES, *_INSTEPS)),
    KeyPose(2.0, {**_OVER, "spine_side": 18.0, "arm_raise": 60.0, "elbow": 80.0}, (*_KNEES, *_INSTEPS)),
    KeyPose(3.1, {**_OVER, "pitch": 62.0, "leg_raise": 105.0, "spine_bend": 40.0}, (*_KNEES, *_INSTEPS)),
    KeyPose(4.1, {**_OVER, "spine_twist": -25.0, "right_elbow": 95.0}, (*_KNEES, *_INSTEPS)),
    KeyPose(5.2, _OVER, (*_KNEES, *_INSTEPS)),
)

_SQUAT = {
    "pitch": 32.0, "spine_bend": 12.0, "nod": -20.0, "leg_raise": 100.0, "leg_aside": 14.0, "leg_twist": 12.0,
    "knee": 98.0, "point_toes": -28.0, "arm_raise": 78.0, "elbow": 10.0,
}  # fmt: skip
_HALF_SQUAT = {**_between(_STAND, _SQUAT), "arm_raise": 60.0}
_SQUATTING = tuple(
    KeyPose(time_s, pose, _FEET)
    for time_s, pose in ((0.0, _STAND), (0.4, _STAND), (1.5, _SQUAT), (2.5, _STAND), (2.9, _STAND), (4.0, _HALF_SQUAT),
                         (5.0, _STAND), (6.2, _SQUAT), (7.3, _STAND))
)  # fmt: skip
# A kick to the front, then one to the side, both with the right leg.
_FIGHTER = {**_STAND, "arm_raise": 35.0, "arm_aside": 12.0, "elbow": 105.0, "knee": 14.0, "leg_raise": 9.0}
_CHAMBERED = {**_FIGHTER, "right_leg_raise": 88.0, "right_knee": 105.0, "right_point_toes": 20.0}
_FRONT_KICK = {
    **_CHAMBERED, "pitch": -8.0, "right_leg_raise": 95.0, "right_knee": 12.0, "right_point_toes": 35.0,
}  # fmt: skip
_TURNED_OUT = {
    **_CHAMBERED, "roll": -18.0, "right_leg_raise": 62.0, "right_leg_aside": 45.0, "right_leg_twist": -20.0,
}  # fmt: skip
_SIDE_KICK = {**_TURNED_OUT, "roll": -24.0, "right_leg_raise": 40.0, "right_leg_aside": 58.0, "right_knee": 14.0}
_KICKING = tuple(
    KeyPose(time_s, pose, _FEET if pose is _FIGHTER else _LEFT_FOOT)
    for time_s, pose in ((0.0, _FIGHTER), (0.5, _FIGHTER), (0.9, _CHAMBERED), (1.1, _FRONT_KICK), (1.35, _CHAMBERED),
                         (1.9, _FIGHTER), (2.6, _FIGHTER), (3.0, _TURNED_OUT), (3.25, _SIDE_KICK), (3.55, _TURNED_OUT),
                         (4.2, _FIGHTER), (4.7, _FIGHTER))
)  # fmt: skip

ACROBATICS: Mapping[str, tuple[ActingPart, ...]] = MappingProxyType(
    {
        "lying": (ActingPart(_LYING),),
        "crawl": (ActingPart(_crawl(6)),),
        "cartwheel": (ActingPart(_CARTWHEEL),),
        "handstand": (ActingPart(_HANDSTAND),),
        "kneel": (ActingPart(_KNEELING),),
        "pull-up": (ActingPart(_PULL_UP),),
        "roll": (ActingPart(_ROLL),),
        "squat": (ActingPart(_SQUATTING),),
        "kick": (ActingPart(_KICKING),),
        "grappling": (ActingPart(_GRAPPLED, (0.25, 0.0), 180.0), ActingPart(_GRAPPLING, (-0.35, 0.0))),
    }
)
"""Parts of all people in each acrobatic motion, by name."""
