"""Shelf benchmark (Belagiannis et al., CVPR 2014): reader of calibration, 2D keypoints and annotations, and scores.

The folder of the benchmark has ``calibration.json``, ``gt.npz`` (``gt``: actors x images x 14 joints x 3 metres, NaN
where not annotated) and ``detections_*.npz`` (``cam``, ``frame`` = image number, ``kps``: bodies x 17 or 25 joints x
(x, y, score)).
"""

import zipfile
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
from pipeline.core.problems.finding_codes import BENCHMARK_UNREADABLE
from pipeline.validation.evaluation.pcp import HEAD_RULES, benchmark_joints, score_pcp

FRAME_RATE_HZ = 25.0
FIRST_IMAGE, LAST_IMAGE = 300, 599
NUM_SCORED_ACTORS = 3

DEFAULT_DETECTIONS = "detections_openpose_coco17.npz"

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
    arrays: dict[str, np.ndarray] = {}
    keypoints_file = detections or folder / DEFAULT_DETECTIONS
    for path, keys in ((folder / "gt.npz", ("gt",)), (keypoints_file, ("cam", "frame", "kps"))):
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays |= {key: np.array(archive[key]) for key in keys}
        except KeyError:
            problems.append(_unreadable(f"An array of {', '.join(keys)} is missing.", path))
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            problems.append(_unreadable("The file is missing or no NumPy archive of plain arrays.", path))
    cameras: tuple[Camera, ...] = ()
    try:
        cameras = read_calibration(folder / "calibration.json")
    except InputError as error:
        problems.extend(error.problems)
    if "kps" in arrays and (arrays["kps"].ndim != 3 or arrays["kps"].shape[1:] not in {(17, 3), (25, 3)}):
        problems.append(_unreadable("kps must be bodies x 17 or 25 joints x 3.", keypoints_file))
    if "gt" in arrays and (arrays["gt"].ndim != 4 or arrays["gt"].shape[2:] != (14, 3)):
        problems.append(_unreadable("gt must be actors x images x 14 x 3.", folder / "gt.npz"))
    if problems:
        raise InputError(problems)

    num_frames = LAST_IMAGE - FIRST_IMAGE + 1
    times = FrameTimes(np.arange(num_frames) / FRAME_RATE_HZ)
    return ShelfBenchmark(
        cameras=cameras,
        times={camera.name: times for camera in cameras},
        detections={camera.name: _of_camera(camera.name, k, arrays) for k, camera in enumerate(cameras)},
        timebase=Timebase(0.0, FRAME_RATE_HZ, num_frames),
        truth_m=arrays["gt"][:, FIRST_IMAGE : LAST_IMAGE + 1].astype(np.float64),
    )


def _unreadable(message: str, path: Path) -> Problem:
    return Problem(BENCHMARK_UNREADABLE, message, file=path.name, hint="Give the folder of the Shelf benchmark.")


def _of_camera(name: str, number: int, arrays: Mapping[str, np.ndarray]) -> Detections:
    inside = (arrays["frame"] >= FIRST_IMAGE) & (arrays["frame"] <= LAST_IMAGE)
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
        frame=arrays["frame"][rows].astype(np.int64) - FIRST_IMAGE,
        keypoints_px=points_px,
        score=score,
        box_px=np.concatenate([np.nanmin(points_px, axis=1), np.nanmax(points_px, axis=1)], axis=1),
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
        rows = np.flatnonzero(every_image.frame % every == phase)
        kept[camera.name] = Detections(
            camera=camera.name,
            frame=every_image.frame[rows],
            keypoints_px=every_image.keypoints_px[rows],
            score=every_image.score[rows],
            box_px=every_image.box_px[rows],
        )
        thinned[camera.name] = replace(kept[camera.name], frame=kept[camera.name].frame // every)
    timebase = Timebase(0.0, FRAME_RATE_HZ / every, -(-num_frames // every))
    return (
        ShelfBenchmark(benchmark.cameras, times, thinned, timebase, benchmark.truth_m[:, ::every]),
        replace(benchmark, detections=kept),
    )


def score_shelf(tracks: Sequence[Track3D], benchmark: ShelfBenchmark) -> dict[str, Any]:
    """Score tracks of COCO-17 joints: PCP and PCK150 in percent, MPJPE and identity switches.

    The result has:

    - ``pcp``: ``average`` (mean of actors 1-3), ``actors`` and ``parts`` for the head rule ``crossview``, and the
      average ``by_head_rule``.
    - ``mpjpe_mm``, ``pck150``: mean joint error of each actor, and share of the joints within 150 mm.
    - ``switches``: number of changes of an annotated actor's nearest track since the actor's previous annotation.
    """
    alive = [
        [track for track in tracks if 0 <= frame - track.start_frame < track.num_frames]
        for frame in range(benchmark.timebase.num_frames)
    ]
    xyz_m = [
        np.array([track.xyz_m[frame - track.start_frame] for track in people]).reshape(-1, len(COCO_17.names), 3)
        for frame, people in enumerate(alive)
    ]
    by_rule = {
        rule: score_pcp([benchmark_joints(people_m, rule) for people_m in xyz_m], benchmark.truth_m)
        for rule in HEAD_RULES
    }
    reference = by_rule["crossview"]
    averages = {rule: float(np.mean(scores.actors[:NUM_SCORED_ACTORS])) for rule, scores in by_rule.items()}
    histories = (
        [alive[frame][nearest].track_id for frame, nearest in enumerate(row) if nearest >= 0]
        for row in reference.chosen
    )
    return {
        "pcp": {
            "average": averages["crossview"],
            "actors": reference.actors[:NUM_SCORED_ACTORS].tolist(),
            "parts": {name: values[:NUM_SCORED_ACTORS].tolist() for name, values in reference.parts.items()},
            "by_head_rule": averages,
        },
        "mpjpe_mm": reference.mpjpe_mm[:NUM_SCORED_ACTORS].tolist(),
        "pck150": reference.pck150[:NUM_SCORED_ACTORS].tolist(),
        "switches": sum(int(np.count_nonzero(np.diff(history))) for history in histories),
    }
