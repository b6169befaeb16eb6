"""FBX files (binary, 7.4): skeletons with a body as their skin, and their motion as an animation.

A file holds a person, or the scene of a take: everybody, the cameras and the floor.

A preset defines the names and the rest pose. Axes are Maya's: Y up, facing +Z, right-handed; the unit is a
centimetre, and a metre for Blender. The rest pose, which is the bind pose of the skin too, stands on the floor at the
origin. Models are the joints, ends of bones included, and the twist joints of a human body, below a node with the
person's name; joints are aligned with the file's axes at rest.

The animation begins at 0 s with the first frame of the file and has a key in each frame: of the place of the root, and
of the rotation of each joint with children. Before and after the motion's own frames the nearest pose holds; in frames
in which the person is not there, the body is not visible. Numbers
have single precision: if the world's origin is far away, the node at the top has the setting ``origin_m``, the world
position in metres that positions are relative to.
"""

import errno
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Float32
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.options.config import Body, Preset
from pipeline.export.presets import PRESETS, Y_UP_FROM_WORLD, Convention
from pipeline.export.scene import FLOOR, Rgb, TakeScene, color_rgb
from pipeline.export.timelines import frame_blocks, held
from pipeline.export.writers import fbx_scene
from pipeline.export.writers.body_mesh import CAPSULES, BodyAtRest, BodyChoice, body_at_rest
from pipeline.export.writers.euler import euler_deg
from pipeline.export.writers.fbx_drawn import BoundVertices, add_camera, add_material, add_mesh, add_skin
from pipeline.export.writers.fbx_nodes import FbxError, Int64, Node, read, write
from pipeline.export.writers.fbx_stored import StoredScene, has_setting, numbers, object_name
from pipeline.export.writers.registry import TakeWriter, Writer
from pipeline.export.writers.rotation_orders import chained, matrices, rotation_orders
from pipeline.motion.body.joints import TWIST_JOINTS
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, child_names, find_skeleton, parent_indices

# Bytes of the angles of a group of joints, which are computed together.
_GROUP_BYTES = 2**26
_BYTES_OF_ANGLES = 12
_LIMB = "LimbNode"
_REST_TAKE = "T-pose"
# Order of the angles of twist joints, which turn about a forearm alone.
_TWIST_ORDER = "XYZ"
_FLOOR_RGB: Rgb = (150, 150, 150)
ORIGIN = "origin_m"
"""Setting of the node at the top: the world position of the file's origin, in metres."""


def convention_of_fbx(preset: Preset) -> Convention:
    """Convention of a preset in FBX files; the same object for the same preset."""
    return _CONVENTIONS[preset]


def _in_fbx(preset: Preset, convention: Convention) -> Convention:
    return replace(
        convention,
        file_from_world=Y_UP_FROM_WORLD,
        units_per_m=1.0 if preset == "blender" else 100.0,
        is_order_demanded=False,
    )


_CONVENTIONS: Mapping[Preset, Convention] = MappingProxyType(
    {preset: _in_fbx(preset, convention) for preset, convention in PRESETS.items()}
)


def encode(
    motion: SkeletonMotion,
    preset: Preset,
    origin_m: Float[np.ndarray, " 3"],
    frames: range | None = None,
    is_present: Bool[np.ndarray, " frames"] | None = None,
    body: BodyChoice = CAPSULES,
) -> Iterator[bytes]:
    """Write a motion as FBX, piece by piece. Equal motions give equal bytes.

    - ``motion``: bone lengths (joints,) and path of the root (frames, 3) in metres, rotations (frames, joints, 4) as
      quaternions (x, y, z, w); all are finite.
    - ``preset``: names and rest pose.
    - ``origin_m``: world position of the file's origin.
    - ``frames``: output frames of the file; ``None``: the motion's frames. The nearest pose holds outside the motion's
      frames.
    - ``is_present``: frames of the file in which the person is there; ``None``: all.
    - ``body``: body that follows the skeleton.

    Raises ``ModelError`` if the body is a human that is not installed, or was changed.

    >>> turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, 24, 1))
    >>> motion = SkeletonMotion(1, "Anna", 0, 30.0, np.full(24, 0.3), np.zeros((2, 3)), turns, ())
    >>> b"".join(encode(motion, "default", np.zeros(3)))[:18]
    b'Kaydara FBX Binary'
    """
    frames = motion.frames if frames is None else frames
    people = _People(motion.frame_rate_hz, convention_of_fbx(preset), origin_m, frames, body)
    name = people.person_name(motion)
    clip = people.scene.add_clip(name, len(frames))
    people.add(motion, clip, people.convention.top or name, is_present)
    people.add_rest_take()
    yield from write(people.scene.nodes)


