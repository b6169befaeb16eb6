"""Poses of rigid objects from the triangulated points of each frame.

Points whose distances to most others are not the object's are left out. The rest give the pose by weighted least
squares (Kabsch 1976), with the inverse variances of the points as weights.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.own_points import OwnDetections, OwnTracks, RigidShape, columns_of
from pipeline.core.data.people import Track3D
from pipeline.motion.skeleton.rotations import align, continuous_quat_xyzw

# Largest error of a distance or of a point: a share of the object's size, and deviations of the points.
_MAX_SHARE, _MAX_SIGMAS = 0.1, 4.0
_MIN_SIGMA_M = 1e-4
# Extent of the used points across their longest line, as a share of the extent along it, below which no pose is told.
_THIN = 0.05


class RigidMotion(NamedTuple):
    """Poses of a rigid object: ``x_in_world = rotation(quat) x_in_object + place``; NaN in frames without one."""

    shape: RigidShape
    person: int | None  # Number of the track of the person who has it
    frames: range  # Output frames of the rows
    quat_xyzw: Float[np.ndarray, "frames 4"]
    place_m: Float[np.ndarray, "frames 3"]
    rms_m: Float[np.ndarray, " frames"]  # Root mean square distance of the used points from their places
    num_points: Int[np.ndarray, " frames"]  # Number of used points

    @property
    def name(self) -> str:
        """Name in files of a take, each once."""
        return self.shape.name if self.person is None else f"person_{self.person}_{self.shape.name}"


def with_shapes(found: OwnTracks, own: OwnDetections) -> OwnTracks:
    """Add the shapes that have poses to own points, for each animal its own, and sentences about the others.

    Of a shape that is known but for its mirror image, the image that fits better is taken.
    """
    shapes, doubts = [], []
    heads = ["", *(f"{thing.name}_" for thing in found.objects if thing.points[0] not in own.names)]
    for shape in own.shapes:
        images = [shape] if shape.has_sides else [shape, shape._replace(xyz_m=shape.xyz_m * [1.0, 1.0, -1.0])]
        posed = []
        for head in heads:
            points = tuple(head + point for point in shape.points)
            named = [image._replace(name=head + shape.name, points=points) for image in images]
            motions = [list(rigid_motions(replace(found, shapes=(image,)))) for image in named]
            best = min(range(len(named)), key=lambda k: _misfit(motions[k]))
            posed += [named[best]] if motions[best] else []
        shapes += posed
        if not posed:
            reason = "at no time three of its points are located at the distances of the file, which are metres"
            doubts.append(f"{shape.name} has no pose: {reason}.")
    return replace(found, shapes=tuple(shapes), doubts=tuple(doubts))


def rigid_motions(found: OwnTracks) -> Iterator[RigidMotion]:
    """Poses of all rigid objects of people, and of the scene."""
    for owner in _owners(found):
        yield from poses(found.shapes, *owner)


def _owners(found: OwnTracks) -> Iterator[tuple[tuple[str, ...], Track3D, int | None]]:
    """Names and tracks of points with the number of their person: of people, and of the scene."""
    yield from ((found.names, points, points.track_id) for points in found.of_people)
    if found.scene is not None:
        yield found.scene[0].names, found.scene[1], None


def poses(
    shapes: Sequence[RigidShape], names: Sequence[str], track: Track3D, person: int | None = None
) -> tuple[RigidMotion, ...]:
    """Poses of objects whose points a track has; NaN where fewer than three points fit.

    ``names`` are the names of the points of the track, ``person`` is the number of their owner. Objects without a pose
    in any frame are left out.
    """
    within = [shape for shape in shapes if {*shape.points} <= {*names}]
    columns = ([names.index(point) for point in shape.points] for shape in within)
    motions = [_motion(shape, person, columns_of(track, own)) for shape, own in zip(within, columns, strict=True)]
    return tuple(motion for motion in motions if motion.num_points.any())


def _misfit(motions: Sequence[RigidMotion]) -> tuple[int, float]:
    """Number of points that fit, negative, and the sum of the squares of their distances."""
    num = sum(int(motion.num_points.sum()) for motion in motions)
    return -num, sum(float(np.nansum(motion.rms_m**2 * motion.num_points)) for motion in motions)


def _motion(shape: RigidShape, person: int | None, track: Track3D) -> RigidMotion:
    xyz_m = track.xyz_m
    sigma_m = np.zeros(xyz_m.shape[:2]) if track.uncertainty_m is None else np.nan_to_num(track.uncertainty_m)
    sigma_m = np.maximum(sigma_m, _MIN_SIGMA_M)
    between_m = np.linalg.norm(shape.xyz_m[:, None] - shape.xyz_m, axis=-1)
    allowed_m = _MAX_SHARE * between_m.max()
    known = np.isfinite(xyz_m).all(-1)
    used = known.copy()
    for k, lengths_m in enumerate(between_m):  # the distances of all points at once would take much memory
        apart_m = np.abs(np.linalg.norm(xyz_m - xyz_m[:, k, None], axis=-1) - lengths_m)
        agrees = apart_m <= allowed_m + _MAX_SIGMAS * np.hypot(sigma_m[:, k, None], sigma_m)
        used[:, k] &= 2 * (agrees.sum(-1) - 1) >= known.sum(-1) - 1  # a point agrees with itself
    *_, miss_m = _fitted(shape, xyz_m, sigma_m, used)
    used &= miss_m <= allowed_m + _MAX_SIGMAS * sigma_m
    quat, place_m, miss_m = _fitted(shape, xyz_m, sigma_m, used)
    num_points = np.where(np.isfinite(place_m[:, 0]), used.sum(1), 0)
    squares_m2 = np.where(used, miss_m**2, 0.0).sum(1) / np.where(num_points > 0, num_points, np.nan)
    return RigidMotion(shape, person, track.frames, quat, place_m, np.sqrt(squares_m2), num_points)


def _fitted(
    shape: RigidShape,
    xyz_m: Float[np.ndarray, "frames points 3"],
    sigma_m: Float[np.ndarray, "frames points"],
    used: Bool[np.ndarray, "frames points"],
) -> tuple[Float[np.ndarray, "frames 4"], Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames points"]]:
    """Quaternions, places, and distances of all points from their places; NaN where too few points are used."""
    weight = np.where(used, sigma_m**-2.0, 0.0)
    weight /= np.maximum(weight.sum(1, keepdims=True), np.finfo(float).tiny)
    of_shape_m, middle_m = weight @ shape.xyz_m, np.einsum("fp,fpi->fi", weight, np.where(used[..., None], xyz_m, 0.0))
    centred_m, root = shape.xyz_m - of_shape_m[:, None], np.sqrt(weight)[..., None]
    turn = align(root * centred_m, root * np.where(used[..., None], xyz_m - middle_m[:, None], np.nan))
    extents_m = np.linalg.svd(np.where(used[..., None], centred_m, 0.0), compute_uv=False)
    is_told = (used.sum(1) >= 3) & (extents_m[:, 1] > _THIN * extents_m[:, 0])
    quat, matrices = np.full((len(xyz_m), 4), np.nan), turn.as_matrix()
    if is_told.any():
        quat[is_told] = continuous_quat_xyzw(Rotation.from_matrix(matrices[is_told]))
    place_m = middle_m - np.einsum("fij,fj->fi", matrices, of_shape_m)
    place_m[~is_told] = np.nan
    placed_m = np.einsum("fij,pj->fpi", matrices, shape.xyz_m) + place_m[:, None]
    return quat, place_m, np.linalg.norm(xyz_m - placed_m, axis=-1)
