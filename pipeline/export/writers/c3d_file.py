"""C3D files: positions of a person's joints as points, in millimetres and world axes (Z up), and poses of segments.

A joint that is unknown in a frame is invalid there (residual -1); so are all joints in frames before and after the
track. The residual of a measured joint is its standard deviation; it is 0 where the position was filled in. The camera
mask has a bit for each camera that saw the joint, up to seven: how many did, not which. Numbers have single precision:
if the world's origin is far away, the parameter ``WORLD:ORIGIN_M`` has the world position in metres that positions are
relative to.

Poses of segments are 4 x 4 matrices in the group ``ROTATION``, as Theia3D writes and Visual3D reads them: 16 numbers by
columns, places in millimetres, and a reliability: 1, 0 where a landmark of the segment was not seen, -1 where the
person is not there. The format can state a place in the first 32 MiB for them; in longer files they are left out.

Foot strikes and foot offs of gait, and flights of jumps, are in the group ``EVENT``, in the words of Vicon and
Visual3D: labels ``Foot Strike`` and ``Foot Off`` with the contexts ``Left`` and ``Right``. There is no group without
events. Times are from the file's first frame on, in minutes and seconds.

Takes of more than 65,535 frames have their number of frames in ``TRIAL:ACTUAL_END_FIELD`` and ``POINT:LONG_FRAMES``.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet
from pipeline.export.timelines import frame_blocks, unknown_outside
from pipeline.export.writers.registry import PersonContent, Writer, joint_positions
from pipeline.motion.angles.compute import observed
from pipeline.motion.angles.definitions import RIGHT_FRONT_UP, SEGMENT_LABELS, SEGMENTS
from pipeline.motion.gait.analysis import MarkedEvent, analyse_gait, marked_events
from pipeline.motion.skeleton.model import INDEX, posed_joints


def segment_poses(motion: SkeletonMotion, rows: slice) -> Float[np.ndarray, "frames segments 4 4"]:
    """Poses ``world_from_segment`` of the segments of ``SEGMENT_LABELS`` in some rows of a motion; places in metres."""
    part = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    positions_m, world_from_joint = posed_joints(part)
    poses = np.zeros((len(positions_m), len(SEGMENT_LABELS), 4, 4))
    for number, name in enumerate(SEGMENT_LABELS):
        segment = SEGMENTS[name]
        joint = INDEX[segment.joint]
        poses[:, number, :3, :3] = (world_from_joint[joint] @ segment.rest_from_segment)[..., RIGHT_FRONT_UP]
        poses[:, number, :3, 3] = positions_m[:, joint]
    poses[..., 3, 3] = 1.0
    return poses


def segment_reliability(track: Track3D, joints: JointSet) -> Float[np.ndarray, "frames segments"]:
    """1 in frames in which all landmarks of a segment have a position, otherwise 0: the fit has guessed the pose."""
    known = observed(track, joints)
    return np.stack([known[name] for name in SEGMENT_LABELS], axis=1).astype(float)


CENTRES = ("center_of_mass", "extrapolated_center_of_mass")
"""Points of a file beside the joints: the extrapolated centre is on the floor."""

BLOCK_BYTES = 512
MAX_BLOCKS = 2**16 - 1
"""Largest number of a block that a parameter can state."""
_KEY, _INTEL, _FIRST_PARAMETERS = 0x50, 84, 2
_MAX_PARAMETER_BLOCKS, _MAX_ITEMS = 255, 255
_HEADER = struct.Struct("<BBHHHHHfHHf")
_TEXT, _WORD, _FLOAT = -1, 2, 4

Value = Sequence[str] | Sequence[int] | Sequence[float] | np.ndarray
Groups = Mapping[str, Mapping[str, Value]]
"""Values of parameters by group and name: texts, whole numbers of 16 bits, floats, or an array of floats by rows."""


class C3dHeader(NamedTuple):
    """Facts of a file's header."""

    num_points: int
    num_frames: int
    scale: float  # Negative: the scale of residuals; points are floats
    first_block: int  # First block of the points, counted from 1
    frame_rate_hz: float


