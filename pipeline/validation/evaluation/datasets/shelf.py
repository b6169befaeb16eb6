"""Shelf benchmark with 2D keypoints of all its images in one file, for the measurements of single steps.

The folder has the calibration and the truth of ``actors``, and ``detections_*.npz`` (``cam``, ``frame`` = image number,
``kps``: bodies x 17 or 25 joints x (x, y, score)).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.calibration.registry import read_calibration
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Track3D
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import COCO_17
from pipeline.core.parsing import UnreadableError
from pipeline.core.problems.finding_codes import BENCHMARK_UNREADABLE
from pipeline.core.runtime.npz import read_untrusted_arrays
from pipeline.detection.bodies import boxes_around
from pipeline.validation.evaluation.datasets.actors import (
    FRAME_RATE_HZ,
    find_calibration,
    read_actor_truth,
    score_actors,
)

DEFAULT_DETECTIONS = "detections_openpose_coco17.npz"
_MAX_BYTES = 2**30

# Joints of OpenPose's BODY_25 in the order of COCO-17.
_COCO_17_IN_BODY_25 = (0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11)


@dataclass(frozen=True, slots=True, eq=False)
class ShelfBenchmark:
    """Test sequence, images 300 to 599; output frame k is image 300 + k.

    ``cameras``, ``timebase``: cameras of the benchmark, and times of the output frames. ``times``, ``detections``:
    frame times and detections by camera name. ``truth_m``: annotated joints in world coordinates, NaN where not
    annotated.
    """

    cameras: tuple[Camera, ...]
    times: Mapping[str, FrameTimes]
    detections: Mapping[str, Detections]
    timebase: Timebase
    truth_m: Float[np.ndarray, "actors frames 14 3"]


def load_shelf(folder: Path, detections: Path | None = None) -> ShelfBenchmark:
    """Read the benchmark from a folder.

    ``detections`` is a file of other detections of the same images. Raises ``InputError`` with all files that are
    missing or have wrong contents.
    """
    problems: list[Problem] = []
    images, truth_m = read_actor_truth(folder, "shelf", problems)
    keypoints_file = detections or folder / DEFAULT_DETECTIONS
    try:
        arrays = read_untrusted_arrays(keypoints_file, ("cam", "frame", "kps"), _MAX_BYTES)
        if arrays["kps"].ndim != 3 or arrays["kps"].shape[1:] not in {(17, 3), (25, 3)}:
            raise UnreadableError("kps must be bodies x 17 or 25 joints x 3")
    except ValueError as error:
        message = f"The keypoints can't be read: {error}."
        hint = "Give the folder of the Shelf benchmark."
        problems.append(Problem(BENCHMARK_UNREADABLE, message, file=keypoints_file.name, hint=hint))
    cameras: tuple[Camera, ...] = ()
    try:
        cameras = read_calibration(find_calibration(folder, "shelf"))
    except InputError as error:
        problems.extend(error.problems)
    if problems:
        raise InputError(problems)
    times = FrameTimes(np.arange(len(images)) / FRAME_RATE_HZ)
    return ShelfBenchmark(
        cameras=cameras,
        times={camera.name: times for camera in cameras},
        detections={camera.name: _of_camera(camera.name, k, arrays, images) for k, camera in enumerate(cameras)},
        timebase=Timebase(0.0, FRAME_RATE_HZ, len(images)),
        truth_m=truth_m,
    )


def _of_camera(name: str, number: int, arrays: Mapping[str, np.ndarray], images: range) -> Detections:
    inside = (arrays["frame"] >= images.start) & (arrays["frame"] < images.stop)
    rows = np.flatnonzero((arrays["cam"] == number) & inside)
    rows = rows[np.argsort(arrays["frame"][rows], kind="stable")]
    keypoints = arrays["kps"][rows].astype(np.float64)
    if keypoints.shape[1] != len(COCO_17.names):
        keypoints = keypoints[:, _COCO_17_IN_BODY_25]
    score = np.clip(keypoints[..., 2], 0.0, 1.0)
    points_px = np.where(score[..., None] > 0, keypoints[..., :2], np.nan)
    empty = np.isnan(points_px).all((1, 2))
    points_px, score, rows = points_px[~empty], score[~empty], rows[~empty]
    return Detections(
        camera=name,
        frame=arrays["frame"][rows].astype(np.int64) - images.start,
        keypoints_px=points_px,
        score=score,
        box_px=boxes_around(points_px),
    )


def thin(benchmark: ShelfBenchmark, every: int) -> tuple[ShelfBenchmark, ShelfBenchmark]:
    """Keep every n-th image of each camera, the cameras at different phases (Chen et al. 2020, figure 4).

    Returns a benchmark of unsynchronised cameras with a lower frame rate and the truth at its output frames, and one of
    the same detections with the frame numbers and the truth of all images.
    """
    num_frames = benchmark.timebase.num_frames
    times, thinned, kept = {}, {}, {}
    for number, camera in enumerate(benchmark.cameras):
        phase = number * every // len(benchmark.cameras)
        times[camera.name] = FrameTimes(benchmark.times[camera.name].time_s[phase::every])
        every_image = benchmark.detections[camera.name]
        kept[camera.name] = every_image.select(every_image.frame % every == phase)
        thinned[camera.name] = replace(kept[camera.name], frame=kept[camera.name].frame // every)
    timebase = Timebase(0.0, FRAME_RATE_HZ / every, -(-num_frames // every))
    return (
        ShelfBenchmark(benchmark.cameras, times, thinned, timebase, benchmark.truth_m[:, ::every]),
        replace(benchmark, detections=kept),
    )


def score_shelf(tracks: Sequence[Track3D], benchmark: ShelfBenchmark) -> dict[str, Any]:
    """Score tracks of COCO-17 joints as ``score_actors`` does."""
    return score_actors(tracks, COCO_17, np.arange(benchmark.timebase.num_frames), benchmark.truth_m)
