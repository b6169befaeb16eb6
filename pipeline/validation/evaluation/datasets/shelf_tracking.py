"""Tracking metrics on the Shelf benchmark: association accuracy, MOTA and IDF1 of each camera, and ghost tracks.

The truth is partial: actors are annotated in some of the frames only. So people without annotation must not count
against a tracker:

- *MOTA, IDF1*: in each camera, boxes around the projected joints of annotated actors and of tracks; a pair matches
  with an overlap (IoU) of at least 0.5. An actor counts in a camera that sees at least half of the joints. An unmatched
  track counts as a false positive (a duplicate) only within 0.5 m of an actor. A track that overlaps the box of an
  actor with another track nearby is a person in front or behind.
- *Association accuracy*: in each frame of a camera, detections and annotated actors are paired one to one by the mean
  distance of the limbs' joints, at most a quarter of the height of the actor's box. The accuracy is the share of paired
  detections with the actor's identity. Identities and actors are matched one to one for the largest accuracy.
- *Ghost tracks*: tracks longer than 1 s that are not within 0.5 m of an annotated actor in any frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.association.tracking.track_people import assign_detections, locate_people
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Track3D
from pipeline.core.joints import COCO_17
from pipeline.detection.bodies import boxes_around
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.baselines import Triangulation, associate_pairwise, locate_incrementally
from pipeline.validation.evaluation.datasets import shelf
from pipeline.validation.evaluation.datasets.actors import FRAME_RATE_HZ, NUM_SCORED_ACTORS
from pipeline.validation.evaluation.mpjpe import MotFrame, box_overlap, score_mot, select_joints
from pipeline.validation.evaluation.pcp import LIMB_JOINTS, benchmark_joints

_NEAR_M = 0.5
_OVERLAP = 0.5
_NEAR_BOX_HEIGHT = 0.25
_GHOST_S = 1.0
_MIN_OVERLAP = 0.5


def score_tracking(tracks: Sequence[Track3D], benchmark: shelf.ShelfBenchmark) -> dict[str, Any]:
    """Score tracks by the metrics of the module.

    Returns ``mota``, ``idf1`` (fractions of 1), ``false_positives`` and ``missed`` (numbers) by camera name, and the
    number of ``ghost_tracks``.
    """
    frames = np.arange(benchmark.timebase.num_frames)
    predicted_m = benchmark_joints(select_joints(tracks, COCO_17, COCO_17.names, frames))
    # Mean joint distance of each track to each actor in each frame, NaN where either is absent.
    distance_m = np.stack([_mean_distance(truth_m, predicted_m) for truth_m in benchmark.truth_m])
    by_camera = {
        camera.name: score_mot(_mot_frames(camera, predicted_m, distance_m, benchmark)) for camera in benchmark.cameras
    }
    lengths_s = np.array([track.num_frames for track in tracks]) / benchmark.timebase.frame_rate_hz
    is_near = (distance_m <= _NEAR_M).any((0, 2))
    return {
        "mota": {name: scores.mota for name, scores in by_camera.items()},
        "idf1": {name: scores.idf1 for name, scores in by_camera.items()},
        "false_positives": {name: scores.false_positives for name, scores in by_camera.items()},
        "missed": {name: scores.missed for name, scores in by_camera.items()},
        "ghost_tracks": int(np.count_nonzero((lengths_s > _GHOST_S) & ~is_near)),
    }


def _mean_distance(
    truth_m: Float[np.ndarray, "frames 14 3"], predicted_m: Float[np.ndarray, "tracks frames 14 3"]
) -> Float[np.ndarray, "tracks frames"]:
    """Mean distance of shared joints, NaN without any."""
    distance_m = np.linalg.norm(predicted_m - truth_m, axis=-1)
    count = np.isfinite(distance_m).sum(-1)
    return np.where(count > 0, np.nansum(distance_m, axis=-1) / np.maximum(count, 1), np.nan)


def _boxes(camera: Camera, points_m: Float[np.ndarray, "*batch 14 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Boxes around projected joints, NaN without joints."""
    boxes = boxes_around(project(camera, points_m))
    return np.where(np.isfinite(boxes), boxes, np.nan)


