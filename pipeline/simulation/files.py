"""Files of a simulation: the input of ``pipeline.capture.keypoints``, and the ground truth.

::

    calibration.json
    timestamps.csv                                  camera,frame,time_s
    keypoints/<camera>/frame_000000000123_keypoints.json
    truth.npz                                       xyz_m, joint_names, angle_deg, angle_names, frame_rate_hz,
                                                    start_time_s
"""

import csv
import io
import itertools
import json
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from pipeline.angles.definitions import ANGLE_NAMES
from pipeline.calibration.write import encode
from pipeline.data.detections import Detections
from pipeline.joints import BODY_25, COCO_17, FINGER_JOINTS, SIDES, JointSet, finger_joints
from pipeline.simulation.scenes import Simulation

# Joints of BODY_25 that are the middle of two joints of COCO-17.
_MIDDLES = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}


def simulation_files(simulation: Simulation) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the contents of each file; equal simulations give equal bytes.

    Keypoints are those of COCO-17 for the body alone, otherwise BODY_25 with hands of 21 points, wrist first.
    """
    yield "calibration.json", encode(simulation.cameras)
    yield "timestamps.csv", _timestamps(simulation)
    for camera in simulation.cameras:
        num_frames = len(simulation.times[camera.name].time_s)
        for frame, content in enumerate(_frames(simulation.detections[camera.name], num_frames, simulation.joints)):
            yield f"keypoints/{camera.name}/frame_{frame:012d}_keypoints.json", content
    yield "truth.npz", _truth(simulation)


def _timestamps(simulation: Simulation) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("camera", "frame", "time_s"))
    for camera, times in simulation.times.items():
        rows.writerows((camera, frame, repr(time_s)) for frame, time_s in enumerate(times.time_s.tolist()))
    return text.getvalue().encode()


def _frames(detections: Detections, num_frames: int, joints: JointSet) -> Iterator[bytes]:
    # OpenPose writes zeros for a joint that it did not find.
    found = np.nan_to_num(np.concatenate([detections.keypoints_px, detections.score[..., None]], axis=-1))
    parts = {name: points.reshape(len(found), -1).tolist() for name, points in _parts(found, joints).items()}
    borders = np.searchsorted(detections.frame, np.arange(num_frames + 1)).tolist()
    for first, last in itertools.pairwise(borders):
        listed = [{name: points[person] for name, points in parts.items()} for person in range(first, last)]
        yield json.dumps({"version": 1.3, "people": listed}, separators=(",", ":")).encode()


def _parts(found: Float[np.ndarray, "n joints 3"], joints: JointSet) -> dict[str, Float[np.ndarray, "n points 3"]]:
    """Keypoints of each entry of a person in OpenPose's files: x, y and score."""
    if joints == COCO_17:
        return {"pose_keypoints_2d": found}
    parts = {"pose_keypoints_2d": _body_25(found, joints)}
    if not FINGER_JOINTS.isdisjoint(joints.names):
        for side in SIDES:
            parts[f"hand_{side}_keypoints_2d"] = found[:, joints.indices((f"{side}_wrist", *finger_joints(side)))]
    return parts


def _body_25(found: Float[np.ndarray, "n joints 3"], joints: JointSet) -> Float[np.ndarray, "n 25 3"]:
    """Keypoints of BODY_25: neck and middle of the hips are middles of two joints; small toes are not found."""
    keypoints = np.zeros((len(found), len(BODY_25.names), 3))
    for column, name in enumerate(BODY_25.names):
        if name in joints.names:
            keypoints[:, column] = found[:, joints.index(name)]
        elif name in _MIDDLES:
            pair = found[:, joints.indices(_MIDDLES[name])]
            both = np.all(pair[..., 2] > 0, axis=-1)
            middle = np.append(pair[..., :2].mean(1), pair[..., 2:].min(1), axis=-1)
            keypoints[:, column] = np.where(both[:, None], middle, 0.0)
    return keypoints


def _truth(simulation: Simulation) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(
        file,
        xyz_m=simulation.truth_m,
        joint_names=np.array(simulation.joints.names),
        angle_deg=simulation.truth_deg,
        angle_names=np.array(ANGLE_NAMES),
        frame_rate_hz=np.array(simulation.timebase.frame_rate_hz),
        start_time_s=np.array(simulation.timebase.start_time_s),
    )
    return file.getvalue()
