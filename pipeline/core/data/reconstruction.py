"""The result of a reconstruction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Camera, Refinement, Synchronization, Timebase
from pipeline.core.data.detections import DamagedVideo
from pipeline.core.data.people import Doubt, Observations, PersonLoss, Track3D
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.joints import JointOffsets, JointSet
from pipeline.core.options.providers import ProviderName


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
        Findings about the files and the choices.
    num_approximate_frames
        Number of output frames that exceeded a limit of the exact methods of association.
    damaged
        Videos with damaged frames, in the cameras' order.
    doubts
        Doubts about the identity of each person, in the tracks' order; empty if nobody looked for them.
    losses
        Frames in which people are lost in the middle of the room, or were phantoms.
    offsets
        Offsets of the detector's marks from the joints' centres, with which the skeletons were fitted.
    refinement
        Report of the refinement of the calibration; ``None`` if none was asked for.
    synchronization
        Measured clocks; ``None`` if times are as they were declared.
    check
        Check of the session by its people.
    provider
        Execution provider of the networks; ``None`` if there was nothing to detect.
    layout
        Layout of keypoints whose files do not name their points, and how it was told; ``None`` for others.
    is_emptied
        Whether edits removed everybody who was found.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> take = multicap.reconstruct(session)
    >>> take.timebase.frame_rate_hz, len(take.tracks) == len(take.motions)
    (25.0, True)
    """

    cameras: tuple[Camera, ...]
    joints: JointSet
    timebase: Timebase
    located: Sequence[Track3D]
    observations: Sequence[Observations]
    animation: Animation
    warnings: tuple[Finding, ...] = ()
    num_approximate_frames: int = 0
    damaged: tuple[DamagedVideo, ...] = ()
    doubts: Sequence[Sequence[Doubt]] = ()
    losses: Sequence[PersonLoss] = ()
    offsets: JointOffsets = field(default_factory=dict)
    refinement: Refinement | None = None
    synchronization: Synchronization | None = None
    check: SessionCheck = field(default_factory=SessionCheck)
    provider: ProviderName | None = None
    layout: Mapping[str, Any] | None = None
    is_emptied: bool = False

    @property
    def tracks(self) -> tuple[Track3D, ...]:
        """Tracks with final positions."""
        return self.animation.tracks

    @property
    def motions(self) -> tuple[SkeletonMotion, ...]:
        """Skeleton motions, in the tracks' order."""
        return self.animation.motions
