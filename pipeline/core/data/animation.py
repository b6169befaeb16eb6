"""Skeletons in motion on the floor."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import short_text
from pipeline.core.data.people import Track3D

Side = Literal["left", "right"]
FootPart = Literal["foot", "heel", "toe"]
"""Part of a foot that stands; ``foot`` where heel and toe are not told apart."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Floor plane: its height at x and y is ``z_m + slope_x x + slope_y y``."""

    z_m: float  # Height at the world's origin in metres
    # Rise in metres for each metre along X and Y
    slope_x: float
    slope_y: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the floor and the horizontal."""
        return float(np.degrees(np.arctan(np.hypot(self.slope_x, self.slope_y))))

    def height_m(self, xyz_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Vertical distance of points above the floor, negative below it."""
        return xyz_m[..., 2] - self.z_m - self.slope_x * xyz_m[..., 0] - self.slope_y * xyz_m[..., 1]


@dataclass(frozen=True, slots=True)
class FootContact:
    """Contact of a foot with the floor over consecutive frames."""

    side: Side  # Left or right foot
    # First frame, counted from the start of the motion, and length
    start_frame: int
    num_frames: int
    confidence: float  # Confidence in [0, 1], from the ankle's height and speed and from the length of the contact
    pinned: bool  # True if the foot is held in place
    # Mean horizontal distance of the ankle, or of the part, from its median position, before and after pinning
    slide_before_m: float
    slide_after_m: float
    part: FootPart = "foot"  # Heel or toe, where both are known; otherwise the foot as a whole

    @property
    def rows(self) -> slice:
        """Rows of the contact in the motion's arrays."""
        return slice(self.start_frame, self.start_frame + self.num_frames)


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonMotion:
    """One person's skeleton animation: constant bone lengths, a root path and joint rotations.

    Joints are the joints of ``pipeline.motion.skeleton.model``; a joint's position is its parent's position plus the
    parent's rotation applied to the joint's rest offset.
    """

    # Number of the track and name of the person
    track_id: int
    name: str
    # Output frame of the first row, and rate of the output frames
    start_frame: int
    frame_rate_hz: float
    bone_length_m: Float[np.ndarray, " joints"]  # Length of the bone from a joint's parent to the joint; 0 for the root
    root_m: Float[np.ndarray, "frames 3"]  # World position of the root
    # Quaternions (x, y, z, w); the root's parent is the world, Z up
    parent_from_joint: Float[np.ndarray, "frames joints 4"]
    contacts: tuple[FootContact, ...]  # Contacts of the feet with the floor, in order of their start

    __repr__ = short_text

    @property
    def frames(self) -> range:
        """Output frames of the rows."""
        return range(self.start_frame, self.start_frame + len(self.root_m))


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """Smoothed or fitted tracks, their skeletons and the floor."""

    tracks: tuple[Track3D, ...]  # Tracks with final positions
    motions: tuple[SkeletonMotion, ...]  # One skeleton motion a track, in the tracks' order
    floor: Floor | None  # Floor plane; ``None`` if no foot was ever seen

    __repr__ = short_text
