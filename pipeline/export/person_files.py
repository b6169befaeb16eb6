"""Files of one person, written and read back: one of each format, and the person's part of ``skeletons.json``."""

import contextlib
import errno
import hashlib
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.own_points import RigidShape, joined
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.joints import FINGER_JOINTS, SIDES, JointSet, finger_joints
from pipeline.core.options.config import Body, Preset, Timeline
from pipeline.core.options.file_formats import FILE_FORMATS, Export
from pipeline.core.progress import OnShare, split, sub_share
from pipeline.export.scene import file_origin_m
from pipeline.export.timelines import presence, unknown_outside
from pipeline.export.writers import skeletons_json
from pipeline.export.writers.body_mesh import CAPSULES, BodyChoice
from pipeline.export.writers.registry import PersonContent, find_writer
from pipeline.export.writers.rotation_orders import BetweenFrames
from pipeline.motion.angles.compute import JointAngles, joint_angles
from pipeline.motion.balance.compute import Balance, balance_of
from pipeline.motion.forces.person_forces import PersonForces, forces_document, forces_of
from pipeline.motion.skeleton.model import forward_kinematics

SKELETONS = "skeletons"
"""Name of ``skeletons.json`` among the formats."""

_MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class PersonOfTake:
    """A person whose files are written."""

    # Positions of the joints, and motion of the skeleton in the same frames
    track: Track3D
    motion: SkeletonMotion
    # Joints of the track, and clock of its frames
    joints: JointSet
    timebase: Timebase
    origin_m: Float[np.ndarray, " 3"]  # World position that is the origin of files of single precision
    frames: range  # Output frames of the files, the track's frames among them
    # Frames of the files in which the person is there; all in files of the person's own frames
    is_present: Bool[np.ndarray, " frames"]
    body: BodyChoice  # Body in files that have one
    subject: Subject  # Table of segments, sex and mass
    # Points of the user's own in the track's frames, and their names; ``None`` without any
    own: Track3D | None
    own_names: tuple[str, ...]
    laboratory: Laboratory | None = None  # Records of a laboratory beside the cameras
    shapes: tuple[RigidShape, ...] = ()  # Rigid objects
    floor: Floor | None = None
    others: tuple[Track3D, ...] = ()  # Other people of the take
    has_forces: bool = True  # Forces are among the exports, and so in other formats, too

    def forces(self) -> PersonForces | None:
        """Forces of the person, computed once for the files and the report of a job."""
        if self not in _FORCES:
            of_take = self.floor, self.others, self.laboratory, self.timebase
            of_person = self.motion, self.track, self.joints, self.subject, *of_take
            arrays: list[pickle.PickleBuffer] = []
            digest = hashlib.sha256(pickle.dumps(of_person, 5, buffer_callback=arrays.append))
            for array in arrays:
                digest.update(array.raw())
            if (key := digest.digest()) not in _LATEST:
                _LATEST[key] = self.track.num_frames, forces_of(*of_person)
            _FORCES[self] = _LATEST[key][1]
            while sum(num_frames for num_frames, _ in _LATEST.values()) > _MAX_LATEST_FRAMES:
                del _LATEST[next(iter(_LATEST))]
        return _FORCES[self]

    @property
    def all_points(self) -> Track3D:
        """Joints, and points of the user's own behind them."""
        return self.track if self.own is None else joined(self.track, self.own)


# Forces end with the person, but for the latest: processes that write files live longer than a take.
_FORCES = WeakKeyDictionary[PersonOfTake, PersonForces | None]()
_LATEST, _MAX_LATEST_FRAMES = dict[bytes, tuple[int, PersonForces | None]](), 20_000


OnForces = Callable[[int, PersonForces], None]
"""Callback for the number of a track, and the forces of its person."""


def no_forces(_: int, __: PersonForces) -> None:
    """Report no forces."""


def force_figures(people: Iterable[PersonOfTake], on_forces: OnForces = no_forces) -> list[dict[str, Any]]:
    """Figures of people's forces for ``metrics.json``, without people who have none."""
    figures = []
    for number, forces in ((person.track.track_id, person.forces()) for person in people):
        if forces is not None:
            on_forces(number, forces)
            figures.append(forces_document(forces, number))
    return figures


