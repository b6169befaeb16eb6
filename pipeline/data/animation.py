"""Skeletons in motion on the floor."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.data.people import Track3D

Side = Literal["left", "right"]
FootPart = Literal["foot", "heel", "toe"]
"""Part of a foot that stands; ``foot`` where heel and toe are not told apart."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Floor plane: its height at x and y is ``z_m + slope_x x + slope_y y``.

    Parameters
    ----------
    z_m
        Height at the world's origin in metres.
    slope_x, slope_y
        Rise in metres for each metre along X and Y.
    """

    z_m: float
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
    """Contact of a foot with the floor over consecutive frames.

    Parameters
    ----------
    side
        Left or right foot.
    start_frame, num_frames
        First frame, counted from the start of the motion, and length.
    confidence
        Confidence in [0, 1], from the ankle's height and speed and from the length of the contact.
    pinned
        Whether the foot is held in place.
    slide_before_m, slide_after_m
        Mean horizontal distance of the ankle, or of the part, from its median position, before and after pinning.
    part
        Heel or toe, where both are known; otherwise the foot as a whole.
    """

    side: Side
    start_frame: int
    num_frames: int
    confidence: float
    pinned: bool
    slide_before_m: float
    slide_after_m: float
    part: FootPart = "foot"

    @property
    def rows(self) -> slice:
        """Rows of the contact in the motion's arrays."""
        return slice(self.start_frame, self.start_frame + self.num_frames)


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonMotion:
    """One person's skeleton animation: constant bone lengths, a root path and joint rotations.

    Joints are those of ``pipeline.skeleton.model``; a joint's position is its parent's position plus the parent's
    rotation applied to the joint's rest offset.

    Parameters
    ----------
    track_id, name
        Number of the track and name of the person.
    start_frame, frame_rate_hz
        Output frame of the first row, and rate of the output frames.
    bone_length_m
        Length of the bone from a joint's parent to the joint; 0 for the root.
    root_m
        World position of the root.
    parent_from_joint
        Quaternions (x, y, z, w); the root's parent is the world, Z up.
    contacts
        Contacts of the feet with the floor, in order of their start.
    """

    track_id: int
    name: str
    start_frame: int
    frame_rate_hz: float
    bone_length_m: Float[np.ndarray, " joints"]
    root_m: Float[np.ndarray, "frames 3"]
    parent_from_joint: Float[np.ndarray, "frames joints 4"]
    contacts: tuple[FootContact, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """Smoothed or fitted tracks, their skeletons and the floor.

    Parameters
    ----------
    tracks
        Tracks with final positions.
    motions
        One skeleton motion a track, in the tracks' order.
    floor
        Floor plane; ``None`` if no foot was ever seen.
    """

    tracks: tuple[Track3D, ...]
    motions: tuple[SkeletonMotion, ...]
    floor: Floor | None
