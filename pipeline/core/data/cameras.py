"""Cameras, the times of frames, and what was measured of both: refinements of a calibration, and clocks."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import short_text
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import Problem

LensModel = Literal["standard", "fisheye"]
"""OpenCV's distortion models: of ``calib3d``, and of its module ``fisheye`` (Kannala and Brandt)."""

Refusal = Literal["few_people", "undetermined", "no_better"]
"""Why a calibration was not refined: the joints that cameras share are too few, they determine no camera, or errors
of the detector explain how they move the cameras."""


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
        Camera matrix K in pixels.
    distortion
        OpenCV's coefficients k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4]]]; empty for none. Of a fisheye lens
        k1, k2, k3, k4.
    cam_from_world
        Extrinsics: ``x_in_cam = R x_in_world + t``, in metres.
    section
        Second name of the camera in a calibration file, which video files may bear too; empty if there is none.
    lens
        Distortion model.

    Examples
    --------
    >>> matrix = np.array([[1400.0, 0.0, 960.0], [0.0, 1400.0, 540.0], [0.0, 0.0, 1.0]])
    >>> Camera("left", (1920, 1080), matrix, np.zeros(5), Rigid3(np.eye(3), np.array([0.0, 1.0, 4.0]))).is_ideal
    True
    """

    name: str
    size_px: tuple[int, int]
    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " coefficients"]
    cam_from_world: Rigid3
    section: str = ""
    lens: LensModel = "standard"

    __repr__ = short_text

    @property
    def is_ideal(self) -> bool:
        """True if the lens is free of distortion."""
        return self.lens == "standard" and not self.distortion.any()


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """Times of one camera's frames on the session's clock, in seconds, ascending."""

    time_s: Float[np.ndarray, " frames"]

    __repr__ = short_text


@dataclass(frozen=True, slots=True, eq=False)
class Timebase:
    """Times of the output frames: frame k is at ``start_time_s + k / frame_rate_hz`` on the session's clock."""

    start_time_s: float
    frame_rate_hz: float
    num_frames: int
    # Number of output frame 0 in the source: for keypoints the earliest camera's first frame; videos begin at 0
    first_source_frame: int = 0

    def time_s(self, frame: int | float) -> float:
        """Time of an output frame in seconds; a fraction gives a time between two frames."""
        return self.start_time_s + frame / self.frame_rate_hz


@dataclass(frozen=True, slots=True)
class CameraMove:
    """Difference of a refined camera from the given one."""

    camera: str  # Name of the camera
    # Angle between the orientations, and distance between the centres
    rotation_deg: float
    translation_m: float
    focal_ratio: float  # Refined focal length over the given one
    moved_px: float  # Median distance in the camera's own picture by which the people's joints moved


@dataclass(frozen=True, slots=True)
class CameraBump:
    """A camera that was moved in the middle of a take."""

    camera: str  # Name of the camera
    time_s: float  # Time of the bump on the session's clock
    rotation_deg: float  # Angle by which the camera turned


@dataclass(frozen=True, slots=True)
class WorldMove:
    """Move of the world that put the floor to z = 0."""

    tilt_deg: float  # Angle by which the world turned: the tilt of the floor before
    height_m: float  # Height of the floor before, in the middle of the people


@dataclass(frozen=True, slots=True)
class Refinement:
    """Report of the refinement of a calibration."""

    refined: bool  # True if refined cameras took the place of the given ones
    # Median reprojection error with the given and with refined cameras; NaN without people
    error_before_px: float
    error_after_px: float
    num_points: int  # Number of joints that the cameras were compared with
    # Refined cameras that differ from the given ones in the given world, the camera that moved most in its own picture
    # first
    moved: tuple[CameraMove, ...] = ()
    bumped: tuple[CameraBump, ...] = ()  # Cameras that were moved in the middle of the take, in order of time
    # Move of the world, in which all cameras moved alike; ``None`` if the world is the given one
    world: WorldMove | None = None
    refusal: Refusal | None = None  # Why the given cameras were kept; ``None`` if they were refined
    # Largest move in a camera's own picture to the expected cameras, whether these were taken or not; ``None`` if the
    # people determine no camera
    most_moved: CameraMove | None = None

    @property
    def has_new_cameras(self) -> bool:
        """True if the cameras of the reconstruction are not the given ones."""
        return self.refined or self.world is not None


@dataclass(frozen=True, slots=True)
class CameraClock:
    """Clock of a camera, measured: ``session time = shift_s + rate * declared time``."""

    camera: str  # Name of the camera
    # Correction of the declared times. The rate of the reference, the first camera, is 1.
    shift_s: float
    rate: float
    # Standard deviation of the camera's session times, relative to the reference, where it is largest over the take
    sigma_s: float
    # Declared time at which the camera's own time is 0: of a video its first frame's, of keypoints 0
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
    """Disagreement of a camera with the others, were its offset another one; all other clocks are as found."""

    camera: str  # Name of the camera
    # Offsets that were compared near the one that was found, ascending; see ``CameraClock.offset_s``
    offsets_s: tuple[float, ...]
    disagreement: tuple[float, ...]  # Share of the moving joints that disagree, 0 to 1, at each of these offsets


@dataclass(frozen=True, slots=True)
class Synchronization:
    """Clocks of all cameras, measured from the motion of people."""

    clocks: tuple[CameraClock, ...]  # In the cameras' order
    # Reasons not to rely on the clocks, each with a code and a remedy; none: they are certain
    refusals: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()  # Doubts that do not forbid to use the clocks
    evidence: tuple[ClockEvidence, ...] = ()  # Of each camera, in the cameras' order

    @property
    def is_certain(self) -> bool:
        """True if the clocks can be relied on."""
        return not self.refusals


class RefinedCalibration(NamedTuple):
    """Cameras, refined or as given, and the report."""

    cameras: tuple[Camera, ...]
    report: Refinement
