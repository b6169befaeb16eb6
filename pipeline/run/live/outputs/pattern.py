"""Test pattern: simulated people who walk in a circle and open and close their hands, to set up receivers."""

import threading
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import finger_joints
from pipeline.core.layouts import LAYOUTS
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import hand_fingers, joint_rotations, natural_rad
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, posed_joints
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

LAYOUT = LAYOUTS["coco-wholebody-133"]
"""Layout with the joints of the simulated people."""
RATE_HZ = 60.0
"""Rate of the instants."""

_STATURE_M, _RADIUS_M, _ANKLE_M = 1.75, 0.8, 0.07
_LAP_S, _STEPS = 6.0, 6  # Duration of a round, and pairs of steps in it
# Angles in degrees about axes of the rest pose: a mean, and an amplitude of the steps with its phase in steps.
_TURNS = (
    ("Spine", "x", 3.0, 0.0, 0.0),
    ("LeftArm", "y", 70.0, 4.0, 0.0),
    ("RightArm", "x", -85.0, 8.0, 0.0),
    ("RightForeArm", "z", 80.0, 25.0, 0.25),
    ("LeftForeArm", "z", -15.0, 15.0, 0.5),
    ("LeftUpLeg", "x", -5.0, -25.0, 0.0),
    ("RightUpLeg", "x", -5.0, -25.0, 0.5),
    ("LeftLeg", "x", 20.0, 20.0, 0.75),
    ("RightLeg", "x", 20.0, 20.0, 0.25),
)
# Places of marks in the axes of the head or a foot, in metres.
_HEAD = {
    "nose": (0.0, -0.10, 0.06),
    **{f"{side}_eye": (x, -0.08, 0.1) for side, x in zip(SIDES, (0.03, -0.03), strict=True)},
    **{f"{side}_ear": (x, 0.0, 0.08) for side, x in zip(SIDES, (0.075, -0.075), strict=True)},
}


def pattern_instants(num_people: int = 1, rate_hz: float = RATE_HZ) -> Callable[[int], LiveInstant]:
    """Instants by their numbers; the skeletons of the bodies have no fingers, like people of cameras."""
    num_frames = round(_LAP_S * rate_hz)
    motion = _lap(num_frames, rate_hz)
    joint_m, rotations = posed_joints(motion)
    marks_m = _marks_m(joint_m, rotations)
    num_body = len(SKELETON)
    body_m, quat, lengths_m = joint_m[:, :num_body], motion.parent_from_joint[:, :num_body], motion.bone_length_m

    def instant_at(number: int) -> LiveInstant:
        people = []
        for person in range(num_people):
            frame = (number + person * num_frames // num_people) % num_frames
            skeleton = LiveSkeleton(motion.root_m[frame], quat[frame], lengths_m[:num_body], body_m[frame])
            people.append(LivePerson(person + 1, marks_m[frame], skeleton))
        return LiveInstant(number / rate_hz, tuple(people), 0.0)

    return instant_at


def play_pattern(show: Callable[[LiveInstant], None], tick: Callable[[float], None], stopped: threading.Event) -> None:
    """Show a person of the test pattern at its rate until ``stopped``; ``tick`` gets the time each second.

    Instants that were missed, because the machine was busy or slept, are left out.
    """
    instant_at, start_s, number, num_ticks = pattern_instants(), time.monotonic(), 0, 0
    while not stopped.wait(max(0.0, start_s + number / RATE_HZ - time.monotonic())):
        show(instant_at(number))
        if number >= (num_ticks + 1) * RATE_HZ:
            num_ticks = int(number / RATE_HZ)
            tick(number / RATE_HZ)
        number = max(number + 1, int((time.monotonic() - start_s) * RATE_HZ))


def _lap(num_frames: int, rate_hz: float) -> SkeletonMotion:
    """Motion of a round."""
    lap = 2 * np.pi * np.arange(num_frames) / num_frames
    step = _STEPS * lap
    quat = np.zeros((num_frames, len(WHOLE_SKELETON), 4))
    quat[..., 3] = 1.0
    for name, axis, mean_deg, swing_deg, phase in _TURNS:
        angles_deg = mean_deg + swing_deg * np.sin(step + 2 * np.pi * phase)
        quat[:, INDEX[name]] = Rotation.from_euler(axis, angles_deg[:, None], degrees=True).as_quat()
    # The person faces -Y at rest, and walks along +X at the lowest point of the circle.
    quat[:, 0] = Rotation.from_euler("z", (lap + np.pi / 2)[:, None]).as_quat()
    for side in SIDES:
        angle_rad = natural_rad() * (2.0 + 1.5 * np.sin(2 * lap))[:, None]
        numbers, rotations = joint_rotations(side, angle_rad)
        for number, rotation in zip(numbers.tolist(), rotations, strict=True):
            quat[:, number] = rotation.as_quat()
    lengths_m = _STATURE_M * np.array([joint.stature_share for joint in WHOLE_SKELETON])
    legs_m = lengths_m[INDEX["LeftLeg"]] + lengths_m[INDEX["LeftFoot"]]
    height_m = _ANKLE_M + legs_m - 0.02 + 0.015 * np.cos(2 * step)
    root_m = np.stack([_RADIUS_M * np.sin(lap), -_RADIUS_M * np.cos(lap), height_m], axis=-1)
    return SkeletonMotion(1, "", 0, rate_hz, lengths_m, root_m, quat, ())


def _marks_m(
    joint_m: Float[np.ndarray, "frames whole 3"], rotations: list[Float[np.ndarray, "frames 3 3"]]
) -> Float[np.ndarray, "frames marks 3"]:
    """Positions of the marks of ``LAYOUT`` in each frame."""
    places_m = {joint.landmarks[0]: joint_m[:, n] for n, joint in enumerate(SKELETON) if len(joint.landmarks) == 1}
    head = INDEX["Head"]
    places_m |= {name: joint_m[:, head] + rotations[head] @ np.array(offset_m) for name, offset_m in _HEAD.items()}
    for side in SIDES:
        foot = INDEX[f"{side.capitalize()}Foot"]
        places_m[f"{side}_big_toe"] = joint_m[:, INDEX[f"{side.capitalize()}FootEnd"]]
        places_m[f"{side}_heel"] = joint_m[:, foot] + rotations[foot] @ np.array([0.0, 0.04, -0.06])
        joints = [number for finger in hand_fingers(side).values() for number in finger.joints]
        places_m |= {name: joint_m[:, number] for name, number in zip(finger_joints(side), joints, strict=True)}
    return np.stack([places_m[name] for name in LAYOUT.joints.names], axis=1)
