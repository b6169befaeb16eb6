"""File of an armature's bones for the service, which recognises them by their names and by the shape of their tree."""

import json
import struct
from collections.abc import Mapping

from api.blender.extension.retarget import RestArmature

_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


def armature_glb(armature: RestArmature) -> bytes:
    """Bones of an armature in the rest pose as a GLB without a mesh, Y up.

    The file has the places of the bones' heads alone: recognition asks for no axes.
    """
    bones = armature.bones
    numbers = {name: number for number, name in enumerate(bones)}
    children: dict[str | None, list[int]] = {}
    for name, bone in bones.items():
        children.setdefault(bone.parent, []).append(numbers[name])
    nodes: list[Mapping[str, object]] = []
    for name, bone in bones.items():
        above = (0.0, 0.0, 0.0) if bone.parent is None else bones[bone.parent].head
        x, y, z = (own - other for own, other in zip(bone.head, above, strict=True))
        below = {"children": children[name]} if name in children else {}
        nodes.append({"name": name, "translation": [x, z, -y], **below})
    document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": children[None]}], "nodes": nodes}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    size = _HEAD.size + _CHUNK.size + len(text)
    return _HEAD.pack(b"glTF", 2, size) + _CHUNK.pack(len(text), b"JSON") + text
