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
from collections.abc import Iterator

import numpy as np

from pipeline.calibration.write import encode
from pipeline.capture.keypoint_files.writing import encode_frame
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.validation.simulation.scenes import Simulation


def simulation_files(simulation: Simulation) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the contents of each file; equal simulations give equal bytes.

    Keypoints are COCO-17 for the body alone, otherwise BODY_25 with hands of 21 points, wrist first.
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
    borders = np.searchsorted(detections.frame, np.arange(num_frames + 1)).tolist()
    for first, last in itertools.pairwise(borders):
        yield encode_frame(detections.keypoints_px[first:last], detections.score[first:last], joints)


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
