"""Regions of heads in the pictures of a camera, from the people of a take and from all bodies that were detected.

Both see what the other misses. The head of a tracked person is projected into every camera and frame, also where the
person is hidden or no detector found a body. A detected body counts whether a track took it or not: bystanders, people
beyond a largest number of people, people removed by edits, and everybody where a calibration is wrong.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.detections import Detections, HeadRegions, PafFields, SeenHeads
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.geometry.camera import project

FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
"""Joints of the head."""

HOLD_S = 0.5
"""Time before the first and after the last frame of a track for which its head is expected where it was."""

# Radii of spheres, by what is known of the head. A head reaches 0.13 m from its middle; hair, hats and the errors of
# joints come on top.
_OF_EARS_M, _OF_FACE_M, _OF_TRUNK_M, _OF_SHOULDERS_M, _OF_HIPS_M = 0.20, 0.24, 0.32, 0.36, 0.70
# Distance of the middle of the head from the middle between the shoulders, for each metre of the trunk and in metres,
# and from the middle between the hips.
_NECK_BY_TRUNK, _NECK_M, _ABOVE_HIPS_M = 0.5, 0.25, 0.75
# A head of which nothing is known moves at most so fast, and the sphere grows by this much at most.
_SPEED_M_S, _MAX_GROWTH_M = 1.0, 0.5
# Standard deviations of joints by which spheres grow.
_SIGMAS, _MAX_SIGMAS_M = 2.0, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class HeadPath:
    """Sphere around a person's head over time."""

    time_s: Float[np.ndarray, " frames"]  # Ascending times on the session's clock
    center_m: Float[np.ndarray, "frames 3"]  # World coordinates, never NaN
    radius_m: Float[np.ndarray, " frames"]

    def at(self, time_s: float) -> tuple[Float[np.ndarray, " 3"], float] | None:
        """Centre and radius at a time; ``None`` more than ``HOLD_S`` before the first and after the last frame."""
        away_s = max(float(self.time_s[0]) - time_s, time_s - float(self.time_s[-1]), 0.0)
        if away_s > HOLD_S:
            return None
        center_m = np.array([np.interp(time_s, self.time_s, self.center_m[:, axis]) for axis in range(3)])
        radius_m = float(np.interp(time_s, self.time_s, self.radius_m))
        return center_m, radius_m + min(_SPEED_M_S * away_s, _MAX_GROWTH_M)


def head_path(track: Track3D, joints: JointSet, timebase: Timebase) -> HeadPath | None:
    """Sphere around the head of a person in each frame of a track, also where the joints of the head are unknown.

    The less is known, the larger is the sphere: around the ears, the face, above the shoulders, the hips. Frames in
    which nothing is known have a sphere between the spheres of the frames around them. ``None`` if no frame has any of
    these joints.
    """
    center_m, radius_m = _spheres(track, joints)
    is_known = np.isfinite(radius_m)
    if not is_known.any():
        return None
    frames = np.arange(track.num_frames)
    known = frames[is_known]
    away = np.abs(
        frames[:, None] - known[np.clip(np.searchsorted(known, frames)[:, None] + [-1, 0], 0, len(known) - 1)]
    )
    growth_m = np.minimum(_SPEED_M_S * away.min(axis=1) / timebase.frame_rate_hz, _MAX_GROWTH_M)
    filled_m = np.stack([np.interp(frames, known, center_m[is_known, axis]) for axis in range(3)], axis=1)
    time_s = timebase.start_time_s + (track.start_frame + frames) / timebase.frame_rate_hz
    return HeadPath(time_s, filled_m, np.interp(frames, known, radius_m[is_known]) + growth_m)


