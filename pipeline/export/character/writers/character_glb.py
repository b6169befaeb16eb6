"""GLB of a character in motion: its own file with another animation.

The file's buffer stays as it is, byte for byte, with meshes, skins and pictures; times and values of the animation
follow it. Animations of the file are left out. The character stands with Y up, whatever axis its file had.

The animation begins at 0 s. Its ``extras`` have the number of the first output frame, the frame rate, the scale of the
person's path (units of the character for each metre), the output frames in which the person is there, if it is not in
all, and the world position of the origin, if it is not the world's.
"""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Shaped

from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.rig import CharacterRig
from pipeline.export.character.writers.posed import PosedCharacter, chained_places, present_ranges, together
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.timelines import frame_blocks

_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_ALIGNMENT, _FLOAT = 4, 5126
_COLUMNS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def encode(posed: PosedCharacter) -> Iterator[bytes]:
    """Write a character in motion as GLB, piece by piece. Equal motions give equal bytes."""
    held = posed.held()
    file, rate_hz = posed.motion.figure.file, posed.motion.source.frame_rate_hz
    document = json.loads(json.dumps(file.document))
    length = len(file.binary)
    padding = -length % _ALIGNMENT
    views, accessors = document.setdefault("bufferViews", []), document.setdefault("accessors", [])
    contents: list[Callable[[], Shaped[np.ndarray, "rows columns"]]] = []
    end = length + padding

    def add(kind: str, values: Callable[[], Shaped[np.ndarray, "rows columns"]], **bounds: list[float]) -> int:
        nonlocal end
        size = len(posed.frames) * _COLUMNS[kind] * _ALIGNMENT
        views.append({"buffer": 0, "byteOffset": end, "byteLength": size})
        end += size
        contents.append(values)
        accessor = {"bufferView": len(views) - 1, "componentType": _FLOAT, "count": len(posed.frames), "type": kind}
        accessors.append(accessor | bounds)
        return len(accessors) - 1

    times_s = (np.arange(len(posed.frames)) / rate_hz).astype("<f4")
    times = add("SCALAR", lambda: times_s, min=[float(times_s[0])], max=[float(times_s[-1])])
    samplers, channels = [], []

    def animate(node: int, path: str, output: int) -> None:
        samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})

    for node in posed.shifting():
        animate(node, "translation", add("VEC3", lambda node=node: held.translations(node)))  # type: ignore[misc]
    for node in posed.turning():
        animate(node, "rotation", add("VEC4", lambda node=node: held.quaternions(node)))  # type: ignore[misc]
    extras: dict[str, Any] = {
        "start_frame": posed.frames.start,
        "frame_rate_hz": rate_hz,
        "units_per_m": posed.motion.scale,
    }
    if not posed.is_present.all():
        extras["present"] = present_ranges(posed.is_present, posed.frames)
    if posed.origin_m.any():
        extras["origin_m"] = posed.origin_m.tolist()
    document["animations"] = [{"name": posed.name, "samplers": samplers, "channels": channels, "extras": extras}]
    document["buffers"] = [{**(document.get("buffers") or [{}])[0], "byteLength": end}]
    _set_rest(document["nodes"], posed)
    head = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode("utf-8", "replace")
    head += b" " * (-len(head) % _ALIGNMENT)
    yield _HEAD.pack(b"glTF", 2, _HEAD.size + 2 * _CHUNK.size + len(head) + end)
    yield _CHUNK.pack(len(head), b"JSON") + head
    yield _CHUNK.pack(end, b"BIN\0")
    yield bytes(file.binary)
    yield bytes(padding)
    for values in contents:
        yield np.ascontiguousarray(values(), "<f4").tobytes()


def fits(posed: PosedCharacter) -> bool:
    """True if a character in motion is small enough for a file: it states its size in 32 bits."""
    columns = 1 + _COLUMNS["VEC3"] * len(posed.shifting()) + _COLUMNS["VEC4"] * len(posed.motion.turns)
    keys = len(posed.frames) * columns * _ALIGNMENT
    described = len(json.dumps(posed.motion.figure.file.document))
    return keys + len(posed.motion.figure.file.binary) + 2 * described < 2**32 - 2**20


def _set_rest(nodes: list[dict[str, Any]], posed: PosedCharacter) -> None:
    """Put the nodes of a document into the rest pose, as far as they were in another one, or have a matrix."""
    rig = posed.motion.figure.file.rig
    for number, node in enumerate(nodes):
        is_animated = number in posed.motion.turns
        places = {
            "translation": rig.translations[number],
            "rotation": rig.rotations[number],
            "scale": rig.scales[number],
        }
        usual = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}
        is_there = "matrix" not in node and all(
            np.allclose(node.get(name, usual[name]), value, rtol=1e-6, atol=1e-7) for name, value in places.items()
        )
        if is_there or ("matrix" in node and not is_animated and not rig.is_bone[number]):
            continue
        node.pop("matrix", None)
        node.update({name: value.tolist() for name, value in places.items()})


def read_xyz(path: Path, names: tuple[str, ...]) -> Iterator[Float[np.ndarray, "_ bones 3"]]:
    """Read the places of bones from a file of ``encode``, block by block, in the person's world and metres."""
    read = decode_character(path.name, path.read_bytes())
    document, rig = read.document, read.rig
    animation = document["animations"][0]
    extras = animation["extras"]

    def rows(number: int) -> Float32[np.ndarray, "rows columns"]:
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        columns = _COLUMNS[accessor["type"]]
        count = accessor["count"] * columns
        return np.frombuffer(read.binary, "<f4", count, view["byteOffset"]).reshape(-1, columns)

    keys = {
        (channel["target"]["node"], channel["target"]["path"]): rows(
            animation["samplers"][channel["sampler"]]["output"]
        )
        for channel in animation["channels"]
    }
    wanted = [rig.names.index(name) for name in names]
    needed = {above for node in wanted for above in rig.ancestors(node)}
    order = [node for node in rig.order if node in needed]
    num_frames = len(rows(animation["samplers"][0]["input"]))
    origin_m = np.array(extras.get("origin_m", (0.0, 0.0, 0.0)))
    for block in frame_blocks(num_frames):
        places = dict(zip(order, _places(rig, keys, order, block), strict=True))
        xyz = together([places[node] for node in wanted], block.stop - block.start)
        yield xyz @ Y_UP_FROM_WORLD / extras["units_per_m"] + origin_m


def _places(
    rig: CharacterRig, keys: dict[tuple[int, str], Float32[np.ndarray, "rows columns"]], order: list[int], block: slice
) -> list[Float[np.ndarray, "_ 3"]]:
    """Places of nodes in the file's axes in a block of frames."""
    place_of = {node: place for place, node in enumerate(order)}
    turning = [node for node in order if (node, "rotation") in keys]
    quats = np.array([keys[node, "rotation"][block] for node in turning], float)
    turns = _matrices(quats) * rig.scales[turning][:, None, None]
    moving = {place_of[node]: turn for node, turn in zip(turning, turns, strict=True)}
    moved = {
        place_of[node]: keys[node, "translation"][block].astype(float)
        for node in order
        if (node, "translation") in keys
    }
    parents = [place_of.get(int(rig.parents[node]), -1) for node in order]
    return chained_places(parents, rig.translations[order], list(rig.locals[order, :3, :3]), moved, moving)


def _matrices(quat_xyzw: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of quaternions, by glTF's rule rather than the writer's."""
    x, y, z, w = np.moveaxis(quat_xyzw / np.linalg.norm(quat_xyzw, axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
