"""GLB files (glTF 2.0, binary): skeletons with a body mesh, and their motion as an animation.

A file holds a person, or the scene of a take: everybody, the cameras and the floor.

Axes and unit are glTF's: Y up, facing +Z, metres. The rest pose is a T-pose that stands on the floor at the
origin. Joints have the skeleton's names, ends of bones included; a human body has twist joints beside them. The
animation begins at 0 s with the first frame of the file; its ``extras`` contain the number of that output frame. Before
and after the motion's own frames the nearest pose holds. Where the person is not there, a morph target, ``absent``,
shrinks the body to points or slivers: importers know morph targets, they ignore the scale of a node with a skin, and a
scale of the joints would spoil the pose. Numbers have single precision: if the world's origin is far away, ``extras``
also contain the world position in metres, ``origin_m``, that positions are relative to. Points of the user's own are
nodes without a mesh, which have no size where they are unknown.
"""

import errno
import json
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import tan
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pygltflib as gltf
from jaxtyping import Bool, Float, Shaped
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.options.config import Body
from pipeline.export.presets import GLTF
from pipeline.export.scene import FLOOR, Rgb, SceneCamera, ScenePoint, TakeScene, color_rgb
from pipeline.export.timelines import frame_blocks, held
from pipeline.export.writers.body_mesh import CAPSULES, BodyAtRest, BodyChoice, BodyMesh, body_at_rest
from pipeline.export.writers.registry import TakeWriter, Writer
from pipeline.motion.body.joints import TWIST_JOINTS, TwistJoint
from pipeline.motion.skeleton.model import INDEX, child_names, find_skeleton

# NumPy types of the components of accessors.
_COMPONENTS: dict[int, np.dtype[Any]] = {
    gltf.FLOAT: np.dtype("<f4"),
    gltf.UNSIGNED_BYTE: np.dtype("u1"),
    gltf.UNSIGNED_SHORT: np.dtype("<u2"),
}
_NUM_COMPONENTS = {gltf.SCALAR: 1, gltf.VEC3: 3, gltf.VEC4: 4, gltf.MAT4: 16}
_ALIGNMENT = 4
_ROOT = 0
_GAMMA = 2.2
_FLOOR_RGB: Rgb = (150, 150, 150)
# Distances between which programs show what a camera sees.
_NEAR_M, _FAR_M = 0.05, 1000.0
# Cameras of glTF look along -z, with y up.
_CV_FROM_GLTF_CAMERA = np.diag([1.0, -1.0, -1.0])
# Header of a file: magic number, version, length; and of each chunk: length, type.
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_MAX_BYTES = 2**32
_FULL_BYTE = 255
# More than the body of a person and the description of its nodes take.
_MAX_BODY_BYTES = 2**20
# Name in the extras of the world position of the file's origin, in metres.
_ORIGIN = "origin_m"
# Morph target that shrinks the body of a person who is not there.
_ABSENT = "absent"

_Array = Shaped[np.ndarray, "rows *columns"]


