"""Attachment of hands to people: fingers of the detections that belong to each person, located in 3D.

Bodies are associated without fingers. Then the hands of a person's detections are attached where two views agree, and
their joints are triangulated like the body's.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.hands.agreement_kernels import Agreement, choose_hands
from pipeline.association.tracking.observations import UNASSIGNED, Detections2D, observed_by, rows_by_person
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, People, Track3D
from pipeline.core.joints import FINGER_JOINTS, SIDES, JointSet, finger_joints, without_hands
from pipeline.geometry.camera import center_in_world, projection_matrices, rays_in_world
from pipeline.geometry.track_assembly import close_gaps
from pipeline.geometry.tracks import reproject, triangulate_frames
from pipeline.geometry.undistortion import undistort_views

# Knuckles whose positions in the palm hardly change: the roots of the five fingers.
_KNUCKLES = ("thumb_cmc", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp")
_HAND = finger_joints(SIDES[0])
_FINGERS = (*_HAND, *finger_joints(SIDES[1]))
_ROOTS = [_HAND.index(f"{SIDES[0]}_{name}") for name in _KNUCKLES]
# Mean distance of the knuckles from a view's rays at which the view does not support them.
_REACH_M = 0.04
# Largest distance of the knuckles' mean from the wrist: 7 cm, and the errors of both.
_PALM_M = 0.14
# Largest distance of a fingertip from the wrist: a long hand, and the errors of both.
_LONGEST_HAND_M = 0.26
# Rays at an angle below 5 degrees do not tell the depth of a hand.
_LEAST_SINE2 = 0.0076
# A hand exchanged with the other one needs more agreement than one that is not.
_EXCHANGED_SHARE = 0.8
# Distance of a joint from the person's observation at which it counts by half, as a share of the body's size. An
# observation between two frames of a camera lies between two detections.
_REACH_SHARE = 0.05
# Least number of joints that agree.
_LEAST_ALIKE = 2.0


def has_hands(joints: JointSet) -> bool:
    """Return whether a joint set has the fingers of both hands."""
    return set(joints.names) >= FINGER_JOINTS


def without_fingers(bodies: Detections2D, joints: JointSet) -> Detections2D:
    """Detections with the joints of ``without_hands(joints)`` only; the detections themselves if that is all.

    ``bodies`` have all joints of ``joints``.
    """
    names = without_hands(joints).names
    return bodies if len(names) == len(joints.names) else _only(bodies, _columns(joints, names))


def attach_hands(
    people: People,
    bodies: Detections2D,
    cameras: Sequence[Camera],
    joints: JointSet,
    timebase: Timebase,
    min_score: float,
    lambda_t_hz: float,
) -> People:
    """Add the joints of fingers to people.

    - ``people``: people with the joints of ``without_hands(joints)``, such as ``identify`` gives.
    - ``bodies``: detections of all cameras with all joints.
    - ``min_score``: observations with a lower score are not used.
    - ``lambda_t_hz``: rate at which the weight of observations falls with their distance in time; see
      ``TrackingParameters``.
    - Returns people with all joints. A finger is observed by a camera if its hand agrees with the hand of another
      camera at the person's wrist. The joints of the body are unchanged.
    """
    body = without_hands(joints)
    columns = _columns(joints, body.names), _columns(joints, _FINGERS)
    of_bodies, fingers = (_only(bodies, some) for some in columns)
    wrists = body.indices(tuple(f"{side}_wrist" for side in SIDES))
    owner = owners(people, of_bodies, timebase)
    rows_of = {int(owner[rows[0]]): rows for rows in rows_by_person(of_bodies, owner)}
    del of_bodies
    projections = projection_matrices(cameras)
    tracks: list[Track3D] = []
    observations: list[Observations] = []
    for number, (track, seen) in enumerate(zip(people.tracks, people.observations, strict=True)):
        rows = rows_of.get(number, np.empty(0, np.int64))
        points_px, score = observed_by(track, fingers, rows, len(cameras), timebase, lambda_t_hz)
        ideal_px = undistort_views(cameras, points_px)
        wrist_m = track.xyz_m[:, wrists]
        chosen = _agreed_hands(ideal_px, score, wrist_m, cameras, min_score)
        for values, missing in ((points_px, np.nan), (ideal_px, np.nan), (score, 0.0)):
            _arrange(values, chosen, missing)
        xyz_m = triangulate_frames(projections, ideal_px, score, min_score)
        far = np.linalg.norm(xyz_m - np.repeat(wrist_m, len(_HAND), axis=1), axis=-1) > _LONGEST_HAND_M
        xyz_m[far] = np.nan
        source = close_gaps(timebase, xyz_m)
        error_px, mean_score, views = reproject(cameras, xyz_m, points_px, score, min_score)
        hands = replace(track, xyz_m=xyz_m, score=mean_score, source=source, error_px=error_px, views=views)
        tracks.append(_whole_track(track, hands, columns))
        points_px, score = _joined(columns, seen.points_px, points_px, 2), _joined(columns, seen.score, score, 2)
        observations.append(replace(seen, points_px=points_px, score=score))
    return people._replace(tracks=tracks, observations=observations)


def _columns(joints: JointSet, names: Sequence[str]) -> Int[np.ndarray, " names"]:
    return np.array(joints.indices(tuple(names)), np.int64)


def _only(bodies: Detections2D, columns: Int[np.ndarray, " columns"]) -> Detections2D:
    """Detections with some joints."""
    return bodies._replace(
        seen_px=np.ascontiguousarray(bodies.seen_px[:, columns]), score=np.ascontiguousarray(bodies.score[:, columns])
    )


def _agreed_hands(
    ideal_px: Float[np.ndarray, "frames cameras fingers 2"],
    score: Float[np.ndarray, "frames cameras fingers"],
    wrist_m: Float[np.ndarray, "frames 2 3"],
    cameras: Sequence[Camera],
    min_score: float,
) -> Int[np.ndarray, "frames cameras 2"]:
    """Number of the detection's hand that is the hand of each side of the person; see ``choose_hands``."""
    by_hand = (*score.shape[:2], 2, len(_HAND))
    roots_px, roots_score = ideal_px.reshape(*by_hand, 2)[..., _ROOTS, :], score.reshape(by_hand)[..., _ROOTS]
    used = np.isfinite(roots_px).all(-1) & (roots_score >= min_score) & (roots_score > 0)
    roots_px[~used] = np.nan
    rays = np.stack([rays_in_world(camera, roots_px[:, k]) for k, camera in enumerate(cameras)], axis=1)
    weights = np.where(used, roots_score, 0.0).mean(-1)
    chosen = np.empty((*score.shape[:2], 2), np.int64)
    agreement = Agreement(
        _REACH_M,
        _PALM_M,
        _LEAST_SINE2,
        _EXCHANGED_SHARE,
        np.empty((len(_ROOTS), 3)),
        np.empty((2, len(_ROOTS), 3)),
        np.empty((len(cameras), 2)),
    )
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    choose_hands(agreement, rays, weights, centers_m, np.ascontiguousarray(wrist_m), chosen)
    return chosen


