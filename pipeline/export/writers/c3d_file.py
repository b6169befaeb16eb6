"""C3D files: positions of a person's joints as points, in millimetres and world axes (Z up).

A joint that is unknown in a frame is invalid there (residual -1); so are all joints in frames before and after the
track. Numbers have single precision: if the world's origin is far away, the parameter ``WORLD:ORIGIN_M`` has the world
position in metres that positions are relative to.

Foot strikes and foot offs of gait, and flights of jumps, are in the group ``EVENT``, in the words of Vicon and
Visual3D: labels ``Foot Strike`` and ``Foot Off`` with the contexts ``Left`` and ``Right``. There is no group without
events. Times are from the file's first frame on, in minutes and seconds.
"""

import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import ezc3d
import numpy as np
from jaxtyping import Float

from pipeline.data.cameras import Timebase
from pipeline.data.people import Track3D
from pipeline.export.timelines import unknown_outside
from pipeline.gait.analysis import MarkedEvent
from pipeline.joints import JointSet

_MM_PER_M = 1000.0
_PIECE_BYTES = 2**18
# Group and name of the parameter with the world position of the file's origin, in metres.
_ORIGIN = ("WORLD", "ORIGIN_M")
_SECONDS_PER_MINUTE = 60.0
_SUBJECT = "person"


def encode(
    track: Track3D,
    joints: JointSet,
    timebase: Timebase,
    origin_m: Float[np.ndarray, " 3"],
    frames: range | None = None,
    events: Sequence[MarkedEvent] = (),
) -> Iterator[bytes]:
    """Write a track's positions as C3D, piece by piece.

    ``origin_m`` is the world position of the file's origin. ``frames`` are the output frames of the file, ``None``
    those of the track. ``events`` are those of the person.
    """
    frames = track.frames if frames is None else frames
    xyz_m = unknown_outside(track.xyz_m, track.frames, frames)
    content = ezc3d.c3d()
    point = content["parameters"]["POINT"]
    point["RATE"]["value"] = [timebase.frame_rate_hz]
    point["LABELS"]["value"] = list(joints.names)
    point["UNITS"]["value"] = ["mm"]
    position_mm = np.moveaxis(xyz_m - origin_m, 0, -1).swapaxes(0, 1) * _MM_PER_M
    content["data"]["points"] = np.concatenate([position_mm, np.ones((1, *position_mm.shape[1:]))])
    unknown = np.isnan(position_mm).any(0, keepdims=True)
    content["data"]["meta_points"]["residuals"] = np.where(unknown, -1.0, 0.0)
    if origin_m.any():
        content.add_parameter(*_ORIGIN, origin_m.tolist())
    if events:
        times_s = np.array([event.frame - frames.start for event in events]) / timebase.frame_rate_hz
        content.add_parameter("EVENT", "USED", [len(events)])
        content.add_parameter("EVENT", "CONTEXTS", [event.context for event in events])
        content.add_parameter("EVENT", "LABELS", [event.label for event in events])
        content.add_parameter("EVENT", "SUBJECTS", [_SUBJECT] * len(events))
        content.add_parameter("EVENT", "TIMES", np.stack(np.divmod(times_s, _SECONDS_PER_MINUTE)))
    # ezc3d can only write to a path.
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        path = Path(folder) / "person.c3d"
        content.write(str(path))
        with path.open("rb") as file:
            yield from iter(partial(file.read, _PIECE_BYTES), b"")


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the joints from a file of ``encode``; NaN where unknown."""
    content = ezc3d.c3d(str(path))
    group, name = _ORIGIN
    origin_m = content["parameters"].get(group, {}).get(name, {"value": np.zeros(3)})["value"]
    yield np.transpose(content["data"]["points"][:3], (2, 1, 0)) / _MM_PER_M + np.array(origin_m)