def _is_seen(camera: Camera, points_m: Float[np.ndarray, "*batch 14 3"]) -> Bool[np.ndarray, "*batch"]:
    """True if at least half of the joints are in the image."""
    points_px = project(camera, points_m)
    with np.errstate(invalid="ignore"):
        inside = ((points_px >= 0) & (points_px <= np.array(camera.size_px) - 1)).all(-1)
    return inside.mean(-1) >= 0.5


def _mot_frames(
    camera: Camera,
    predicted_m: Float[np.ndarray, "tracks frames 14 3"],
    distance_m: Float[np.ndarray, "actors tracks frames"],
    benchmark: shelf.ShelfBenchmark,
) -> list[MotFrame]:
    truth_px, predicted_px = _boxes(camera, benchmark.truth_m), _boxes(camera, predicted_m)
    seen = _is_seen(camera, benchmark.truth_m)
    present = np.isfinite(predicted_px).all(-1)
    frames = []
    for frame in range(benchmark.timebase.num_frames):
        people, tracks = np.flatnonzero(seen[:, frame]), np.flatnonzero(present[:, frame])
        overlap = box_overlap(truth_px[people, frame], predicted_px[tracks, frame])
        near = distance_m[people[:, None], tracks, frame] <= _NEAR_M
        without = ~near.any(1, keepdims=True)
        counts = (near | (without & (overlap >= _OVERLAP))).any(0)
        frames.append(MotFrame(people, tracks[counts], overlap[:, counts]))
    return frames


def association_accuracy(
    identities: Mapping[str, Int[np.ndarray, " _"]], benchmark: shelf.ShelfBenchmark, by_frame: bool = False
) -> dict[str, float | None]:
    """Association accuracy by camera name, and over ``all`` cameras.

    ``identities``: identity of each detection by camera name, negative for none; see
    ``tracking.track_people.assign_detections``. ``by_frame``: whether identities are matched to actors in each frame
    separately, for methods without identities over time. Returns share of the detections of annotated actors with the
    actor's identity; ``None`` if no detection is near an actor.
    """
    actors, given, cameras, frames = [], [], [], []
    for number, camera in enumerate(benchmark.cameras):
        detections = benchmark.detections[camera.name]
        actor = _actors(camera, detections.frame, detections.keypoints_px, benchmark)
        near = actor >= 0
        actors.append(actor[near])
        given.append(identities[camera.name][near])
        cameras.append(np.full(near.sum(), number))
        frames.append(detections.frame[near])
    actor, identity, camera_number = np.concatenate(actors), np.concatenate(given), np.concatenate(cameras)
    group = np.concatenate(frames) if by_frame else np.zeros(len(actor), int)
    is_right = np.zeros(len(actor), bool)
    for number in np.unique(group):
        rows = np.flatnonzero(group == number)
        is_right[rows] = _went_to_actor(actor[rows], identity[rows], len(benchmark.truth_m))
    by_camera = {
        camera.name: float(is_right[camera_number == number].mean()) if (camera_number == number).any() else None
        for number, camera in enumerate(benchmark.cameras)
    }
    return {"all": float(is_right.mean()) if len(actor) else None, **by_camera}


def _went_to_actor(
    actor: Int[np.ndarray, " n"], identity: Int[np.ndarray, " n"], num_actors: int
) -> Bool[np.ndarray, " n"]:
    """True if each identity is its actor's, with actors and identities matched one to one for the largest number."""
    names, columns = np.unique(identity, return_inverse=True)
    counts = np.zeros((num_actors, len(names)))
    np.add.at(counts, (actor, columns), 1)
    counts[:, names < 0] = 0
    rows, chosen = linear_sum_assignment(-counts)
    pairs = np.zeros(counts.shape, bool)
    pairs[rows, chosen] = counts[rows, chosen] > 0
    return pairs[actor, columns]