def encode_take(scene: TakeScene, preset: Preset, body: Body = "capsules") -> Iterator[bytes]:
    """Write the scene of a take as FBX, piece by piece. Equal scenes give equal bytes."""
    people = _People(
        scene.frame_rate_hz, convention_of_fbx(preset), scene.origin_m, scene.frames, BodyChoice(body, scene.floor)
    )
    clip = people.scene.add_clip("take", len(scene.frames))
    for person in scene.people:
        people.add(person.motion, clip, people.person_name(person.motion), person.is_present)
    people.add_rest_take()
    for camera in scene.cameras:
        add_camera(people.scene, camera, people.convention, scene.origin_m)
    corners = people.convention.file_from_xyz_m(scene.floor_m - scene.origin_m)
    up = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    floor = add_mesh(people.scene, FLOOR, corners, np.arange(4)[None], np.tile(up / np.linalg.norm(up), (4, 1)))
    people.scene.connect(add_material(people.scene, FLOOR, _FLOOR_RGB), floor.model)
    yield from write(people.scene.nodes)


class _People:
    """Scene of a file, to which people are added."""

    def __init__(
        self,
        frame_rate_hz: float,
        convention: Convention,
        origin_m: Float[np.ndarray, " 3"],
        frames: range,
        body: BodyChoice,
    ) -> None:
        self._body = body
        self.scene, self.convention = fbx_scene.FbxScene(frame_rate_hz, convention.units_per_m), convention
        self._origin_m, self._frames = origin_m, frames
        self._at_rest: list[tuple[list[Int64], BodyAtRest]] = []

    def person_name(self, motion: SkeletonMotion) -> str:
        """Name of a person in the file, never a joint's name: some programs find models by their names."""
        name = fbx_scene.safe_name(motion.name) or f"person-{motion.track_id}"
        is_of_joint = name in {self.convention.name(joint.name) for joint in WHOLE_SKELETON}
        return f"{name} ({motion.track_id})" if is_of_joint else name

    def add(
        self,
        motion: SkeletonMotion,
        clip: fbx_scene.Clip,
        top_name: str,
        is_present: Bool[np.ndarray, " frames"] | None,
    ) -> None:
        """Add a person with the body and the motion, below a node with a name."""
        scene, convention = self.scene, self.convention
        body = body_at_rest(motion, convention, self._body)
        orders = rotation_orders(motion, convention, "ufbx").axes
        joints = find_skeleton(len(body.offsets))
        top = add_top(scene, motion, top_name, self._origin_m, self._frames.start)
        models: list[Int64] = []
        for joint, parent, offset, axes in zip(joints, parent_indices(len(joints)), body.offsets, orders, strict=True):
            above = models[parent] if models else top
            models.append(_add_joint(scene, convention.name(joint.name), above, offset, axes))
        twists = [
            _add_joint(scene, convention.name(twist.name), models[INDEX[twist.parent]], offset, _TWIST_ORDER)
            for twist, offset in zip(body.twists, body.twist_offsets, strict=True)
        ]
        places = {top: np.zeros(3), **dict(zip([*models, *twists], body.positions, strict=True))}
        skin = _add_skin(scene, self.person_name(motion), motion.track_id, body, places)
        if is_present is not None and not is_present.all():
            scene.show(clip, skin, is_present)
        orders += (_TWIST_ORDER,) * len(twists)
        _animate(scene, clip, [*models, *twists], motion, convention, orders, self._origin_m, self._frames)
        self._at_rest.append((models, body))

    def add_rest_take(self) -> None:
        """Add the rest pose of everybody as an animation, if software needs it."""
        if self.convention.has_rest_take:
            clip = self.scene.add_clip(_REST_TAKE, 1)
            for models, body in self._at_rest:
                _animate_rest(self.scene, clip, models, body)


