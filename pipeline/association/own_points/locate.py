"""Locate points of the user's own in the world: points that belong to people, and objects.

A point belongs to people if it is listed with their joints and stays near them, or if it is listed with no person and
stays near a single one. Points of a rigid object have one owner. Other points are objects, such as a ball that is
listed with the player: of each picture the detection with the highest score counts.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.clustering.cluster_people import reconstruct_by_clustering
from pipeline.association.clustering.clustering_parameters import derive_parameters as clustering_parameters
from pipeline.association.own_points.rigid import with_shapes
from pipeline.association.tracking.observations import Detections2D, gather, observed_by
from pipeline.association.tracking.track_people import track_bodies
from pipeline.association.tracking.tracking_parameters import TrackingParameters, derive_parameters
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.own_points import OwnDetections, OwnTracks, SceneObject, columns_of
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import JointSet, other_side
from pipeline.core.options.config import Method
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.track_assembly import close_gaps, make_person
from pipeline.geometry.tracks import reproject, triangulate_frames
from pipeline.geometry.triangulation import DISPUTED_M
from pipeline.geometry.undistortion import undistort_views

# A row of a file is a person's if the middle difference of its joints is at most this share of the diagonal of its box:
# between two output frames a body moves, and other rows are other people.
_MAX_APART = 0.25
# A point stays near a person if a joint is that near in so many frames: the reach of a racket, or of an arm.
_NEAR_M, _NEAR_SHARE = 1.2, 0.95


def locate_own_points(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    detections: Mapping[str, Detections],
    own: OwnDetections,
    joints: JointSet,
    tracks: Sequence[Track3D],
    observations: Sequence[Observations],
    parameters: TrackingParameters,
    method: Method = "tracking",
) -> OwnTracks:
    """Locate own points by robust triangulation.

    ``detections``, ``joints``: bodies by camera with joints in distorted pixels, NaN where a joint was not found.
    ``own``: own points of these bodies and of the scene. ``tracks``, ``observations``: people in the world (metres),
    and their observations in the same frames. ``method``: how animals with bones are found. Returns points of people in
    the frames of their tracks, and objects in all frames. Positions are NaN where fewer than two views agree within 6
    cm, and interpolated in gaps of at most 0.2 s. Standard deviations are in metres, root mean square over the axes.
    Rigid objects that have poses are listed.
    """
    bodies, of_bodies, of_scene = (gather(cameras, times, some) for some in (detections, own.of_bodies, own.of_scene))
    animals = track_animals(cameras, times, timebase, own, method)

    def located(track: Track3D, points: Detections2D, rows: Int[np.ndarray, " rows"]) -> Track3D:
        seen = observed_by(track, points, rows, len(cameras), timebase, parameters.lambda_t_hz)
        return locate_points(cameras, timebase, track, *seen, parameters.min_score)

    best = _best_of_frames(of_bodies, of_scene)
    shape = timebase.num_frames, 0
    everywhere = Track3D(0, 0, np.empty((*shape, 3)), *(np.empty(shape) for _ in range(4)))
    scene = located(everywhere, best, np.arange(len(best.frame)))
    of_people = [
        located(track, of_bodies, _rows_of(bodies, seen, track, timebase, joints))
        for track, seen in zip(tracks, observations, strict=True)
    ]
    with_bodies = np.isfinite(of_bodies.seen_px).any((0, 2))
    is_persons = with_bodies & _stay_near(zip(of_people, tracks, strict=True), len(own.names))
    groups = [[own.names.index(point) for point in shape.points] for shape in own.shapes]
    alone = set(range(len(own.names))).difference(*groups)
    for group in [*groups, *([k] for k in sorted(alone))]:
        if with_bodies[group].all():
            is_persons[group] = 2 * is_persons[group].sum() > len(group)
            continue
        is_persons[group] = False
        if not with_bodies[group].any():
            of_group = columns_of(scene, group)
            near = [number for number, track in enumerate(tracks) if _stay_near([(of_group, track)], len(group)).all()]
            if len(near) == 1:
                person = near[0]
                is_persons[group] = True
                of_people[person] = _with_columns(of_people[person], group, _in_frames(of_group, tracks[person].frames))
    columns = np.flatnonzero(is_persons).tolist()
    things = [
        SceneObject(name, points := tuple(own.names[k] for k in group), columns_of(scene, group), _within(own, points))
        for name, group in [
            *((shape.name, group) for shape, group in zip(own.shapes, groups, strict=True)),
            *((own.names[k], [k]) for k in sorted(alone)),
        ]
        if not is_persons[group].any() and np.isfinite(scene.xyz_m[:, group]).any()
    ]
    names, people = tuple(own.names[k] for k in columns), tuple(columns_of(points, columns) for points in of_people)
    return with_shapes(OwnTracks(names, people, (*things, *animals), bones=_within(own, names)), own)


def _within(own: OwnDetections, names: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Bones between points of these names."""
    return tuple(bone for bone in own.bones if {*bone} <= {*names})


