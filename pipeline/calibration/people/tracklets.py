"""Tracklets: short tracks of a body in the image of one camera, kept pure rather than long."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.people.following import MAX_GAP_S, Followed, follow_bodies
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.geometry.undistortion import undistort_px

MIN_INSTANTS = 8
"""Instants of the shortest tracklet that is kept, and that two tracklets must share to be compared."""

_STEP_S, _MAX_INSTANTS = 0.1, 1200


@dataclass(frozen=True, slots=True, eq=False)
class ViewTracklet:
    """A body in one camera at consecutive instants."""

    camera: int  # Number of the camera
    first: int  # First instant
    points_px: Float[np.ndarray, "instants joints 2"]  # Distorted pixels of ``JOINTS``; NaN where a joint is not seen
    # The same points on the normalised image plane (z = 1), without distortion
    ideal: Float[np.ndarray, "instants joints 2"]
    height_px: float  # Median height of the body in the image

    @property
    def instants(self) -> range:
        """Instants of the rows."""
        return range(self.first, self.first + len(self.points_px))

    def shared(self, other: "ViewTracklet") -> range:
        """Instants that both have."""
        return range(max(self.first, other.first), min(self.instants.stop, other.instants.stop))

    def rows(self, instants: range | Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Rows of some of its instants."""
        return np.asarray(instants) - self.first


def shared_instants(times: Sequence[FrameTimes]) -> Float[np.ndarray, " instants"]:
    """Instants at which the cameras are compared: 0.1 s apart, further in takes of more than two minutes."""
    begin_s = min(float(camera_times.time_s[0]) for camera_times in times)
    end_s = max(float(camera_times.time_s[-1]) for camera_times in times)
    step_s = max(_STEP_S, (end_s - begin_s) / _MAX_INSTANTS)
    return begin_s + step_s * np.arange(max(2, int((end_s - begin_s) / step_s) + 1))


def find_tracklets(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    instants_s: Float[np.ndarray, " instants"],
) -> list[ViewTracklet]:
    """Follow bodies through each camera's images, and sample them at instants of the session's clock.

    A tracklet ends where two bodies come so close that they may be exchanged.
    """
    return [
        tracklet
        for number, camera in enumerate(cameras)
        for body in follow_bodies(times[camera.name].time_s, detections[camera.name], joints)
        if (tracklet := _sampled(number, camera, body, instants_s)) is not None
    ]


def with_camera(tracklet: ViewTracklet, camera: Camera) -> ViewTracklet:
    """Tracklet with its normalised points under other intrinsics."""
    return ViewTracklet(
        tracklet.camera, tracklet.first, tracklet.points_px, _ideal(camera, tracklet.points_px), tracklet.height_px
    )


def _sampled(
    number: int, camera: Camera, body: Followed, instants_s: Float[np.ndarray, " instants"]
) -> ViewTracklet | None:
    """Interpolate a tracklet at the instants within it; ``None`` if it is too short."""
    times_s, points_px = body.times_s, body.points_px
    first, stop = np.searchsorted(instants_s, [times_s[0], times_s[-1] + 1e-9])
    if stop - first < MIN_INSTANTS:
        return None
    wanted_s = instants_s[first:stop]
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    before_s, after_s = times_s[after - 1], times_s[after]
    share = ((wanted_s - before_s) / (after_s - before_s))[:, None, None]
    sampled = (1 - share) * points_px[after - 1] + share * points_px[after]
    sampled[after_s - before_s > MAX_GAP_S] = np.nan
    return ViewTracklet(number, int(first), read_only(sampled), _ideal(camera, sampled), body.height_px)


def _ideal(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    inverse = np.linalg.inv(camera.matrix)
    return read_only(undistort_px(camera, points_px) @ inverse[:2, :2].T + inverse[:2, 2])
