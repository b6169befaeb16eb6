"""Program for Python with ``pufbx``: world positions of all bones in every frame of FBX files, as ufbx finds them.

    python ufbx_reader.py [--half-way] FILE...

Prints JSON: by file the names of the bones, the times of the keys and the positions (frames, bones, 3) in the file's
axes and unit; with ``--half-way`` they are half-way between frames.
"""

import json
import sys
from itertools import pairwise
from typing import Any

import numpy as np
import pufbx


def matrices(places: np.ndarray, quat_xyzw: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Transforms (frames, 4, 4) of places, rotations and scales."""
    x, y, z, w = quat_xyzw.T
    transforms = np.tile(np.eye(4), (len(places), 1, 1))
    transforms[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], -1)
    transforms[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], -1)
    transforms[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1)
    transforms[:, :3, :3] *= scales[:, None]
    transforms[:, :3, 3] = places
    return transforms


def read(path: str, is_half_way: bool) -> dict[str, Any]:
    """Read the bones of a file."""
    scene = pufbx.load_fbx(path)
    # The curve of the visibility has a key where it changes, the others one in each frame.
    keys = [key.time for key in max((curve.keyframes for curve in scene.anim_curves), key=len)]
    rate_hz = (len(keys) - 1) / (keys[-1] - keys[0]) if len(keys) > 1 else 30.0
    baked, _, names = pufbx.anim_to_array(path, anim_index=0, resample_rate=2 * rate_hz if is_half_way else rate_hz)
    if is_half_way:
        keys, baked = [(before + after) / 2 for before, after in pairwise(keys)], [part[1::2] for part in baked]
    # Of a single frame nothing is baked that is as at rest.
    animated = dict(zip(names, baked, strict=True))
    found: dict[str, np.ndarray] = {}
    file_from_node: dict[str, np.ndarray] = {}
    for node in scene.nodes:
        still = node.local_transform
        channels = animated.get(node.name)
        if channels is None:
            place = [still.translation.x, still.translation.y, still.translation.z]
            turn = [still.rotation.x, still.rotation.y, still.rotation.z, still.rotation.w]
            scales = [still.scale.x, still.scale.y, still.scale.z]
            channels = np.tile([*place, *turn, *scales], (len(keys), 1))
        parent = file_from_node[node.parent.name] if node.parent is not None else np.eye(4)
        file_from_node[node.name] = parent @ matrices(channels[:, :3], channels[:, 3:7], channels[:, 7:])
        if node.bone is not None:
            found[node.name] = file_from_node[node.name][:, :3, 3]
    return {
        "names": list(found),
        "times": keys,
        "positions": np.stack(list(found.values()), axis=1).tolist(),
    }


paths = [argument for argument in sys.argv[1:] if argument != "--half-way"]
sys.stdout.write(json.dumps({path: read(path, "--half-way" in sys.argv) for path in paths}))