class _Buffer:
    """Buffer of a file, and the accessors of its arrays, which are made when they are written."""

    def __init__(self) -> None:
        self.accessors: list[gltf.Accessor] = []
        self.views: list[gltf.BufferView] = []
        self.num_bytes = 0
        self._contents: list[Callable[[], bytes]] = []

    def add(
        self,
        array: _Array | Callable[[], _Array],
        kind: str,
        component: int = gltf.FLOAT,
        target: int | None = None,
        *,
        normalized: bool = False,
    ) -> int:
        """Append an array, or what a function will return once more, and return the number of its accessor.

        Whole numbers that are ``normalized`` stand for shares of the largest.
        """

        def values() -> _Array:
            made = array() if callable(array) else array
            return np.ascontiguousarray(made, _COMPONENTS[component]).reshape(-1, _NUM_COMPONENTS[kind])

        first = values()
        self.views.append(gltf.BufferView(buffer=0, byteOffset=self.num_bytes, byteLength=first.nbytes, target=target))
        self.num_bytes += -(-first.nbytes // _ALIGNMENT) * _ALIGNMENT
        self._contents.append(lambda: values().tobytes())
        self.accessors.append(
            gltf.Accessor(
                bufferView=len(self.views) - 1,
                componentType=component,
                count=len(first),
                type=kind,
                normalized=normalized,
                min=first.min(0).tolist(),
                max=first.max(0).tolist(),
            )
        )
        return len(self.accessors) - 1

    def contents(self) -> Iterator[bytes]:
        """Bytes of the arrays, one after the other."""
        for content in (make() for make in self._contents):
            yield content.ljust(-(-len(content) // _ALIGNMENT) * _ALIGNMENT, b"\0")


@dataclass(frozen=True, slots=True)
class _Channel:
    """Values of a property of a node at the times of an animation."""

    node: int
    path: str
    output: int  # Number of the accessor of the values
    interpolation: str = "LINEAR"


class GlbDocument:
    """Content of a file, to which people are added."""

    def __init__(self, origin_m: Float[np.ndarray, " 3"], frames: range, frame_rate_hz: float) -> None:
        self._origin_m, self._frames, self._frame_rate_hz = origin_m, frames, frame_rate_hz
        self._buffer = _Buffer()
        self._file = gltf.GLTF2(asset=gltf.Asset(generator="Multicap"), scene=0, scenes=[gltf.Scene()])
        self._times: int | None = None
        self._channels: list[_Channel] = []

    def add_skeleton(self, motion: SkeletonMotion, at_rest: BodyAtRest) -> int:
        """Add the skeleton of a person in its rest pose; return the number of the root's node.

        The other joints follow in the order of the skeleton, then the twist joints.
        """
        file, first_joint = self._file, len(self._file.nodes) + 1
        file.scenes[0].nodes.append(first_joint - 1)
        file.nodes += [
            gltf.Node(name=motion.name, children=[first_joint + _ROOT]),
            *_joint_nodes(at_rest, first_joint),
        ]
        return first_joint

    def add_extension(self, name: str, content: dict[str, Any]) -> None:
        """Add an extension of the file."""
        self._file.extensionsUsed.append(name)
        self._file.extensions[name] = content

    def add_person(self, motion: SkeletonMotion, is_present: Bool[np.ndarray, " frames"], body: BodyChoice) -> None:
        """Add the skeleton, the body and the motion of a person."""
        file = self._file
        at_rest = body_at_rest(motion, GLTF, body)
        rest_m, mesh = at_rest.positions, at_rest.mesh
        first_joint = self.add_skeleton(motion, at_rest)
        of_body = first_joint + len(rest_m)
        file.scenes[0].nodes.append(of_body)
        file.nodes.append(gltf.Node(name=f"{motion.name} body", mesh=len(file.meshes), skin=len(file.skins)))
        primitive = _primitive(mesh, self._buffer, len(file.materials))
        shape = gltf.Mesh(name="body", primitives=[primitive])
        file.meshes.append(shape)
        file.materials.append(_material("body", color_rgb(motion.track_id)))
        file.skins.append(_skin(rest_m, self._buffer, first_joint))
        self.animate(motion, first_joint, at_rest.twists)
        if not is_present.all():
            shrunk = self._buffer.add(at_rest.shrunk - mesh.vertices, gltf.VEC3)
            primitive.targets = [gltf.Attributes(POSITION=shrunk)]
            shape.weights, shape.extras = [0.0], {"targetNames": [_ABSENT]}
            weights = self._buffer.add(~is_present, gltf.SCALAR)
            self._channels.append(_Channel(of_body, gltf.WEIGHTS, weights, "STEP"))

    def animate(self, motion: SkeletonMotion, first_joint: int, twists: tuple[TwistJoint, ...] = ()) -> None:
        """Add keys to a skeleton: position of the root, and rotation of each joint with children and twist joint."""
        buffer, own, frames, origin_m = self._buffer, motion.frames, self._frames, self._origin_m
        if self._times is None:
            self._times = buffer.add(np.arange(len(frames)) / self._frame_rate_hz, gltf.SCALAR)

        def root_m() -> Float[np.ndarray, "frames 3"]:
            return GLTF.file_from_xyz_m(held(motion.root_m, own, frames) - origin_m)

        def turns(joint: int) -> Callable[[], Float[np.ndarray, "frames 4"]]:
            return lambda: GLTF.file_from_quat(held(motion.parent_from_joint[:, joint], own, frames))

        def twisted(twist: TwistJoint) -> Float[np.ndarray, "frames 4"]:
            return held(GLTF.twist_from_quat(motion.parent_from_joint, twist), own, frames)

        self._channels.append(_Channel(first_joint + _ROOT, gltf.TRANSLATION, buffer.add(root_m, gltf.VEC3)))
        children = child_names(len(motion.bone_length_m))
        for joint in (INDEX[name] for name in children if children[name]):
            output = buffer.add(turns(joint), gltf.VEC4)
            self._channels.append(_Channel(first_joint + joint, gltf.ROTATION, output))
        for number, twist in enumerate(twists, first_joint + len(motion.bone_length_m)):
            output = buffer.add(partial(twisted, twist), gltf.VEC4)
            self._channels.append(_Channel(number, gltf.ROTATION, output))

    def add_points(self, points: Sequence[ScenePoint], owner: SkeletonMotion | None = None) -> None:
        """Add points of the user's own, of a person or of objects: nodes of size 0 where a point is unknown.

        A rigid object has its points below it.
        """
        file, buffer = self._file, self._buffer
        if points and self._times is None:
            self._times = buffer.add(np.arange(len(self._frames)) / self._frame_rate_hz, gltf.SCALAR)
        head = "" if owner is None else f"{owner.name} "
        for point in points:
            number = len(file.nodes)
            file.scenes[0].nodes.append(number)
            parts = [(f"{head}{name}", GLTF.file_from_xyz_m(place_m).tolist()) for name, place_m in point.parts]
            file.nodes.append(gltf.Node(name=f"{head}{point.name}"))
            if parts:
                file.nodes[number].children = list(range(number + 1, number + 1 + len(parts)))
            file.nodes += [gltf.Node(name=name, translation=place) for name, place in parts]
            if point.turn_xyzw is not None:
                turns = buffer.add(GLTF.file_from_quat(point.turn_xyzw), gltf.VEC4)
                self._channels.append(_Channel(number, gltf.ROTATION, turns))
            places = GLTF.file_from_xyz_m(point.xyz_m - self._origin_m)
            self._channels.append(_Channel(number, gltf.TRANSLATION, buffer.add(places, gltf.VEC3)))
            if not point.is_known.all():
                sizes = np.repeat(point.is_known[:, None], 3, axis=1)
                self._channels.append(_Channel(number, gltf.SCALE, buffer.add(sizes, gltf.VEC3), "STEP"))

    def add_camera(self, shown: SceneCamera) -> None:
        """Add a camera, with the lens as extras."""
        file, place = self._file, shown.world_from_cam
        across_rad, upright_rad = shown.fov_rad
        lens = gltf.Perspective(
            aspectRatio=tan(across_rad / 2) / tan(upright_rad / 2), yfov=upright_rad, znear=_NEAR_M, zfar=_FAR_M
        )
        name = shown.camera.name
        turn = Rotation.from_matrix(GLTF.file_from_world @ place.rotation @ _CV_FROM_GLTF_CAMERA)
        file.scenes[0].nodes.append(len(file.nodes))
        file.nodes.append(
            gltf.Node(
                name=name,
                camera=len(file.cameras),
                translation=GLTF.file_from_xyz_m(place.translation_m - self._origin_m).tolist(),
                rotation=turn.as_quat().tolist(),
            )
        )
        file.cameras.append(gltf.Camera(name=name, type="perspective", perspective=lens, extras=shown.facts))

    def add_floor(self, corners_m: Float[np.ndarray, "4 3"]) -> None:
        """Add the floor, a quadrilateral with its corners counterclockwise from above."""
        file, buffer = self._file, self._buffer
        corners = GLTF.file_from_xyz_m(corners_m - self._origin_m)
        up = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        primitive = gltf.Primitive(
            attributes=gltf.Attributes(
                POSITION=buffer.add(corners, gltf.VEC3, target=gltf.ARRAY_BUFFER),
                NORMAL=buffer.add(np.tile(up / np.linalg.norm(up), (4, 1)), gltf.VEC3, target=gltf.ARRAY_BUFFER),
            ),
            indices=buffer.add(
                np.array([0, 1, 2, 0, 2, 3]), gltf.SCALAR, gltf.UNSIGNED_SHORT, gltf.ELEMENT_ARRAY_BUFFER
            ),
            material=len(file.materials),
        )
        file.scenes[0].nodes.append(len(file.nodes))
        file.nodes.append(gltf.Node(name=FLOOR, mesh=len(file.meshes)))
        file.meshes.append(gltf.Mesh(name=FLOOR, primitives=[primitive]))
        file.materials.append(_material(FLOOR, _FLOOR_RGB))

    def encode(self, name: str) -> Iterator[bytes]:
        """Yield the bytes of the file, piece by piece; ``name`` is the animation's name."""
        file, buffer = self._file, self._buffer
        if self._channels:
            file.animations = [self._animation(name)]
        file.accessors, file.bufferViews = buffer.accessors, buffer.views
        file.buffers = [gltf.Buffer(byteLength=buffer.num_bytes)]
        head = file.gltf_to_json(separators=(",", ":"), indent=None).encode()
        head += b" " * (-len(head) % _ALIGNMENT)
        yield _HEAD.pack(b"glTF", 2, _HEAD.size + 2 * _CHUNK.size + len(head) + buffer.num_bytes)
        yield _CHUNK.pack(len(head), b"JSON")
        yield head
        yield _CHUNK.pack(buffer.num_bytes, b"BIN\0")
        yield from buffer.contents()

    def _animation(self, name: str) -> gltf.Animation:
        return gltf.Animation(
            name=name,
            samplers=[
                gltf.AnimationSampler(input=self._times, output=channel.output, interpolation=channel.interpolation)
                for channel in self._channels
            ],
            channels=[
                gltf.AnimationChannel(
                    sampler=number, target=gltf.AnimationChannelTarget(node=channel.node, path=channel.path)
                )
                for number, channel in enumerate(self._channels)
            ],
            extras={
                "start_frame": self._frames.start,
                "frame_rate_hz": self._frame_rate_hz,
                **({_ORIGIN: self._origin_m.tolist()} if self._origin_m.any() else {}),
            },
        )


def encode(
    motion: SkeletonMotion,
    origin_m: Float[np.ndarray, " 3"],
    frames: range | None = None,
    is_present: Bool[np.ndarray, " frames"] | None = None,
    body: BodyChoice = CAPSULES,
    points: Sequence[ScenePoint] = (),
) -> Iterator[bytes]:
    """Write a motion as GLB, piece by piece. Equal motions give equal bytes.

    - ``motion``: bone lengths (joints,) and path of the root (frames, 3) in metres, rotations (frames, joints, 4) as
      quaternions (x, y, z, w); all are finite.
    - ``origin_m``: world position of the file's origin.
    - ``frames``: output frames of the file; ``None``: the motion's frames. The nearest pose holds outside the motion's
      frames.
    - ``is_present``: frames of the file in which the person is there; ``None``: all.
    - ``body``: body that follows the skeleton.
    - ``points``: points of the user's own in the frames of the file.

    Raises ``ModelError`` if the body is a human that is not installed, or was changed.

    >>> turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, 24, 1))
    >>> motion = SkeletonMotion(1, "Anna", 0, 30.0, np.full(24, 0.3), np.zeros((2, 3)), turns, ())
    >>> b"".join(encode(motion, np.zeros(3)))[:4]
    b'glTF'
    """
    frames = motion.frames if frames is None else frames
    document = GlbDocument(origin_m, frames, motion.frame_rate_hz)
    document.add_person(motion, np.ones(len(frames), bool) if is_present is None else is_present, body)
    document.add_points(points, motion)
    yield from document.encode(motion.name)


def fits(scene: TakeScene) -> bool:
    """True if the scene of a take is small enough for a file: it states its size in 32 bits."""
    keys = (len(scene.frames) * (4 * len(person.motion.bone_length_m) + 4) for person in scene.people)
    return sum(keys) * _COMPONENTS[gltf.FLOAT].itemsize + len(scene.people) * _MAX_BODY_BYTES < _MAX_BYTES


def encode_take(scene: TakeScene, body: Body = "capsules") -> Iterator[bytes]:
    """Write the scene of a take as GLB, piece by piece. Equal scenes give equal bytes."""
    document = GlbDocument(scene.origin_m, scene.frames, scene.frame_rate_hz)
    for person in scene.people:
        document.add_person(person.motion, person.is_present, BodyChoice(body, scene.floor))
        document.add_points(person.points, person.motion)
    document.add_points(scene.objects)
    for camera in scene.cameras:
        document.add_camera(camera)
    document.add_floor(scene.floor_m)
    yield from document.encode("take")


def _joint_nodes(at_rest: BodyAtRest, first_joint: int) -> list[gltf.Node]:
    offsets_m, twists = at_rest.offsets, at_rest.twists
    children = child_names(len(offsets_m))
    below: dict[str, list[int]] = {
        joint.name: [first_joint + INDEX[child] for child in children[joint.name]]
        for joint in find_skeleton(len(offsets_m))
    }
    for number, twist in enumerate(twists, first_joint + len(offsets_m)):
        below[twist.parent].append(number)
    named = [*below.items(), *((twist.name, []) for twist in twists)]
    return [
        gltf.Node(name=GLTF.name(name), translation=offset_m.tolist(), children=numbers)
        for (name, numbers), offset_m in zip(named, [*offsets_m, *at_rest.twist_offsets], strict=True)
    ]


def _primitive(mesh: BodyMesh, buffer: _Buffer, material: int) -> gltf.Primitive:
    weights = np.rint(mesh.weights * _FULL_BYTE)
    return gltf.Primitive(
        attributes=gltf.Attributes(
            POSITION=buffer.add(mesh.vertices, gltf.VEC3, target=gltf.ARRAY_BUFFER),
            NORMAL=buffer.add(mesh.normals, gltf.VEC3, target=gltf.ARRAY_BUFFER),
            JOINTS_0=buffer.add(mesh.joints, gltf.VEC4, gltf.UNSIGNED_BYTE, gltf.ARRAY_BUFFER),
            WEIGHTS_0=buffer.add(weights, gltf.VEC4, gltf.UNSIGNED_BYTE, gltf.ARRAY_BUFFER, normalized=True),
        ),
        indices=buffer.add(mesh.triangles.reshape(-1), gltf.SCALAR, gltf.UNSIGNED_SHORT, gltf.ELEMENT_ARRAY_BUFFER),
        material=material,
    )


def _material(name: str, rgb: Rgb) -> gltf.Material:
    """Matt material in a colour."""
    linear = (np.array(rgb) / 255.0) ** _GAMMA
    surface = gltf.PbrMetallicRoughness(
        baseColorFactor=[*np.round(linear, 4).tolist(), 1.0], metallicFactor=0.0, roughnessFactor=0.8
    )
    return gltf.Material(name=name, pbrMetallicRoughness=surface)


def _skin(rest_m: Float[np.ndarray, "joints 3"], buffer: _Buffer, first_joint: int) -> gltf.Skin:
    """Skin whose joints are aligned with the file's axes in the rest pose."""
    joint_from_file = np.tile(np.eye(4), (len(rest_m), 1, 1))
    joint_from_file[:, :3, 3] = -rest_m
    # Matrices are stored column by column.
    matrices = buffer.add(joint_from_file.swapaxes(1, 2), gltf.MAT4)
    nodes = list(range(first_joint, first_joint + len(rest_m)))
    return gltf.Skin(inverseBindMatrices=matrices, joints=nodes, skeleton=first_joint - 1)


class GlbReader:
    """Accessors of an open file, read range by range."""

    def __init__(self, file: BinaryIO) -> None:
        file.seek(_HEAD.size)
        length, _ = _CHUNK.unpack(file.read(_CHUNK.size))
        self.document: dict[str, Any] = json.loads(file.read(length))
        self._file, self._start = file, _HEAD.size + 2 * _CHUNK.size + length

    def num_rows(self, number: int) -> int:
        """Length of an accessor."""
        return int(self.document["accessors"][number]["count"])

    def rows(self, number: int, rows: slice) -> Float[np.ndarray, "rows columns"]:
        """Rows of an accessor."""
        accessor = self.document["accessors"][number]
        columns, kind = _NUM_COMPONENTS[accessor["type"]], _COMPONENTS[accessor["componentType"]]
        start = self.document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        row_bytes = columns * kind.itemsize
        self._file.seek(self._start + start + rows.start * row_bytes)
        content = self._file.read((rows.stop - rows.start) * row_bytes)
        if len(content) < (rows.stop - rows.start) * row_bytes:
            raise OSError(errno.EIO, f"{Path(self._file.name).name} is cut off")
        return np.frombuffer(content, kind).reshape(-1, columns).astype(np.float64)


def read_xyz_m(path: Path, person: int = 0) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of a skeleton's joints from a file, block by block.

    ``person`` is the person's place among the people of a scene; a file of one person has one.
    """
    with path.open("rb") as file:
        reader = GlbReader(file)
        nodes, joints = reader.document["nodes"], reader.document["skins"][person]["joints"]
        twists = {GLTF.name(twist.name) for twist in TWIST_JOINTS}
        yield from positions_m(reader, [joint for joint in joints if nodes[joint]["name"] not in twists])


def positions_m(reader: GlbReader, joints: Sequence[int]) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """World positions (metres) of the nodes of joints in the frames of the animation, block by block.

    ``joints`` has parents before their children.
    """
    document = reader.document
    nodes, animation = document["nodes"], document["animations"][0]
    outputs = {
        (channel["target"]["node"], channel["target"]["path"]): animation["samplers"][channel["sampler"]]["output"]
        for channel in animation["channels"]
    }
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    origin_m = np.array(animation.get("extras", {}).get(_ORIGIN, (0.0, 0.0, 0.0)))
    for rows in frame_blocks(reader.num_rows(animation["samplers"][0]["input"])):
        num_frames = rows.stop - rows.start
        places_m: dict[int, Float[np.ndarray, "frames 3"]] = {}
        file_from_node: dict[int, Float[np.ndarray, "frames 3 3"]] = {}
        for number in joints:
            place, turned = outputs.get((number, gltf.TRANSLATION)), outputs.get((number, gltf.ROTATION))
            if place is None:
                offsets_m = np.tile(nodes[number]["translation"], (num_frames, 1))
            else:
                offsets_m = reader.rows(place, rows)
            turn = np.eye(3) if turned is None else Rotation.from_quat(reader.rows(turned, rows)).as_matrix()
            turn = np.broadcast_to(turn, (num_frames, 3, 3))
            parent = parents[number]
            if parent in places_m:
                of_parent = file_from_node[parent]
                offsets_m = places_m[parent] + (of_parent @ offsets_m[..., None])[..., 0]
                turn = of_parent @ turn
            places_m[number], file_from_node[number] = offsets_m, turn
        yield GLTF.xyz_m_from_file(np.stack(list(places_m.values()), axis=1)) + origin_m


WRITER = Writer(
    lambda person: encode(
        person.motion, person.origin_m, person.frames, person.is_present, person.body, person.scene_points
    ),
    lambda path, _: read_xyz_m(path),
    holds_name=True,
    has_origin=True,
    take=TakeWriter(
        lambda scene, _, body: encode_take(scene, body), lambda path, _, person: read_xyz_m(path, person), fits
    ),
)
