"""The records that pass between stages.

All are frozen; their arrays are read-only by convention of the makers (``read_only``). NaN means unseen, and its score
is 0. World coordinates are metres, right-handed, Z up; pixel (0, 0) is the centre of the first pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.geometry.rigid import Rigid3
from pipeline.joints import JointSet

Side = Literal["left", "right"]


def read_only(array: np.ndarray) -> np.ndarray:
    """Mark an array as read-only and return it."""
    array.flags.writeable = False
    return array


def no_frames() -> Int[np.ndarray, " 0"]:
    """Frame numbers of no frame."""
    return read_only(np.empty(0, np.int64))


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
    damaged
        Numbers of the frames whose picture is damaged or missing, ascending.
    """

    camera: str
    frame: Int[np.ndarray, " n"]
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]
    box_px: Float[np.ndarray, "n 4"]
    damaged: Int[np.ndarray, " damaged"] = field(default_factory=no_frames)


@dataclass(frozen=True, slots=True)
class MapGrid:
    """Where the cells of a network's maps lie on an image: cell (0, 0) at ``offset_px``, then every ``pitch_px``.

    Parameters
    ----------
    offset_px, pitch_px
        In x and y, pixels of the full image.
    """

    offset_px: tuple[float, float]
    pitch_px: tuple[float, float]

    def image_from_map(self, cells: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map places on the maps, in cells, to pixels."""
        return cells * np.array(self.pitch_px) + np.array(self.offset_px)

    def map_from_image(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels to places on the maps, in cells."""
        return (points_px - np.array(self.offset_px)) / np.array(self.pitch_px)


@dataclass(frozen=True, slots=True, eq=False)
class PafFields:
    """What a network with part affinity fields saw in some of a camera's frames, before anybody grouped it to bodies.

    Parameters
    ----------
    camera
        The camera's name.
    frame
        The camera's frame numbers, ascending.
    peak_row, peak_joint
        Of each peak of a heatmap: its row in ``frame``, ascending, and the joint.
    peak_px
        Where it is, in pixels of the full image (distorted, as seen).
    peak_score
        The heatmap's value there, the detector's confidence.
    fields
        A limb's unit vectors (x, y) where it lies, in the order of ``limbs``; bytes as of ``geometry.fields.quantise``.
    limbs
        Which two joints each field leads from and to, numbers on the joint axis.
    grid
        Where the fields' cells lie on the image.
    damaged
        Numbers of the frames whose picture is damaged or missing, ascending; a missing one is not in ``frame``.
    """

    camera: str
    frame: Int[np.ndarray, " frames"]
    peak_row: Int[np.ndarray, " n"]
    peak_joint: Int[np.ndarray, " n"]
    peak_px: Float[np.ndarray, "n 2"]
    peak_score: Float[np.ndarray, " n"]
    fields: UInt8[np.ndarray, "frames limbs 2 height width"]
    limbs: Int[np.ndarray, "limbs 2"]
    grid: MapGrid
    damaged: Int[np.ndarray, " damaged"] = field(default_factory=no_frames)


@dataclass(frozen=True, slots=True, eq=False)
class Poses3D:
    """People at some output frames, each instant by itself: nobody knows yet who is who.

    Parameters
    ----------
    frame
        The output frame of each pose, ascending.
    xyz_m
        World positions of the joints of a method's skeleton, NaN where a joint was not found.
    points_px
        The 2D joints behind them in full-image pixels (distorted, as seen), NaN where a camera has none.
    score
        The detector's confidence, 0 where there is none.
    approximate
        The output frames in which there was more to decide than exact methods can, ascending.
    """

    frame: Int[np.ndarray, " poses"]
    xyz_m: Float[np.ndarray, "poses joints 3"]
    points_px: Float[np.ndarray, "poses joints cameras 2"]
    score: Float[np.ndarray, "poses joints cameras"]
    approximate: Int[np.ndarray, " frames"] = field(default_factory=lambda: np.empty(0, int))


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

    def time_s(self, frame: int | float) -> float:
        """When an output frame is; half-way between two of them at halves."""
        return self.start_time_s + frame / self.frame_rate_hz


@dataclass(frozen=True, slots=True)
class Floor:
    """The floor that feet stand on, as a plane: ``z_m + slope_x x + slope_y y`` is its height at x and y.

    Parameters
    ----------
    z_m
        Height at the world's origin.
    slope_x, slope_y
        Rise a metre.
    """

    z_m: float
    slope_x: float
    slope_y: float

    @property
    def tilt_deg(self) -> float:
        """Angle to the horizontal."""
        return float(np.degrees(np.arctan(np.hypot(self.slope_x, self.slope_y))))

    def height_m(self, xyz_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Vertical distance of points above the floor, negative below it."""
        return xyz_m[..., 2] - self.z_m - self.slope_x * xyz_m[..., 0] - self.slope_y * xyz_m[..., 1]


@dataclass(frozen=True, slots=True)
class FootContact:
    """A foot that stands on the floor for a while.

    Parameters
    ----------
    side
        Which foot.
    start_frame, num_frames
        On the motion's frames.
    confidence
        How sure it is, in [0, 1]: by height and speed of the ankle, and how long it lasts.
    pinned
        Whether the foot is held in place.
    slide_before_m, slide_after_m
        Mean horizontal distance of the ankle from its median place, without pinning and in the motion as it is.
    """

    side: Side
    start_frame: int
    num_frames: int
    confidence: float
    pinned: bool
    slide_before_m: float
    slide_after_m: float

    @property
    def rows(self) -> slice:
        """Its frames on the motion's."""
        return slice(self.start_frame, self.start_frame + self.num_frames)


class People(NamedTuple):
    """Result of association.

    Parameters
    ----------
    tracks, observations
        Everybody's, in the same order.
    num_approximate_frames
        See ``Reconstruction``.
    """

    tracks: Sequence[Track3D]
    observations: Sequence[Observations]
    num_approximate_frames: int


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
        When and where feet stand on the floor, by start.
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
    """What smoothing or the fit makes of tracks.

    Parameters
    ----------
    tracks
        With final positions.
    motions
        A skeleton each, in their order.
    floor
        ``None`` if no foot was ever seen.
    """

    tracks: tuple[Track3D, ...]
    motions: tuple[SkeletonMotion, ...]
    floor: Floor | None


@dataclass(frozen=True, slots=True)
class DamagedVideo:
    """A video with damaged or missing pictures among the frames that a reconstruction uses.

    Parameters
    ----------
    camera, file
        Name of the camera, and of the video's file.
    num_damaged, num_frames
        How many frames are damaged, of how many that are used.
    first_s, last_s
        Times of the first and the last damaged frame since the start of the video.
    """

    camera: str
    file: str
    num_damaged: int
    num_frames: int
    first_s: float
    last_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """Everything that a reconstruction gives.

    Parameters
    ----------
    located
        Tracks as association located the joints, before anything was smoothed or fit.
    observations
        Behind them, in their order.
    animation
        Made of them, in their order.
    num_approximate_frames
        Output frames in which people were not told apart exactly: there was more to decide than exact methods can.
    damaged
        Videos with damaged frames, in the cameras' order.
    """

    cameras: tuple[Camera, ...]
    joints: JointSet
    timebase: Timebase
    located: Sequence[Track3D]
    observations: Sequence[Observations]
    animation: Animation
    warnings: tuple[str, ...] = field(default=())
    num_approximate_frames: int = 0
    damaged: tuple[DamagedVideo, ...] = ()

    @property
    def tracks(self) -> tuple[Track3D, ...]:
        """Everybody with final positions."""
        return self.animation.tracks

    @property
    def motions(self) -> tuple[SkeletonMotion, ...]:
        """Everybody's skeleton."""
        return self.animation.motions
