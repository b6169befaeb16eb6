"""Phantoms and spurious tracks: tracks without a body of their own.

A person who has left, or who is in no picture, may be followed on by limbs that belong to neighbours. Each of these
observations lies where a neighbour's own joint is in this picture, while a person's own limbs rarely do, even in a hug.

Bodies of different cameras that do not belong together agree by chance now and then. How often follows from geometry
(a-contrario detection, Desolneux, Moisan and Morel 2000): a body of a second camera lies at a ray by chance with the
probability that the band around its epipolar line covers, times the number of bodies in the picture; a body of a third
camera with the probability of the disc around a point. Moments count once a fifth of a second, because wrong
detections last, and only where there are pictures: chance has no occasion in a pause.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.ndimage import uniform_filter1d

from pipeline.association.identity.merging import runs
from pipeline.core.data.arrays import mean_known
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, PersonLoss, Source, Track3D
from pipeline.core.joints import JointSet, other_side
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person, record_life

# Time over which observations are judged together, and shortest time of a phantom.
_WINDOW_S, _SHORTEST_S = 0.5, 0.2
# Share of measured joints below which a person may be a phantom, and share of observations that belong to others.
_MAX_COVERAGE, _MIN_FOREIGN = 0.5, 0.5
# Distance of an observation from another person's joint, at that person, within which it shows the joint.
_REACH_M = 0.08
# Distance between the middles of two people within which limbs may be taken for the other's.
_NEAR_M = 1.5


def end_phantoms(
    persons: Sequence[Person], cameras: Sequence[Camera], joints: JointSet, timebase: Timebase, min_score: float
) -> list[tuple[Person | None, list[PersonLoss]]]:
    """Take the limbs of others from people who have hardly any other observations.

    Observations with a score below ``min_score`` are not used.

    Returns each person without the frames of phantoms, ``None`` if too few frames are left; and the phantoms of each,
    with the number of the track.
    """
    size = 2 * round(_WINDOW_S * timebase.frame_rate_hz / 2) + 1
    support = [
        _mean_around(np.concatenate([_is_seen(seen, rows, min_score).sum((1, 2)) for rows in blocks]), size)
        for track, seen in persons
        for blocks in [large_arrays.blocks(track.num_frames)]
    ]
    ended: list[tuple[Person | None, list[PersonLoss]]] = []
    for number, person in enumerate(persons):
        track, _ = person
        coverage = _mean_around((track.source == Source.MEASURED).mean(1), size)
        rows = np.flatnonzero((coverage < _MAX_COVERAGE) & (support[number] > 0))
        foreign = np.zeros(track.num_frames)
        for block in large_arrays.blocks(len(rows)):
            setting = persons, support, cameras, joints, min_score
            foreign[rows[block]] = _num_foreign(number, rows[block], *setting)
        is_phantom = np.zeros(track.num_frames, bool)
        is_phantom[rows] = (_mean_around(foreign, size) >= _MIN_FOREIGN * support[number])[rows]
        shortest = _SHORTEST_S * timebase.frame_rate_hz
        parts = [part for part in runs(is_phantom) if part.stop - part.start >= shortest]
        if not parts:
            ended.append((person, []))
            continue
        own = _without(person, parts, cameras, timebase, min_score)
        ended.append((own, [_phantom(track, part) for part in parts]))
    return ended


def _num_foreign(
    number: int,
    rows: Int[np.ndarray, " rows"],
    persons: Sequence[Person],
    support: Sequence[Float[np.ndarray, " frames"]],
    cameras: Sequence[Camera],
    joints: JointSet,
    min_score: float,
) -> Int[np.ndarray, " rows"]:
    """Number of a person's observations in some rows that show the same joint, of either side, of another person.

    Only people with more observations at that time count: a phantom explains no person.
    """
    track, seen = persons[number]
    is_foreign = np.zeros((len(rows), *seen.score.shape[1:]), bool)
    swapped = joints.indices(tuple(map(other_side, joints.names)))
    for other, (neighbour, _) in enumerate(persons):
        their_rows = rows + track.start_frame - neighbour.start_frame
        inside = np.flatnonzero((their_rows >= 0) & (their_rows < neighbour.num_frames))
        inside = inside[support[other][their_rows[inside]] > support[number][rows[inside]]]
        apart_m = mean_known(neighbour.xyz_m[their_rows[inside]], 1) - mean_known(track.xyz_m[rows[inside]], 1)
        inside = inside[np.linalg.norm(apart_m, axis=-1) <= _NEAR_M]
        if other == number or not len(inside):
            continue
        xyz_m = neighbour.xyz_m[their_rows[inside]]
        for k, camera in enumerate(cameras):
            depth_m = camera.cam_from_world.apply(xyz_m)[..., 2]
            focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
            reach_px = np.where(depth_m > 0, _REACH_M * focal_px / depth_m, 0.0)
            joint_px, points_px = project(camera, xyz_m), seen.points_px[rows[inside], k]
            for of_joint in (slice(None), swapped):
                apart_px = np.linalg.norm(joint_px[:, of_joint] - points_px, axis=-1)
                is_foreign[inside, k] |= apart_px < reach_px[:, of_joint]
    return np.asarray((is_foreign & _is_seen(seen, rows, min_score)).sum((1, 2)))


def _is_seen(
    seen: Observations, rows: slice | Int[np.ndarray, " rows"], min_score: float
) -> Bool[np.ndarray, "rows cameras joints"]:
    return (seen.score[rows] >= min_score) & np.isfinite(seen.points_px[rows, ..., 0])


def _without(
    person: Person, parts: Sequence[slice], cameras: Sequence[Camera], timebase: Timebase, min_score: float
) -> Person | None:
    track, seen = person
    xyz_m = track.copy_measured()
    points_px, score = large_arrays.copy(seen.points_px), large_arrays.copy(seen.score)
    for part in parts:
        xyz_m[part], points_px[part], score[part] = np.nan, np.nan, 0.0
    detection = seen.detection if len(seen.detection) else None
    return record_life(cameras, timebase, track.start_frame, xyz_m, points_px, score, min_score, detection)


def _phantom(track: Track3D, part: slice) -> PersonLoss:
    known_m = [xyz_m[np.isfinite(xyz_m).all(-1)] for xyz_m in (track.xyz_m[part], track.xyz_m)]
    place_m = (known_m[0] if len(known_m[0]) else known_m[1]).mean(0)
    frames = track.start_frame + part.start, track.start_frame + part.stop
    return PersonLoss("phantom", track.track_id, *frames, tuple(place_m.round(3).tolist()))


def _mean_around(values: Shaped[np.ndarray, " frames"], size: int) -> Float[np.ndarray, " frames"]:
    """Mean of the values in a window around each frame; frames outside the track count as 0."""
    return np.asarray(uniform_filter1d(values.astype(float), size, mode="constant"))


# Expected number of coincidences in a session below which a track is a person.
_MAX_FALSE_ALARMS = 0.1
_MOMENT_S = 0.2
_MIN_JOINTS = 3
# Radius in mean reprojection errors, and least error as a share of the image's shorter side.
_RADIUS, _LEAST_ERROR = 2.0, 0.005


def mean_bodies(observations: Iterable[Observations], num_recorded: int) -> float:
    """Mean number of bodies in a picture, at least 1; ``num_recorded`` frames have pictures."""
    bodies = [_has_body(seen) for seen in observations]
    return float(max(1.0, sum(of_person.sum() / of_person.shape[1] for of_person in bodies) / num_recorded))


def is_spurious(
    person: Person, cameras: Sequence[Camera], timebase: Timebase, num_bodies: float, num_recorded: int
) -> bool:
    """True if a track may be chance; never if it lasts for half of the session, which may be too short to tell.

    ``num_bodies`` is the mean number of bodies in a picture; ``num_recorded`` output frames have pictures.
    """
    if 2 * person[0].num_frames >= num_recorded:
        return False
    return log_false_alarms(person, cameras, timebase, num_bodies, num_recorded) > math.log(_MAX_FALSE_ALARMS)


def log_false_alarms(
    person: Person, cameras: Sequence[Camera], timebase: Timebase, num_bodies: float, num_recorded: int
) -> float:
    """Logarithm of the expected number of coincidences that are as good as a track; see ``is_spurious``."""
    track, seen = person
    num_views = _has_body(seen).sum(-1)
    size_px = np.median([camera.size_px for camera in cameras], axis=0)
    error_px = mean_known(track.error_px, -1)
    radius_px = _RADIUS * np.maximum(error_px, _LEAST_ERROR * size_px.min())
    at_line = np.minimum(1.0, num_bodies * 2 * radius_px / size_px.min())
    at_point = np.minimum(1.0, num_bodies * np.pi * radius_px**2 / size_px.prod())
    log_chance = np.log(at_line) + (num_views - 2) * np.log(at_point)
    agreeing = (num_views >= 2) & np.isfinite(error_px)
    num_pairs = max(1.0, len(cameras) * (len(cameras) - 1) / 2)
    frames_a_moment = max(1.0, _MOMENT_S * timebase.frame_rate_hz)
    num_moments = max(1.0, num_recorded / frames_a_moment)
    return float(np.log(num_moments * num_pairs * num_bodies**2) + log_chance[agreeing].sum() / frames_a_moment)


def _has_body(seen: Observations) -> Bool[np.ndarray, "frames cameras"]:
    return np.asarray((seen.score > 0).sum(-1) >= _MIN_JOINTS)
