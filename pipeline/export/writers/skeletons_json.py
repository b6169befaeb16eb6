"""``skeletons.json``: world positions of the joints of all people, frame by frame.

Positions and uncertainty are rounded to 0.1 mm, scores to 0.001 and errors to 0.01 px; NaN becomes null. The
uncertainty of a track without is null as a whole. The file is strict JSON with a line a track. Equal reconstructions
give equal bytes.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.association.own_points.rigid import RigidMotion, rigid_motions
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.export.timelines import BLOCK_FRAMES, frame_blocks

SCHEMA_VERSION = 1

_WITHOUT_UNCERTAINTY = ',"uncertainty_m":null'
_OWN = ',"own_points":'
_PART_BYTES = 2**20
_LETTERS = np.array([source.letter for source in Source])


def _dumps(value: object) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def _joints_or_null(values: Float[np.ndarray, "frames joints *values"], decimals: int) -> list[list[object]]:
    """Round the values of a block of frames; null where a value of a joint is NaN."""
    known = np.isfinite(values).reshape(*values.shape[:2], -1).all(-1)
    # Adding zero turns -0.0 into 0.0.
    rounded = (np.round(values, decimals) + 0.0).tolist()
    return [
        [value if is_known else None for value, is_known in zip(*frame, strict=True)]
        for frame in zip(rounded, known.tolist(), strict=True)
    ]


def _track_parts(track: Track3D) -> Iterator[str]:
    """Series of a track's JSON object, block by block: all numbers as Python objects would need too much memory."""
    series: dict[str, Callable[[slice], Sequence[object]]] = {
        "positions_m": lambda rows: _joints_or_null(track.xyz_m[rows], 4),
        "scores": lambda rows: _joints_or_null(track.score[rows], 3),
        "sources": lambda rows: ["".join(letters) for letters in _LETTERS[track.source[rows]]],
        "error_px": lambda rows: _joints_or_null(track.error_px[rows], 2),
    }
    uncertainty_m = track.uncertainty_m
    if uncertainty_m is not None:
        series["uncertainty_m"] = lambda rows: _joints_or_null(uncertainty_m[rows], 4)
    yield from _series_parts(series, track.num_frames)
    if uncertainty_m is None:
        yield _WITHOUT_UNCERTAINTY


def _series_parts(series: Mapping[str, Callable[[slice], Sequence[object]]], num_frames: int) -> Iterator[str]:
    for field, frames_of in series.items():
        yield f',"{field}":['
        for rows in frame_blocks(num_frames):
            yield f"{',' if rows.start else ''}{_dumps(frames_of(rows))[1:-1]}"
        yield "]"


def _rigid_parts(motion: RigidMotion) -> Iterator[str]:
    """JSON object of the poses of a rigid object, block by block."""

    def series(values: Float[np.ndarray, "frames *numbers"], decimals: int) -> Callable[[slice], Sequence[object]]:
        return lambda rows: [frame[0] for frame in _joints_or_null(values[rows, None], decimals)]

    shape = motion.shape
    head = {
        "name": shape.name,
        "person": motion.person,
        "start_frame": motion.frames.start,
        "point_names": shape.points,
        "points_m": np.round(shape.xyz_m, 4).tolist(),
    }
    yield _dumps(head).removesuffix("}")
    arrays = {
        "positions_m": (motion.place_m, 4),
        "rotations_xyzw": (motion.quat_xyzw, 6),
        "rms_m": (motion.rms_m, 4),
    }
    yield from _series_parts({name: series(*array) for name, array in arrays.items()}, len(motion.rms_m))
    yield "}"


def encode_track(track: Track3D, own: Track3D | None = None) -> Iterator[bytes]:
    """Write the line of a track, piece by piece, without its end and its head: a name does not change these bytes.

    ``own`` has the person's points of the user's own.
    """
    for part in _track_parts(track):
        yield part.encode("ascii")
    if own is not None:
        yield f"{_OWN}{{{''.join(_track_parts(own)).removeprefix(',')}}}".encode("ascii")


def join(reconstruction: Reconstruction, tracks: Sequence[Path]) -> Iterator[bytes]:
    """Write ``skeletons.json``, piece by piece, from files of ``encode_track`` of all tracks in their order."""
    timebase, joints, own = reconstruction.timebase, reconstruction.joints, reconstruction.own
    head = {
        "schema_version": SCHEMA_VERSION,
        "frame_rate_hz": timebase.frame_rate_hz,
        "start_time_s": timebase.start_time_s,
        "num_frames": timebase.num_frames,
        **({"first_source_frame": timebase.first_source_frame} if timebase.first_source_frame else {}),
        "joint_names": joints.names,
        "bones": joints.bones,
        **({"own_point_names": own.names} if own.names else {}),
        **({"own_point_bones": own.bones} if own.bones else {}),
    }
    yield f'{_dumps(head).removesuffix("}")},"tracks":[\n'.encode("ascii")
    for number, (track, motion, path) in enumerate(
        zip(reconstruction.tracks, reconstruction.motions, tracks, strict=True)
    ):
        of_track = {"id": track.track_id, "name": motion.name, "start_frame": track.start_frame}
        separator = ",\n" if number else ""
        yield f"{separator}{_dumps(of_track).removesuffix('}')}".encode("ascii")
        with path.open("rb") as file:
            while part := file.read(_PART_BYTES):
                yield part
        yield b"}"
    yield b"\n]"
    for number, thing in enumerate(own.objects):
        head = {"name": thing.name, "point_names": thing.points, "start_frame": thing.track.start_frame}
        head |= {"bones": thing.bones} if thing.bones else {}
        yield (b"," if number else b',"objects":[\n') + _dumps(head).removesuffix("}").encode("ascii")
        yield from encode_track(thing.track)
        yield b"}\n"
    yield b"]" if own.objects else b""
    rigid = list(rigid_motions(own))
    for number, poses in enumerate(rigid):
        yield b",\n" if number else b',"rigid_objects":[\n'
        yield from (part.encode("ascii") for part in _rigid_parts(poses))
    yield b"]}\n" if rigid else b"}\n"


def read_track_m(path: Path) -> Float[np.ndarray, "_ joints 3"]:
    """Read world positions (metres) from a file of ``encode_track``, own points last; NaN where null.

    The other series are decoded too, to detect damage.
    """
    parts_m = []
    for line in path.read_text(encoding="ascii").split(_OWN):
        parts_m.append(np.concatenate([_as_array(block) for block in _blocks(line, "positions_m")]))
        has_uncertainty = _WITHOUT_UNCERTAINTY not in line
        for name in ("scores", "sources", "error_px", *(("uncertainty_m",) if has_uncertainty else ())):
            for _ in _blocks(line, name):
                pass
    return np.concatenate(parts_m, axis=1)


def _as_array(frames: Sequence[Any]) -> Float[np.ndarray, "frames joints 3"]:
    unknown = [np.nan] * 3
    return np.array([[xyz_m or unknown for xyz_m in frame] for frame in frames])


def _blocks(line: str, name: str) -> Iterator[list[Any]]:
    """Decode a series in a track's line, block by block: all values as Python objects could need several GiB."""
    start = f'"{name}":['
    values = _values(line, line.index(start) + len(start))
    while block := list(islice(values, BLOCK_FRAMES)):
        yield block


def _values(line: str, place: int) -> Iterator[Any]:
    """Decode the values of a JSON list; ``place`` is the position after its bracket."""
    decoder = json.JSONDecoder()
    while line[place - 1 : place] != "]":
        value, place = decoder.raw_decode(line, place)
        yield value
        place += 1
