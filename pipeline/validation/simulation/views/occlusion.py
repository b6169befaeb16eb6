"""Occlusion of joints from a camera by bodies and boxes.

A body consists of capsules, which are segments with a radius: trunk, head, thighs and shins. The test is made on the
image plane, where a capsule is a segment with a width.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.joints import COCO_17

_CAPSULES = (
    (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"), 0.16),
    (("left_ear", "right_ear"), ("nose",), 0.10),
    (("left_hip",), ("left_knee",), 0.07),
    (("right_hip",), ("right_knee",), 0.07),
    (("left_knee",), ("left_ankle",), 0.05),
    (("right_knee",), ("right_ankle",), 0.05),
)
"""Ends of each capsule (means of joints) and radius in metres; the trunk first."""
_TRUNK = _CAPSULES[:1]
_FREE_JOINTS = COCO_17.indices(("left_elbow", "right_elbow", "left_wrist", "right_wrist"))
# Narrower than for other people: the trunk does not hide an arm that hangs beside it.
_OWN_TRUNK_RADIUS = 0.75


@dataclass(frozen=True, slots=True)
class Box:
    """Box of furniture between two opposite corners in the world, in metres."""

    min_m: tuple[float, float, float]
    max_m: tuple[float, float, float]


def hidden_by_boxes(
    center_m: Float[np.ndarray, " 3"], points_m: Float[np.ndarray, "*batch 3"], boxes: Sequence[Box]
) -> Bool[np.ndarray, "*batch"]:
    """True if the line from a camera's centre to a point meets a box (slab method); false for NaN."""
    hidden = np.zeros(points_m.shape[:-1], dtype=bool)
    towards = points_m - center_m
    # Avoids a division by zero for lines parallel to a wall.
    towards = np.where(np.abs(towards) < 1e-9, 1e-9, towards)
    for box in boxes:
        first, second = (np.asarray(box.min_m) - center_m) / towards, (np.asarray(box.max_m) - center_m) / towards
        enter, leave = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
        hidden |= (enter < leave) & (enter < 1) & (leave > 0)
    return hidden


def hidden_by_bodies(in_cam_m: Float[np.ndarray, "people frames joints 3"]) -> Bool[np.ndarray, "people frames joints"]:
    """Mark joints of ``COCO_17`` behind another person's body, or an arm behind the person's trunk.

    Joints are in camera coordinates, NaN for absent people.
    """
    return points_hidden_by_bodies(in_cam_m, in_cam_m, _FREE_JOINTS)


def points_hidden_by_bodies(
    points_m: Float[np.ndarray, "people frames points 3"],
    in_cam_m: Float[np.ndarray, "people frames 17 3"],
    free: Sequence[int],
) -> Bool[np.ndarray, "people frames points"]:
    """Mark points of a person behind another person's body, or a free point behind the person's trunk.

    Points, and joints of ``COCO_17``, are in camera coordinates, NaN for absent people. The person's own trunk can hide
    the points of the numbers ``free``.
    """
    num_people = len(in_cam_m)
    hidden = np.zeros(points_m.shape[:3], dtype=bool)
    plane = _on_plane(points_m)
    low, high = _bounds(plane)
    body_low, body_high = _bounds(_on_plane(in_cam_m))
    nearest_m, farthest_m = np.fmin.reduce(in_cam_m[..., 2], axis=2), np.fmax.reduce(points_m[..., 2], axis=2)
    for behind in range(num_people):
        for before in range(num_people):
            if before == behind:
                continue
            overlap = ((low[behind] < body_high[before]) & (high[behind] > body_low[before])).all(-1)
            frames = np.flatnonzero(overlap & (nearest_m[before] < farthest_m[behind]))
            if len(frames):
                hidden[behind, frames] |= _behind(
                    plane[behind, frames], points_m[behind, frames, :, 2], in_cam_m[before, frames], _CAPSULES, 1.0
                )
        moving = plane[behind][:, free], points_m[behind][:, free, 2]
        hidden[behind][:, free] |= _behind(*moving, in_cam_m[behind], _TRUNK, _OWN_TRUNK_RADIUS)
    return hidden


def _on_plane(in_cam_m: np.ndarray) -> np.ndarray:
    """Positions on the image plane at distance 1; NaN beside and behind the camera."""
    return np.asarray(in_cam_m[..., :2] / np.where(in_cam_m[..., 2:] > 0.1, in_cam_m[..., 2:], np.nan))


def _bounds(plane: Float[np.ndarray, "people frames joints 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around each body on the image plane, with a margin for its volume; NaN for absent people."""
    low, high = np.fmin.reduce(plane, axis=2), np.fmax.reduce(plane, axis=2)
    margin = 0.15 * (high - low).max(-1, keepdims=True)
    return low - margin, high + margin


def _behind(
    plane: Float[np.ndarray, "frames joints 2"],
    depth_m: Float[np.ndarray, "frames joints"],
    body_m: Float[np.ndarray, "frames 17 3"],
    capsules: Sequence[tuple[tuple[str, ...], tuple[str, ...], float]],
    scale: float,
) -> Bool[np.ndarray, "frames joints"]:
    """True if points of the image plane lie within and behind the capsules of a body."""
    hidden = np.zeros(depth_m.shape, dtype=bool)
    for first, second, radius_m in capsules:
        begin_m, end_m = (body_m[:, COCO_17.indices(names)].mean(1) for names in (first, second))
        begin, end = (point_m[:, None, :2] / np.maximum(point_m[:, None, 2:], 0.1) for point_m in (begin_m, end_m))
        along = end - begin
        share = ((plane - begin) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
        share = np.clip(share, 0.0, 1.0)
        distance = np.linalg.norm(plane - begin - share[..., None] * along, axis=-1)
        capsule_depth_m = begin_m[:, None, 2] + share * (end_m - begin_m)[:, None, 2]
        radius = scale * radius_m
        # Comparisons are false for NaN: absent people and people beside the camera.
        hidden |= (
            (distance * capsule_depth_m < radius) & (capsule_depth_m + radius / 2 < depth_m) & (capsule_depth_m > 0.1)
        )
    return hidden