def add_top(
    scene: fbx_scene.FbxScene, motion: SkeletonMotion, name: str, origin_m: Float[np.ndarray, " 3"], start_frame: int
) -> Int64:
    """Add the node above the joints, on the floor."""
    facts = [
        fbx_scene.integer("person", motion.track_id, "U"),
        fbx_scene.integer("start_frame", start_frame, "U"),
        fbx_scene.number("frame_rate_hz", motion.frame_rate_hz, "U"),
    ]
    if origin_m.any():
        facts.append(fbx_scene.vector(ORIGIN, origin_m, flags="U"))
    top = scene.add_model(name, "Null", fbx_scene.SCENE, *facts)
    scene.connect(scene.add("NodeAttribute", name, "NodeAttribute", "Null", Node("TypeFlags", ("Null",))), top)
    return top


def _add_joint(
    scene: fbx_scene.FbxScene, name: str, parent: Int64, offset: Float[np.ndarray, " 3"], axes: str
) -> Int64:
    turns = (
        fbx_scene.setting("RotationActive", "bool", "", 1),
        fbx_scene.choice("RotationOrder", fbx_scene.ROTATION_ORDERS.index(axes)),
    )
    places = fbx_scene.local(fbx_scene.TRANSLATION, offset), fbx_scene.local(fbx_scene.ROTATION, np.zeros(3))
    bone = scene.add_model(name, _LIMB, parent, *turns, *places)
    scene.connect(scene.add("NodeAttribute", name, "NodeAttribute", _LIMB, Node("TypeFlags", ("Skeleton",))), bone)
    return bone


def _add_skin(
    scene: fbx_scene.FbxScene,
    name: str,
    track_id: int,
    body: BodyAtRest,
    models: Mapping[Int64, Float[np.ndarray, " 3"]],
) -> Int64:
    """Add the body of a person; ``models`` are the node at the top and the joints' nodes, with their places.

    Returns the model of the body.
    """
    mesh, (_, *joints) = body.mesh, models
    drawn = add_mesh(scene, f"{name} body", mesh.vertices, mesh.triangles, mesh.normals)
    scene.connect(add_material(scene, f"{name} body", color_rgb(track_id)), drawn.model)
    bound = []
    for index, joint in enumerate(joints):
        vertices, places_of = np.nonzero((mesh.joints == index) & (mesh.weights > 0.0))
        if len(vertices):
            bound.append(BoundVertices(joint, vertices, mesh.weights[vertices, places_of], _moved(models[joint])))
    add_skin(scene, name, drawn, bound)
    places = {**models, drawn.model: np.zeros(3)}
    scene.add_bind_pose(name, {model: _moved(place) for model, place in places.items()})
    return drawn.model


