"""Mirror images of people: a person behind a plane who does at the same time what another person does before it.

The joints of an image are the reflections of the person's joints, with left and right exchanged: the plane halves the
lines between them, and stands upright on all of them. That holds in every frame and to the accuracy of the positions.
Dancers who do the same are decimetres away from it, and cameras behind the plane see them: no camera sees an image from
behind the mirror.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.people import Track3D
from pipeline.core.joints import FINGER_JOINTS, JointSet, other_side

# Shortest common time, and share of the image's frames in which the person must be known.
_MIN_S, _MIN_SHARE = 2.0, 0.5
_MIN_JOINTS = 6
# Frames from which the plane is found, and their largest median distance: most pairs of people are far from it.
_NUM_SAMPLES, _MAX_COARSE_M = 200, 0.2
# Time over which distances are averaged: noise of positions counts less, motion that is not the same counts as much.
_BLOCK_S = 0.25
# Largest distance of an image's joints from the reflected ones: in the median of a block's joints over the time, and in
# nine blocks of ten.
_MAX_ERROR_M, _MAX_ERROR_90_M = 0.05, 0.1
# Least movement of a quarter of the joints, also as a multiple of that distance: still people tell nothing.
_MIN_MOVED_M, _MIN_MOVED = 0.1, 4.0
# Share of an image's views that cameras behind the mirror may have by mistake.
_MAX_BEHIND = 0.1
_ITERATIONS, _OUTLIER_M = 5, 0.15


@dataclass(frozen=True, slots=True, eq=False)
class MirrorImage:
    """Mirror image of a person."""

    number: int  # Position of the image's track
    original: int  # Position of the person's track
    # Plane of the mirror: points with ``normal @ xyz_m == offset_m``; the normal's largest component is positive
    normal: Float[np.ndarray, " 3"]
    offset_m: float
    error_m: float  # Median distance of the image's joints from the person's reflected ones
    num_frames: int  # Frames in which both were located


@dataclass(frozen=True, slots=True, eq=False)
class Mirror:
    """Plane that reflects a track to another one, and how well it does."""

    normal: Float[np.ndarray, " 3"]
    offset_m: float
    error_m: float


def find_mirror(first: Track3D, second: Track3D, joints: JointSet, frame_rate_hz: float) -> Mirror | None:
    """Find the plane that reflects a person to another one all the time; ``None`` if there is none.

    The normal points to the first person.
    """
    start = max(first.start_frame, second.start_frame)
    stop = min(first.start_frame + first.num_frames, second.start_frame + second.num_frames)
    if stop - start < _MIN_S * frame_rate_hz:
        return None
    body = [name for name in joints.names if name not in FINGER_JOINTS and other_side(name) in joints.names]
    if len(body) < _MIN_JOINTS:
        return None
    columns = np.array(joints.indices(tuple(body)))
    others = np.array(joints.indices(tuple(other_side(name) for name in body)))

    def at(frames: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Joints of the person, with left and right exchanged, and of the image in frames in which both are known."""
        person_m = first.xyz_m[frames - first.start_frame][:, others]
        image_m = second.xyz_m[frames - second.start_frame][:, columns]
        known = (np.isfinite(person_m[..., 0]) & np.isfinite(image_m[..., 0])).sum(-1) >= _MIN_JOINTS
        return person_m[known], image_m[known]

    step = -(-(stop - start) // _NUM_SAMPLES)
    person_m, image_m = at(np.arange(start, stop, step))
    if len(person_m) * step < _MIN_S * frame_rate_hz:
        return None
    normal, offset_m = _fit_plane(person_m.reshape(-1, 3), image_m.reshape(-1, 3))
    if not np.nanmedian(_error_m(person_m, image_m, normal, offset_m)) <= _MAX_COARSE_M:
        return None
    person_m, image_m = at(np.arange(start, stop))
    block = max(1, round(_BLOCK_S * frame_rate_hz))
    shape = (-1, block, *person_m.shape[1:])
    whole = slice(len(person_m) // block * block)
    error_m = _error_m(person_m[whole].reshape(shape), image_m[whole].reshape(shape), normal, offset_m)
    error_m = np.nanmedian(error_m, axis=-1)
    usual_m, high_m = float(np.median(error_m)), float(np.quantile(error_m, 0.9))
    if (
        usual_m > _MAX_ERROR_M
        or high_m > _MAX_ERROR_90_M
        or _moved_m(person_m) < max(_MIN_MOVED_M, _MIN_MOVED * usual_m)
    ):
        return None
    return Mirror(normal, offset_m, usual_m)


def _error_m(
    person_m: Float[np.ndarray, "*batch joints 3"],
    image_m: Float[np.ndarray, "*batch joints 3"],
    normal: Float[np.ndarray, " 3"],
    offset_m: float,
) -> Float[np.ndarray, "blocks joints"]:
    """Distance of an image's joints from the reflected ones, of frames or of blocks of frames; NaN if unknown."""
    away_m = image_m - _reflect(person_m, normal, offset_m)
    known = np.isfinite(away_m)
    if away_m.ndim > 3:
        count = known.sum(1)
        away_m = np.where(known, away_m, 0.0).sum(1) / np.where(count > 0, count, np.nan)
    return np.asarray(np.linalg.norm(away_m, axis=-1))


def _reflect(
    xyz_m: Float[np.ndarray, "*batch 3"], normal: Float[np.ndarray, " 3"], offset_m: float
) -> Float[np.ndarray, "*batch 3"]:
    return np.asarray(xyz_m - 2 * (xyz_m @ normal - offset_m)[..., None] * normal)


def is_image(
    mirror: Mirror,
    behind: Track3D,
    cameras_m: Float[np.ndarray, "cameras 3"],
    sees: Bool[np.ndarray, "frames cameras"],
    num_common: int,
) -> bool:
    """Tell whether the person on the far side of a plane is an image: all cameras that see it are on the near side.

    ``sees`` is whether a camera saw any joint in a frame of the track ``behind``; ``num_common`` are frames that it
    shares with the person.
    """
    if num_common < _MIN_SHARE * np.isfinite(behind.xyz_m[..., 0]).any(-1).sum():
        return False
    is_behind = cameras_m @ mirror.normal < mirror.offset_m
    views = sees.sum(0)
    return bool(views.sum() > 0 and views[is_behind].sum() <= _MAX_BEHIND * views.sum())


def _fit_plane(
    person_m: Float[np.ndarray, "points 3"], image_m: Float[np.ndarray, "points 3"]
) -> tuple[Float[np.ndarray, " 3"], float]:
    """Plane half-way between points and their images, robustly; its normal points to the first ones."""
    known = np.isfinite(person_m).all(-1) & np.isfinite(image_m).all(-1)
    person_m, image_m = person_m[known], image_m[known]
    between_m, middle_m = person_m - image_m, (person_m + image_m) / 2
    normal = np.median(between_m, axis=0)
    used = np.ones(len(between_m), bool)
    for _ in range(_ITERATIONS):
        _, _, axes = np.linalg.svd(between_m[used], full_matrices=False)
        normal = axes[0] * (np.sign(axes[0] @ normal) or 1.0)
        offset_m = float(np.median(middle_m[used] @ normal))
        error_m = np.linalg.norm(image_m - _reflect(person_m, normal, offset_m), axis=-1)
        used = error_m <= max(_OUTLIER_M, float(np.median(error_m)))
    return normal, offset_m


def _moved_m(person_m: Float[np.ndarray, "frames joints 3"]) -> float:
    """Movement of the liveliest quarter of a person's located joints: distance from their usual places."""
    person_m = person_m[:, np.isfinite(person_m[..., 0]).any(0)]
    away_m = np.linalg.norm(person_m - np.nanmedian(person_m, axis=0), axis=-1)
    return float(np.nanquantile(np.nanquantile(away_m, 0.9, axis=0), 0.75))