def _spheres(track: Track3D, joints: JointSet) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, " frames"]]:
    """Centres and radii from the joints of each frame alone, NaN where they tell nothing."""
    shoulders_m, hips_m = _middle(track, joints, "shoulder"), _middle(track, joints, "hip")
    up = np.array([0.0, 0.0, 1.0])
    # From the vaguest to the best; what is known better takes the place of what was found before.
    center_m, radius_m = hips_m + _ABOVE_HIPS_M * up, np.full(track.num_frames, _OF_HIPS_M)
    ways = [
        (shoulders_m + _NECK_M * up, _OF_SHOULDERS_M),
        (shoulders_m + _NECK_BY_TRUNK * (shoulders_m - hips_m), _OF_TRUNK_M),
    ]
    face = [joints.index(name) for name in FACE if name in joints.names]
    if face:
        face_m = track.xyz_m[:, face]
        is_seen = np.isfinite(face_m).all(axis=-1)
        num_seen = is_seen.sum(axis=1, keepdims=True)
        total_m = np.where(is_seen[..., None], face_m, 0.0).sum(axis=1)
        ways.append((np.where(num_seen > 0, total_m / np.maximum(num_seen, 1), np.nan), _OF_FACE_M))
        ways.append((_middle(track, joints, "ear", both=True), _OF_EARS_M))
    for way_m, way_radius_m in ways:
        is_known = np.isfinite(way_m).all(axis=-1)
        center_m = np.where(is_known[:, None], way_m, center_m)
        radius_m = np.where(is_known, way_radius_m, radius_m)
    if face and track.uncertainty_m is not None:
        sigma_m = np.nan_to_num(track.uncertainty_m[:, face]).max(axis=1)
        radius_m = radius_m + np.minimum(_SIGMAS * sigma_m, _MAX_SIGMAS_M)
    return center_m, np.where(np.isfinite(center_m).all(axis=-1), radius_m, np.nan)


def _middle(track: Track3D, joints: JointSet, part: str, both: bool = False) -> Float[np.ndarray, "frames 3"]:
    """Middle between the left and the right joint of a part, or the only known one of them; else NaN.

    ``both``: NaN unless both are known.
    """
    names = [name for name in (f"left_{part}", f"right_{part}") if name in joints.names]
    if len(names) < 2:
        return np.full((track.num_frames, 3), np.nan)
    left_m, right_m = (track.xyz_m[:, joints.index(name)] for name in names)
    middle_m = (left_m + right_m) / 2
    if both:
        return middle_m
    middle_m = np.where(np.isfinite(middle_m), middle_m, left_m)
    return np.where(np.isfinite(middle_m), middle_m, right_m)


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
# Radii by what is known of the head, as for people in the world, and the distance of the head from the shoulders.
_OF_PICTURED_FACE_M, _OF_NOSE_M, _OF_PICTURED_SHOULDERS_M = 0.18, 0.24, 0.36
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
    radius_px = np.fmin(np.fmax(pixels_a_metre * _OF_PICTURED_FACE_M, _MIN_OF_BOX * side_px), _MAX_OF_BOX * side_px)
    up_px = np.array([0.0, -1.0]) * (radius_px / _OF_PICTURED_FACE_M)[:, None]
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
        (above_px, np.full(len(box_px), _OF_PICTURED_SHOULDERS_M)),
        (along_px, np.full(len(box_px), _OF_PICTURED_SHOULDERS_M)),
        (center_px, np.where(num_seen > 1, _OF_PICTURED_FACE_M, _OF_NOSE_M)),
    ]
    for way_px, way_m in ways:
        is_known = np.isfinite(way_px).all(axis=1)
        half_way_px = (radius_px * way_m / _OF_PICTURED_FACE_M)[:, None].repeat(2, axis=1)
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


NEAR_S = 0.2
"""Time around a frame in which a detected head counts where the frame itself has no region: detectors miss frames."""

# Heads at most so far from the centre of a camera, in radii of their sphere, cover the whole picture.
_AT_CAMERA = 1.2
_GROWTH_OF_NEAR = 1.3
# Ellipses of peaks of heatmaps, which have no size: a share of the longer side of the picture if no person is tracked.
_MIN_OF_PICTURE = 0.05
# Pixels beyond the picture at which projections of points are cut, in sides of the picture.
_MAX_BEYOND = 4.0
# Factor by which a sphere is larger than the convex hull of its points in all ``_DIRECTIONS``.
_OVER_HULL = 1.06

_STEPS = np.linspace(-1.0, 1.0, 5)
# Unit vectors to points on the surface of a cube.
_DIRECTIONS = np.array([point for point in itertools.product(_STEPS, repeat=3) if np.abs(point).max() == 1.0])
_DIRECTIONS = read_only(_DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True))