def _rows_of(
    bodies: Detections2D, seen: Observations, track: Track3D, timebase: Timebase, joints: JointSet
) -> Int[np.ndarray, " rows"]:
    """Rows of a person's bodies, ascending, at most one a camera and frame: the nearest to the observations."""
    frame = np.rint((bodies.time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(int) - track.start_frame
    rows = np.flatnonzero((frame >= 0) & (frame < len(seen.points_px)))
    observed_px, body_px = seen.points_px[frame[rows], bodies.camera[rows]], bodies.seen_px[rows]
    # The global pass may have swapped left and right.
    swapped = [joints.index(other_side(name)) for name in joints.names]
    apart_px = np.fmin(*(np.linalg.norm(some_px - observed_px, axis=-1) for some_px in (body_px, body_px[:, swapped])))
    is_both = np.isfinite(apart_px)
    rows, apart_px, body_px = (values[is_both.any(1)] for values in (rows, apart_px, body_px))
    middle_px = np.nanmedian(apart_px, axis=1) if len(rows) else np.empty(0)
    size_px = np.linalg.norm(np.nanmax(body_px, axis=1) - np.nanmin(body_px, axis=1), axis=-1)
    is_near = middle_px <= _MAX_APART * size_px
    rows, middle_px = rows[is_near], middle_px[is_near]
    ranked = rows[np.lexsort((middle_px, bodies.frame[rows], bodies.camera[rows]))]
    _, first = np.unique(np.stack([bodies.camera[ranked], bodies.frame[ranked]]), axis=1, return_index=True)
    return np.sort(ranked[first])


def _best_of_frames(*parts: Detections2D) -> Detections2D:
    """Points of each camera's frames with the highest score, whatever row they are in."""
    camera, frame, time_s = (np.concatenate([part[k] for part in parts]) for k in range(3))
    seen_px, score = (np.concatenate([part[k] for part in parts]) for k in (3, 4))
    pictures, first, picture = np.unique(np.stack([camera, frame]), axis=1, return_index=True, return_inverse=True)
    best_px = np.full((pictures.shape[1], *seen_px.shape[1:]), np.nan)
    best = np.zeros((pictures.shape[1], score.shape[1]))
    picture = picture.reshape(-1)
    for k in range(score.shape[1]):
        ranked = np.lexsort((score[:, k], picture))
        last = ranked[np.append(np.diff(picture[ranked]) != 0, True)[: len(ranked)]]
        best_px[picture[last], k], best[picture[last], k] = seen_px[last, k], score[last, k]
    colour = np.zeros((len(first), 0, 0), np.uint8)
    return Detections2D(pictures[0], pictures[1], time_s[first], best_px, best, colour)


def _stay_near(pairs: Iterable[tuple[Track3D, Track3D]], num: int) -> Bool[np.ndarray, " points"]:
    """Points that stay near the joints of people: tracks of points, and of the person in some of the same frames."""
    near, known = np.zeros(num, int), np.zeros(num, int)
    for given, person in pairs:
        points = _in_frames(given, person.frames)
        for k in range(num):
            apart_m = np.linalg.norm(points.xyz_m[:, k, None] - person.xyz_m, axis=-1)
            is_both = np.isfinite(apart_m)
            near[k] += (np.where(is_both, apart_m, np.inf).min(1, initial=np.inf) <= _NEAR_M).sum()
            known[k] += np.isfinite(points.xyz_m[:, k, 0]).sum()
    return (known > 0) & (near >= _NEAR_SHARE * known)


def _in_frames(points: Track3D, frames: range) -> Track3D:
    """Points in some of their frames."""
    return points.part(slice(frames.start - points.start_frame, frames.stop - points.start_frame))


def _with_columns(points: Track3D, columns: list[int], of_columns: Track3D) -> Track3D:
    arrays: dict[str, Any] = {name: array.copy() for name, array in points.joint_arrays.items()}
    for name, array in of_columns.joint_arrays.items():
        arrays[name][:, columns] = array
        read_only(arrays[name])
    return replace(points, **arrays)


# Track animals: bodies whose points are all the user's own. Cross-view tracking (Chen et al. 2020) takes any points,
# hypothesis clustering points with bones. Their thresholds are lengths of people, so the world is enlarged until the
# animals are as large as people, and made small again afterwards.

# Extent of a person in a picture, as the larger side of the box, to which animals are compared.
_PERSON_M = 1.5
# Largest enlargement: for animals of unknown size, or as small as a fly.
_MAX_SCALE = 1000.0
# Lengths of its own that an animal moves in a second at most.
_LENGTHS_S = 10.0


def track_animals(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], timebase: Timebase, own: OwnDetections, method: Method
) -> tuple[SceneObject, ...]:
    """Track animals, and locate their points in the frames of the take; none without animals.

    Without bones they are tracked, whatever the method is. Positions and standard deviations are in metres, NaN where a
    point is unknown.
    """
    bodies = gather(cameras, times, own.of_animals) if own.of_animals else None
    if bodies is None or not len(bodies.frame):
        return ()
    scale = _scale(cameras, bodies)
    enlarged = _enlarged(cameras, scale)
    parameters = derive_parameters(enlarged, timebase.frame_rate_hz)
    parameters = replace(parameters, confirm_instants=min(parameters.confirm_instants, timebase.num_frames))
    if method == "clustering" and own.bones:
        derived = clustering_parameters(enlarged)
        min_joints = min(derived.min_joints, len(own.names))
        of_clustering = replace(derived, speed_m_s=_LENGTHS_S * _PERSON_M, min_joints=min_joints)
        parts = times, own.of_animals, timebase, JointSet(own.names, own.bones), of_clustering
        tracks, observations = reconstruct_by_clustering(enlarged, *parts)
    else:
        found = track_bodies(enlarged, times, bodies, timebase, parameters)
        tracks, observations = tuple(found.tracks), tuple(found.observations)
    animals = []
    for number, (track, seen) in enumerate(zip(tracks, observations, strict=True), 1):
        located = locate_points(enlarged, timebase, track, seen.points_px, seen.score, parameters.min_score)
        name = f"animal_{number}"
        points = tuple(f"{name}_{point}" for point in own.names)
        bones = tuple((f"{name}_{first}", f"{name}_{second}") for first, second in own.bones)
        animals.append(SceneObject(name, points, _in_take(located, timebase.num_frames, scale), bones))
    return tuple(animals)


def _enlarged(cameras: Sequence[Camera], scale: float) -> list[Camera]:
    poses = [camera.cam_from_world for camera in cameras]
    moved = (Rigid3(pose.rotation, pose.translation_m * scale) for pose in poses)
    return [replace(camera, cam_from_world=pose) for camera, pose in zip(cameras, moved, strict=True)]


def _scale(cameras: Sequence[Camera], bodies: Detections2D) -> float:
    """Factor that makes animals as large as people, by their extents in the pictures; 1 for larger ones."""
    known = np.isfinite(bodies.seen_px).all(-1)
    low, high = (np.where(known[..., None], bodies.seen_px, sign * np.inf) for sign in (1, -1))
    extents_px = (high.max(1) - low.min(1)).max(-1)
    extents_px = extents_px[known.sum(1) > 1]
    if not len(extents_px):
        return 1.0
    # Enlarged, no camera is nearer than a metre, within which the pixels of a metre have no meaning.
    enlarged = derive_parameters(_enlarged(cameras, _MAX_SCALE), 1.0)
    scale_px_m = _MAX_SCALE * enlarged.alpha_epipolar_px / enlarged.alpha_3d_m
    extent_m = float(np.median(extents_px)) / scale_px_m
    return float(np.clip(_PERSON_M / max(extent_m, 1e-9), 1.0, _MAX_SCALE))


def _in_take(track: Track3D, num_frames: int, scale: float) -> Track3D:
    """Track over all frames of the take, in the size of the world."""
    unknown = {"xyz_m": np.nan, "error_px": np.nan, "uncertainty_m": np.nan}
    arrays: dict[str, Any] = {}
    for name, array in track.joint_arrays.items():
        whole = np.full((num_frames, *array.shape[1:]), unknown.get(name, 0), array.dtype)
        whole[track.start_frame : track.frames.stop] = array / scale if name in ("xyz_m", "uncertainty_m") else array
        arrays[name] = read_only(whole)
    return replace(track, start_frame=0, **arrays)


# Least deviation of a point in a picture.
_MIN_SIGMA_PX = 0.5


def locate_points(
    cameras: Sequence[Camera],
    timebase: Timebase,
    track: Track3D,
    points_px: Float[np.ndarray, "frames cameras points 2"],
    score: Float[np.ndarray, "frames cameras points"],
    min_score: float,
) -> Track3D:
    """Triangulate points robustly in the frames of a track, with standard deviations.

    Pixels are distorted, NaN where a camera does not see a point.
    """
    matrices, ideal_px = projection_matrices(cameras), undistort_views(cameras, points_px)
    xyz_m = triangulate_frames(matrices, ideal_px, score, min_score)
    used, sigma_m = np.zeros(score.shape), np.full(xyz_m.shape[:2], np.nan)
    for k in range(xyz_m.shape[1]):  # the derivatives of all points at once would take much memory
        jacobian, residual_px = _views(matrices, xyz_m[:, k], ideal_px[:, :, k])
        # A metre at the point has this length in the picture, in pixels.
        scale_px_m = np.sqrt((jacobian**2).sum((-2, -1)) / 2.0)
        agrees = np.linalg.norm(residual_px, axis=-1) <= DISPUTED_M * scale_px_m
        agrees &= (score[:, :, k] > 0) & (score[:, :, k] >= min_score)
        agrees &= agrees.sum(1, keepdims=True) >= 2
        is_known = agrees.any(1)
        xyz_m[~is_known, k] = np.nan
        used[:, :, k] = np.where(agrees, score[:, :, k], 0.0)
        if is_known.any():
            sigma_m[is_known, k] = _sigma_m(jacobian[is_known], residual_px[is_known], agrees[is_known])
            sigma_m[:, k] = np.interp(np.arange(len(xyz_m)), np.flatnonzero(is_known), sigma_m[is_known, k])
    source = close_gaps(timebase, xyz_m)
    sigma_m[source == Source.ABSENT] = np.nan
    seen_px = np.where(used[..., None] > 0, points_px, np.nan)
    located, _ = make_person(track.start_frame, xyz_m, source, reproject(cameras, xyz_m, seen_px, used), seen_px, used)
    return replace(located, track_id=track.track_id, uncertainty_m=read_only(sigma_m))


def _views(
    matrices: Float[np.ndarray, "cameras 3 4"],
    xyz_m: Float[np.ndarray, "frames 3"],
    ideal_px: Float[np.ndarray, "frames cameras 2"],
) -> tuple[Float[np.ndarray, "frames cameras 2 3"], Float[np.ndarray, "frames cameras 2"]]:
    """Derivative of a point's projection by its position, and residual, in each view; NaN without one, or behind it."""
    image = np.einsum("cij,fj->fci", matrices[..., :3], xyz_m) + matrices[..., 3]
    depth = np.where(image[..., 2:] > 0, image[..., 2:], np.nan)
    projected_px = image[..., :2] / depth
    turned = matrices[:, :2, :3] - projected_px[..., None] * matrices[:, 2:, :3]
    return turned / depth[..., None], ideal_px - projected_px


def _sigma_m(
    jacobian: Float[np.ndarray, "frames cameras 2 3"],
    residual_px: Float[np.ndarray, "frames cameras 2"],
    agrees: Bool[np.ndarray, "frames cameras"],
) -> Float[np.ndarray, " frames"]:
    """Standard deviation of a point: noise of all its residuals, seen by the views of each frame."""
    squares_px2 = np.where(agrees[..., None], residual_px, 0.0) ** 2
    freedoms = 2 * agrees.sum() - 3 * len(agrees)
    variance_px2 = max(float(squares_px2.sum()) / freedoms, _MIN_SIGMA_PX**2)
    rows = np.where(agrees[..., None, None], jacobian, 0.0)
    covariance_m2 = variance_px2 * np.linalg.inv(np.einsum("fcia,fcib->fab", rows, rows))
    return np.sqrt(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3.0)