def score_single_view(benchmark: shelf.ShelfBenchmark) -> dict[str, dict[str, Any]]:
    """MOTA, IDF1 and switches of a single-view tracker by camera (Chen et al. 2020, table 4); see ``track_boxes``.

    An unmatched detection counts as a false positive only if it is near an annotated actor.
    """
    scores: dict[str, dict[str, Any]] = {"mota": {}, "idf1": {}, "switches": {}}
    truth = benchmark.truth_m
    for camera in benchmark.cameras:
        detections = benchmark.detections[camera.name]
        limbs_px = detections.keypoints_px[:, COCO_17.indices(LIMB_JOINTS)]
        known = np.isfinite(limbs_px).any((1, 2))
        box_px = np.full((len(limbs_px), 4), np.nan)
        box_px[known] = boxes_around(limbs_px[known])
        identity = track_boxes(detections.frame, np.nan_to_num(box_px))
        near = _actors(camera, detections.frame, detections.keypoints_px, benchmark) >= 0
        truth_px, seen = _boxes(camera, truth), _is_seen(camera, truth)
        frames = []
        for frame in range(benchmark.timebase.num_frames):
            people, rows = np.flatnonzero(seen[:, frame]), np.flatnonzero((detections.frame == frame) & known)
            overlap = box_overlap(truth_px[people, frame], box_px[rows])
            counts = near[rows] | (overlap >= _OVERLAP).any(0)
            frames.append(MotFrame(people, identity[rows[counts]], overlap[:, counts]))
        of_camera = score_mot(frames)
        for name, by_camera in scores.items():
            by_camera[camera.name] = getattr(of_camera, name)
    return scores


def _actors(
    camera: Camera,
    frame: Int[np.ndarray, " n"],
    keypoints_px: Float[np.ndarray, "n 17 2"],
    benchmark: shelf.ShelfBenchmark,
) -> Int[np.ndarray, " n"]:
    """Number of the actor of each detection, -1 for none."""
    num_limb_joints = len(LIMB_JOINTS)
    limbs_px = keypoints_px[:, COCO_17.indices(LIMB_JOINTS)]
    truth_px = project(camera, benchmark.truth_m[:, :, :num_limb_joints])[:, frame]
    boxes = _boxes(camera, benchmark.truth_m)[:, frame]
    apart_px = np.linalg.norm(truth_px - limbs_px, axis=-1)
    count = np.isfinite(apart_px).sum(-1)
    mean_px = np.where(count > 0, np.nansum(apart_px, axis=-1) / np.maximum(count, 1), np.inf)
    heights_px = np.nan_to_num(boxes[..., 3] - boxes[..., 1])
    relative = np.where(heights_px > 0, mean_px / np.maximum(heights_px, 1e-9), np.inf)
    actor = np.full(len(frame), -1)
    for number in np.unique(frame):
        rows = np.flatnonzero(frame == number)
        # A pair beyond the gate costs more than all pairs within the gate together, and is left out.
        cost = np.minimum(relative[:, rows], 1.0 + _NEAR_BOX_HEIGHT * len(relative))
        people, columns = linear_sum_assignment(cost)
        near = cost[people, columns] <= _NEAR_BOX_HEIGHT
        actor[rows[columns[near]]] = people[near]
    return actor


def track_boxes(frame: Int[np.ndarray, " n"], box_px: Float[np.ndarray, "n 4"]) -> Int[np.ndarray, " n"]:
    """Number the tracks of one camera's detections: the baseline of cross-view tracking.

    After Bochinski, Eiselein and Sikora, "High-speed tracking-by-detection without using image information" (AVSS
    2017): a detection continues the track whose last box it overlaps most, and a track without a detection ends. Frame
    numbers ascend, and boxes are x0, y0, x1, y1. Tracks are numbered from 0.
    """
    identity = np.empty(len(frame), int)
    num_tracks, before = 0, np.empty(0, int)
    for number in range(int(frame.max(initial=-1)) + 1):
        rows = np.flatnonzero(frame == number)
        overlap = box_overlap(box_px[before], box_px[rows])
        left, right = linear_sum_assignment(overlap, maximize=True)
        follows = overlap[left, right] >= _MIN_OVERLAP
        identity[rows] = -1
        identity[rows[right[follows]]] = identity[before[left[follows]]]
        new = rows[identity[rows] < 0]
        identity[new] = num_tracks + np.arange(len(new))
        num_tracks += len(new)
        before = rows
    return identity


