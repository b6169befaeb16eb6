"""Keypoint files of OpenPose, made from simulated people."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.validation.simulation.scenes import Simulation


def write_keypoints(folder: Path, simulation: Simulation, names: Mapping[str, str], first: int = 0) -> Path:
    """Write the detections of a simulation, in a folder of each camera; ``first`` is the number of its frame 0."""
    for camera, name in names.items():
        detections = simulation.detections[camera]
        for frame in range(simulation.timebase.num_frames):
            rows = (detections.frame == frame).nonzero()[0]
            points = np.concatenate([detections.keypoints_px[rows], detections.score[rows][..., None]], axis=-1)
            people = [{"pose_keypoints_2d": body.ravel().tolist()} for body in np.nan_to_num(points)]
            path = folder / name / f"{name}_{first + frame:012}_keypoints.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({"version": 1.3, "people": people}), encoding="utf-8")
    return folder
