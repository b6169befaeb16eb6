"""Simulated 2D pose detector: noise, scores and faults of its detections."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.views.faults import (
    NO_FAULTS,
    Confusion,
    Faults,
    confuse,
    false_positives,
    heavy_tailed,
    lasting_events,
    lasting_noise,
)
from pipeline.validation.simulation.views.occlusion import Box, hidden_by_bodies, hidden_by_boxes

UNASSIGNED = -1
"""Identity of a false positive."""

# Difficulty of each joint relative to the mean: standard deviations of COCO's annotators (keypoint evaluation, OKS).
_DEVIATIONS = np.array([26, 25, 25, 35, 35, 79, 79, 72, 72, 62, 62, 107, 107, 87, 87, 89, 89], dtype=float)
_DIFFICULTY = _DEVIATIONS / _DEVIATIONS.mean()
BEST_SCORE = 0.92
"""Score of a visible joint without error."""

# Error on the body at which the score falls to 0.6 of the best score.
_SCORE_SCALE_M = 0.10
_HIDDEN_SCORE = 0.45
_DUPLICATE_SCORE = 0.7
_DUPLICATE_MISSING = 0.3


@dataclass(frozen=True, slots=True)
class DetectorAccuracy:
    """Accuracy of a simulated detector."""

    # Standard deviation of the average joint in metres at the person's distance: a fixed share of the body's size in
    # the image. Half of the variance lasts for ``noise_memory_s``; half is drawn for every frame with heavy tails.
    noise_m: float = 0.012
    noise_px: float = 0.0  # Standard deviation in pixels, independent of the body's size, added to ``noise_m``
    tail: float = 4.0  # Degrees of freedom of the heavy-tailed half (Student's t), above 2
    noise_memory_s: float = 0.2  # Correlation time of the lasting half
    hidden_noise: float = 4.0  # Factor of the noise of hidden joints
    hidden_missing: float = 0.5  # Share of hidden joints that are not found
    faults: Faults = field(default_factory=Faults)  # Rates of further faults
    # Length of a palm in the image, if it were seen from the front, below which a hand is not found
    smallest_palm_px: float = 15.0


PERFECT = DetectorAccuracy(noise_m=0.0, hidden_missing=0.0, faults=NO_FAULTS, smallest_palm_px=0.0)
"""Detector that finds every joint in the image exactly; hidden joints have lower scores."""


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedPeople:
    """Projection of people to a camera: pixels, image scale, and whether joints are in the image or hidden."""

    points_px: Float[np.ndarray, "people frames joints 2"]
    px_per_m: Float[np.ndarray, "people frames joints"]
    in_image: Bool[np.ndarray, "people frames joints"]
    hidden: Bool[np.ndarray, "people frames joints"]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedBodies:
    """Detected bodies as rows of arrays."""

    frame: Int[np.ndarray, " n"]
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]
    identity: Int[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Bodies that a detector finds in one camera: each once, some a second time, and false positives."""

    confusion: Confusion
    bodies: SimulatedBodies
    copies: SimulatedBodies
    false_positives: SimulatedBodies


def detect(
    camera: Camera,
    period_s: float,
    people_m: Float[np.ndarray, "people frames joints 3"],
    boxes: Sequence[Box],
    detector: DetectorAccuracy,
    rng: np.random.Generator,
) -> tuple[Detections, Int[np.ndarray, " n"]]:
    """Detect people in all frames of one camera.

    ``period_s``: time between two frames. ``people_m``: true joints of ``COCO_17`` in the world at the camera's frames,
    NaN for absent people. ``boxes``: furniture that hides joints. Returns detections, in random order within a frame,
    and the person of each detection, ``UNASSIGNED`` for false positives. A body with limbs of another person keeps its
    identity.
    """
    found = find_bodies(camera, period_s, people_m, boxes, detector, rng)
    return collect(camera.name, (found.bodies, found.copies, found.false_positives), rng)


def find_bodies(
    camera: Camera,
    period_s: float,
    people_m: Float[np.ndarray, "people frames joints 3"],
    boxes: Sequence[Box],
    detector: DetectorAccuracy,
    rng: np.random.Generator,
) -> Found:
    """Find the bodies in all frames of one camera; for the arguments see ``detect``."""
    faults = detector.faults
    memory_frames = faults.memory_s / period_s
    view = look(camera, people_m, boxes)
    confusion = confuse(view.points_px, view.in_image & ~view.hidden, faults, memory_frames, rng)
    noise_frames = detector.noise_memory_s / period_s
    bodies = _mark(view, confusion, confusion.found, detector, noise_frames, rng)
    twice = confusion.found & (rng.random(confusion.found.shape) < faults.duplicate)
    copies = _mark(view, confusion, twice, detector, noise_frames, rng)
    copies = _keep(copies, rng.random(copies.score.shape) >= _DUPLICATE_MISSING, _DUPLICATE_SCORE)
    frame, keypoints_px, score = false_positives(camera.size_px, people_m.shape[1], faults, memory_frames, rng)
    unassigned = np.full(len(frame), UNASSIGNED)
    return Found(confusion, bodies, copies, SimulatedBodies(frame, keypoints_px, score, unassigned))


