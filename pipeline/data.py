"""Records that pass between stages: cameras, detections, tracks, motions and the reconstruction.

All records are frozen, and their arrays are read-only by convention (``read_only``). NaN marks a joint without a
value; its score is 0. World coordinates are metres, right-handed, Z up. Pixel (0, 0) is the centre of the first pixel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.errors import Problem
from pipeline.findings import SessionCheck
from pipeline.geometry.rigid import Rigid3
from pipeline.joints import JointOffsets, JointSet

Side = Literal["left", "right"]
FootPart = Literal["foot", "heel", "toe"]
"""Part of a foot that stands; ``foot`` where heel and toe are not told apart."""


def read_only(array: np.ndarray) -> np.ndarray:
    """Mark an array as read-only and return it."""
    array.flags.writeable = False
    return array


def no_frames() -> Int[np.ndarray, " 0"]:
    """Return an empty, read-only array of frame numbers."""
    return read_only(np.empty(0, np.int64))


def no_changes() -> Float[np.ndarray, " 0"]:
    """Return an empty, read-only array of changes of pictures."""
    return read_only(np.empty(0, np.float32))


def no_samples() -> UInt8[np.ndarray, " 0"]:
    """Return an empty, read-only array of samples of a picture."""
    return read_only(np.empty(0, np.uint8))


def no_colours() -> UInt8[np.ndarray, "0 0 0"]:
    """Return an empty, read-only array of colour histograms: colours were not measured."""
    return read_only(np.empty((0, 0, 0), np.uint8))


def no_detections() -> Int[np.ndarray, "0 0"]:
    """Return an empty, read-only array of detections by frame and camera."""
    return read_only(np.empty((0, 0), np.int32))


class Source(IntEnum):
    """Origin of a joint's position in a frame: absent, measured, interpolated or predicted."""

    ABSENT = 0
    MEASURED = 1
    INTERPOLATED = 2
    PREDICTED = 3

    @property
    def letter(self) -> str:
        """Letter of the source in ``skeletons.json``: ``-``, ``m``, ``i`` or ``p``."""
        return "-mip"[self.value]


LensModel = Literal["standard", "fisheye"]
"""OpenCV's distortion models: that of ``calib3d``, and that of its module ``fisheye`` (Kannala and Brandt)."""


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A calibrated pinhole camera with one of OpenCV's distortion models.

    Parameters
    ----------
    name
        Name of the camera, unique in a session.
    size_px
        Width and height of the image, after the video's rotation is applied.
    matrix
        Camera matrix K.
    distortion
        OpenCV's distortion coefficients k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4]]]; empty for none. Of a
        fisheye lens k1, k2, k3, k4.
    cam_from_world
        Extrinsics: ``x_in_cam = R x_in_world + t``.
    section
        Second name of the camera in a calibration file, which video files may bear too; empty if there is none.
    lens
        Distortion model.
    """

    name: str
    size_px: tuple[int, int]
    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " coefficients"]
    cam_from_world: Rigid3
    section: str = ""
    lens: LensModel = "standard"

    @property
    def is_ideal(self) -> bool:
        """Whether the lens is free of distortion."""
        return self.lens == "standard" and not self.distortion.any()


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """Times of one camera's frames on the session's clock, in seconds, ascending."""

    time_s: Float[np.ndarray, " frames"]


@dataclass(frozen=True, slots=True, eq=False)
class PictureChanges:
    """Changes of a camera's pictures from one frame to the next, see ``detect.doubled``.

    Parameters
    ----------
    frame
        Numbers of the frames that were decoded, ascending.
    change
        Difference of each picture from the picture of the frame before, in grey levels; NaN where that is unknown.
    first, last
        Samples of the first and the last picture.
    """

    frame: Int[np.ndarray, " frames"] = field(default_factory=no_frames)
    change: Float[np.ndarray, " frames"] = field(default_factory=no_changes)
    first: UInt8[np.ndarray, " samples"] = field(default_factory=no_samples)
    last: UInt8[np.ndarray, " samples"] = field(default_factory=no_samples)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """2D bodies in the frames of one camera, sorted by frame.

    Parameters
    ----------
    camera
        The camera's name.
    frame
        The camera's frame number of each body, ascending.
    keypoints_px
        Joints in full-image pixels (distorted, as seen), NaN where the detector found no joint.
    score
        The detector's confidence in [0, 1], 0 where the joint is NaN.
    box_px
        x0, y0, x1, y1 around each body.
    damaged
        Numbers of the frames whose picture is damaged or missing, ascending.
    colour
        Histograms of the colours of each body's parts, see ``detect.appearance``; zeros where a part is unknown. No
        rows: colours were not measured.
    changes
        Changes of the pictures; none in detections of other programs.
    """

    camera: str
    frame: Int[np.ndarray, " n"]
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]
    box_px: Float[np.ndarray, "n 4"]
    damaged: Int[np.ndarray, " damaged"] = field(default_factory=no_frames)
    colour: UInt8[np.ndarray, "coloured parts bins"] = field(default_factory=no_colours)
    changes: PictureChanges = field(default_factory=PictureChanges, kw_only=True)

    def within(self, frames: range) -> "Detections":
        """Select the bodies in a range of the camera's frame numbers, without the changes of the pictures."""
        rows = slice(*np.searchsorted(self.frame, [frames.start, frames.stop]))
        return Detections(
            camera=self.camera,
            frame=self.frame[rows],
            keypoints_px=self.keypoints_px[rows],
            score=self.score[rows],
            box_px=self.box_px[rows],
            colour=self.colour[rows],
            damaged=self.damaged[slice(*np.searchsorted(self.damaged, [frames.start, frames.stop]))],
        )