def _arrange(values: np.ndarray, chosen: Int[np.ndarray, "frames cameras 2"], missing: float) -> None:
    """Exchange and drop, in place, the hands of (frames, cameras, fingers, ...) as they were chosen."""
    hands = values.reshape(*chosen.shape, len(_HAND), *values.shape[3:])
    is_exchanged = chosen == np.arange(2)[::-1]
    others = hands[:, :, ::-1][is_exchanged]
    hands[is_exchanged] = others
    hands[chosen < 0] = missing


def _whole_track(body: Track3D, hands: Track3D, columns: Sequence[Int[np.ndarray, " _"]]) -> Track3D:
    return replace(
        body,
        xyz_m=_joined(columns, body.xyz_m, hands.xyz_m, 1),
        score=_joined(columns, body.score, hands.score, 1),
        source=_joined(columns, body.source, hands.source, 1),
        error_px=_joined(columns, body.error_px, hands.error_px, 1),
        views=_joined(columns, body.views, hands.views, 1),
    )


def _joined(columns: Sequence[Int[np.ndarray, " _"]], body: np.ndarray, hands: np.ndarray, axis: int) -> np.ndarray:
    shape = list(body.shape)
    shape[axis] = sum(map(len, columns))
    joined = np.empty(shape, body.dtype)
    by_joint = np.moveaxis(joined, axis, 0)
    for of_part, values in zip(columns, (body, hands), strict=True):
        by_joint[of_part] = np.moveaxis(values, axis, 0)
    return read_only(joined)


def owners(people: People, bodies: Detections2D, timebase: Timebase) -> Int[np.ndarray, " detections"]:
    """Find the person of each detection: the one whose observations in the camera have the detection's joints.

    People and bodies have the same joints, the body's. Returns the person's position in ``people.tracks`` for
    each detection, ``UNASSIGNED`` if it has no person's joints.
    """
    nearest = np.rint((bodies.time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(np.int64)
    size_px = _sizes_px(bodies.seen_px)
    owner = np.full(len(bodies.camera), UNASSIGNED)
    most_alike = np.full(len(bodies.camera), _LEAST_ALIKE)
    for number, (track, seen) in enumerate(zip(people.tracks, people.observations, strict=True)):
        for camera in range(seen.score.shape[1]):
            start, stop = np.searchsorted(bodies.camera, [camera, camera + 1])
            of_camera = nearest[start:stop]
            first, last = np.searchsorted(of_camera, [track.start_frame, track.start_frame + track.num_frames])
            rows = np.arange(start + first, start + last)
            alike = _alike(seen, nearest[rows] - track.start_frame, camera, bodies.seen_px[rows], size_px[rows])
            better = alike > most_alike[rows]
            owner[rows[better]] = number
            most_alike[rows[better]] = alike[better]
    return owner


def _sizes_px(points_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, " n"]:
    """Longer side of the box around each body's joints; at least a pixel."""
    found = np.isfinite(points_px)
    low = np.where(found, points_px, np.inf).min(1, initial=np.inf)
    high = np.where(found, points_px, -np.inf).max(1, initial=-np.inf)
    return np.maximum((high - low).max(-1), 1.0)


def _alike(
    seen: Observations,
    frame: Int[np.ndarray, " n"],
    camera: int,
    points_px: Float[np.ndarray, "n joints 2"],
    size_px: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Number of joints that agree with the observations of a camera; a joint at some distance counts in part."""
    apart = np.linalg.norm(seen.points_px[frame, camera] - points_px, axis=-1) / (_REACH_SHARE * size_px[:, None])
    return np.asarray(np.where(np.isfinite(apart), 1.0 / (1.0 + apart**2), 0.0).sum(-1))