def take_people(
    take: Reconstruction, timeline: Timeline, body: Body, *, has_forces: bool = True
) -> Iterator[PersonOfTake]:
    """People of a take, in its order."""
    origin_m = file_origin_m(take.cameras)
    # Capsules are the same on every floor.
    choice = CAPSULES if body == "capsules" else BodyChoice(body, take.animation.floor)
    for number, (track, motion) in enumerate(zip(take.tracks, take.motions, strict=True)):
        frames = range(take.timebase.num_frames) if timeline == "take" else track.frames
        is_present = presence(track, frames) if timeline == "take" else np.ones(len(frames), bool)
        subject = take.subject_of(track.track_id)
        of_take = take.joints, take.timebase, origin_m, frames, is_present, choice, subject
        own = take.own.of_person(number), take.own.names, take.laboratory, take.own.shapes
        others = take.animation.floor, tuple(other for other in take.tracks if other is not track)
        yield PersonOfTake(track, motion, *of_take, *own, *others, has_forces)


@dataclass(frozen=True, slots=True)
class KeptFile:
    """A file that was written before."""

    # Largest distance between joints read back and their true positions; ``None`` without joints
    distance_mm: float | None
    # Place at which interpolated angles are farthest off, for formats with angles
    between: BetweenFrames | None = None
    difference: float | None = None  # Largest difference of angles or forces read back; ``None`` without any


class KeptFiles:
    """Files of people that were written before; of this class itself, none."""

    def find(self, person: PersonOfTake, name: str, path: Path) -> KeptFile | None:
        """Write a person's file of a format, if it is kept, to a path; ``None`` if it is not."""
        return None

    def keep(self, person: PersonOfTake, name: str, path: Path, kept: KeptFile) -> None:
        """Keep the file of a person of a format, and what was found in it."""


def write_person(
    person: PersonOfTake, paths: Mapping[str, Path], preset: Preset, kept: KeptFiles, on_share: OnShare
) -> Iterator[tuple[str, KeptFile]]:
    """Write the files of a person, or take them from those that are kept.

    Each file is written and read back under a temporary name, so that no incomplete file has its final name.

    ``paths``: path of the file of each format, and of the part of ``skeletons.json`` under ``SKELETONS``. Yields
    format, and what was found in its file, when the file is complete. Raises ``OSError`` if a file can't be written,
    the disk is full, or the content of a file differs from the written content.
    """
    skeleton_m = cache(lambda: forward_kinematics(person.motion))
    angles = cache(lambda: joint_angles(person.motion, person.track, person.joints))
    balance = cache(lambda: balance_of(person.motion, person.track, person.joints, person.subject))
    for (name, path), on_file in zip(paths.items(), split(on_share, [1] * len(paths)), strict=True):
        found = kept.find(person, name, path)
        if found is None:
            # Writing takes about as long as reading.
            computed = skeleton_m, angles, balance
            found = _written(person, name, path, preset, *computed, sub_share(on_file, 0.5, 1.0))
            kept.keep(person, name, path, found)
        on_file(1.0)
        yield name, found
    on_share(1.0)


def _written(
    person: PersonOfTake,
    name: str,
    path: Path,
    preset: Preset,
    skeleton_m: Callable[[], Float[np.ndarray, "frames joints 3"]],
    angles: Callable[[], JointAngles],
    balance: Callable[[], Balance | None],
    on_read: OnShare,
) -> KeptFile:
    """Write a file of a person and read it back; returns what was found in it."""
    track = person.track
    if name == SKELETONS:
        with replacing(path, skeletons_json.encode_track(track, person.own)) as part:
            positions_m = partial(unknown_outside, person.all_points.xyz_m, track.frames)
            return KeptFile(furthest_mm(path, track.frames, positions_m, [skeletons_json.read_track_m(part)], on_read))
    export: Export = next(export for export in FILE_FORMATS if export == name)
    holds = FILE_FORMATS[export].holds
    joints = person.joints
    if holds == "joints":
        joints = replace(joints, names=(*joints.names, *person.own_names))
        track = without_resting_fingers(person.all_points, joints)
    content = PersonContent(
        track,
        person.motion,
        joints,
        person.timebase,
        path.name,
        person.frames,
        person.is_present,
        person.origin_m,
        preset,
        person.body,
        skeleton_m,
        angles,
        balance,
        person.forces if person.has_forces else lambda: None,
        person.own,
        person.own_names,
        person.laboratory,
        person.shapes,
    )
    writer = find_writer(export)
    expected = writer.expected(content)
    with replacing(path, writer.encode(content)) as part:
        read = writer.read(part, preset)
        if holds in {"angles", "forces"}:
            return KeptFile(None, difference=furthest(path, writer.frames(content), expected, read, on_read))
        distance_mm = furthest_mm(path, writer.frames(content), expected, read, on_read)
    return KeptFile(distance_mm, writer.between_frames(content))


