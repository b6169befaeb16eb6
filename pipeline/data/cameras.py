"""Cameras, the times of frames, and what was measured of both: refinements of a calibration, and clocks."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.errors import Problem
from pipeline.geometry.rigid import Rigid3

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
class Timebase:
    """Times of the output frames: frame k is at ``start_time_s + k / frame_rate_hz`` on the session's clock."""

    start_time_s: float
    frame_rate_hz: float
    num_frames: int

    def time_s(self, frame: int | float) -> float:
        """Time of an output frame in seconds; a fraction gives a time between two frames."""
        return self.start_time_s + frame / self.frame_rate_hz


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
