"""Program of a live capture from cameras whose networks find the joints of a simulated scene; see ``filmed_room``.

A picture tells its camera by the brightness of its right half, and its instant by the left one.
"""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from typing import Any

import av
import numpy as np

from pipeline.detection.appearance import NUM_BINS, PARTS
from pipeline.run.live.cameras import detector_pool, listeners, program, run
from pipeline.run.live.cameras.detector_pool import DetectedBodies, DetectionJob
from pipeline.validation.simulation.scenes import SCENES, Simulation, record

NUM_CAMERAS, SCALE = 3, 5
_DARKEST, _STEP, _CAMERA_STEP = 20, 3, 60


@cache
def filmed_room() -> Simulation:
    """Scene of the pictures."""
    return record(replace(SCENES["room"], duration_s=2.0), 0, NUM_CAMERAS)


def pictures(camera: int) -> list[av.VideoFrame]:
    """Pictures of a camera."""
    width, height = (side // SCALE for side in filmed_room().cameras[camera].size_px)
    found = []
    for number in range(filmed_room().timebase.num_frames):
        gray = np.full((height, width, 3), _DARKEST + _CAMERA_STEP * camera, np.uint8)
        gray[:, : width // 2] = _DARKEST + _STEP * number
        found.append(av.VideoFrame.from_ndarray(gray, format="rgb24"))
    return found


def detect(job: DetectionJob) -> DetectedBodies:
    """Bodies that the simulation has in a picture."""
    image, room = np.memmap(job.path, np.uint8, "r", shape=job.shape)[job.slot], filmed_room()
    middle = image.shape[1] // 2
    number = round((np.median(image[:, : middle - 8]) - _DARKEST) / _STEP)
    camera = room.cameras[round((np.median(image[:, middle + 8 :]) - _DARKEST) / _CAMERA_STEP)]
    found = room.detections[camera.name]
    rows = found.frame == number
    points_px = (found.keypoints_px[rows] + 0.5) / SCALE - 0.5
    colour = np.ones((rows.sum(), len(PARTS), NUM_BINS), np.uint8) if job.measures_colours else None
    return DetectedBodies(points_px, found.score[rows], colour, np.full(rows.sum(), 100.0), 1e-3)


if __name__ == "__main__":
    run_edges: Any = run
    run_edges.verify = lambda _: None
    pool: Any = detector_pool
    pool.num_processes, pool.detect_bodies = lambda _: 1, detect
    edges: Any = listeners
    edges.DetectorPool = lambda *_: ThreadPoolExecutor(2)
    sys.exit(program.main())
