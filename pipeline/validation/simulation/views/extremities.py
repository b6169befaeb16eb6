"""Simulated detection of heels, big toes and fingers on the bodies that a detector finds.

Feet and hands follow the ankle or wrist of the detection: with a limb of another person come its foot or hand, and with
exchanged legs the feet of the other side. A hand is found as a whole, as by a network that reads one crop a hand.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17, FINGER_JOINTS, SIDES, JointSet, finger_joints
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.views.detector import (
    DetectorAccuracy,
    ProjectedPeople,
    SimulatedBodies,
    collect,
    find_bodies,
    noisy,
)
from pipeline.validation.simulation.views.faults import Confusion, lasting_events
from pipeline.validation.simulation.views.occlusion import Box, hidden_by_boxes, points_hidden_by_bodies

_NUM_BODY = len(COCO_17.names)
# Noise of fingers as a share of the noise of the average joint that grows with the body's size: a network for hands
# reads a crop of its own.
_FINGER_NOISE = 0.5
_PALM = ("thumb_cmc", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp")


def detect_extremities(
    camera: Camera,
    period_s: float,
    people_m: Float[np.ndarray, "people frames joints 3"],
    boxes: Sequence[Box],
    detector: DetectorAccuracy,
    rng: np.random.Generator,
    joints: JointSet,
) -> tuple[Detections, Int[np.ndarray, " n"]]:
    """Detect people with feet, or with feet and hands, in all frames of one camera.

    Feet and hands are drawn from a stream of their own. Rows and body joints are as in ``detector.detect``.
    ``joints`` are the joints of ``people_m``, ``BODY_FEET`` or ``WHOLE_BODY``; all else is as in ``detector.detect``.
    """
    (own,) = rng.spawn(1)
    found = find_bodies(camera, period_s, people_m[:, :, :_NUM_BODY], boxes, detector, rng)
    view = _look(camera, people_m, boxes, joints)
    palm_px = _palm_px(people_m, view, joints)
    kinds = [
        _extend(bodies, view, palm_px, found.confusion, detector, period_s, joints, own)
        for bodies in (found.bodies, found.copies)
    ]
    return collect(camera.name, (*kinds, _without(found.false_positives, len(joints.names))), rng)


def _look(
    camera: Camera, people_m: Float[np.ndarray, "people frames joints 3"], boxes: Sequence[Box], joints: JointSet
) -> ProjectedPeople:
    """Project the joints of feet and hands to a camera; the person's trunk can hide hands."""
    in_cam_m = camera.cam_from_world.apply(people_m)
    beyond_m = people_m[:, :, _NUM_BODY:]
    points_px = project(camera, beyond_m)
    hands = [k for k, name in enumerate(joints.names[_NUM_BODY:]) if name in FINGER_JOINTS]
    hidden = points_hidden_by_bodies(in_cam_m[:, :, _NUM_BODY:], in_cam_m[:, :, :_NUM_BODY], hands)
    focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    return ProjectedPeople(
        points_px=points_px,
        px_per_m=focal_px / np.maximum(in_cam_m[:, :, _NUM_BODY:, 2], 0.1),
        in_image=np.all((points_px >= 0) & (points_px <= np.array(camera.size_px) - 1), axis=-1),
        hidden=hidden | hidden_by_boxes(center_in_world(camera), beyond_m, boxes),
    )


def _palm_px(
    people_m: Float[np.ndarray, "people frames joints 3"], view: ProjectedPeople, joints: JointSet
) -> Float[np.ndarray, "people frames beyond"]:
    """Length of the palm that belongs to each joint in pixels, as if seen from the front; infinite for feet."""
    palm_px = np.full(view.px_per_m.shape, np.inf)
    for side in SIDES:
        columns = _hand_columns(side, joints)
        if not columns:
            continue
        wrist, knuckle = joints.indices((f"{side}_wrist", f"{side}_middle_mcp"))
        length_m = np.linalg.norm(people_m[:, :, knuckle] - people_m[:, :, wrist], axis=-1)
        palm_px[..., columns] = (length_m * view.px_per_m[..., knuckle - _NUM_BODY])[..., None]
    return palm_px


def _hand_columns(side: str, joints: JointSet, parts: Sequence[str] | None = None) -> list[int]:
    """Columns of a hand's joints after the body's; with ``parts``, only of these joints."""
    names = finger_joints(side) if parts is None else [f"{side}_{part}" for part in parts]
    return [k for k, name in enumerate(joints.names[_NUM_BODY:]) if name in names]


