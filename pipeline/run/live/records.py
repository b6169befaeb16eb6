"""Records of a live capture: an instant, its people, and their skeletons."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True, eq=False)
class LiveSkeleton:
    """Pose of a person's animation skeleton at an instant; joints are those of ``skeleton.model:SKELETON``."""

    root_m: Float[np.ndarray, " 3"]  # World position of the root
    parent_from_joint: Float[np.ndarray, "bones 4"]  # Quaternions (x, y, z, w); the root's parent is the world, Z up
    bone_length_m: Float[np.ndarray, " bones"]  # Length of the bone from a joint's parent to the joint; 0 for the root
    joint_m: Float[np.ndarray, "bones 3"]  # World positions of the skeleton's joints


@dataclass(frozen=True, slots=True, eq=False)
class LivePerson:
    """A person at an instant."""

    id: int  # Number of the person, from 1 in order of first appearance; the same for the whole capture
    # World positions of the detector's joints, NaN where unknown: of the skeleton, or located before there is one
    xyz_m: Float[np.ndarray, "joints 3"]
    # ``None`` until the person's bones are learnt, and behind a gap until hips and shoulders are located
    skeleton: LiveSkeleton | None


@dataclass(frozen=True, slots=True, eq=False)
class LiveInstant:
    """People at an output instant, final: no later frame changes them."""

    time_s: float  # Time of the instant on the cameras' clock
    people: tuple[LivePerson, ...]  # People in sight, in order of their numbers
    lag_s: float  # Time on the cameras' clock from the instant to the newest frame that had come when it became final


@dataclass(frozen=True, slots=True)
class LiveCounts:
    """Frames of a live capture so far."""

    taken: int = 0  # Frames that were used, late ones included
    late: int = 0  # Frames that came after a later frame, of any camera, and were sorted in
    dropped: int = 0  # Frames that came too late and were not used