def _moved(place: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """Transform of a model that is at a place and not turned."""
    transform = np.eye(4)
    transform[:3, 3] = place
    return transform


def _animate(
    scene: fbx_scene.FbxScene,
    clip: fbx_scene.Clip,
    models: list[Int64],
    motion: SkeletonMotion,
    convention: Convention,
    orders: tuple[str, ...],
    origin_m: Float[np.ndarray, " 3"],
    frames: range,
) -> None:
    """Add the curves of a motion: of the place of the root, and of the rotation of each joint with children.

    ``models`` are the joints of the skeleton, then the twist joints that the file has.
    """
    if not len(motion.root_m):
        return
    places = convention.file_from_xyz_m(held(motion.root_m, motion.frames, frames) - origin_m)
    scene.animate(clip, models[0], fbx_scene.TRANSLATION, places[0], lambda axis: places[:, axis])
    num_joints = len(motion.bone_length_m)
    joints = [*_with_children(num_joints), *range(num_joints, len(models))]
    angles = _Angles(motion, convention, orders, joints, frames)
    for index in joints:
        scene.animate(clip, models[index], fbx_scene.ROTATION, angles.first(index), partial(angles.angles_deg, index))


def _animate_rest(scene: fbx_scene.FbxScene, clip: fbx_scene.Clip, models: list[Int64], body: BodyAtRest) -> None:
    """Add curves of the rest pose, so that programs stand the skeleton in it, whatever pose it was in before."""
    scene.animate(clip, models[0], fbx_scene.TRANSLATION, body.offsets[0], lambda axis: body.offsets[:1, axis])
    for index in _with_children(len(models)):
        scene.animate(clip, models[index], fbx_scene.ROTATION, np.zeros(3), lambda _: np.zeros(1))


def _with_children(num_joints: int) -> list[int]:
    children = child_names(num_joints)
    return [index for index, joint in enumerate(find_skeleton(num_joints)) if children[joint.name]]


class _Angles:
    """Angles of joints about X, Y and Z in degrees, computed for groups of joints in turn.

    A file has all frames of a curve in one piece, one curve after another. So the angles of a group are in memory, of
    all joints with fewer than 100,000 frames.
    """

    def __init__(
        self, motion: SkeletonMotion, convention: Convention, orders: tuple[str, ...], joints: list[int], frames: range
    ) -> None:
        self._motion, self._convention, self._orders, self._joints = motion, convention, orders, joints
        self._frames = frames
        self._size = max(1, _GROUP_BYTES // (_BYTES_OF_ANGLES * len(frames)))
        self._group: list[int] = []
        self._angles_deg = np.empty((0, 3, 0), np.float32)
        self._first_deg: Float[np.ndarray, "joints 3"] | None = None

    def first(self, joint: int) -> Float[np.ndarray, " 3"]:
        """Angles of a joint in the first frame."""
        if self._first_deg is None:
            self._first_deg = next(self._blocks(self._joints, self._frames[:1]))[0]
        angles_deg: np.ndarray = self._first_deg[self._joints.index(joint)]
        return angles_deg

    def angles_deg(self, joint: int, axis: int) -> Float32[np.ndarray, " frames"]:
        """Angles of a joint about an axis in all frames."""
        if joint not in self._group:
            start = self._joints.index(joint)
            self._group = self._joints[start : start + self._size]
            # A group is in memory before the next one is made.
            self._angles_deg = np.empty((0, 3, 0), np.float32)
            angles_deg = np.empty((len(self._group), 3, len(self._frames)), np.float32)
            for rows, block_deg in zip(
                frame_blocks(angles_deg.shape[2]), self._blocks(self._group, self._frames), strict=True
            ):
                angles_deg[:, :, rows] = np.moveaxis(block_deg, 0, -1)
            self._angles_deg = angles_deg
        values: np.ndarray = self._angles_deg[self._group.index(joint), axis]
        if (joint, axis) == (self._joints[-1], 2):
            # Of a take, one person's angles are in memory at a time.
            self._group, self._angles_deg = [], np.empty((0, 3, 0), np.float32)
        return values

    def _blocks(self, joints: list[int], frames: range) -> Iterator[Float[np.ndarray, "frames joints 3"]]:
        """Angles of some joints in some frames, continuous from block to block."""
        orders = [self._orders[joint] for joint in joints]
        # Columns of the angles about X, Y and Z among those in the order of the rotations.
        columns = np.array([[axes.index(axis) for axis in "XYZ"] for axes in orders])
        angles_deg = np.zeros((1, len(joints), 3))
        own, turns = self._motion.frames, self._motion.parent_from_joint
        for rows in frame_blocks(len(frames)):
            of_skeleton = held(turns, own, frames[rows])
            quat = self._convention.parent_from_joint(of_skeleton)
            if max(joints) >= quat.shape[1]:
                twists = [self._convention.twist_from_quat(of_skeleton, twist)[:, None] for twist in TWIST_JOINTS]
                quat = np.concatenate([quat, *twists], axis=1)
            quat = quat[:, joints]
            angles_deg = euler_deg(matrices(quat), orders, angles_deg[-1])
            yield np.take_along_axis(angles_deg, columns[None], axis=2)


def read_xyz_m(path: Path, preset: Preset, person: int = 0) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of a skeleton's joints from a file, block by block.

    ``person`` is the person's place among the people of a take; a file of one person has one.

    Raises ``OSError`` if the file is no FBX or is damaged, lacks a joint or a curve, or has keys at other times than
    its frames.
    """
    convention = convention_of_fbx(preset)
    try:
        stored = StoredScene(read(np.memmap(path, np.uint8, "r").data))
        skeleton = _StoredSkeleton(stored, person, convention)
    except FbxError as error:
        raise OSError(errno.EIO, f"{path.name} is damaged: {error}") from error
    for rows in frame_blocks(skeleton.num_frames):
        turns = np.broadcast_to(np.eye(3), (rows.stop - rows.start, len(skeleton.offsets), 3, 3)).copy()
        for joint, (axes, curves) in skeleton.rotations.items():
            angles_deg = np.stack([curves["XYZ".index(axis)][rows] for axis in axes], axis=-1)
            turns[:, joint] = Rotation.from_euler(axes, angles_deg, degrees=True).as_matrix()
        places = np.stack([curve[rows] for curve in skeleton.places], axis=-1).astype(np.float64)
        yield convention.xyz_m_from_file(chained(places, skeleton.offsets, turns)) + skeleton.origin_m


class _StoredSkeleton:
    """Skeleton of a file of ``encode``, and its curves."""

    def __init__(self, scene: StoredScene, person: int, convention: Convention) -> None:
        names = [convention.name(joint.name) for joint in WHOLE_SKELETON]
        tops = list(scene.find_all("Model", "Null"))
        top = tops[person] if person < len(tops) else -1
        limbs = _limbs_below(scene, top)
        num_joints = len(limbs.keys() & set(names))
        if num_joints not in (len(SKELETON), len(WHOLE_SKELETON)) or not limbs.keys() >= set(names[:num_joints]):
            raise FbxError("the skeleton has other joints")
        models = [limbs[name] for name in names[:num_joints]]
        above = [scene.parent(model, "Model") for model in models]
        if above != [top, *(models[parent] for parent in parent_indices(num_joints)[1:])]:
            raise FbxError("joints have other parents")
        facts = scene.objects[top]
        self.origin_m = np.array(numbers(facts, ORIGIN, 3) if has_setting(facts, ORIGIN) else (0.0, 0.0, 0.0))
        self.offsets = np.array([numbers(scene.objects[model], fbx_scene.TRANSLATION, 3) for model in models])
        (rate_hz,) = numbers(scene.global_settings, "CustomFrameRate", 1)
        layer = next(iter(scene.find_all("AnimationLayer", "")), 0)
        self.places = _curves(scene, layer, models[0], fbx_scene.TRANSLATION, rate_hz)
        self.num_frames = len(self.places[0]) if self.places else 0
        self.rotations = {}
        for index in _with_children(num_joints) if self.num_frames else ():
            (order,) = numbers(scene.objects[models[index]], "RotationOrder", 1)
            if order not in range(len(fbx_scene.ROTATION_ORDERS)):
                raise FbxError(f"rotations have the order {order}")
            curves = _curves(scene, layer, models[index], fbx_scene.ROTATION, rate_hz)
            if not curves or len(curves[0]) != self.num_frames:
                raise FbxError("curves have different numbers of frames")
            self.rotations[index] = fbx_scene.ROTATION_ORDERS[int(order)], curves


def _limbs_below(scene: StoredScene, top: int) -> dict[str, int]:
    """Joints below a node, by name; parents come before their children."""
    below, limbs = {top}, {}
    for model, node in scene.find_all("Model", _LIMB).items():
        if scene.parent(model, "Model") in below:
            below.add(model)
            limbs[object_name(node)] = model
    return limbs


def _curves(
    scene: StoredScene, layer: int, model: int, of_setting: str, rate_hz: float
) -> list[Float32[np.ndarray, " frames"]]:
    """Curves of X, Y and Z of a setting of a model, with a key in each frame; none if it is not animated."""
    found = scene.curves(layer, model, of_setting)
    if found is None:
        return []
    times, values = found
    for curve in times:
        if not np.array_equal(curve, fbx_scene.ticks(len(values[0]), rate_hz)):
            raise FbxError("a curve has keys at other times than the frames")
    return values


WRITER = Writer(
    lambda person: encode(person.motion, person.preset, person.origin_m, person.frames, person.is_present, person.body),
    read_xyz_m,
    between_frames=lambda person: rotation_orders(person.motion, convention_of_fbx(person.preset), "ufbx").between,
    holds_name=True,
    has_origin=True,
    take=TakeWriter(encode_take, read_xyz_m),
)
