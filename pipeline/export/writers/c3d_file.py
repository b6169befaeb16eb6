"""C3D files: positions of a person's joints as points, in millimetres and world axes (Z up), and poses of segments.

A joint that is unknown in a frame is invalid there (residual -1); so are all joints in frames before and after the
track. The residual of a measured joint is its standard deviation; it is 0 where the position was filled in. The camera
mask has a bit for each camera that saw the joint, up to seven: how many did, not which. Numbers have single precision:
if the world's origin is far away, the parameter ``WORLD:ORIGIN_M`` has the world position in metres that positions are
relative to.

Poses of segments are 4 x 4 matrices in the group ``ROTATION``, as Theia3D writes and Visual3D reads them: 16 numbers by
columns, places in millimetres, and a reliability: 1, 0 where a landmark of the segment was not seen, -1 where the
person is not there. Rigid objects have poses behind the segments. The format can state a place in the first 32 MiB for
them; in longer files they are left out.

Foot strikes and foot offs of gait, and flights of jumps, are in the group ``EVENT``, in the words of Vicon and
Visual3D: labels ``Foot Strike`` and ``Foot Off`` with the contexts ``Left`` and ``Right``. There is no group without
events. Times are from the file's first frame on, in minutes and seconds.

With a laboratory's file whose time is known, the person is at its frames and in its unit of lengths; its analog
channels, force plates and events are added. Samples are floats in the file, which hold every integer of 16 bits: each
number is the laboratory's, and scales and offsets stay. Corners of force plates are in the world of the points; all
else of a plate is along its own axes. Without a laboratory's file, but with the export ``forces``, plates are estimated
(``estimated_plates``).

Takes of more than 65,535 frames have their number of frames in ``TRIAL:ACTUAL_END_FIELD`` and ``POINT:LONG_FRAMES``.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.association.own_points.rigid import RigidMotion, poses
from pipeline.capture.laboratory.c3d_content import BLOCK_BYTES, C3dHeader, read_header, read_parameters
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Laboratory, LaboratoryEvent
from pipeline.core.data.own_points import RigidShape
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet
from pipeline.export.resample import on_clock
from pipeline.export.timelines import frame_blocks, unknown_outside
from pipeline.export.writers.estimated_plates import estimated_plates
from pipeline.export.writers.registry import PersonContent, Writer, joint_positions
from pipeline.motion.angles.compute import observed
from pipeline.motion.body_segments import RIGHT_FRONT_UP, SEGMENT_LABELS, SEGMENTS
from pipeline.motion.gait.analysis import MarkedEvent, analyse_gait, marked_events
from pipeline.motion.laboratory.plates import UNITS_M, plate_corners_m
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

MAX_BLOCKS = 2**16 - 1
"""Largest number of a block that a parameter can state."""
_KEY, _INTEL, _FIRST_PARAMETERS = 0x50, 84, 2
_MAX_PARAMETER_BLOCKS, _MAX_ITEMS = 255, 255
_HEADER = struct.Struct("<BBHHHHHfHHf")
_TEXT, _BYTE, _WORD, _FLOAT = -1, 1, 2, 4

Value = Sequence[str] | Sequence[int] | Sequence[float] | np.ndarray
Groups = Mapping[str, Mapping[str, Value]]
"""Values of parameters by group and name: texts, whole numbers of 16 bits, floats, or an array of numbers by rows."""


def header_bytes(header: C3dHeader) -> bytes:
    """Header of a file; a number of frames beyond 16 bits is in the parameters alone."""
    packed = _HEADER.pack(
        _FIRST_PARAMETERS,
        _KEY,
        header.num_points,
        header.samples_per_frame,
        header.first_frame,
        min(header.last_frame, MAX_BLOCKS),
        0,
        header.scale,
        header.first_block,
        header.samples_per_channel,
        header.frame_rate_hz,
    )
    return packed.ljust(BLOCK_BYTES, b"\0")


def parameter_bytes(groups: Groups) -> bytes:
    """Blocks of the parameters.

    Raises ``ValueError`` if they need more than 255 blocks.
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
    return struct.pack("<bb", len(name), number) + name.encode("latin-1"), content + b"\0"


