"""GLB files (glTF 2.0, binary): the skeleton with a body mesh, and the motion as an animation.

Axes and unit are those of glTF: Y up, facing +Z, metres. The rest pose is a T-pose that stands on the floor at the
origin. Joints have the skeleton's names, ends of bones included. The animation begins at 0 s with the person's first
frame; its ``extras`` contain the number of that output frame. Numbers have single precision: if the world's origin is
far away, ``extras`` also contain the world position in metres, ``origin_m``, that positions are relative to.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
from jaxtyping import Float, Shaped
from scipy.spatial.transform import Rotation

from pipeline.data.animation import SkeletonMotion
from pipeline.export.colors import color_rgb
from pipeline.export.presets import GLTF
from pipeline.export.writers.body_mesh import BodyMesh, body_at_rest
from pipeline.skeleton.model import INDEX, children_of, skeleton_of

# NumPy types of the components of accessors.
_COMPONENTS: dict[int, np.dtype[Any]] = {
    gltf.FLOAT: np.dtype("<f4"),
    gltf.UNSIGNED_BYTE: np.dtype("u1"),
    gltf.UNSIGNED_SHORT: np.dtype("<u2"),
}
_NUM_COMPONENTS = {gltf.SCALAR: 1, gltf.VEC3: 3, gltf.VEC4: 4, gltf.MAT4: 16}
_ALIGNMENT = 4
_ROOT = 0
# Number of the first joint's node; the node before it is the parent of the skeleton.
_FIRST_JOINT = 1
_GAMMA = 2.2
# Name in the extras of the world position of the file's origin, in metres.
_ORIGIN = "origin_m"


class _Buffer:
    """Buffer of a file, and the accessors of its arrays."""

    def __init__(self) -> None:
        self.accessors: list[gltf.Accessor] = []
        self.views: list[gltf.BufferView] = []
        self.content = bytearray()

    def add(
        self,
        array: Shaped[np.ndarray, "rows *columns"],
        kind: str,
        component: int = gltf.FLOAT,
        target: int | None = None,
    ) -> int:
        """Append an array and return the number of its accessor."""
        values = np.ascontiguousarray(array, _COMPONENTS[component]).reshape(-1, _NUM_COMPONENTS[kind])
        content = values.tobytes()
        self.views.append(
            gltf.BufferView(buffer=0, byteOffset=len(self.content), byteLength=len(content), target=target)
        )
        self.content += content.ljust(-(-len(content) // _ALIGNMENT) * _ALIGNMENT, b"\0")
        self.accessors.append(
            gltf.Accessor(
                bufferView=len(self.views) - 1,
                componentType=component,
                count=len(values),
                type=kind,
                min=values.min(0).tolist(),
                max=values.max(0).tolist(),
            )
        )
        return len(self.accessors) - 1


def encode(motion: SkeletonMotion, origin_m: Float[np.ndarray, " 3"]) -> Iterator[bytes]:
    """Write a motion as GLB, piece by piece; ``origin_m`` is the world position of the file's origin.

    Equal motions give equal bytes.
    """
    body = body_at_rest(motion.bone_length_m, GLTF)
    offsets_m = body.offsets
    buffer = _Buffer()
    file = gltf.GLTF2(
        asset=gltf.Asset(generator="Multicap"),
        scene=0,
        scenes=[gltf.Scene(nodes=[0, _FIRST_JOINT + len(offsets_m)])],
        nodes=[
            gltf.Node(name=motion.name, children=[_FIRST_JOINT + _ROOT]),
            *_joint_nodes(offsets_m),
            gltf.Node(name=f"{motion.name} body", mesh=0, skin=0),
        ],
        meshes=[gltf.Mesh(name="body", primitives=[_primitive(body.mesh, buffer)])],
        materials=[_material(motion.track_id)],
        skins=[_skin(body.positions, buffer)],
        animations=[_animation(motion, origin_m, buffer)],
        accessors=buffer.accessors,
        bufferViews=buffer.views,
        buffers=[gltf.Buffer(byteLength=len(buffer.content))],
    )
    file.set_binary_blob(bytes(buffer.content))
    yield from file.save_to_bytes()


def _joint_nodes(offsets_m: Float[np.ndarray, "joints 3"]) -> list[gltf.Node]:
    children = children_of(len(offsets_m))
    return [
        gltf.Node(
            name=GLTF.name(joint.name),
            translation=offset_m.tolist(),
            children=[_FIRST_JOINT + INDEX[child] for child in children[joint.name]],
        )
        for joint, offset_m in zip(skeleton_of(len(offsets_m)), offsets_m, strict=True)
    ]


def _primitive(mesh: BodyMesh, buffer: _Buffer) -> gltf.Primitive:
    joints, weights = np.zeros((len(mesh.joint), 4)), np.zeros((len(mesh.joint), 4))
    joints[:, 0], weights[:, 0] = mesh.joint, 1.0
    return gltf.Primitive(
        attributes=gltf.Attributes(
            POSITION=buffer.add(mesh.vertices, gltf.VEC3, target=gltf.ARRAY_BUFFER),
            NORMAL=buffer.add(mesh.normals, gltf.VEC3, target=gltf.ARRAY_BUFFER),
            JOINTS_0=buffer.add(joints, gltf.VEC4, gltf.UNSIGNED_BYTE, gltf.ARRAY_BUFFER),
            WEIGHTS_0=buffer.add(weights, gltf.VEC4, target=gltf.ARRAY_BUFFER),
        ),
        indices=buffer.add(mesh.triangles.reshape(-1), gltf.SCALAR, gltf.UNSIGNED_SHORT, gltf.ELEMENT_ARRAY_BUFFER),
        material=0,
    )


def _material(track_id: int) -> gltf.Material:
    """Matt material in the person's colour."""
    linear = (np.array(color_rgb(track_id)) / 255.0) ** _GAMMA
    surface = gltf.PbrMetallicRoughness(
        baseColorFactor=[*np.round(linear, 4).tolist(), 1.0], metallicFactor=0.0, roughnessFactor=0.8
    )
    return gltf.Material(name="body", pbrMetallicRoughness=surface)