@dataclass(frozen=True, slots=True)
class MapGrid:
    """Positions of the cells of a network's maps on an image.

    Parameters
    ----------
    offset_px
        Centre of cell (0, 0) in x and y, pixels of the full image.
    pitch_px
        Distance of neighbouring cells in x and y, pixels of the full image.
    """

    offset_px: tuple[float, float]
    pitch_px: tuple[float, float]

    def image_from_map(self, cells: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map positions in cells to pixels of the full image."""
        return cells * np.array(self.pitch_px) + np.array(self.offset_px)

    def map_from_image(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the full image to positions in cells."""
        return (points_px - np.array(self.offset_px)) / np.array(self.pitch_px)


@dataclass(frozen=True, slots=True, eq=False)
class PafFields:
    """Heatmap peaks and part affinity fields in frames of one camera, not yet grouped to bodies (Cao et al. 2017).

    Parameters
    ----------
    camera
        The camera's name.
    frame
        The camera's frame numbers, ascending.
    peak_row, peak_joint
        Row of each peak in ``frame``, ascending, and its joint.
    peak_px
        Position of each peak in pixels of the full image (distorted, as seen).
    peak_score
        Value of the heatmap at each peak: the detector's confidence.
    fields
        Unit vectors (x, y) along each limb, in the order of ``limbs``; bytes made by ``geometry.fields.quantise``.
    limbs
        First and second joint of each field's limb, as numbers on the joint axis.
    grid
        Positions of the fields' cells on the image.
    damaged
        Numbers of the frames whose picture is damaged or missing, ascending; a missing frame is not in ``frame``.
    changes
        Changes of the pictures.
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
    changes: PictureChanges = field(default_factory=PictureChanges, kw_only=True)


DetectionsByCamera = Mapping[str, Detections] | Mapping[str, PafFields]
"""Bodies, or peaks and fields, by name of the camera."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses3D:
    """3D poses at some output frames, located frame by frame and not yet linked to tracks.

    Parameters
    ----------
    frame
        The output frame of each pose, ascending.
    xyz_m
        World positions of the joints of a method's skeleton, NaN where a joint was not found.
    points_px
        2D joints behind the positions in full-image pixels (distorted, as seen), NaN where a camera has no joint.
    score
        The detector's confidence, 0 where ``points_px`` is NaN.
    approximate
        Output frames that exceeded a limit of the exact methods, ascending.
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
        Number from 1, in order of first appearance.
    start_frame
        Output frame of the first row. Includes the frames in which the track was tentative.
    xyz_m
        World positions, NaN where a joint is absent.
    score
        Mean confidence of the observations behind a joint, 0 where it is absent.
    source
        ``Source`` value of each joint.
    error_px
        Mean reprojection error of a joint in pixels of the full image, NaN where it has no observation.
    views
        Number of cameras with an observation of the joint.
    uncertainty_m
        Standard deviation of a joint's position, root mean square over the axes; NaN where it is absent. ``None``: no
        uncertainty was computed.
    """

    track_id: int
    start_frame: int
    xyz_m: Float[np.ndarray, "frames joints 3"]
    score: Float[np.ndarray, "frames joints"]
    source: Int[np.ndarray, "frames joints"]
    error_px: Float[np.ndarray, "frames joints"]
    views: Int[np.ndarray, "frames joints"]
    uncertainty_m: Float[np.ndarray, "frames joints"] | None = None

    @property
    def num_frames(self) -> int:
        """Length in output frames."""
        return len(self.xyz_m)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """2D observations that association gave to one track, on the track's output frames.

    Parameters
    ----------
    track_id
        Number of the track.
    points_px
        Joints in full-image pixels (distorted, as seen) at the output instants, NaN where a camera has no observation.
    score
        The detector's confidence, 0 where ``points_px`` is NaN.
    detection
        Rows of the detections in ``tracking.observations.Bodies`` at the output frames that are nearest to them, -1
        where there is none. No rows: not recorded, because no colours were measured.
    """

    track_id: int
    points_px: Float[np.ndarray, "frames cameras joints 2"]
    score: Float[np.ndarray, "frames cameras joints"]
    detection: Int[np.ndarray, "recorded recorded_cameras"] = field(default_factory=no_detections)


@dataclass(frozen=True, slots=True, eq=False)
class Timebase:
    """Times of the output frames: frame k is at ``start_time_s + k / frame_rate_hz`` on the session's clock."""

    start_time_s: float
    frame_rate_hz: float
    num_frames: int

    def time_s(self, frame: int | float) -> float:
        """Time of an output frame in seconds; a fraction gives a time between two frames."""
        return self.start_time_s + frame / self.frame_rate_hz


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
class Leftovers:
    """2D bodies that association gave to nobody, at the nearest output instants.

    Parameters
    ----------
    frame, camera
        Output frame and position of the camera of each body.
    points_px
        Joints in full-image pixels (distorted, as seen), NaN where the detector found no joint.
    score
        The detector's confidence, 0 where ``points_px`` is NaN.
    """

    frame: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]


