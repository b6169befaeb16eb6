"""Files in the form of CMU Panoptic, made from simulated people."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.validation.simulation.scenes import Simulation
from tests.pipeline.validation.evaluation.datasets.openpose_files import write_keypoints

# Panoptic's world: y = -z, z = y.
FROM_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_LEFT, _RIGHT = ([f"{side}_{name}" for name in _LIMBS] for side in ("left", "right"))
_FACE = ("left_eye", "left_ear", "right_eye", "right_ear")


def camera_entry(camera: Camera, name: str) -> dict[str, Any]:
    """HD camera of the calibration."""
    panel, node = name.split("_")
    return {
        "name": name,
        "type": "hd",
        "resolution": list(camera.size_px),
        "panel": int(panel),
        "node": int(node),
        "K": camera.matrix.tolist(),
        "distCoef": camera.distortion.tolist(),
        "R": (camera.cam_from_world.rotation @ FROM_UPRIGHT.T).tolist(),
        "t": (100.0 * camera.cam_from_world.translation_m).reshape(3, 1).tolist(),
    }


def body_entry(number: int, xyz_m: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Body of 19 joints in centimetres, y down."""

    def middle(name: str) -> np.ndarray:
        return (xyz_m[f"left_{name}"] + xyz_m[f"right_{name}"]) / 2

    points = [middle("shoulder"), xyz_m["nose"], middle("hip"), *(xyz_m[name] for name in (*_LEFT, *_RIGHT, *_FACE))]
    joints = np.concatenate([100.0 * np.array(points) @ FROM_UPRIGHT.T, np.full((19, 1), 0.6)], axis=1)
    return {"id": number, "joints19": np.round(joints, 4).ravel().tolist()}


def write_poses(folder: Path, frame: int, bodies: Sequence[dict[str, Any]]) -> Path:
    """Write the poses of an HD frame."""
    path = folder / "hdPose3d_stage1_coco19" / f"body3DScene_{frame:08}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"version": 0.7, "univTime": 53541.542 + frame, "fpsType": "hd_29_97", "bodies": list(bodies)}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def write_calibration(folder: Path, cameras: Mapping[str, Camera]) -> Path:
    """Write the calibration of a sequence."""
    path = folder / f"calibration_{folder.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    listed = [camera_entry(camera, name) for name, camera in cameras.items()]
    path.write_text(json.dumps({"calibDataSource": "test", "cameras": listed}), encoding="utf-8")
    return path


def write_sequence(folder: Path, simulation: Simulation, names: Sequence[str]) -> Path:
    """Write calibration, poses and keypoints of all frames of a simulation."""
    write_calibration(folder, dict(zip(names, simulation.cameras, strict=True)))
    for frame in range(simulation.timebase.num_frames):
        people_m = simulation.truth_m[:, frame]
        bodies = [
            body_entry(number, dict(zip(simulation.joints.names, xyz_m, strict=True)))
            for number, xyz_m in enumerate(people_m)
            if np.isfinite(xyz_m).all()
        ]
        write_poses(folder, frame, bodies)
    cameras = [camera.name for camera in simulation.cameras]
    write_keypoints(folder / "keypoints", simulation, dict(zip(cameras, names, strict=True)))
    return folder