def header_bytes(header: C3dHeader) -> bytes:
    """Header of a file; a number of frames beyond 16 bits is in the parameters alone."""
    last = min(header.num_frames, MAX_BLOCKS)
    packed = _HEADER.pack(
        _FIRST_PARAMETERS,
        _KEY,
        header.num_points,
        0,
        1,
        last,
        0,
        header.scale,
        header.first_block,
        0,
        header.frame_rate_hz,
    )
    return packed.ljust(BLOCK_BYTES, b"\0")


def read_header(content: bytes) -> C3dHeader:
    """Read a header of ``header_bytes``; the number of frames is at most 65,535."""
    _, _, num_points, _, first, last, _, scale, first_block, _, rate_hz = _HEADER.unpack_from(content)
    return C3dHeader(num_points, last - first + 1, scale, first_block, rate_hz)


def parameter_bytes(groups: Groups) -> bytes:
    """Blocks of the parameters.

    Raises
    ------
    ValueError
        If they need more than 255 blocks.
    """
    entries = [
        entry
        for number, (group, parameters) in enumerate(groups.items(), start=1)
        for entry in (_entry(group, -number, b""), *_parameter_entries(number, parameters))
    ]
    # Each entry states where the next one begins; the last one states 0.
    linked = [
        head + struct.pack("<H", len(rest) + 2 if number < len(entries) - 1 else 0) + rest
        for number, (head, rest) in enumerate(entries)
    ]
    content = bytes(4) + b"".join(linked)
    num_blocks = -(-len(content) // BLOCK_BYTES)
    if num_blocks > _MAX_PARAMETER_BLOCKS:
        raise ValueError(f"the parameters need {num_blocks} blocks")
    return bytes((1, _KEY, num_blocks, _INTEL)) + content[4:].ljust(num_blocks * BLOCK_BYTES - 4, b"\0")


def _parameter_entries(group: int, parameters: Mapping[str, Value]) -> Iterator[tuple[bytes, bytes]]:
    """Entries of a group's parameters; long lists go on in further ones."""
    for name, value in parameters.items():
        for start in range(0, max(len(value), 1), _MAX_ITEMS):
            part = value[start : start + _MAX_ITEMS]
            yield _entry(name if start == 0 else f"{name}{start // _MAX_ITEMS + 1}", group, _packed(part))


def _entry(name: str, number: int, content: bytes) -> tuple[bytes, bytes]:
    """Bytes before and after the offset of an entry, which ends with an empty description."""
    return struct.pack("<bb", len(name), number) + name.encode("ascii"), content + b"\0"


def _packed(value: Value) -> bytes:
    """Type, dimensions and values of a parameter."""
    if isinstance(value, np.ndarray):
        dimensions, code, content = value.shape[::-1], _FLOAT, value.astype("<f4").tobytes()
    elif all(isinstance(item, str) for item in value):
        texts = [str(item).encode("ascii", "replace")[:_MAX_ITEMS] for item in value]
        width = max(map(len, texts), default=0)
        dimensions, code, content = (width, len(texts)), _TEXT, b"".join(text.ljust(width) for text in texts)
    elif all(isinstance(item, int) for item in value):
        dimensions, code, content = (len(value),), _WORD, np.array(value, "<u2").tobytes()
    else:
        dimensions, code, content = (len(value),), _FLOAT, np.array(value, "<f4").tobytes()
    if dimensions == (1,):
        dimensions = ()
    return struct.pack(f"<bB{len(dimensions)}B", code, len(dimensions), *dimensions) + content


def read_numbers(content: bytes) -> dict[tuple[str, str], np.ndarray]:
    """Numbers in the blocks of ``parameter_bytes`` by group and name, each as a flat array."""
    names: dict[int, str] = {}
    numbers: dict[tuple[str, str], np.ndarray] = {}
    place, step = 4, 1
    while step:
        length, number = struct.unpack_from("<bb", content, place)
        name = content[place + 2 : place + 2 + length].decode("ascii")
        place += 2 + length
        (step,) = struct.unpack_from("<H", content, place)
        if number < 0:
            names[-number] = name
        else:
            code, num_dimensions = struct.unpack_from("<bB", content, place + 2)
            if code in (_WORD, _FLOAT):
                count = int(np.prod(list(content[place + 4 : place + 4 + num_dimensions]), initial=1))
                kind = "<u2" if code == _WORD else "<f4"
                numbers[names[number], name] = np.frombuffer(content, kind, count, place + 4 + num_dimensions)
        place += step
    return numbers


_MM_PER_M = 1000.0
_SECONDS_PER_MINUTE = 60.0
_SUBJECT = "person"
# Millimetres that a step of the residual's byte stands for: ezc3d writes 1 into the header of whatever it writes again,
# and leaves the parameter, so that other readers refuse any other number then.
_RESIDUAL_MM = 1.0
_MAX_BYTE, _MAX_CAMERAS, _MASK_SHIFT = 255, 7, 8
# Events that the blocks of parameters hold beside the rest.
_MAX_EVENTS = 2000
_POINT_BYTES, _ROTATION_NUMBERS = 16, 17
_INVALID_POINT = np.array([0.0, 0.0, 0.0, -1.0], "<f4").tobytes()


def encode(
    track: Track3D,
    joints: JointSet,
    timebase: Timebase,
    origin_m: Float[np.ndarray, " 3"],
    frames: range | None = None,
    events: Sequence[MarkedEvent] = (),
    motion: SkeletonMotion | None = None,
) -> Iterator[bytes]:
    """Write a track's positions as C3D, piece by piece.

    Parameters
    ----------
    track
        World positions (frames, joints, 3) in metres, Z up; NaN where a joint is unknown, which is invalid in the file.
    origin_m
        World position of the file's origin.
    frames
        Output frames of the file; ``None``: the track's frames. Joints are unknown outside the track's frames.
    events
        Events of the person; of more than 2,000 the first ones are written.
    motion
        Motion of the skeleton in the track's frames, for the poses of segments; ``None``: the file has none.

    Examples
    --------
    >>> from pipeline.core.joints import COCO_17
    >>> known, zeros = np.zeros((2, 17, 3)), np.zeros((2, 17))
    >>> track = Track3D(1, 0, known, zeros, zeros.astype(np.int8), zeros, zeros.astype(int))
    >>> content = b"".join(encode(track, COCO_17, Timebase(0.0, 30.0, 2), np.zeros(3)))
    >>> read_header(content).num_points, len(content) % BLOCK_BYTES
    (17, 0)
    """
    frames = track.frames if frames is None else frames
    num_point_blocks = _num_blocks(len(frames) * len(joints.names) * _POINT_BYTES)

    def groups_at(first_block: int) -> Groups:
        rotations = first_block + num_point_blocks if motion is not None else None
        return _groups(joints, timebase, origin_m, frames, events[:_MAX_EVENTS], first_block, rotations)

    # Numbers of blocks have a fixed length: the parameters are as long as they were without them.
    first_block = 2 + len(parameter_bytes(groups_at(0))) // BLOCK_BYTES
    yield header_bytes(C3dHeader(len(joints.names), len(frames), -_RESIDUAL_MM, first_block, timebase.frame_rate_hz))
    yield parameter_bytes(groups_at(first_block))
    # Readers of long takes that take the rest of the last block for frames find no points there.
    yield from _padded(_point_pieces(track, origin_m, frames), _INVALID_POINT)
    if motion is not None and first_block + num_point_blocks <= MAX_BLOCKS:
        yield from _padded(_rotation_pieces(motion, track, joints, origin_m, frames), bytes(4))


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the joints from a file of ``encode``, block by block; NaN where unknown."""
    with path.open("rb") as file:
        header = read_header(file.read(BLOCK_BYTES))
        numbers = read_numbers(file.read((header.first_block - 2) * BLOCK_BYTES))
        low, high = numbers["TRIAL", "ACTUAL_END_FIELD"]
        origin_m = numbers.get(("WORLD", "ORIGIN_M"), np.zeros(3)).astype(float)
        for block in frame_blocks(int(low) + (int(high) << 16)):
            size = (block.stop - block.start) * header.num_points * _POINT_BYTES
            values = np.frombuffer(file.read(size), "<f4").reshape(-1, header.num_points, 4).astype(float)
            is_known = values[..., 3:] >= 0.0
            yield np.where(is_known, values[..., :3] / _MM_PER_M + origin_m, np.nan)


def _groups(
    joints: JointSet,
    timebase: Timebase,
    origin_m: Float[np.ndarray, " 3"],
    frames: range,
    events: Sequence[MarkedEvent],
    first_block: int,
    rotation_block: int | None,
) -> Groups:
    """Parameters of a file; ``rotation_block`` is the first block of the poses of segments, ``None`` without them."""
    rate_hz, num_frames = timebase.frame_rate_hz, len(frames)
    groups: dict[str, dict[str, Value]] = {
        "POINT": {
            "USED": [len(joints.names)],
            "FRAMES": [min(num_frames, MAX_BLOCKS)],
            "LONG_FRAMES": [float(num_frames)],
            "SCALE": [-_RESIDUAL_MM],
            "RATE": [rate_hz],
            "DATA_START": [first_block],
            "LABELS": joints.names,
            "UNITS": ["mm"],
            "X_SCREEN": ["+X"],
            "Y_SCREEN": ["+Z"],
        },
        "ANALOG": {"USED": [0], "RATE": [0.0], "GEN_SCALE": [1.0]},
        "TRIAL": {
            "ACTUAL_START_FIELD": [1, 0],
            "ACTUAL_END_FIELD": [num_frames & 0xFFFF, num_frames >> 16],
            "CAMERA_RATE": [rate_hz],
        },
        "MANUFACTURER": {"COMPANY": ["Multicap"], "SOFTWARE": ["Multicap"]},
    }
    if origin_m.any():
        groups["WORLD"] = {"ORIGIN_M": origin_m.tolist()}
    if rotation_block is not None and rotation_block <= MAX_BLOCKS:
        groups["ROTATION"] = {
            "USED": [len(SEGMENT_LABELS)],
            "DATA_START": [rotation_block],
            "RATE": [rate_hz],
            "RATIO": [1],
            "FRAMES": [min(num_frames, MAX_BLOCKS)],
            "LABELS": list(SEGMENT_LABELS.values()),
            "UNITS": ["mm"],
        }
    if events:
        times_s = np.array([event.frame - frames.start for event in events]) / rate_hz
        groups["EVENT"] = {
            "USED": [len(events)],
            "CONTEXTS": [event.context for event in events],
            "LABELS": [event.label for event in events],
            "SUBJECTS": [_SUBJECT] * len(events),
            "TIMES": np.stack(np.divmod(times_s, _SECONDS_PER_MINUTE), axis=1),
        }
    return groups


def _point_pieces(track: Track3D, origin_m: Float[np.ndarray, " 3"], frames: range) -> Iterator[bytes]:
    """Points of blocks of frames: three coordinates, and mask and residual in one number."""
    sigma_m = np.full(track.source.shape, np.nan) if track.uncertainty_m is None else track.uncertainty_m
    for block in frame_blocks(len(frames)):
        part = frames[block]
        xyz_m, known_sigma_m, source, views = (
            unknown_outside(values.astype(float), track.frames, part)
            for values in (track.xyz_m, sigma_m, track.source, track.views)
        )
        is_known = np.isfinite(xyz_m).all(-1)
        is_measured = is_known & (source == Source.MEASURED)
        residual = np.clip(np.round(known_sigma_m * _MM_PER_M / _RESIDUAL_MM), 1.0, _MAX_BYTE)
        mask = 2.0 ** np.minimum(views, _MAX_CAMERAS) - 1.0
        word = np.where(is_measured, np.nan_to_num(mask) * 2**_MASK_SHIFT + np.nan_to_num(residual), 0.0)
        values = np.empty((*is_known.shape, 4), "<f4")
        values[..., :3] = np.where(is_known[..., None], (xyz_m - origin_m) * _MM_PER_M, 0.0)
        values[..., 3] = np.where(is_known, word, -1.0)
        yield values.tobytes()


def _rotation_pieces(
    motion: SkeletonMotion, track: Track3D, joints: JointSet, origin_m: Float[np.ndarray, " 3"], frames: range
) -> Iterator[bytes]:
    """Poses of segments of blocks of frames, each with its reliability."""
    reliability = segment_reliability(track, joints)
    for block in frame_blocks(len(frames)):
        part = frames[block]
        values = np.zeros((len(part), len(SEGMENT_LABELS), _ROTATION_NUMBERS), "<f4")
        values[..., -1] = -1.0
        inside = range(max(part.start, track.frames.start), min(part.stop, track.frames.stop))
        if inside:
            rows = slice(inside.start - track.start_frame, inside.stop - track.start_frame)
            poses = segment_poses(motion, rows)
            poses[..., :3, 3] = (poses[..., :3, 3] - origin_m) * _MM_PER_M
            own = values[inside.start - part.start : inside.stop - part.start]
            own[..., :-1] = np.swapaxes(poses, -1, -2).reshape(*poses.shape[:2], -1)
            own[..., -1] = reliability[rows]
        yield values.tobytes()


def _padded(pieces: Iterator[bytes], filling: bytes) -> Iterator[bytes]:
    """Pieces, and as many fillings as the last block has room for."""
    size = 0
    for piece in pieces:
        size += len(piece)
        yield piece
    yield filling * (-size % BLOCK_BYTES // len(filling))


def _num_blocks(num_bytes: int) -> int:
    return -(-num_bytes // BLOCK_BYTES)


def _with_centre(person: PersonContent) -> PersonContent:
    """Person with the centre of mass and the extrapolated centre of mass as further points."""
    balance, track = person.balance(), person.track
    if balance is None:
        return person
    on_floor_m = np.pad(balance.extrapolated_m, [(0, 0), (0, 1)])
    points_m = np.stack([balance.centre_m, on_floor_m], axis=1)
    known = np.isfinite(points_m).all(-1)
    given_m = np.full(track.score.shape, np.nan) if track.uncertainty_m is None else track.uncertainty_m

    def wider(given: np.ndarray, added: np.ndarray) -> np.ndarray:
        return np.concatenate([given, added], axis=1)

    widened = replace(
        track,
        xyz_m=wider(track.xyz_m, points_m),
        score=wider(track.score, known.astype(float)),
        source=wider(track.source, np.full(known.shape, Source.MEASURED)),
        error_px=wider(track.error_px, np.full(known.shape, np.nan)),
        views=wider(track.views, np.zeros(known.shape, int)),
        uncertainty_m=wider(given_m, np.stack([balance.sigma_m, balance.margin_sigma_m], axis=1)),
    )
    return replace(person, track=widened, joints=JointSet((*person.joints.names, *CENTRES), person.joints.bones))


def _encode_person(given: PersonContent) -> Iterator[bytes]:
    """Write a person's file, with the events of gait and jumps."""
    events = marked_events(analyse_gait(given.track, given.joints, given.timebase.frame_rate_hz))
    person = _with_centre(given)
    content = person.track, person.joints, person.timebase, person.origin_m, person.frames, events, person.motion
    return encode(*content)


WRITER = Writer(
    _encode_person,
    lambda path, _: read_xyz_m(path),
    lambda person: joint_positions(_with_centre(person)),
    has_origin=True,
)