def _skin(rest_m: Float[np.ndarray, "joints 3"], buffer: _Buffer) -> gltf.Skin:
    """Skin whose joints are aligned with the file's axes in the rest pose."""
    joint_from_file = np.tile(np.eye(4), (len(rest_m), 1, 1))
    joint_from_file[:, :3, 3] = -rest_m
    # Matrices are stored column by column.
    matrices = buffer.add(joint_from_file.swapaxes(1, 2), gltf.MAT4)
    nodes = list(range(_FIRST_JOINT, _FIRST_JOINT + len(rest_m)))
    return gltf.Skin(inverseBindMatrices=matrices, joints=nodes, skeleton=0)


def _animation(motion: SkeletonMotion, origin_m: Float[np.ndarray, " 3"], buffer: _Buffer) -> gltf.Animation:
    """Animation with a key for each frame: position of the root, and rotation of each joint with children."""
    times = buffer.add(np.arange(len(motion.root_m)) / motion.frame_rate_hz, gltf.SCALAR)
    paths = [(_ROOT, gltf.TRANSLATION, buffer.add(GLTF.file_from_xyz_m(motion.root_m - origin_m), gltf.VEC3))]
    quat_xyzw = GLTF.parent_from_joint(motion.parent_from_joint)
    children = children_of(len(motion.bone_length_m))
    paths += [
        (INDEX[name], gltf.ROTATION, buffer.add(quat_xyzw[:, INDEX[name]], gltf.VEC4))
        for name in children
        if children[name]
    ]
    return gltf.Animation(
        name=motion.name,
        samplers=[gltf.AnimationSampler(input=times, output=output, interpolation="LINEAR") for *_, output in paths],
        channels=[
            gltf.AnimationChannel(
                sampler=number, target=gltf.AnimationChannelTarget(node=_FIRST_JOINT + index, path=path)
            )
            for number, (index, path, _) in enumerate(paths)
        ],
        extras={
            "start_frame": motion.start_frame,
            "frame_rate_hz": motion.frame_rate_hz,
            **({_ORIGIN: origin_m.tolist()} if origin_m.any() else {}),
        },
    )


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the skeleton's joints from the animation in a file of ``encode``."""
    file = gltf.GLTF2.load_binary(str(path))
    content = file.binary_blob()

    def array(number: int) -> Float[np.ndarray, "rows columns"]:
        accessor = file.accessors[number]
        view, columns = file.bufferViews[accessor.bufferView], _NUM_COMPONENTS[accessor.type]
        values = np.frombuffer(content, _COMPONENTS[accessor.componentType], accessor.count * columns, view.byteOffset)
        return values.reshape(-1, columns).astype(np.float64)

    animation = file.animations[0]
    animated = {
        (channel.target.node, channel.target.path): array(animation.samplers[channel.sampler].output)
        for channel in animation.channels
    }
    positions_m: dict[int, np.ndarray] = {}
    file_from_node: dict[int, Rotation] = {}
    parents = {child: number for number, node in enumerate(file.nodes) for child in node.children or ()}
    num_frames = len(array(animation.samplers[0].input))
    # Parents come before their children.
    for number in file.skins[0].joints:
        still = np.tile(file.nodes[number].translation, (num_frames, 1))
        offsets_m = animated.get((number, gltf.TRANSLATION), still)
        turn = Rotation.from_quat(animated.get((number, gltf.ROTATION), np.tile([0.0, 0.0, 0.0, 1.0], (num_frames, 1))))
        parent = parents[number]
        if parent in positions_m:
            offsets_m = positions_m[parent] + file_from_node[parent].apply(offsets_m)
            turn = file_from_node[parent] * turn
        positions_m[number], file_from_node[number] = offsets_m, turn
    origin_m = np.array((animation.extras or {}).get(_ORIGIN, (0.0, 0.0, 0.0)))
    yield GLTF.xyz_m_from_file(np.stack(list(positions_m.values()), axis=1)) + origin_m
