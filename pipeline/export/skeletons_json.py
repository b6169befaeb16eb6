"""``skeletons.json``: all people's joint positions, frame by frame, in the world.

Positions are rounded to 0.1 mm, scores to 0.001 and errors to 0.01 px; NaN becomes null. The bytes are strict JSON and
always the same for the same reconstruction.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.data import Reconstruction, Source, Track3D

SCHEMA_VERSION = 1

_BEFORE_TRACKS = b',"tracks":['
_LETTERS = np.array([source.letter for source in Source])


def _dumps(value: object) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def _joints_or_null(frame: Float[np.ndarray, "joints *values"], decimals: int) -> list[object]:
    """One frame's values; null where any of a joint's values is NaN. Adding zero turns -0.0 into 0.0."""
    known = np.isfinite(frame).reshape(len(frame), -1).all(-1)
    rounded = (np.round(frame, decimals) + 0.0).tolist()
    return [value if is_known else None for value, is_known in zip(rounded, known.tolist(), strict=True)]


def _track_parts(track: Track3D) -> Iterator[str]:
    """One track's object, in pieces of one frame: a long capture's numbers never stand in memory as Python objects."""
    head = {"id": track.track_id, "name": f"person-{track.track_id}", "start_frame": track.start_frame}
    yield _dumps(head).removesuffix("}")
    series = {
        "positions_m": (_joints_or_null(frame, 4) for frame in track.xyz_m),
        "scores": (_joints_or_null(frame, 3) for frame in track.score),
        "sources": ("".join(_LETTERS[frame]) for frame in track.source),
        "error_px": (_joints_or_null(frame, 2) for frame in track.error_px),
    }
    for name, frames in series.items():
        yield f',"{name}":['
        for number, frame in enumerate(frames):
            yield f",{_dumps(frame)}" if number else _dumps(frame)
        yield "]"
    yield "}"


def encode(reconstruction: Reconstruction) -> Iterator[bytes]:
    """Write all tracks as ``skeletons.json``, piece by piece."""
    timebase, joints = reconstruction.timebase, reconstruction.joints
    head = {
        "schema_version": SCHEMA_VERSION,
        "frame_rate_hz": timebase.frame_rate_hz,
        "start_time_s": timebase.start_time_s,
        "num_frames": timebase.num_frames,
        "joint_names": joints.names,
        "bones": joints.bones,
    }
    yield _dumps(head).removesuffix("}").encode("ascii") + _BEFORE_TRACKS
    for number, track in enumerate(reconstruction.tracks):
        yield b"," if number else b""
        for part in _track_parts(track):
            yield part.encode("ascii")
    yield b"]}\n"


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """World positions of each track in a file that ``encode`` wrote, NaN where null, a person at a time."""
    content = path.read_text(encoding="ascii")
    decoder = json.JSONDecoder()
    at = content.index(_BEFORE_TRACKS.decode("ascii")) + len(_BEFORE_TRACKS)
    while content[at] != "]":
        track, at = decoder.raw_decode(content, at + (content[at] == ","))
        unknown = [np.nan] * 3
        yield np.array([[xyz_m or unknown for xyz_m in frame] for frame in track["positions_m"]])
