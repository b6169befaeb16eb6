"""Reader of characters in GLB and VRM files, for files of strangers: bounded, and every error is an ``InputError``.

The rest pose is the one in which the mesh was bound to the bones, where a skin states it, else the nodes' pose: files
are often saved in the middle of a movement.
"""

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.errors import printable
from pipeline.core.parsing import UnreadableError, read_json
from pipeline.core.problems.session_codes import CHARACTER_FORMAT, CHARACTER_TOO_LARGE
from pipeline.export.character.rig import (
    MAX_COORDINATE,
    MAX_LEVELS,
    MAX_NODES,
    MAX_SCALE,
    MIN_SCALE,
    CharacterFileError,
    CharacterRig,
    checked,
)

Format = Literal["GLB", "VRM 0.x", "VRM 1.0", "FBX"]
"""Formats of characters' files."""

_MAX_JSON_BYTES, _MAX_VERTICES, _MAX_JOINTS, _MAX_NAME = 64 << 20, 4_000_000, 100_000, 200
# Difference of a matrix to what translation, rotation and scales give, as a share of its scales.
_SHEAR = 1e-3
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_COMPONENTS: Mapping[int, np.dtype[Any]] = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_NUM_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Extensions that compress matrices and skins too; Draco compresses meshes alone.
_COMPRESSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")


@dataclass(frozen=True, slots=True, eq=False)
class Skinned:
    """Vertices of a mesh in the rest pose, and the bone that moves each one most."""

    positions: Float[np.ndarray, "vertices 3"]  # Positions in the scene, in the file's axes and unit
    bones: Int[np.ndarray, " vertices"]  # Numbers of nodes


@dataclass(frozen=True, slots=True, eq=False)
class CharacterFile:
    """Content of a character's file."""

    name: str  # Base name of the file
    format: Format
    # JSON and bytes of the buffer: the file's own, or made from an FBX file
    document: Mapping[str, Any]
    binary: memoryview
    rig: CharacterRig
    skinned: tuple[Skinned, ...]  # Meshes that bones move; those in compressed form are left out
    humanoid: Mapping[str, int]  # Nodes by the names of VRM's humanoid bones; empty in other files


def decode_character(name: str, content: bytes) -> CharacterFile:
    """Read a character from the bytes of a GLB or VRM file.

    Raises ``InputError`` if the file is in another format, is damaged, or has more than is read.
    """
    with checked(name):
        document, binary = _chunks(content)
        return build_character(name, document, binary, _format(document))


def build_character(name: str, document: dict[str, Any], binary: memoryview, format_name: Format) -> CharacterFile:
    """Character of a document and its buffer; see ``checked`` for errors."""
    reader = GltfDocument(document, binary)
    rig, skinned = reader.rig(), []
    for mesh_node in [
        (reader.index(node, "mesh", reader.meshes), reader.index(node, "skin", reader.skins))
        for node in reader.nodes
        if "mesh" in node and "skin" in node
    ]:
        found = reader.skinned(mesh_node, rig)
        if found is not None:
            skinned.append(found)
    return CharacterFile(name, format_name, document, binary, rig, tuple(skinned), reader.humanoid())


def _format(document: Mapping[str, Any]) -> Format:
    """Format by the extension of a VRM's humanoid, ``GLB`` without one."""
    extensions = document.get("extensions")
    names = extensions.keys() if isinstance(extensions, dict) else ()
    return "VRM 1.0" if "VRMC_vrm" in names else "VRM 0.x" if "VRM" in names else "GLB"