def head_regions(
    camera: Camera, frames: range, time_s: Float[np.ndarray, " frames"], people: Sequence[HeadPath], seen: SeenHeads
) -> HeadRegions:
    """Ellipses around all heads in each frame of a camera, also of heads that are hidden or out of the picture.

    ``frames``, ``time_s``: numbers of the frames, and their times on the session's clock. ``people``: heads of the
    take's people over time. ``seen``: heads that a detector saw. One of a neighbouring frame counts where no other
    region is.
    """
    projected = [_projected(camera, people, float(now_s)) for now_s in time_s]
    seen_px = _sized(camera, seen.ellipse_px, [ellipse_px for ellipse_px in projected if len(ellipse_px)])
    first = np.searchsorted(seen.frame, np.arange(frames.start, frames.stop))
    last = np.searchsorted(seen.frame, np.arange(frames.start, frames.stop), side="right")
    found: list[Float[np.ndarray, "here 4"]] = []
    for number, now_s in enumerate(time_s):
        here_px = np.concatenate([projected[number], seen_px[first[number] : last[number]]])
        near = slice(*np.searchsorted(time_s, [now_s - NEAR_S, now_s + NEAR_S]))
        around_px = seen_px[first[near][0] : last[near][-1]]
        missed_px = around_px[~_is_covered(around_px[:, :2], here_px)]
        missed_px[:, 2:] *= _GROWTH_OF_NEAR
        found.append(np.concatenate([here_px, missed_px]))
    numbers = np.repeat(np.arange(frames.start, frames.stop), [len(ellipse_px) for ellipse_px in found])
    ellipse_px = np.concatenate([np.empty((0, 4)), *found]).astype(np.float32)
    return HeadRegions(
        camera.name, camera.size_px, frames.start, frames.stop, read_only(numbers), read_only(ellipse_px)
    )


def sphere_ellipse(
    camera: Camera, center_m: Float[np.ndarray, " 3"], radius_m: float
) -> Float[np.ndarray, " 4"] | None:
    """Ellipse around the picture of a sphere, through the lens; ``None`` if the sphere is behind the camera.

    The axes are the picture's: the ellipse has the shape of the box around the projected points of the sphere,
    and is large enough for each of them. A sphere at the camera covers the whole picture.
    """
    size_px = np.array(camera.size_px, float)
    center_in_cam = camera.cam_from_world.apply(center_m)
    if np.linalg.norm(center_in_cam) < _AT_CAMERA * radius_m:
        return np.concatenate([(size_px - 1) / 2, size_px])
    points_px = project(camera, center_m + radius_m * _DIRECTIONS)
    points_px = points_px[np.isfinite(points_px).all(axis=1)]
    if not len(points_px):
        return None
    points_px = np.clip(points_px, -_MAX_BEYOND * size_px, (1 + _MAX_BEYOND) * size_px)
    low_px, high_px = points_px.min(axis=0), points_px.max(axis=0)
    middle_px, half_px = (low_px + high_px) / 2, np.maximum((high_px - low_px) / 2, 1.0)
    reach = float(np.linalg.norm((points_px - middle_px) / half_px, axis=1).max())
    return np.concatenate([middle_px, half_px * reach * _OVER_HULL])


def _projected(camera: Camera, people: Sequence[HeadPath], time_s: float) -> Float[np.ndarray, "here 4"]:
    spheres = [sphere for path in people if (sphere := path.at(time_s)) is not None]
    ellipses = [ellipse_px for sphere in spheres if (ellipse_px := sphere_ellipse(camera, *sphere)) is not None]
    return np.array(ellipses).reshape(-1, 4)


def _sized(
    camera: Camera, ellipse_px: Float[np.ndarray, "n 4"], projected: Sequence[Float[np.ndarray, "here 4"]]
) -> Float[np.ndarray, "n 4"]:
    """Ellipses; one without a size (a single joint has none) gets the usual size of heads in this camera."""
    least_px = _MIN_OF_PICTURE * max(camera.size_px)
    usual_px = float(np.median(np.concatenate(projected)[:, 2:])) if projected else 0.0
    half_px = np.where(ellipse_px[:, 2:] >= 1.0, ellipse_px[:, 2:], max(least_px, usual_px))
    return np.concatenate([ellipse_px[:, :2], half_px], axis=1)


def _is_covered(points_px: Float[np.ndarray, "n 2"], ellipse_px: Float[np.ndarray, "here 4"]) -> np.ndarray:
    """Points that are in the inner half of one of the ellipses."""
    from_center = (points_px[:, None] - ellipse_px[None, :, :2]) / ellipse_px[None, :, 2:]
    return np.asarray((np.linalg.norm(from_center, axis=2) < 0.5).any(axis=1))
