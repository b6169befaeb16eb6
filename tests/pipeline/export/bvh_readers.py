"""World positions of a BVH file, read by third-party libraries."""

import warnings
from pathlib import Path

import numpy as np
from bvh_converter.bvhplayer_skeleton import process_bvhfile, process_bvhkeyframe

with warnings.catch_warnings():
    # Importing bvhio imports PyGLM by an old name.
    warnings.simplefilter("ignore", PendingDeprecationWarning)
    import bvhio as bvhio  # noqa: PLC0414 - tests take it from here, without the warning


def read_with_bvhio(path: Path) -> dict[str, np.ndarray]:
    """Positions (frames, 3) in the file's units by joint name; ends of bones are not read."""
    num_frames = bvhio.readAsBvh(str(path)).FrameCount
    root = bvhio.readAsHierarchy(str(path))
    read: dict[str, list[np.ndarray]] = {}
    for frame in range(num_frames):
        root.loadPose(frame)
        for joint, _, _ in root.layout():
            read.setdefault(joint.Name, []).append(np.array(joint.PositionWorld))
    return {name: np.array(positions) for name, positions in read.items()}


def read_with_bvh_converter(path: Path) -> dict[str, np.ndarray]:
    """Positions (frames, 3) in the file's units by joint name, ends of bones included."""
    skeleton = process_bvhfile(str(path))
    for frame, values in enumerate(skeleton.keyframes):
        process_bvhkeyframe(values, skeleton.root, skeleton.dt * frame)
    header, rows = skeleton.get_frames_worldpos()
    names = [name.removesuffix(".X") for name in header[1::3]]
    positions = np.array(rows)[:, 1:].reshape(len(rows), len(names), 3)
    return {name: positions[:, column] for column, name in enumerate(names)}