def _chunks(content: bytes) -> tuple[dict[str, Any], memoryview]:
    if len(content) < _HEAD.size + _CHUNK.size or not content.startswith(b"glTF"):
        raise CharacterFileError("The file is not a GLB, VRM or FBX file.", CHARACTER_FORMAT)
    _, version, _ = _HEAD.unpack_from(content)
    if version != 2:
        raise CharacterFileError(f"The file is glTF {version}; glTF 2.0 is read.", CHARACTER_FORMAT)
    length, kind = _CHUNK.unpack_from(content, _HEAD.size)
    start = _HEAD.size + _CHUNK.size
    if kind != b"JSON" or start + length > len(content):
        raise CharacterFileError("The file is cut off.")
    if length > _MAX_JSON_BYTES:
        raise CharacterFileError(f"The file describes more than {_MAX_JSON_BYTES >> 20} MiB.", CHARACTER_TOO_LARGE)
    try:
        document = read_json(content[start : start + length])
    except UnreadableError as error:
        raise CharacterFileError("The description of the file is not a JSON.") from error
    if not isinstance(document, dict):
        raise CharacterFileError("The description of the file is not a JSON object.")
    binary = memoryview(b"")
    place = start + length
    if len(content) >= place + _CHUNK.size:
        length, kind = _CHUNK.unpack_from(content, place)
        place += _CHUNK.size
        if kind == b"BIN\0":
            if place + length > len(content):
                raise CharacterFileError("The file is cut off.")
            binary = memoryview(content)[place : place + length]
    return document, binary