def _packed(value: Value) -> bytes:
    """Type, dimensions and values of a parameter."""
    if isinstance(value, np.ndarray):
        code = {"u1": _BYTE, "u2": _WORD}.get(value.dtype.str[1:], _FLOAT)
        kind = "<f4" if code == _FLOAT else value.dtype.newbyteorder("<")
        dimensions, content = value.shape[::-1], value.astype(kind).tobytes()
    elif all(isinstance(item, str) for item in value):
        texts = [str(item).encode("latin-1", "replace")[:_MAX_ITEMS] for item in value]
        width = max(map(len, texts), default=0)
        dimensions, code, content = (width, len(texts)), _TEXT, b"".join(text.ljust(width) for text in texts)
    elif all(isinstance(item, int) for item in value):
        dimensions, code, content = (len(value),), _WORD, np.array(value, "<u2").tobytes()
    else:
        dimensions, code, content = (len(value),), _FLOAT, np.array(value, "<f4").tobytes()
    if dimensions == (1,):
        dimensions = ()
    return struct.pack(f"<bB{len(dimensions)}B", code, len(dimensions), *dimensions) + content


_MM_PER_M = 1000.0
_M_PER_MM = 0.001
_SUBJECT = "person"
# Millimetres that a step of the residual's byte stands for: ezc3d writes 1 into the header of whatever it writes again,
# and leaves the parameter, so that other readers refuse any other number then.
_RESIDUAL_MM = 1.0
_MAX_BYTE, _MAX_CAMERAS, _MASK_SHIFT = 255, 7, 8
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
    laboratory: Laboratory | None = None,
    shapes: Sequence[RigidShape] = (),
) -> Iterator[bytes]:
    """Write a track's positions as C3D, piece by piece.

    - ``track``: world positions (frames, joints, 3) in metres, Z up; NaN where a joint is unknown, which is invalid in
      the file.
    - ``origin_m``: world position of the file's origin.
    - ``frames``: output frames of the file; ``None``: the track's frames. Joints are unknown outside the track's
      frames.
    - ``events``: events of the person; of more than 2,000, or fewer of long words, the first ones are written.
    - ``motion``: motion of the skeleton in the track's frames, for the poses of segments; ``None``: the file has none.
    - ``laboratory``: laboratory on whose frames the track is: its channels, force plates, events and unit of lengths
      are the file's.
    - ``shapes``: rigid objects of points among the joints, whose poses are behind the segments.

    >>> from pipeline.core.joints import COCO_17
    >>> known, zeros = np.zeros((2, 17, 3)), np.zeros((2, 17))
    >>> track = Track3D(1, 0, known, zeros, zeros.astype(np.int8), zeros, zeros.astype(int))
    >>> content = b"".join(encode(track, COCO_17, Timebase(0.0, 30.0, 2), np.zeros(3)))
    >>> read_header(content).num_points, len(content) % BLOCK_BYTES
    (17, 0)
    """
    frames = track.frames if frames is None else frames
    samples_per_frame, per_channel = (0, 0) if laboratory is None else per_frame(laboratory)
    unit, per_m = ("mm", _MM_PER_M) if laboratory is None else (laboratory.unit, 1.0 / UNITS_M[laboratory.unit])
    num_point_blocks = _num_blocks(len(frames) * (len(joints.names) * _POINT_BYTES + samples_per_frame * _FLOAT))

    rigid = poses(shapes, joints.names, track)
    labels = [*(SEGMENT_LABELS.values() if motion is not None else ()), *(each.shape.name for each in rigid)]

    def groups_at(first_block: int) -> Groups:
        rotations = first_block + num_point_blocks if labels else None
        groups = _groups(joints, timebase, origin_m, unit, frames, first_block, rotations, labels)
        own = [
            LaboratoryEvent(*event[:2], _SUBJECT, (event.frame - frames.start) / timebase.frame_rate_hz)
            for event in events
        ]
        return with_groups(groups, own, laboratory, origin_m)

    # Numbers of blocks have a fixed length: the parameters are as long as they were without them.
    first_block = 2 + len(parameter_bytes(groups_at(0))) // BLOCK_BYTES
    scale, rate_hz = -_RESIDUAL_MM * per_m * _M_PER_MM, timebase.frame_rate_hz
    facts = len(joints.names), samples_per_frame, 1, len(frames), scale, first_block, per_channel, rate_hz
    yield header_bytes(C3dHeader(*facts))
    yield parameter_bytes(groups_at(first_block))
    # Readers of long takes that take the rest of the last block for frames find no points there.
    points = _point_pieces(track, origin_m, per_m, frames)
    yield from _padded(points if laboratory is None else with_samples(points, laboratory), _INVALID_POINT)
    if labels and first_block + num_point_blocks <= MAX_BLOCKS:
        yield from _padded(_rotation_pieces(motion, track, joints, origin_m, per_m, frames, rigid), bytes(4))


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the joints from a file of ``encode``, block by block; NaN where unknown."""
    with path.open("rb") as file:
        header = read_header(file.read(BLOCK_BYTES))
        groups = read_parameters(file.read((header.first_block - 2) * BLOCK_BYTES))
        low, high = groups["TRIAL"]["ACTUAL_END_FIELD"]
        origin_m = np.asarray(groups.get("WORLD", {}).get("ORIGIN_M", np.zeros(3)), float)
        width, per_m = 4 * header.num_points, 1.0 / UNITS_M[str(groups["POINT"]["UNITS"][0])]
        for block in frame_blocks(int(low) + (int(high) << 16)):
            size = (block.stop - block.start) * (width + header.samples_per_frame) * _FLOAT
            rows = np.frombuffer(file.read(size), "<f4").reshape(-1, width + header.samples_per_frame)
            values = rows[:, :width].reshape(-1, header.num_points, 4).astype(float)
            is_known = values[..., 3:] >= 0.0
            yield np.where(is_known, values[..., :3] / per_m + origin_m, np.nan)


def _groups(
    joints: JointSet,
    timebase: Timebase,
    origin_m: Float[np.ndarray, " 3"],
    unit: str,
    frames: range,
    first_block: int,
    rotation_block: int | None,
    rotation_labels: list[str],
) -> dict[str, dict[str, Value]]:
    """Parameters of a file; ``rotation_block`` is the first block of the poses of segments, ``None`` without them."""
    rate_hz, num_frames = timebase.frame_rate_hz, len(frames)
    groups: dict[str, dict[str, Value]] = {
        "POINT": {
            "USED": [len(joints.names)],
            "FRAMES": [min(num_frames, MAX_BLOCKS)],
            "LONG_FRAMES": [float(num_frames)],
            "SCALE": [-_RESIDUAL_MM * _M_PER_MM / UNITS_M[unit]],
            "RATE": [rate_hz],
            "DATA_START": [first_block],
            "LABELS": joints.names,
            "UNITS": [unit],
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
            "USED": [len(rotation_labels)],
            "DATA_START": [rotation_block],
            "RATE": [rate_hz],
            "RATIO": [1],
            "FRAMES": [min(num_frames, MAX_BLOCKS)],
            "LABELS": rotation_labels,
            "UNITS": [unit],
        }
    return groups


def _point_pieces(track: Track3D, origin_m: Float[np.ndarray, " 3"], per_m: float, frames: range) -> Iterator[bytes]:
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
        values[..., :3] = np.where(is_known[..., None], (xyz_m - origin_m) * per_m, 0.0)
        values[..., 3] = np.where(is_known, word, -1.0)
        yield values.tobytes()


def _rotation_pieces(
    motion: SkeletonMotion | None,
    track: Track3D,
    joints: JointSet,
    origin_m: Float[np.ndarray, " 3"],
    per_m: float,
    frames: range,
    rigid: Sequence[RigidMotion],
) -> Iterator[bytes]:
    """Poses of segments and of rigid objects of blocks of frames, each with its reliability."""
    reliability = np.empty((0, 0)) if motion is None else segment_reliability(track, joints)
    num = reliability.shape[1]
    for block in frame_blocks(len(frames)):
        part = frames[block]
        values = np.zeros((len(part), num + len(rigid), _ROTATION_NUMBERS), "<f4")
        values[..., -1] = -1.0
        for k, each in enumerate(rigid, num):
            quat, place_m = (unknown_outside(v, each.frames, part) for v in (each.quat_xyzw, each.place_m))
            known = np.flatnonzero(np.isfinite(place_m[:, 0]))
            pose = np.zeros((len(known), 4, 4))
            pose[:, :3, :3] = Rotation.from_quat(quat[known]).as_matrix() if len(known) else 0.0
            pose[:, :3, 3], pose[:, 3, 3] = (place_m[known] - origin_m) * per_m, 1.0
            values[known, k] = np.column_stack([np.swapaxes(pose, 1, 2).reshape(-1, 16), np.ones(len(known))])
        if motion is None:
            yield values.tobytes()
            continue
        inside = range(max(part.start, track.frames.start), min(part.stop, track.frames.stop))
        if inside:
            rows = slice(inside.start - track.start_frame, inside.stop - track.start_frame)
            poses = segment_poses(motion, rows)
            poses[..., :3, 3] = (poses[..., :3, 3] - origin_m) * per_m
            own = values[inside.start - part.start : inside.stop - part.start, :num]
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


def _on_laboratory(person: PersonContent) -> PersonContent:
    """Person at the frames of the laboratory's file, if its time is known and it has frames of the person."""
    laboratory = person.laboratory
    if laboratory is None or laboratory.start is None:
        return replace(person, laboratory=None)
    clock = Timebase(laboratory.start.time_s, laboratory.frame_rate_hz, laboratory.num_frames)
    moved = on_clock(person.track, person.motion, person.timebase, clock)
    if moved is None:
        return replace(person, laboratory=None)
    return replace(person, track=moved[0], motion=moved[1], timebase=clock, frames=range(clock.num_frames))


