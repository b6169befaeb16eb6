"""The records that pass between stages.

All are frozen; their arrays are read-only by convention of the makers (``read_only``). NaN means unseen, and its score
is 0. World coordinates are metres, right-handed, Z up; pixel (0, 0) is the centre of the first pixel.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.geometry.rigid import Rigid3
from pipeline.joints import JointSet


def read_only(array: np.ndarray) -> np.ndarray:
    """Mark an array as read-only and return it."""
    array.flags.writeable = False
    return array


class Source(IntEnum):
    """How a joint of a frame is known."""

    ABSENT = 0
    MEASURED = 1
    INTERPOLATED = 2
    PREDICTED = 3

    @property
    def letter(self) -> str:
        """The letter of ``skeletons.json``."""
        return "-mip"[self.value]


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A calibrated pinhole camera with OpenCV's distortion model.

    Parameters
    ----------
    name
        Unique in a session.
    size_px
        Width and height of the image, after the video's rotation is applied.
    matrix
        Camera matrix K.
    distortion
        OpenCV's distortion coefficients k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4]]]; empty for none.
    cam_from_world
        Extrinsics: ``x_in_cam = R x_in_world + t``.
    section
        What a calibration file calls the camera beside its name, if it does; files may bear this name too.
    """

    name: str
    size_px: tuple[int, int]
    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " coefficients"]
    cam_from_world: Rigid3
    section: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """Times of one camera's frames on the session's clock, ascending."""

    time_s: Float[np.ndarray, " frames"]


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """All 2D bodies that one camera saw, sorted by frame.

    Parameters
    ----------
    camera
        The camera's name.
    frame
        The camera's frame number of each body, ascending.
    keypoints_px
        Joints in full-image pixels (distorted, as seen), NaN where the detector found none.
    score
        The detector's confidence in [0, 1], 0 where the joint is NaN.
    box_px
        x0, y0, x1, y1 around each body.
    """

    camera: str
    frame: Int[np.ndarray, " n"]
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]
    box_px: Float[np.ndarray, "n 4"]


@dataclass(frozen=True, slots=True, eq=False)
class Track3D:
    """One person over time, on the session's output frames.

    Parameters
    ----------
    track_id
        From 1, in order of first appearance.
    start_frame
        Output frame of the first row. Includes the frames in which the track was tentative.
    xyz_m
        World positions, NaN where absent.
    score
        Mean confidence of the observations behind a joint, 0 where absent.
    source
        ``Source`` values: how each joint is known.
    error_px
        Mean reprojection error of a joint over its observations in pixels of the full image, NaN where it has none.
    views
        Number of cameras whose observations stand behind a joint.
    """

    track_id: int
    start_frame: int
    xyz_m: Float[np.ndarray, "frames joints 3"]
    score: Float[np.ndarray, "frames joints"]
    source: Int[np.ndarray, "frames joints"]
    error_px: Float[np.ndarray, "frames joints"]
    views: Int[np.ndarray, "frames joints"]

    @property
    def num_frames(self) -> int:
        """Length in output frames."""
        return len(self.xyz_m)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """The 2D observations that association gave to one track, on its output frames.

    Parameters
    ----------
    track_id
        The track's.
    points_px
        Matched joints in full-image pixels (distorted, as seen) at the output instants, NaN where a camera has none.
    score
        The detector's confidence, 0 where there is none.
    """

    track_id: int
    points_px: Float[np.ndarray, "frames cameras joints 2"]
    score: Float[np.ndarray, "frames cameras joints"]


@dataclass(frozen=True, slots=True, eq=False)
class Timebase:
    """The output frames: frame k is at ``start_time_s + k / frame_rate_hz`` on the session's clock."""

    start_time_s: float
    frame_rate_hz: float
    num_frames: int


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonMotion:
    """One person's animation: constant bones, a root path and a rotation a joint and frame.

    Joints are those of ``pipeline.skeleton.model``; a joint's position is its parent's position plus the parent's
    rotation applied to the joint's rest offset.

    Parameters
    ----------
    track_id, name
        Whose it is.
    start_frame, frame_rate_hz
        When it begins on the session's output frames, and how fast these follow each other.
    bone_length_m
        Length of the bone from a joint's parent to the joint; 0 for the root.
    root_m
        World position of the root.
    parent_from_joint
        Quaternions (x, y, z, w); the root's parent is the world, Z up.
    contacts
        Frames in which a foot (left, right) stands on the floor; all false until contacts are estimated.
    """

    track_id: int
    name: str
    start_frame: int
    frame_rate_hz: float
    bone_length_m: Float[np.ndarray, " joints"]
    root_m: Float[np.ndarray, "frames 3"]
    parent_from_joint: Float[np.ndarray, "frames joints 4"]
    contacts: Bool[np.ndarray, "frames 2"]


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """Everything that a reconstruction gives."""

    cameras: tuple[Camera, ...]
    joints: JointSet
    timebase: Timebase
    tracks: tuple[Track3D, ...]
    observations: tuple[Observations, ...]
    motions: tuple[SkeletonMotion, ...]
    warnings: tuple[str, ...] = field(default=())
