"""Heads that a detector saw: of bodies, or of peaks of heatmaps, whether a track took them or not."""

import itertools
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from pipeline.core.data.detections import Detections, PafFields
from pipeline.core.data.heads import SeenHeads
from pipeline.core.joints import JointSet
from pipeline.export.privacy.people import FACE

# Lengths on a grown body, by which the pixels of a metre are estimated. Each of them is foreshortened in some view,
# so that the largest estimate counts.
_LENGTHS_M = {
    ("shoulders", "hips"): 0.50,
    ("left_shoulder", "right_shoulder"): 0.35,
    ("left_ear", "right_ear"): 0.15,
    ("left_eye", "right_eye"): 0.065,
    ("nose", "left_ear"): 0.12,
    ("nose", "right_ear"): 0.12,
    ("left_shoulder", "left_elbow"): 0.28,
    ("right_shoulder", "right_elbow"): 0.28,
    ("left_hip", "left_knee"): 0.42,
    ("right_hip", "right_knee"): 0.42,
    ("left_knee", "left_ankle"): 0.42,
    ("right_knee", "right_ankle"): 0.42,
}
# Radii by what is known of the head, as of people in the world, and the distance of the head from the shoulders.
_OF_FACE_M, _OF_NOSE_M, _OF_SHOULDERS_M, _NECK_BY_TRUNK, _NECK_M = 0.18, 0.24, 0.36, 0.5, 0.25
# A radius is at most this share of the longer side of the box around the body, and at least the other share: a head is
# a seventh of an upright body.
_MAX_OF_BOX, _MIN_OF_BOX = 0.35, 0.09


def seen_heads(chunks: Iterable[Detections | PafFields], joints: JointSet) -> dict[str, SeenHeads]:
    """Heads in the detections of tasks, by camera; the tasks of a camera are in order of time."""
    frames: dict[str, list[np.ndarray]] = {}
    ellipses: dict[str, list[np.ndarray]] = {}
    for chunk in chunks:
        if isinstance(chunk, PafFields):
            face = [joints.index(name) for name in FACE if name in joints.names]
            is_head = np.isin(chunk.peak_joint, face)
            frame = chunk.frame[chunk.peak_row[is_head]]
            ellipse_px = np.pad(chunk.peak_px[is_head], ((0, 0), (0, 2)), constant_values=np.nan)
        else:
            frame, ellipse_px = chunk.frame, head_ellipses(chunk.keypoints_px, chunk.box_px, joints)
        frames.setdefault(chunk.camera, []).append(frame)
        ellipses.setdefault(chunk.camera, []).append(ellipse_px)
    return {camera: SeenHeads(np.concatenate(frames[camera]), np.concatenate(ellipses[camera])) for camera in frames}


def head_ellipses(
    keypoints_px: Float[np.ndarray, "n joints 2"], box_px: Float[np.ndarray, "n 4"], joints: JointSet
) -> Float[np.ndarray, "n 4"]:
    """Ellipse around the head of each body: centre, half of the width and half of the height, in pixels.

    Of a body without joints of the head the region above its shoulders is taken; without shoulders, the whole box.
    Joints are NaN where they are unknown.
    """
    place_px = {name: keypoints_px[:, number] for number, name in enumerate(joints.names)}
    place_px["shoulders"] = _mean(place_px, ("left_shoulder", "right_shoulder"), len(box_px))
    place_px["hips"] = _mean(place_px, ("left_hip", "right_hip"), len(box_px))
    side_px = (box_px[:, 2:] - box_px[:, :2]).max(axis=1)
    pixels_a_metre = _pixels_a_metre(place_px, len(box_px))
    radius_px = np.fmin(np.fmax(pixels_a_metre * _OF_FACE_M, _MIN_OF_BOX * side_px), _MAX_OF_BOX * side_px)
    up_px = np.array([0.0, -1.0]) * (radius_px / _OF_FACE_M)[:, None]
    shoulders_px, hips_px = place_px["shoulders"], place_px["hips"]
    # From the vaguest to the best. Twice the area of the box is the smallest ellipse around it.
    middle_px, half_px = (box_px[:, 2:] + box_px[:, :2]) / 2, (box_px[:, 2:] - box_px[:, :2]) / 2
    ellipse_px = np.concatenate([middle_px, half_px * np.sqrt(2.0)], axis=1)
    face_px = [place_px[name] for name in FACE if name in place_px]
    num_seen = sum((np.isfinite(joint_px[:, 0]).astype(int) for joint_px in face_px), np.zeros(len(box_px), int))
    above_px = shoulders_px + _NECK_M * up_px
    along_px = shoulders_px + _NECK_BY_TRUNK * (shoulders_px - hips_px)
    center_px = _mean(place_px, FACE, len(box_px))
    ways = [
        (above_px, np.full(len(box_px), _OF_SHOULDERS_M)),
        (along_px, np.full(len(box_px), _OF_SHOULDERS_M)),
        (center_px, np.where(num_seen > 1, _OF_FACE_M, _OF_NOSE_M)),
    ]
    for way_px, way_m in ways:
        is_known = np.isfinite(way_px).all(axis=1)
        half_way_px = (radius_px * way_m / _OF_FACE_M)[:, None].repeat(2, axis=1)
        ellipse_px = np.where(is_known[:, None], np.concatenate([way_px, half_way_px], axis=1), ellipse_px)
    return _around_joints(ellipse_px, face_px)


def _pixels_a_metre(place_px: dict[str, Float[np.ndarray, "n 2"]], num_bodies: int) -> Float[np.ndarray, " n"]:
    """Largest estimate of the pixels that a metre has at each body; NaN if no length is known."""
    largest = np.full(num_bodies, np.nan)
    for (start, end), length_m in _LENGTHS_M.items():
        if start in place_px and end in place_px:
            largest = np.fmax(largest, np.linalg.norm(place_px[end] - place_px[start], axis=1) / length_m)
    return largest


def _mean(place_px: dict[str, Float[np.ndarray, "n 2"]], names: tuple[str, ...], num_bodies: int) -> np.ndarray:
    """Mean of the known joints among some, NaN without any."""
    total_px, num_known = np.zeros((num_bodies, 2)), np.zeros((num_bodies, 1), int)
    for name in names:
        if name in place_px:
            is_known = np.isfinite(place_px[name]).all(axis=1, keepdims=True)
            total_px += np.where(is_known, place_px[name], 0.0)
            num_known += is_known
    return np.where(num_known > 0, total_px / np.maximum(num_known, 1), np.nan)


def _around_joints(
    ellipse_px: Float[np.ndarray, "n 4"], face_px: list[Float[np.ndarray, "n 2"]]
) -> Float[np.ndarray, "n 4"]:
    """Ellipses widened until each joint of the head is half of the radius inside at least."""
    radius_px = ellipse_px[:, 2:].copy()
    for joint_px, axis in itertools.product(face_px, (0, 1)):
        reach_px = np.abs(joint_px[:, axis] - ellipse_px[:, axis]) + ellipse_px[:, 2 + axis] / 2
        radius_px[:, axis] = np.fmax(radius_px[:, axis], reach_px)
    return np.concatenate([ellipse_px[:, :2], radius_px], axis=1)