def look(
    camera: Camera, people_m: Float[np.ndarray, "people frames joints 3"], boxes: Sequence[Box]
) -> ProjectedPeople:
    """Project people to a camera and determine hidden joints; see ``detect``."""
    in_cam_m = camera.cam_from_world.apply(people_m)
    points_px = project(camera, people_m)
    focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    return ProjectedPeople(
        points_px=points_px,
        px_per_m=focal_px / np.maximum(in_cam_m[..., 2], 0.1),
        in_image=np.all((points_px >= 0) & (points_px <= np.array(camera.size_px) - 1), axis=-1),
        hidden=hidden_by_bodies(in_cam_m) | hidden_by_boxes(center_in_world(camera), people_m, boxes),
    )


def _mark(
    view: ProjectedPeople,
    confusion: Confusion,
    found: Bool[np.ndarray, "people frames"],
    detector: DetectorAccuracy,
    noise_frames: float,
    rng: np.random.Generator,
) -> SimulatedBodies:
    points_px, score = see_joints(view, confusion.who, confusion.which, detector, noise_frames, rng)
    people, rows = np.nonzero(found)
    bodies = SimulatedBodies(rows, points_px[people, rows], score[people, rows], people)
    return _keep(bodies, bodies.score > 0)


def see_joints(
    view: ProjectedPeople,
    who: Int[np.ndarray, "people frames joints"],
    which: Int[np.ndarray, "people frames joints"],
    detector: DetectorAccuracy,
    noise_frames: float,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "people frames joints 2"], Float[np.ndarray, "people frames joints"]]:
    """Draw the detected positions and scores of joints; the score is 0 for missed joints and outside of the image.

    ``who`` and ``which`` are the person and the joint behind each detected joint, see ``faults``; ``noise_frames`` is
    the correlation time of the lasting half of the noise, in frames.
    """
    source = who, np.arange(who.shape[1])[:, None], which
    hidden, px_per_m = view.hidden[source], view.px_per_m[source]
    sigma_px = np.hypot(detector.noise_px, detector.noise_m * px_per_m) * _DIFFICULTY
    error_px, score = noisy(sigma_px, px_per_m, hidden, detector, noise_frames, rng)
    missed = lasting_events(rng, (who.shape[0], who.shape[2], who.shape[1]), detector.faults.miss_joint, noise_frames)
    missed = np.moveaxis(missed, -1, 1) | (hidden & (rng.random(score.shape) < detector.hidden_missing))
    return view.points_px[source] + error_px, np.where(view.in_image[source] & ~missed, score, 0.0)


def noisy(
    sigma_px: Float[np.ndarray, "people frames joints"],
    px_per_m: Float[np.ndarray, "people frames joints"],
    hidden: Bool[np.ndarray, "people frames joints"],
    detector: DetectorAccuracy,
    noise_frames: float,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "people frames joints 2"], Float[np.ndarray, "people frames joints"]]:
    """Draw the errors of found joints in pixels, and their scores.

    ``sigma_px`` is for visible joints; ``noise_frames`` is the correlation time of the lasting half of the noise,
    in frames.
    """
    sigma_px = sigma_px * np.where(hidden, detector.hidden_noise, 1.0)
    # Time is the last axis of lasting noise.
    shape = (sigma_px.shape[0], sigma_px.shape[2], 2, sigma_px.shape[1])
    lasting = np.moveaxis(lasting_noise(rng, shape, noise_frames), -1, 1)
    sudden = heavy_tailed(rng, lasting.shape, detector.tail)
    error_px = sigma_px[..., None] * (lasting + sudden) / np.sqrt(2)

    error_m = np.linalg.norm(error_px, axis=-1) / px_per_m
    score = BEST_SCORE * np.exp(-0.5 * (error_m / _SCORE_SCALE_M) ** 2) * np.where(hidden, _HIDDEN_SCORE, 1.0)
    score *= 1 - 0.3 * rng.random(score.shape) ** 2
    return error_px, score


def _keep(bodies: SimulatedBodies, kept: Bool[np.ndarray, "n joints"], factor: float = 1.0) -> SimulatedBodies:
    """Remove joints of bodies, and scale the scores of the others."""
    return SimulatedBodies(
        bodies.frame,
        np.where(kept[..., None], bodies.keypoints_px, np.nan),
        np.where(kept, factor * bodies.score, 0.0),
        bodies.identity,
    )


def collect(camera: str, kinds: Sequence[SimulatedBodies], rng: np.random.Generator) -> tuple[Detections, np.ndarray]:
    """Sort bodies by frame, in random order within a frame; bodies without joints are left out."""
    frame, keypoints_px, score, identity = (
        np.concatenate([getattr(kind, name) for kind in kinds])
        for name in ("frame", "keypoints_px", "score", "identity")
    )
    any_joint = np.any(score > 0, axis=-1)
    order = np.lexsort((rng.random(len(frame)), frame))
    order = order[any_joint[order]]
    detections = Detections(
        camera=camera,
        frame=read_only(frame[order]),
        keypoints_px=read_only(keypoints_px[order]),
        score=read_only(score[order]),
        box_px=read_only(
            np.concatenate(
                [np.fmin.reduce(keypoints_px[order], axis=1), np.fmax.reduce(keypoints_px[order], axis=1)], axis=1
            )
        ),
    )
    return detections, read_only(identity[order])
