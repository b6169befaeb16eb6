"""Writers and readers of the formats of people's files.

``pipeline.core.options.config`` declares names, labels, media types and limits of the formats; the web API needs these
too.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.core.options.config import Body, Export, Preset
from pipeline.export.presets import PRESETS
from pipeline.export.scene import TakeScene
from pipeline.export.writers import angle_tables, bvh, c3d_file, csv_table, fbx, glb, trc, vrma
from pipeline.export.writers.body_mesh import BodyChoice
from pipeline.export.writers.rotation_orders import BetweenFrames, rotation_orders
from pipeline.motion.angles.compute import JointAngles
from pipeline.motion.gait.analysis import MarkedEvent, analyse_gait, marked_events


@dataclass(frozen=True, slots=True, eq=False)
class PersonContent:
    """Content of a person's file."""

    track: Track3D  # Positions of the joints
    motion: SkeletonMotion  # Motion of the skeleton in the same frames
    # Joints of the track, and clock of its frames
    joints: JointSet
    timebase: Timebase
    file_name: str  # Name of the file
    frames: range  # Output frames of the file, those of the person among them
    is_present: Bool[np.ndarray, " frames"]  # Frames of the file in which the person is there
    origin_m: Float[np.ndarray, " 3"]  # World position that is the origin of files of single precision
    preset: Preset  # Convention of BVH and FBX files
    body: BodyChoice  # Body of files that have one
    angles: Callable[[], JointAngles]  # Joint angles in the frames of the track, computed once


@dataclass(frozen=True, slots=True)
class TakeFormat:
    """Writer and reader of files of a format with the scene of a whole take."""

    encode: Callable[[TakeScene, Preset, Body], Iterator[bytes]]  # Yields the bytes of a file, piece by piece
    # Yields blocks of frames of a person of a file, as of ``Format.read``, by the place among the scene's people
    read_xyz_m: Callable[[Path, Preset, int], Iterator[Float[np.ndarray, "_ joints 3"]]]
    fits: Callable[[TakeScene], bool]  # Whether a file can be as large as a scene needs


@dataclass(frozen=True, slots=True)
class Format:
    """Writer and reader of a format."""

    encode: Callable[[PersonContent], Iterator[bytes]]  # Yields the bytes of a person's file, piece by piece
    # Yields blocks of frames of a file of ``encode`` as world positions in metres, (frames, joints, 3), or as angles in
    # degrees, (frames, columns, 1); NaN for unknown values
    read: Callable[[Path, Preset], Iterator[Float[np.ndarray, "_ values components"]]]
    # Place at which interpolated angles are farthest off; ``None`` for formats without angles
    between_frames: Callable[[PersonContent], BetweenFrames | None] = lambda _: None
    # Whether the file holds the person's name. Other files stay as they are when the person is renamed.
    holds_name: bool = False
    # Whether numbers have single precision, and positions are relative to the origin of ``PersonContent``
    has_origin: bool = False
    of_take: TakeFormat | None = None  # Files of a whole take; ``None`` for formats that hold one person


def _usd() -> ModuleType:
    """Writer and reader of USD, which import an optional package."""
    from pipeline.export.writers import usd  # noqa: PLC0415 - see above

    return usd


def _events(person: PersonContent) -> Sequence[MarkedEvent]:
    """Events of a person's gait and jumps."""
    return marked_events(analyse_gait(person.track, person.joints, person.timebase.frame_rate_hz))


FORMATS: Mapping[Export, Format] = MappingProxyType(
    {
        "bvh": Format(
            lambda person: bvh.encode(person.motion, PRESETS[person.preset], person.frames),
            lambda path, preset: bvh.read_xyz_m(path, PRESETS[preset]),
            lambda person: rotation_orders(person.motion, PRESETS[person.preset], "Blender").between,
        ),
        "glb": Format(
            lambda person: glb.encode(person.motion, person.origin_m, person.frames, person.is_present, person.body),
            lambda path, _: glb.read_xyz_m(path),
            holds_name=True,
            has_origin=True,
            of_take=TakeFormat(
                lambda scene, _, body: glb.encode_take(scene, body),
                lambda path, _, person: glb.read_xyz_m(path, person),
                glb.fits,
            ),
        ),
        "fbx": Format(
            lambda person: fbx.encode(
                person.motion, person.preset, person.origin_m, person.frames, person.is_present, person.body
            ),
            fbx.read_xyz_m,
            lambda person: rotation_orders(person.motion, fbx.convention_of_fbx(person.preset), "ufbx").between,
            holds_name=True,
            has_origin=True,
            of_take=TakeFormat(fbx.encode_take, fbx.read_xyz_m, lambda _: True),
        ),
        "usd": Format(
            lambda person: _usd().encode(person.motion, person.origin_m, person.frames, person.is_present, person.body),
            lambda path, _: _usd().read_xyz_m(path),
            holds_name=True,
            has_origin=True,
            of_take=TakeFormat(
                lambda scene, _, body: _usd().encode_take(scene, body),
                lambda path, _, person: _usd().read_xyz_m(path, person),
                lambda _: True,
            ),
        ),
        "vrma": Format(
            lambda person: vrma.encode(person.motion, person.origin_m, person.frames),
            lambda path, _: vrma.read_xyz_m(path),
            holds_name=True,
            has_origin=True,
        ),
        "trc": Format(
            lambda person: trc.encode(person.track, person.joints, person.timebase, person.file_name, person.frames),
            lambda path, _: trc.read_xyz_m(path),
        ),
        "c3d": Format(
            lambda person: c3d_file.encode(
                person.track,
                person.joints,
                person.timebase,
                person.origin_m,
                person.frames,
                _events(person),
                person.motion,
            ),
            lambda path, _: c3d_file.read_xyz_m(path),
            has_origin=True,
        ),
        "csv": Format(
            lambda person: csv_table.encode(person.track, person.joints, person.timebase, person.frames),
            lambda path, _: csv_table.read_xyz_m(path),
        ),
        "angles": Format(
            lambda person: angle_tables.encode_csv(person.angles(), person.timebase, person.frames),
            lambda path, _: angle_tables.read_csv(path),
        ),
        "mot": Format(
            lambda person: angle_tables.encode_mot(person.angles(), person.timebase, person.file_name, person.frames),
            lambda path, _: angle_tables.read_mot(path),
        ),
    }
)
