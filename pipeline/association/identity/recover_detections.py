"""Recovery of detections without a person after association.

Where fewer than two cameras see a person for a while, the person is expected on the way from the last position to the
next one. A body without a person that is at this place in a picture is the person's.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.association.identity.merging import relocate
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Leftovers
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person

# Largest mean distance of a body's joints from the expected ones, at the person's distance.
_REACH_M = 0.25
MIN_JOINTS = 4
"""Joints that must be compared."""
_ENOUGH_CAMERAS = 2
# Longest time without a joint over which its position is expected on a straight line.
_LONGEST_GAP_S = 2.0
_FAR_M = 1e6


def recover_detections(
    people: Sequence[Person], left: Leftovers, cameras: Sequence[Camera], timebase: Timebase, min_score: float
) -> list[Person]:
    """Give people the bodies that are where they are expected, and locate their joints there.

    ``left`` are bodies without a person. Observations with a score below ``min_score`` are not used.
    """
    distance_m = [_distances_m(person, left, cameras, timebase) for person in people]
    claimed = _assign(np.array(distance_m).reshape(len(people), len(left.frame)), left)
    return [
        _with_bodies(person, left, np.flatnonzero(claimed == number), cameras, timebase, min_score)
        for number, person in enumerate(people)
    ]


def _distances_m(
    person: Person, left: Leftovers, cameras: Sequence[Camera], timebase: Timebase
) -> Float[np.ndarray, " bodies"]:
    """Distance of each body from the person, infinite where it can't be the person's."""
    track, seen = person
    distance_m = np.full(len(left.frame), np.inf)
    row = left.frame - track.start_frame
    inside = np.flatnonzero((row >= 0) & (row < track.num_frames))
    sees = np.asarray((seen.score > 0).sum(-1) >= MIN_JOINTS)
    missed = (sees.sum(-1) < _ENOUGH_CAMERAS)[row[inside]] & ~sees[row[inside], left.camera[inside]]
    inside = inside[missed]
    expected_m = _expected_m(track.xyz_m, row[inside], round(_LONGEST_GAP_S * timebase.frame_rate_hz))
    for number in np.unique(left.camera[inside]).tolist():
        of_camera = left.camera[inside] == number
        bodies = inside[of_camera]
        mean_m = mean_distance_m(cameras[number], expected_m[of_camera], left.points_px[bodies])
        distance_m[bodies] = np.where(mean_m <= _REACH_M, mean_m, np.inf)
    return distance_m


def mean_distance_m(
    camera: Camera, xyz_m: Float[np.ndarray, "n joints 3"], points_px: Float[np.ndarray, "n joints 2"]
) -> Float[np.ndarray, " n"]:
    """Mean distance of a body's joints from a person's, at the person's distance; NaN if too few can be compared."""
    depth_m = camera.cam_from_world.apply(xyz_m)[..., 2]
    apart_px = np.linalg.norm(project(camera, xyz_m) - points_px, axis=-1)
    apart_m = apart_px * depth_m / np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    known = np.isfinite(apart_m) & (depth_m > 0)
    count = known.sum(-1)
    return np.where(count >= MIN_JOINTS, np.where(known, apart_m, 0.0).sum(-1) / np.maximum(count, 1), np.nan)


def _expected_m(
    xyz_m: Float[np.ndarray, "frames joints 3"], rows: Int[np.ndarray, " n"], longest_gap: int
) -> Float[np.ndarray, "n joints 3"]:
    """Positions of joints at some rows, on straight lines over gaps; NaN outside and in long gaps."""
    expected_m = np.full((len(rows), *xyz_m.shape[1:]), np.nan)
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(np.isfinite(xyz_m[:, joint, 0]))
        if not len(known):
            continue
        after = np.minimum(np.searchsorted(known, rows), len(known) - 1)
        before = np.maximum(np.searchsorted(known, rows, side="right") - 1, 0)
        bridged = known[after] - known[before] <= longest_gap
        bridged &= (known[before] <= rows) & (rows <= known[after])
        for axis in range(xyz_m.shape[2]):
            line_m = np.interp(rows, known, xyz_m[known, joint, axis])
            expected_m[:, joint, axis] = np.where(bridged, line_m, np.nan)
    return expected_m


def _assign(distance_m: Float[np.ndarray, "people bodies"], left: Leftovers) -> Int[np.ndarray, " bodies"]:
    """Person of each body, -1 for none; at most one body of a picture for each person."""
    person = np.full(distance_m.shape[1], -1)
    wanted = np.flatnonzero(np.isfinite(distance_m).any(0))
    picture = np.lexsort((left.camera[wanted], left.frame[wanted]))
    wanted = wanted[picture]
    changes = (np.diff(left.frame[wanted]) != 0) | (np.diff(left.camera[wanted]) != 0)
    for bodies in np.split(wanted, np.flatnonzero(changes) + 1):
        cost_m = distance_m[:, bodies]
        rows, columns = linear_sum_assignment(np.where(np.isfinite(cost_m), cost_m, _FAR_M))
        near = np.isfinite(cost_m[rows, columns])
        person[bodies[columns[near]]] = rows[near]
    return person


def _with_bodies(
    person: Person,
    left: Leftovers,
    bodies: Int[np.ndarray, " n"],
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> Person:
    """Person with more bodies; the person itself if there are none."""
    if not len(bodies):
        return person
    track, seen = person
    rows = left.frame[bodies] - track.start_frame
    points_px, score = large_arrays.copy(seen.points_px), large_arrays.copy(seen.score)
    points_px[rows, left.camera[bodies]] = left.points_px[bodies]
    score[rows, left.camera[bodies]] = left.score[bodies]
    changed = np.zeros(track.num_frames, bool)
    changed[rows] = True
    return relocate((track, replace(seen, points_px=points_px, score=score)), changed, cameras, timebase, min_score)
