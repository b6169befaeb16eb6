"""Files of a simulation: the input of ``pipeline.capture.keypoints``, and the ground truth.

::

    calibration.json
    timestamps.csv                                  camera,frame,time_s
    keypoints/<camera>/frame_000000000123_keypoints.json
    truth.npz                                       xyz_m, joint_names, frame_rate_hz, start_time_s
"""

import csv
import io
import itertools
import json
from collections.abc import Iterator

import numpy as np

from pipeline.calibration.write import encode
from pipeline.data import Detections
from pipeline.simulation.scenes import Simulation


def simulation_files(simulation: Simulation) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the contents of each file; equal simulations give equal bytes."""
    yield "calibration.json", encode(simulation.cameras)
    yield "timestamps.csv", _timestamps(simulation)
    for camera in simulation.cameras:
        num_frames = len(simulation.times[camera.name].time_s)
        for frame, content in enumerate(_frames(simulation.detections[camera.name], num_frames)):
            yield f"keypoints/{camera.name}/frame_{frame:012d}_keypoints.json", content
    yield "truth.npz", _truth(simulation)


def _timestamps(simulation: Simulation) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("camera", "frame", "time_s"))
    for camera, times in simulation.times.items():
        rows.writerows((camera, frame, repr(time_s)) for frame, time_s in enumerate(times.time_s.tolist()))
    return text.getvalue().encode()


def _frames(detections: Detections, num_frames: int) -> Iterator[bytes]:
    # OpenPose writes zeros for a joint that it did not find.
    people = np.nan_to_num(np.concatenate([detections.keypoints_px, detections.score[..., None]], axis=-1))
    borders = np.searchsorted(detections.frame, np.arange(num_frames + 1)).tolist()
    for first, last in itertools.pairwise(borders):
        listed = [{"pose_keypoints_2d": person.ravel().tolist()} for person in people[first:last]]
        yield json.dumps({"version": 1.3, "people": listed}, separators=(",", ":")).encode()


def _truth(simulation: Simulation) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(
        file,
        xyz_m=simulation.truth_m,
        joint_names=np.array(simulation.joints.names),
        frame_rate_hz=np.array(simulation.timebase.frame_rate_hz),
        start_time_s=np.array(simulation.timebase.start_time_s),
    )
    return file.getvalue()