def _shown(person: PersonContent) -> PersonContent:
    return _on_laboratory(_with_centre(person))


def _encode_person(given: PersonContent) -> Iterator[bytes]:
    """Write a person's file, with the events of gait and jumps."""
    events = marked_events(analyse_gait(given.track, given.joints, given.timebase.frame_rate_hz))
    person = _shown(given)
    if person.laboratory is not None:
        times_s = [given.timebase.time_s(event.frame) - person.timebase.start_time_s for event in events]
        frames = [time_s * person.timebase.frame_rate_hz for time_s in times_s]
        events = tuple(
            event._replace(frame=frame)
            for event, frame in zip(events, frames, strict=True)
            if 0.0 <= frame <= len(person.frames)
        )
    laboratory = person.laboratory
    if laboratory is None and (forces := given.forces()) is not None:
        laboratory = estimated_plates(forces, given.timebase, given.frames)
    content = person.track, person.joints, person.timebase, person.origin_m, person.frames, events, person.motion
    return encode(*content, laboratory, person.shapes)


WRITER = Writer(
    _encode_person,
    lambda path, _: read_xyz_m(path),
    lambda person: joint_positions(_shown(person)),
    has_origin=True,
    frames=lambda person: _shown(person).frames,
)


_SECONDS_PER_MINUTE = 60.0
# Events that the blocks of parameters hold beside the rest, and their bytes.
_MAX_EVENTS, _MAX_EVENT_BYTES = 2000, 64_000


