"""People in the world: poses at instants, tracks over time with their observations, doubts about identities."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.data.arrays import no_detections


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
