"""People in the world: poses at instants, tracks over time with their observations, doubts about identities."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.arrays import no_detections, short_text
from pipeline.core.runtime import large_arrays


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
    """3D poses at some output frames, located frame by frame and not yet linked to tracks."""

    frame: Int[np.ndarray, " poses"]  # The output frame of each pose, ascending
    # World positions of the joints of a method's skeleton, NaN where a joint was not found
    xyz_m: Float[np.ndarray, "poses joints 3"]
    # 2D joints behind the positions in full-image pixels (distorted, as seen), NaN where a camera has no joint
    points_px: Float[np.ndarray, "poses joints cameras 2"]
    score: Float[np.ndarray, "poses joints cameras"]  # The detector's confidence, 0 where ``points_px`` is NaN
    # Output frames that exceeded a limit of the exact methods, ascending
    approximate: Int[np.ndarray, " frames"] = field(default_factory=lambda: np.empty(0, int))


@dataclass(frozen=True, slots=True, eq=False)
class Track3D:
    """One person over time, on the session's output frames."""

    track_id: int  # Number from 1, in order of first appearance
    start_frame: int  # Output frame of the first row. Includes the frames in which the track was tentative.
    xyz_m: Float[np.ndarray, "frames joints 3"]  # World positions, NaN where a joint is absent
    # Mean confidence of the observations behind a joint, 0 where it is absent
    score: Float[np.ndarray, "frames joints"]
    source: Int[np.ndarray, "frames joints"]  # ``Source`` value of each joint
    # Mean reprojection error of a joint in pixels of the full image, NaN where it has no observation
    error_px: Float[np.ndarray, "frames joints"]
    views: Int[np.ndarray, "frames joints"]  # Number of cameras with an observation of the joint
    # Standard deviation of a joint's position, root mean square over the axes; NaN where it is absent. ``None``: no
    # uncertainty was computed.
    uncertainty_m: Float[np.ndarray, "frames joints"] | None = None
    # Orientations of the segments of ``pipeline.motion.body_segments`` that a file of 3D points states, NaN where
    # it states none. ``None``: no orientation is stated.
    world_from_segment: Float[np.ndarray, "frames segments 3 3"] | None = None

    __repr__ = short_text

    @property
    def num_frames(self) -> int:
        """Length in output frames."""
        return len(self.xyz_m)

    @property
    def frames(self) -> range:
        """Output frames of the rows."""
        return range(self.start_frame, self.start_frame + len(self.xyz_m))

    @property
    def joint_arrays(self) -> dict[str, np.ndarray]:
        """All arrays by name, a row a frame."""
        names = ("xyz_m", "score", "source", "error_px", "views", "uncertainty_m", "world_from_segment")
        return {name: array for name in names if (array := getattr(self, name)) is not None}

    def copy_measured(self) -> Float[np.ndarray, "frames joints 3"]:
        """Copy the world positions; NaN where a joint was not measured."""
        xyz_m = large_arrays.copy(self.xyz_m)
        xyz_m[self.source != Source.MEASURED] = np.nan
        return xyz_m

    def part(self, rows: slice) -> "Track3D":
        """Some rows of the track."""
        arrays: dict[str, Any] = {name: array[rows] for name, array in self.joint_arrays.items()}
        return replace(self, start_frame=self.start_frame + rows.start, **arrays)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """2D observations that association gave to one track, on the track's output frames."""

    track_id: int  # Number of the track
    # Joints in full-image pixels (distorted, as seen) at the output instants, NaN where a camera has no observation
    points_px: Float[np.ndarray, "frames cameras joints 2"]
    score: Float[np.ndarray, "frames cameras joints"]  # The detector's confidence, 0 where ``points_px`` is NaN
    # Rows of the detections in ``tracking.observations.Detections2D`` at the output frames that are nearest to them, -1
    # where there is none. No rows: not recorded, because no colours were measured.
    detection: Int[np.ndarray, "recorded recorded_cameras"] = field(default_factory=no_detections)

    __repr__ = short_text

    def part(self, rows: slice) -> "Observations":
        """Some rows of the observations."""
        return replace(self, points_px=self.points_px[rows], score=self.score[rows], detection=self.detection[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Leftovers:
    """2D bodies without a person after association, at the nearest output instants."""

    # Output frame and position of the camera of each body
    frame: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    # Joints in full-image pixels (distorted, as seen), NaN where the detector found no joint
    points_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]  # The detector's confidence, 0 where ``points_px`` is NaN


class Doubt(NamedTuple):
    """Moment at which a person may have been taken for another one."""

    frame: int  # Output frame from which on the other choice differs
    confidence: float  # Probability of the choice against the most likely other one
    # Number of the person who would go on as this one, 0 if there is none: the person would end or begin here
    other: int


class PersonLoss(NamedTuple):
    """Frames in which a person is lost in the middle of the cameras' common view, or was a phantom."""

    # ``vanished``: the person is not found, though cameras view the place. ``phantom``: the track had no body of its
    # own, and the frames were taken from it.
    kind: Literal["vanished", "phantom"]
    track_id: int  # Number of the person, 0 if there is no person in other frames
    start_frame: int
    stop_frame: int
    place_m: tuple[float, float, float]  # Middle of the joints in the world, where the person was last, or the phantom


class People(NamedTuple):
    """Result of association, or of the global pass over it."""

    # One each a person, in the same order
    tracks: Sequence[Track3D]
    observations: Sequence[Observations]
    num_approximate_frames: int = 0  # See ``Reconstruction``
    # Doubts about the identity of each person, in the same order; empty before the global pass
    doubts: Sequence[Sequence[Doubt]] = ()
    # Bodies without a person; ``None`` after the global pass, and where association takes joints one by one
    leftovers: Leftovers | None = None
    losses: Sequence[PersonLoss] = ()  # Frames in which people are lost or were phantoms; empty before the global pass