def without_resting_fingers(track: Track3D, joints: JointSet) -> Track3D:
    """Track without the fingers of hands that no camera saw.

    Such hands rest in a pose of the model. It animates a skeleton, but is no measurement. A hand was seen in frames in
    which one of its fingers was measured or interpolated.
    """
    if FINGER_JOINTS.isdisjoint(joints.names):
        return track
    xyz_m = np.array(track.xyz_m)
    for side in SIDES:
        columns = np.isin(joints.names, finger_joints(side))
        is_seen = np.isin(track.source[:, columns], (Source.MEASURED, Source.INTERPOLATED)).any(1)
        xyz_m[np.ix_(~is_seen, columns)] = np.nan
    return replace(track, xyz_m=read_only(xyz_m))


@contextlib.contextmanager
def replacing(path: Path, pieces: Iterable[bytes]) -> Iterator[Path]:
    """Write a file under a temporary name for the block; rename it to ``path`` if the block succeeds.

    The temporary name has the ending of ``path``, by which readers know the format.
    """
    part = path.with_name(f".part-{path.name}")
    try:
        with part.open("wb") as file:
            file.writelines(pieces)
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def spoilt(path: Path) -> OSError:
    """Error of a file that is read back with other contents."""
    return OSError(errno.EIO, f"{path.name} does not hold what was written to it")


def furthest_mm(
    path: Path,
    frames: range,
    expected_m: Callable[[range], Float[np.ndarray, "_ joints 3"]],
    read_m: Iterable[Float[np.ndarray, "_ joints 3"]],
    on_share: OnShare,
) -> float | None:
    """Largest distance in mm between a person's positions read from a file, block by block, and the expected positions.

    ``expected_m`` gives the positions in a range of ``frames``, the file's frames. ``None`` if no joint is
    known in any frame. Raises ``OSError`` if shapes or unknown joints differ.
    """
    far_m = furthest(path, frames, expected_m, read_m, on_share)
    return None if far_m is None else far_m * _MM_PER_M


def furthest(
    path: Path,
    frames: range,
    expected: Callable[[range], Float[np.ndarray, "_ values components"]],
    read: Iterable[Float[np.ndarray, "_ values components"]],
    on_share: OnShare,
) -> float | None:
    """Largest distance between values read from a file, block by block, and the expected values.

    ``expected`` gives the values in a range of ``frames``, the file's frames. ``None`` if no value is known
    in any frame. Raises ``OSError`` if shapes or unknown values differ.
    """
    num_read, far = 0, []
    for block in read:
        expected_block = expected(frames[num_read : num_read + len(block)])
        num_read += len(block)
        if block.shape != expected_block.shape:
            raise spoilt(path)
        apart = (block - expected_block).reshape(-1, block.shape[-1])
        if not np.isfinite(apart).all():
            known, known_in_file = (np.isfinite(values).all(-1) for values in (expected_block, block))
            if (known != known_in_file).any():
                raise spoilt(path)
            apart = apart[known.reshape(-1)]
        if len(apart):
            far.append(np.sqrt(np.einsum("vc,vc->v", apart, apart).max()))
        on_share(num_read / len(frames))
    if num_read != len(frames):
        raise spoilt(path)
    return float(max(far)) if far else None