def _extend(
    bodies: SimulatedBodies,
    view: ProjectedPeople,
    palm_px: Float[np.ndarray, "people frames beyond"],
    confusion: Confusion,
    detector: DetectorAccuracy,
    period_s: float,
    joints: JointSet,
    rng: np.random.Generator,
) -> SimulatedBodies:
    """Add the joints of feet and hands to detected bodies."""
    memory_frames = detector.faults.memory_s / period_s
    noise_frames = detector.noise_memory_s / period_s
    who, which = _sources(confusion, detector, memory_frames, joints, rng)
    source = who, np.arange(who.shape[1])[:, None], which
    px_per_m, hidden = view.px_per_m[source], view.hidden[source]
    share = np.array([_FINGER_NOISE if name in FINGER_JOINTS else 1.0 for name in joints.names[_NUM_BODY:]])
    sigma_px = np.hypot(detector.noise_px, share * detector.noise_m * px_per_m)
    error_px, score = noisy(sigma_px, px_per_m, hidden, detector, noise_frames, rng)
    joint_first = (who.shape[0], who.shape[2], who.shape[1])
    missed = np.moveaxis(lasting_events(rng, joint_first, detector.faults.miss_joint, noise_frames), -1, 1)
    missed = missed | _missed_hands(view, source, palm_px, detector, memory_frames, joints, rng)
    feet = [k for k, name in enumerate(joints.names[_NUM_BODY:]) if name not in FINGER_JOINTS]
    missed[..., feet] |= hidden[..., feet] & (rng.random((*hidden.shape[:2], len(feet))) < detector.hidden_missing)
    score = np.where(view.in_image[source] & ~missed, score, 0.0)
    points_px = np.where(score[..., None] > 0, view.points_px[source] + error_px, np.nan)

    rows = bodies.identity, bodies.frame
    # Without a wrist no hand is searched, and without any joint there is no body.
    carried = np.where(_is_finger(joints), bodies.score[:, _carriers(joints)], bodies.score.max(1, keepdims=True)) > 0
    return SimulatedBodies(
        bodies.frame,
        np.concatenate([bodies.keypoints_px, np.where(carried[..., None], points_px[rows], np.nan)], axis=1),
        np.concatenate([bodies.score, np.where(carried, score[rows], 0.0)], axis=1),
        bodies.identity,
    )


def _sources(
    confusion: Confusion, detector: DetectorAccuracy, memory_frames: float, joints: JointSet, rng: np.random.Generator
) -> tuple[Int[np.ndarray, "people frames beyond"], Int[np.ndarray, "people frames beyond"]]:
    """Person and joint behind each detected joint of feet and hands."""
    carriers = _carriers(joints)
    who = confusion.who[..., carriers]
    crossed = confusion.which[..., carriers] != carriers
    exchanged = lasting_events(rng, confusion.found.shape, detector.faults.swap_hands, memory_frames)
    crossed = crossed ^ (exchanged[..., None] & _is_finger(joints))
    names = joints.names[_NUM_BODY:]
    other_side = np.array([names.index(_mirrored(name)) for name in names])
    return who, np.where(crossed, other_side, np.arange(len(names)))


def _missed_hands(
    view: ProjectedPeople,
    source: tuple[np.ndarray, np.ndarray, np.ndarray],
    palm_px: Float[np.ndarray, "people frames beyond"],
    detector: DetectorAccuracy,
    memory_frames: float,
    joints: JointSet,
    rng: np.random.Generator,
) -> Bool[np.ndarray, "people frames beyond"]:
    """Joints of hands that are not found: small, hidden or not wholly in the image, or missed."""
    hidden, in_image, length_px = view.hidden[source], view.in_image[source], palm_px[source]
    missed = np.zeros(hidden.shape, dtype=bool)
    for side in SIDES:
        columns, palm = _hand_columns(side, joints), _hand_columns(side, joints, _PALM)
        if not columns:
            continue
        lost = lasting_events(rng, hidden.shape[:2], detector.faults.miss_hand, memory_frames)
        is_hidden = hidden[..., palm].mean(-1) > 0.5
        lost |= is_hidden & (rng.random(lost.shape) < detector.hidden_missing)
        lost |= ~in_image[..., palm].all(-1) | (length_px[..., palm].min(-1) < detector.smallest_palm_px)
        missed[..., columns] = lost[..., None]
    return missed


def _without(bodies: SimulatedBodies, num_joints: int) -> SimulatedBodies:
    """Add joints that are not found."""
    missing = ((0, 0), (0, num_joints - bodies.score.shape[1]))
    return SimulatedBodies(
        bodies.frame,
        np.pad(bodies.keypoints_px, (*missing, (0, 0)), constant_values=np.nan),
        np.pad(bodies.score, missing),
        bodies.identity,
    )


def _carriers(joints: JointSet) -> Int[np.ndarray, " beyond"]:
    """Ankle or wrist of the body that carries each joint of feet and hands."""
    return np.array(
        [
            COCO_17.index(f"{name.partition('_')[0]}_{'wrist' if name in FINGER_JOINTS else 'ankle'}")
            for name in joints.names[_NUM_BODY:]
        ]
    )


def _is_finger(joints: JointSet) -> Bool[np.ndarray, " beyond"]:
    return np.array([name in FINGER_JOINTS for name in joints.names[_NUM_BODY:]])


def _mirrored(name: str) -> str:
    side, _, joint = name.partition("_")
    return f"{SIDES[1 - SIDES.index(side)]}_{joint}"