class GltfDocument:
    """Checked access to the JSON of a file and its buffer; see ``checked`` for errors."""

    def __init__(self, document: dict[str, Any], binary: memoryview) -> None:
        self._document, self._binary = document, binary
        self.nodes = self._objects("nodes")
        if len(self.nodes) > MAX_NODES:
            message = f"The file has {len(self.nodes):,} nodes; at most {MAX_NODES:,} are read."
            raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")
        if not self.nodes:
            raise CharacterFileError("The file has no nodes.")
        self._views, self._accessors = self._objects("bufferViews"), self._objects("accessors")
        self.meshes, self.skins = self._objects("meshes"), self._objects("skins")
        self.materials = self._objects("materials")
        required = document.get("extensionsRequired")
        for extension in _COMPRESSIONS:
            if isinstance(required, list) and extension in required:
                message = f"The content of the file is compressed ({extension})."
                hint = "Export the character once more without compression."
                raise CharacterFileError(message, CHARACTER_FORMAT, hint)
        for number, buffer in enumerate(self._objects("buffers")):
            if number or "uri" in buffer:
                raise CharacterFileError("The file keeps a part of its content in other files.")
            if self._count(buffer, "byteLength") > len(binary):
                raise CharacterFileError("The file is cut off.")
        self.joints_of = [self._indices(skin, "joints", self.nodes) for skin in self.skins]
        if not all(self.joints_of):
            raise CharacterFileError("A skin has no bones.")
        if sum(map(len, self.joints_of)) > _MAX_JOINTS:
            message = f"The skins of the file have more than {_MAX_JOINTS:,} bones."
            raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")
        self._bind: dict[int, Float[np.ndarray, "joints 4 4"]] = {}
        self._num_vertices = 0

    def rig(self) -> CharacterRig:
        """Nodes in the pose in which the mesh was bound."""
        names = self._names()
        parents = self._parents()
        places = [self._place(node) for node in self.nodes]
        is_bone = np.zeros(len(names), bool)
        for number in range(len(self.skins)):
            is_bone[list(self.joints_of[number])] = True
        translations, rotations, scales = (read_only(np.array(column)) for column in zip(*places, strict=True))
        is_skeleton = is_bone if is_bone.any() else np.ones(len(names), bool)
        return self._bound(CharacterRig(names, read_only(parents), translations, rotations, scales, is_skeleton))

    def _bound(self, rig: CharacterRig) -> CharacterRig:
        """CharacterRig in the pose of its skins: places of bones in bones of the same skin."""
        translations, rotations, scales = map(np.array, (rig.translations, rig.rotations, rig.scales))
        is_bound = np.zeros(len(rig.names), bool)
        for number in range(len(self.skins)):
            joints = self.joints_of[number]
            place_of = {joint: place for place, joint in enumerate(joints)}
            joint_from_mesh = self.bind_matrices(number)
            mesh_from_joint = _inverses(joint_from_mesh)
            if mesh_from_joint is None:
                continue
            for joint, place in place_of.items():
                parent = int(rig.parents[joint])
                if parent not in place_of or is_bound[joint]:
                    continue
                found = decomposed(joint_from_mesh[place_of[parent]] @ mesh_from_joint[place])
                if found is not None:
                    translations[joint], rotations[joint], scales[joint] = found
                    is_bound[joint] = True
        return rig.posed(read_only(translations), read_only(rotations), read_only(scales))

    def skinned(self, mesh_and_skin: tuple[int, int], rig: CharacterRig) -> Skinned | None:
        """Vertices of a mesh that bones move; ``None`` if they are compressed, or there are none."""
        mesh, skin = mesh_and_skin
        joints = np.array(self.joints_of[skin])
        scene_from_mesh = rig.worlds[joints] @ self.bind_matrices(skin)
        positions, bones = [], []
        for primitive in objects_in(self.meshes[mesh], "primitives"):
            attributes = primitive.get("attributes")
            if not isinstance(attributes, dict) or not {"POSITION", "JOINTS_0", "WEIGHTS_0"} <= attributes.keys():
                continue
            found = [self.rows(attributes, name, kind) for name, kind in _SKINNED]
            self._num_vertices += 0 if found[0] is None else len(found[0])
            if self._num_vertices > _MAX_VERTICES:
                raise CharacterFileError(f"The file has more than {_MAX_VERTICES:,} vertices.", CHARACTER_TOO_LARGE)
            if any(rows is None for rows in found):
                continue
            (points, influences, weights) = (np.asarray(rows, float) for rows in found)
            if not len(points) == len(influences) == len(weights):
                raise CharacterFileError("A mesh has attributes of different lengths.")
            numbers = influences[np.arange(len(points)), weights.argmax(1)].astype(int)
            if len(numbers) and numbers.max() >= len(joints):
                raise CharacterFileError("A mesh names a bone that its skin does not have.")
            moved = np.einsum("vij,vj->vi", scene_from_mesh[numbers, :3, :3], points)
            positions.append(moved + scene_from_mesh[numbers, :3, 3])
            bones.append(joints[numbers])
        if not positions:
            return None
        all_positions = np.concatenate(positions)
        if not np.isfinite(all_positions).all():
            raise CharacterFileError("A mesh has positions that are not numbers.")
        return Skinned(read_only(all_positions), read_only(np.concatenate(bones)))

    def humanoid(self) -> dict[str, int]:
        """Nodes of VRM's humanoid bones, of either version."""
        extensions = self._document.get("extensions")
        if not isinstance(extensions, dict):
            return {}
        found: dict[str, int] = {}
        for name in ("VRMC_vrm", "VRM"):
            extension = extensions.get(name)
            humanoid = extension.get("humanoid") if isinstance(extension, dict) else None
            bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
            if isinstance(bones, dict):
                pairs = [(bone, value) for bone, value in bones.items() if isinstance(value, dict)]
            elif isinstance(bones, list):
                pairs = [(value.get("bone"), value) for value in bones if isinstance(value, dict)]
            else:
                continue
            for bone, value in pairs:
                if isinstance(bone, str) and "node" in value:
                    found.setdefault(bone, self.index(value, "node", self.nodes))
            break
        return found

    def _names(self) -> tuple[str, ...]:
        """Names of the nodes, made different by a number where they are not."""
        given = [node.get("name") for node in self.nodes]
        names = [printable(name[:_MAX_NAME]) if isinstance(name, str) and name else "node" for name in given]
        taken = Counter(names)
        unique = [f"{name}#{number}" if taken[name] > 1 else name for number, name in enumerate(names)]
        if len(set(unique)) < len(unique):
            unique = [f"{name}#{number}" for number, name in enumerate(names)]
        return tuple(unique)

    def _parents(self) -> Int[np.ndarray, " nodes"]:
        parents = np.full(len(self.nodes), -1)
        for number, node in enumerate(self.nodes):
            for child in self._indices(node, "children", self.nodes):
                if parents[child] >= 0:
                    raise CharacterFileError("A node has two parents.")
                parents[child] = number
        depth = np.full(len(parents), -1)
        for start in range(len(parents)):
            way: list[int] = []
            above = start
            while above >= 0 and depth[above] < 0:
                if len(way) > MAX_LEVELS:
                    raise CharacterFileError(f"Nodes are in a circle, or have more than {MAX_LEVELS} levels.")
                way.append(above)
                above = int(parents[above])
            first = 0 if above < 0 else int(depth[above]) + 1
            for level, passed in enumerate(reversed(way), first):
                depth[passed] = level
        if depth.max() > MAX_LEVELS:
            raise CharacterFileError(f"Nodes have more than {MAX_LEVELS} levels.")
        return parents

    def _place(self, node: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if "matrix" in node:
            matrix = _numbers(node["matrix"], 16).reshape(4, 4).T
            found = decomposed(matrix)
            if found is None:
                raise CharacterFileError("A node has a matrix that is not a translation, rotation and scale.")
            return found
        translation = _numbers(node.get("translation", (0.0, 0.0, 0.0)), 3)
        rotation = _numbers(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), 4)
        scales = _numbers(node.get("scale", (1.0, 1.0, 1.0)), 3)
        length = np.linalg.norm(rotation)
        if not 0.1 < length < 10.0:
            raise CharacterFileError("A node has a rotation that is not a unit quaternion.")
        # Scale 0 hides things; it has no inverse, which is needed only if a bone has it.
        if np.abs(translation).max() > MAX_COORDINATE or np.abs(scales).max() > MAX_SCALE:
            raise CharacterFileError("A node is too far away, or too large.")
        return translation, rotation / length, np.where(np.abs(scales) < MIN_SCALE, MIN_SCALE, scales)

    def bind_matrices(self, skin: int) -> Float[np.ndarray, "joints 4 4"]:
        """Matrices from a mesh to each bone of its skin in the bound pose."""
        if skin not in self._bind:
            num_joints = len(self.joints_of[skin])
            rows = self.rows(self.skins[skin], "inverseBindMatrices", "MAT4")
            if rows is None:
                matrices = np.tile(np.eye(4), (num_joints, 1, 1))
            elif len(rows) < num_joints:
                raise CharacterFileError("A skin has fewer matrices than bones.")
            else:
                matrices = np.asarray(rows[:num_joints], float).reshape(-1, 4, 4).swapaxes(1, 2)
            if not (np.abs(matrices) < MAX_COORDINATE).all():
                raise CharacterFileError("A skin has matrices that are not numbers, or too large.")
            self._bind[skin] = matrices
        return self._bind[skin]

    def rows(self, owner: Mapping[str, Any], name: str, kind: str) -> Shaped[np.ndarray, "rows columns"] | None:
        """Rows of the accessor that a field names; ``None`` without one, or if it is compressed."""
        if name not in owner:
            return None
        accessor = self._accessors[self.index(owner, name, self._accessors)]
        component = accessor.get("componentType")
        dtype = _COMPONENTS.get(component) if isinstance(component, int) else None
        if accessor.get("type") != kind or dtype is None:
            raise CharacterFileError(f"The accessor of {name} has another type than its use asks for.")
        if "sparse" in accessor or "bufferView" not in accessor:
            return None
        view = self._views[self.index(accessor, "bufferView", self._views)]
        if isinstance(view.get("extensions"), dict):
            return None
        if self._count(view, "buffer") != 0:
            raise CharacterFileError("A view is of a buffer that the file does not have.")
        columns, count = _NUM_COMPONENTS[kind], self._count(accessor, "count")
        start, length = self._count(view, "byteOffset"), self._count(view, "byteLength")
        offset, row_bytes = self._count(accessor, "byteOffset"), columns * dtype.itemsize
        stride = self._count(view, "byteStride") or row_bytes
        if stride < row_bytes or start + length > len(self._binary):
            raise CharacterFileError(f"The data of {name} lie outside of the file.")
        if count and offset + (count - 1) * stride + row_bytes > length:
            raise CharacterFileError(f"The data of {name} lie outside of their view.")
        if not count:
            return np.zeros((0, columns), dtype)
        rows = np.ndarray((count, columns), dtype, self._binary, start + offset, (stride, dtype.itemsize))
        if accessor.get("normalized") is True and dtype.kind in "iu":
            return rows / np.iinfo(dtype).max
        return rows

    def _objects(self, name: str) -> list[dict[str, Any]]:
        return objects_in(self._document, name)

    def require(self, is_true: bool | np.bool_, message: str) -> None:
        """Refuse the file with a message unless something is true of it."""
        if not is_true:
            raise CharacterFileError(message)

    def index(self, owner: Mapping[str, Any], name: str, targets: Sequence[object]) -> int:
        """Number in a field that names one of some targets."""
        number = owner.get(name)
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(targets):
            raise CharacterFileError(f"The field {name} names something that the file does not have.")
        return number

    def _indices(self, owner: Mapping[str, Any], name: str, targets: Sequence[object]) -> tuple[int, ...]:
        numbers = owner.get(name, [])
        if not isinstance(numbers, list) or len(numbers) > MAX_NODES:
            raise CharacterFileError(f"The field {name} is not a list.")
        return tuple(self.index({name: number}, name, targets) for number in numbers)

    def _count(self, owner: Mapping[str, Any], name: str) -> int:
        number = owner.get(name, 0)
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**40:
            raise CharacterFileError(f"The field {name} is not a count.")
        return number