class Doubt(NamedTuple):
    """Moment at which a person may have been taken for another one.

    Parameters
    ----------
    frame
        Output frame from which on the other choice differs.
    confidence
        Probability of the choice against the most likely other one.
    other
        Number of the person who would go on as this one, 0 if it is nobody else: the person would end or begin here.
    """

    frame: int
    confidence: float
    other: int


class People(NamedTuple):
    """Result of association, or of the global pass over it.

    Parameters
    ----------
    tracks, observations
        One each a person, in the same order.
    num_approximate_frames
        See ``Reconstruction``.
    doubts
        Doubts about the identity of each person, in the same order; empty before the global pass.
    leftovers
        Bodies that belong to nobody; ``None`` after the global pass, and where association takes joints one by one.
    """

    tracks: Sequence[Track3D]
    observations: Sequence[Observations]
    num_approximate_frames: int = 0
    doubts: Sequence[Sequence[Doubt]] = ()
    leftovers: Leftovers | None = None


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


@dataclass(frozen=True, slots=True)
class DamagedVideo:
    """A video with damaged, missing or doubled pictures among the frames that a reconstruction uses.

    Parameters
    ----------
    camera, file
        Name of the camera, and base name of the video file.
    num_damaged, num_frames
        Number of damaged frames, and of all frames that are used.
    first_s, last_s
        Times of the first and the last damaged frame since the start of the video; 0 if none is damaged.
    doubled_s
        Times of the frames that show the picture before once more, since the start of the video.
    """

    camera: str
    file: str
    num_damaged: int
    num_frames: int
    first_s: float
    last_s: float
    doubled_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class CameraMove:
    """Difference of a refined camera from the given one.

    Parameters
    ----------
    camera
        Name of the camera.
    rotation_deg, translation_m
        Angle between the orientations, and distance between the centres.
    focal_ratio
        Refined focal length over the given one.
    """

    camera: str
    rotation_deg: float
    translation_m: float
    focal_ratio: float


@dataclass(frozen=True, slots=True)
class CameraBump:
    """A camera that was moved in the middle of a take.

    Parameters
    ----------
    camera
        Name of the camera.
    time_s
        Time of the bump on the session's clock.
    rotation_deg
        Angle by which the camera turned.
    """

    camera: str
    time_s: float
    rotation_deg: float


@dataclass(frozen=True, slots=True)
class WorldMove:
    """Move of the world that put the floor to z = 0.

    Parameters
    ----------
    tilt_deg
        Angle by which the world turned: the tilt of the floor before.
    height_m
        Height of the floor before, in the middle of the people.
    """

    tilt_deg: float
    height_m: float