def per_frame(laboratory: Laboratory) -> tuple[int, int]:
    """Analog numbers of a frame, and samples of a channel in it."""
    return laboratory.samples_per_frame * laboratory.samples.shape[1], laboratory.samples_per_frame


def with_samples(points: Iterator[bytes], laboratory: Laboratory) -> Iterator[bytes]:
    """Blocks of points, each frame with its samples after it."""
    samples = laboratory.samples.reshape(laboratory.num_frames, -1)
    for block, part in zip(points, frame_blocks(len(samples)), strict=True):
        rows = np.frombuffer(block, "<f4").reshape(part.stop - part.start, -1)
        yield np.concatenate([rows, samples[part].astype("<f4")], axis=1).tobytes()


def with_groups(
    groups: Mapping[str, Mapping[str, Any]],
    events: Sequence[LaboratoryEvent],
    laboratory: Laboratory | None,
    origin_m: Float[np.ndarray, " 3"],
) -> dict[str, Mapping[str, Any]]:
    """Groups of a file with the events, and with channels, force plates and events of a laboratory."""
    added: dict[str, Mapping[str, Any]] = {}
    if laboratory is not None:
        events = sorted((*events, *laboratory.events), key=lambda event: event.time_s)
        added["ANALOG"] = {**laboratory.groups["ANALOG"], "RATE": [laboratory.sample_rate_hz]}
        if plates := laboratory.groups["FORCE_PLATFORM"]:
            corners = (plate_corners_m(laboratory) - origin_m) / UNITS_M[laboratory.unit]
            added["FORCE_PLATFORM"] = {**plates, "CORNERS": corners} if len(corners) else plates
    if events:
        widths = [max(map(len, texts)) for texts in zip(*(event[:3] for event in events), strict=True)]
        events = events[: min(_MAX_EVENTS, _MAX_EVENT_BYTES // (8 + sum(widths)))]
        times = np.stack(np.divmod([event.time_s for event in events], _SECONDS_PER_MINUTE), axis=1)
        added["EVENT"] = {
            "USED": [len(events)],
            "CONTEXTS": [event.context for event in events],
            "LABELS": [event.label for event in events],
            "SUBJECTS": [event.subject for event in events],
            "TIMES": times,
        }
    return {**groups, **added}
