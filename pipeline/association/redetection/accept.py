"""Acceptance of bodies that were detected again: they replace observations of people."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.identity.merging import relocate
from pipeline.association.redetection.expect import BODY, expected_body_m
from pipeline.association.tracking.observations import UNASSIGNED, Detections2D, gather, observed_by, rows_by_person
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import People, Track3D
from pipeline.core.joints import COCO_17, JointSet, other_side
from pipeline.geometry.camera import project

# Largest median distance of a body's joints from the expected ones, at the person's distance. Sides do not matter.
_REACH_M = 0.35
# Distance of two marks of one joint, as a share of the diagonal of the box around the body.
_ALIKE_SHARE = 0.06
_OTHER_SIDE = COCO_17.indices(tuple(map(other_side, COCO_17.names)))


def accept(
    people: People,
    found: Mapping[str, Detections],
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    joints: JointSet,
    min_score: float,
    lambda_t_hz: float,
) -> People:
    """Give people the bodies that were detected again, and locate their joints again there.

    A body belongs to the person who is expected nearest to it, who may stand in front of the one who was looked for;
    bodies far from all people are left. Its joints replace the joints of the observation; joints that were not read
    again stay, and so do those that both detections mark alike, of which the first one is more exact.

    ``people``: people with the joints of ``joints``, and their observations. ``found``: bodies of each camera, by name.
    ``min_score``: observations with a lower score are not used. ``lambda_t_hz``: rate at which the weight of
    observations falls with their distance in time; see ``TrackingParameters``.
    """
    bodies = gather(cameras, times, found)
    tracks, observations = list(people.tracks), list(people.observations)
    expected_m = [expected_body_m(track, joints, timebase.frame_rate_hz) for track in tracks]
    owner = _nearest_person(bodies, tracks, expected_m, cameras, timebase)
    for rows in rows_by_person(bodies, owner):
        number = int(owner[rows[0]])
        track, seen = tracks[number], observations[number]
        points_px, score = observed_by(track, bodies, rows, len(cameras), timebase, lambda_t_hz)
        is_new = (score > 0) & ~_agrees(points_px, seen.points_px)
        merged = replace(
            seen,
            points_px=read_only(np.where(is_new[..., None], points_px, seen.points_px)),
            score=read_only(np.where(is_new, score, seen.score)),
        )
        located, known = relocate((track, merged), np.asarray(is_new.any((1, 2))), cameras, timebase, min_score)
        tracks[number] = replace(located, track_id=track.track_id)
        observations[number] = replace(known, track_id=track.track_id)
    return people._replace(tracks=tuple(tracks), observations=tuple(observations))


def _nearest_person(
    bodies: Detections2D,
    tracks: Sequence[Track3D],
    expected_m: Sequence[Float[np.ndarray, "frames 17 3"]],
    cameras: Sequence[Camera],
    timebase: Timebase,
) -> Int[np.ndarray, " bodies"]:
    """Person whose expected joints are nearest to each body; ``UNASSIGNED`` if all are too far."""
    frame = np.rint((bodies.time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(np.int64)
    owner, nearest_m = np.full(len(frame), UNASSIGNED), np.full(len(frame), _REACH_M)
    for number, (track, places_m) in enumerate(zip(tracks, expected_m, strict=True)):
        lives = (frame >= track.start_frame) & (frame < track.start_frame + track.num_frames)
        for place, camera in enumerate(cameras):
            rows = np.flatnonzero(lives & (bodies.camera == place))
            away_m = _distances_m(camera, places_m[frame[rows] - track.start_frame], bodies.seen_px[rows])
            nearer = away_m < nearest_m[rows]
            owner[rows[nearer]], nearest_m[rows[nearer]] = number, away_m[nearer]
    return owner


def _agrees(
    again_px: Float[np.ndarray, "frames cameras joints 2"], seen_px: Float[np.ndarray, "frames cameras joints 2"]
) -> Bool[np.ndarray, "frames cameras joints"]:
    """Joints that two detections of a body mark alike, for its size."""
    known = np.isfinite(seen_px)
    size_px = np.where(known, seen_px, -np.inf).max(2) - np.where(known, seen_px, np.inf).min(2)
    limit_px = _ALIKE_SHARE * np.linalg.norm(np.maximum(size_px, 0.0), axis=-1, keepdims=True)
    return np.asarray(np.linalg.norm(again_px - seen_px, axis=-1) < limit_px)


def _distances_m(
    camera: Camera, xyz_m: Float[np.ndarray, "n 17 3"], points_px: Float[np.ndarray, "n joints 2"]
) -> Float[np.ndarray, " n"]:
    """Median distance of bodies' joints from expected ones, left or right, at their depth; infinite without any."""
    num_joints = len(COCO_17.names)
    px_per_m = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]) / camera.cam_from_world.apply(xyz_m)[..., 2]
    places_px = project(camera, xyz_m)
    apart_m = np.fmin(
        *(
            np.linalg.norm(places_px[:, order] - points_px[:, :num_joints], axis=-1) / px_per_m[:, order]
            for order in (list(range(num_joints)), _OTHER_SIDE)
        )
    )[:, BODY]
    is_known = np.isfinite(apart_m).any(-1)
    return np.where(is_known, np.nanmedian(np.where(is_known[:, None], apart_m, 0.0), axis=-1), np.inf)
