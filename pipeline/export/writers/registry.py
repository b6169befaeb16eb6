"""Declaration of a writer, which each module of this folder makes of its format, and lookup of writers by format.

``pipeline.core.options.file_formats`` declares names, labels, media types and limits of the formats; the web API needs
these too.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.own_points import RigidShape
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.core.options.choices import plainly_annotated
from pipeline.core.options.config import Body, Preset
from pipeline.core.options.file_formats import FILE_FORMATS, Export
from pipeline.export.scene import ScenePoint, TakeScene, scene_points
from pipeline.export.timelines import held, unknown_outside
from pipeline.export.writers.body_mesh import BodyChoice
from pipeline.export.writers.rotation_orders import BetweenFrames
from pipeline.motion.angles.compute import JointAngles
from pipeline.motion.balance.compute import Balance
from pipeline.motion.forces.person_forces import PersonForces


@dataclass(frozen=True, slots=True, eq=False)
class PersonContent:
    """Content of a person's file.

    Parameters
    ----------
    track, motion
        Positions of the joints in metres, and motion of the skeleton in the same frames.
    joints, timebase
        Joints of the track, and clock of its frames.
    file_name
        Name of the file.
    frames, is_present
        Output frames of the file, the person's frames among them; frames of the file in which the person is there.
    origin_m
        World position that is the origin of files of single precision.
    preset, body
        Convention of BVH and FBX files; body of files that have one.
    skeleton_m, angles, balance, forces
        World positions of the skeleton's joints, joint angles in degrees, centre of mass and balance, and forces, in
        the frames of the track, each computed once.
    own, own_names
        Points of the user's own in the frames of the track, and their names. In files of joints they are behind the
        joints in ``track`` and ``joints``, too.
    laboratory
        Records of a laboratory beside the cameras; ``None``: none.
    shapes
        Rigid objects, of the person's own points if these are theirs.

    Examples
    --------
    >>> from dataclasses import fields
    >>> [field.name for field in fields(PersonContent)][:3]
    ['track', 'motion', 'joints']
    """

    track: Track3D
    motion: SkeletonMotion
    joints: JointSet
    timebase: Timebase
    file_name: str
    frames: range
    is_present: Bool[np.ndarray, " frames"]
    origin_m: Float[np.ndarray, " 3"]
    preset: Preset
    body: BodyChoice
    skeleton_m: Callable[[], Float[np.ndarray, "_ joints 3"]]
    angles: Callable[[], JointAngles]
    balance: Callable[[], Balance | None] = lambda: None
    forces: Callable[[], PersonForces | None] = lambda: None
    own: Track3D | None = None
    own_names: tuple[str, ...] = ()
    laboratory: Laboratory | None = None
    shapes: tuple[RigidShape, ...] = ()

    @property
    def scene_points(self) -> tuple[ScenePoint, ...]:
        """Points of the user's own in the frames of the file."""
        return scene_points(self.own_names, self.own, self.frames, self.shapes)


plainly_annotated(PersonContent.__init__)

Expected = Callable[[range], Float[np.ndarray, "_ values components"]]
"""Gives the values that a file holds in a range of its frames."""


def skeleton_positions(person: PersonContent) -> Expected:
    """World positions (metres) of the skeleton's joints; outside of the person's frames the nearest pose holds."""
    return partial(held, person.skeleton_m(), person.motion.frames)


def joint_positions(person: PersonContent) -> Expected:
    """World positions (metres) of the track's joints, NaN before and after the person's frames."""
    return partial(unknown_outside, person.track.xyz_m, person.track.frames)


@dataclass(frozen=True, slots=True)
class TakeWriter:
    """Writer and reader of files of a format with the scene of a whole take."""

    encode: Callable[[TakeScene, Preset, Body], Iterator[bytes]]  # Yields the bytes of a file, piece by piece
    # Yields blocks of frames of a person of a file, like ``Writer.read``, by the place among the scene's people
    read: Callable[[Path, Preset, int], Iterator[Float[np.ndarray, "_ joints 3"]]]
    fits: Callable[[TakeScene], bool] = lambda _: True  # True if a file can be as large as a scene needs


@dataclass(frozen=True, slots=True)
class Writer:
    """Writer and reader of a format. Every file is read back and compared with what it should hold.

    Parameters
    ----------
    encode
        Yields the bytes of a person's file, piece by piece.
    read
        Yields blocks of frames of a file of ``encode`` as world positions in metres, (frames, joints, 3), or as angles
        in degrees, (frames, columns, 1); NaN for unknown values.
    expected
        Values that ``read`` should yield.
    between_frames
        Place at which interpolated angles are farthest off; ``None`` for formats without angles.
    holds_name
        True if the file holds the person's name. Other files stay as they are when the person is renamed.
    has_origin
        True if numbers have single precision, and positions are relative to the origin of ``PersonContent``.
    take
        Files of a whole take; ``None`` for formats that hold one person.
    frames
        Frames of a file, if they are not the person's.

    Examples
    --------
    >>> def encode(content):
    ...     yield ",".join(content.joints.names).encode()
    >>> Writer(encode, read=lambda path, preset: iter(())).has_origin
    False
    """

    encode: Callable[[PersonContent], Iterator[bytes]]
    read: Callable[[Path, Preset], Iterator[Float[np.ndarray, "_ values components"]]]
    expected: Callable[[PersonContent], Expected] = skeleton_positions
    between_frames: Callable[[PersonContent], BetweenFrames | None] = lambda _: None
    holds_name: bool = False
    has_origin: bool = False
    take: TakeWriter | None = None
    frames: Callable[[PersonContent], range] = lambda person: person.frames


plainly_annotated(Writer.__init__)


def find_writer(export: Export) -> Writer:
    """Writer of a format of people's files, whose module is imported; see ``formats_of_people``.

    Raises ``ImportError`` if the package that the format needs is not installed.
    """
    reference = str(FILE_FORMATS[export].writer)
    writer: Writer = resolve_name(f"{__package__}{reference}" if reference.startswith(".") else reference)
    return writer