_SKINNED = (("POSITION", "VEC3"), ("JOINTS_0", "VEC4"), ("WEIGHTS_0", "VEC4"))


def objects_in(owner: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """List of objects in a field of a file."""
    values = owner.get(name, [])
    if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
        raise CharacterFileError(f"The field {name} is not a list of objects.")
    return values


def _numbers(value: Any, count: int) -> Float[np.ndarray, " count"]:
    is_list = isinstance(value, (list, tuple)) and len(value) == count
    if not is_list or not all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in value):
        raise CharacterFileError("A node has a place that is not a list of numbers.")
    numbers = np.array(value, float)
    if not np.isfinite(numbers).all():
        raise CharacterFileError("A node has a place that is not finite.")
    return numbers


def _inverses(matrices: Float[np.ndarray, "joints 4 4"]) -> Float[np.ndarray, "joints 4 4"] | None:
    """Inverse matrices; ``None`` if one of them has none."""
    scales = np.abs(np.linalg.det(matrices[:, :3, :3]))
    if (scales < MIN_SCALE**2).any():
        return None
    return np.linalg.inv(matrices)


def decomposed(matrix: Float[np.ndarray, "4 4"]) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Translation, rotation (quaternion) and scales of a matrix; ``None`` if it shears, or is flat."""
    turned = matrix[:3, :3]
    if not (np.abs(matrix) < MAX_COORDINATE).all():
        return None
    scales = np.linalg.norm(turned, axis=0)
    if not ((scales > MIN_SCALE) & (scales < MAX_SCALE)).all():
        return None
    if np.linalg.det(turned) < 0:
        scales[0] = -scales[0]
    axes = turned / scales
    if np.abs(axes.T @ axes - np.eye(3)).max() > _SHEAR:
        return None
    return matrix[:3, 3].copy(), Rotation.from_matrix(axes).as_quat(), scales