@dataclass(frozen=True, slots=True)
class Refinement:
    """Report of the refinement of a calibration.

    Parameters
    ----------
    refined
        Whether refined cameras took the place of the given ones.
    error_before_px, error_after_px
        Median reprojection error with the given and with refined cameras, cross-validated over time; NaN without
        people.
    num_points
        Number of joints that the cameras were compared with.
    moved
        Refined cameras that differ from the given ones in the given world, in the cameras' order.
    bumped
        Cameras that were moved in the middle of the take, in order of time.
    world
        Move of the world, in which all cameras moved alike; ``None`` if the world is the given one.
    """

    refined: bool
    error_before_px: float
    error_after_px: float
    num_points: int
    moved: tuple[CameraMove, ...] = ()
    bumped: tuple[CameraBump, ...] = ()
    world: WorldMove | None = None

    @property
    def has_new_cameras(self) -> bool:
        """Whether the cameras of the reconstruction are not the given ones."""
        return self.refined or self.world is not None


@dataclass(frozen=True, slots=True)
class CameraClock:
    """Clock of a camera, measured: ``session time = shift_s + rate * declared time``.

    Parameters
    ----------
    camera
        Name of the camera.
    shift_s, rate
        Correction of the declared times. The rate of the reference, the first camera, is 1.
    sigma_s
        Standard deviation of the camera's session times, relative to the reference, where it is largest over the take.
    start_s
        Declared time at which the camera's own time is 0: of a video that of its first frame, of keypoints 0.
    """

    camera: str
    shift_s: float
    rate: float
    sigma_s: float
    start_s: float = 0.0

    @property
    def offset_s(self) -> float:
        """Session time at which the camera's own time is 0: ``session time = offset_s + rate * own time``."""
        return self.shift_s + self.rate * self.start_s

    def session_s(self, declared_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Session times of declared times."""
        return self.shift_s + self.rate * declared_s


@dataclass(frozen=True, slots=True)
class ClockEvidence:
    """Disagreement of a camera with the others, were its offset another one; all other clocks are as found.

    Parameters
    ----------
    camera
        Name of the camera.
    offsets_s
        Offsets that were compared near the one that was found, ascending; see ``CameraClock.offset_s``.
    disagreement
        Share of the moving joints that disagree, 0 to 1, at each of these offsets.
    """

    camera: str
    offsets_s: tuple[float, ...]
    disagreement: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Synchronization:
    """Clocks of all cameras, measured from the motion of people.

    Parameters
    ----------
    clocks
        In the cameras' order.
    refusals
        Reasons not to rely on the clocks, each with a code and a remedy; none: they are certain.
    warnings
        Doubts that do not forbid to use the clocks.
    evidence
        Of each camera, in the cameras' order.
    """

    clocks: tuple[CameraClock, ...]
    refusals: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()
    evidence: tuple[ClockEvidence, ...] = ()

    @property
    def is_certain(self) -> bool:
        """Whether the clocks can be relied on."""
        return not self.refusals


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """Result of a reconstruction.

    Parameters
    ----------
    cameras, joints, timebase
        Cameras of the session, refined if they were, joints of the tracks, and times of the output frames.
    located
        Tracks with joints as association located them, before smoothing and fit.
    observations
        Observations behind the located tracks, in the same order.
    animation
        Final tracks and skeletons, in the same order.
    warnings
        Sentences for the user.
    num_approximate_frames
        Number of output frames that exceeded a limit of the exact methods of association.
    damaged
        Videos with damaged frames, in the cameras' order.
    doubts
        Doubts about the identity of each person, in the tracks' order; empty if nobody looked for them.
    offsets
        Offsets of the detector's marks from the joints' centres, with which the skeletons were fitted.
    refinement
        Report of the refinement of the calibration; ``None`` if none was asked for.
    synchronization
        Measured clocks; ``None`` if times are as they were declared.
    check
        Check of the session by its people.
    is_emptied
        Whether edits removed everybody who was found.
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
    doubts: Sequence[Sequence[Doubt]] = ()
    offsets: JointOffsets = field(default_factory=dict)
    refinement: Refinement | None = None
    synchronization: Synchronization | None = None
    check: SessionCheck = field(default_factory=SessionCheck)
    is_emptied: bool = False

    @property
    def tracks(self) -> tuple[Track3D, ...]:
        """Tracks with final positions."""
        return self.animation.tracks

    @property
    def motions(self) -> tuple[SkeletonMotion, ...]:
        """Skeleton motions, in the tracks' order."""
        return self.animation.motions