_WEIGHTS_2D = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
_EVERY = (1, 2, 3, 4, 5, 6, 8, 10)


def ablate(benchmark: shelf.ShelfBenchmark) -> dict[str, Any]:
    """Run the whole ablation.

    The result has:

    - ``association``: association accuracy by camera of cross-view tracking and of matching in pairs of views,
      identities matched frame by frame (figure 3; the paper's other baselines need an appearance network that is not
      available).
    - ``weights``: association accuracy and PCP by the weights of 2D and 3D correspondence (table S1).
    - ``triangulation``: PCP of torso, upper arms and lower arms, and average, by triangulation of the same association
      (table 3).
    - ``every``: PCP by the share of images kept, cameras at different phases (figure 4).
    - ``single_view``: MOTA and IDF1 of a single-view tracker by camera (table 4).
    """
    return {
        "association": _association(benchmark),
        "weights": _weights(benchmark),
        "triangulation": _triangulations(benchmark),
        "every": [_thinned(benchmark, every) for every in _EVERY],
        "single_view": score_single_view(benchmark),
    }


def _association(benchmark: shelf.ShelfBenchmark) -> dict[str, dict[str, float | None]]:
    parameters = derive_parameters(benchmark.cameras, FRAME_RATE_HZ)
    views = (benchmark.cameras, benchmark.times, benchmark.detections)
    return {
        "pairs_of_views": association_accuracy(associate_pairwise(*views, parameters), benchmark, by_frame=True),
        "tracking": association_accuracy(assign_detections(*views, parameters), benchmark, by_frame=True),
    }


def _weights(benchmark: shelf.ShelfBenchmark) -> list[dict[str, Any]]:
    rows = []
    for weight_2d in _WEIGHTS_2D:
        parameters = replace(
            derive_parameters(benchmark.cameras, FRAME_RATE_HZ), weight_2d=weight_2d, weight_3d=1.0 - weight_2d
        )
        views = (benchmark.cameras, benchmark.times, benchmark.detections)
        identities = assign_detections(*views, parameters)
        tracks = locate_people(*views, identities, benchmark.timebase, parameters).tracks
        rows.append(
            {
                "weight_2d": weight_2d,
                "weight_3d": 1.0 - weight_2d,
                "association_accuracy": association_accuracy(identities, benchmark)["all"],
                "pcp": shelf.score_shelf(tracks, benchmark)["pcp"]["average"],
            }
        )
    return rows


def _triangulations(benchmark: shelf.ShelfBenchmark) -> dict[str, dict[str, float]]:
    """PCP by kind of triangulation; ``robust`` is the triangulation of whole tracks."""
    parameters = derive_parameters(benchmark.cameras, benchmark.timebase.frame_rate_hz)
    views = (benchmark.cameras, benchmark.times, benchmark.detections)
    identities = assign_detections(*views, parameters)
    by_kind = {}
    for kind in Triangulation:
        tracks, _ = locate_incrementally(*views, identities, benchmark.timebase, parameters, kind)
        by_kind[kind.value] = _parts(shelf.score_shelf(tracks, benchmark))
    robust = locate_people(*views, identities, benchmark.timebase, parameters).tracks
    return {**by_kind, "robust": _parts(shelf.score_shelf(robust, benchmark))}


def _parts(scores: dict[str, Any]) -> dict[str, float]:
    parts = {
        name: float(np.mean(scores["pcp"]["parts"][name][:NUM_SCORED_ACTORS]))
        for name in ("torso", "upper_arms", "lower_arms")
    }
    return {**parts, "average": scores["pcp"]["average"]}


def _thinned(benchmark: shelf.ShelfBenchmark, every: int) -> dict[str, Any]:
    thinned, _ = shelf.thin(benchmark, every)
    averages = {kind: parts["average"] for kind, parts in _triangulations(thinned).items()}
    return {"every": every, **averages}
