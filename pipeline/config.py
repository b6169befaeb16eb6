"""What a reconstruction may be asked for."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Method = Literal["tracking", "clustering"]
Smoothing = Literal["none", "butterworth", "one-euro", "fit"]
Feet = Literal["off", "auto", "always"]
Export = Literal["bvh", "glb", "trc", "c3d", "csv"]
Preset = Literal["default", "blender", "unity-humanoid", "unreal", "mixamo"]


@dataclass(frozen=True, slots=True)
class ReconstructionConfig:
    """Choices of one reconstruction; the result does not depend on the last two.

    Parameters
    ----------
    method
        How detections become tracks: cross-view tracking of whole bodies, or clustering of joints.
    detector
        A network of ``pipeline.detect.models``.
    tracking
        Parameters of the tracker by name, instead of those that are derived from the session; see
        ``tracking.parameters.TrackingParameters``.
    clustering
        Likewise, parameters of clustering; see ``clustering.parameters.ClusteringParameters``.
    smoothing
        What becomes of the joints' positions; see ``skeleton.fit`` and ``skeleton.smooth``.
    cutoff_hz
        Of ``butterworth``.
    feet
        Which feet that stand are held in place: none, where it is likely that they stand, or all.
    frames
        Those of the session's output frames that are wanted; ``None``: all.
    people
        How many at most: those whom most cameras saw for longest; ``None``: everybody.
    chunk_frames
        Output frames of one chunk: what is decoded and detected as one piece, of one camera.
    processes
        How many chunks are worked on at once, each with a single-threaded network of its own.
    """

    method: Method = "tracking"
    detector: str = "movenet-multipose"
    tracking: Mapping[str, float] = field(default_factory=dict)
    clustering: Mapping[str, float] = field(default_factory=dict)
    smoothing: Smoothing = "fit"
    cutoff_hz: float = 6.0
    feet: Feet = "auto"
    frames: range | None = None
    people: int | None = None
    chunk_frames: int = 100
    processes: int = 1
