"""One side for one limb: left and right of a person's arms and legs, over all views and time together.

Detectors call left right, mostly in bodies that lean, stand on their hands or turn somersaults, and each view by
itself. Where another labelling of the views agrees clearly better, or limbs seem to jump to the other side, a chain
over the frames decides (``chain``). Stretches without such doubts are one link of the chain, so that a session without
them costs next to nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation

from pipeline.association.identity.limbs import LimbPair, arms_and_legs
from pipeline.association.identity.merging import relocate
from pipeline.association.identity.side_candidates import SeenRays, SideCandidates, find_candidates, locate_limbs
from pipeline.association.identity.side_chain import LimbStates, cost_of_way, limb_states, most_likely
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import center_in_world, rays_in_world
from pipeline.geometry.track_assembly import Person
from pipeline.geometry.undistortion import undistort_px

# Agreement that another labelling must gain, in observations with score 1, to be a doubt.
_CLEARLY = 0.6
# Frames without two views are looked at near doubts only.
_NEAR_S = 0.25
# Limbs jump to the other side if their ways from there cost so much less.
_JUMP = 1.5
_LONGEST_STEP_S = 0.2
# Frames that are worked on at once, to bound the memory.
_BLOCK = 512


def decide_sides(
    person: Person, cameras: Sequence[Camera], timebase: Timebase, joints: JointSet, min_score: float
) -> Person:
    """Exchange the labels of the views that call left right, and locate the joints again there.

    Observations with a score below ``min_score`` are not used. Returns the person itself if nothing is exchanged, or
    the joints have no trunk.
    """
    pairs = arms_and_legs(joints)
    if pairs is None:
        return person
    track, seen = person
    candidates = tuple(_candidates(person, limbs, cameras, min_score) for limbs in pairs)
    doubtful = _doubtful(track, pairs, candidates, timebase)
    if not doubtful.any():
        return person
    starts = doubtful | np.append(False, doubtful[:-1])
    starts[0] = True
    borders = np.append(np.flatnonzero(starts), len(doubtful))
    arms, legs = (
        _states(person, limbs, candidate, doubtful, borders, cameras, timebase, min_score)
        for limbs, candidate in zip(pairs, candidates, strict=True)
    )
    points_px, score = large_arrays.copy(seen.points_px), large_arrays.copy(seen.score)
    changed = np.zeros(track.num_frames, bool)
    num_frames = np.diff(borders)
    for limbs, of_moments in zip(pairs, most_likely(arms, legs, num_frames), strict=True):
        exchanged = np.repeat(of_moments, num_frames, axis=0)
        for values in (points_px, score):
            here, view = np.nonzero(exchanged)
            values[here[:, None], view[:, None], limbs.both] = values[here[:, None], view[:, None], limbs.exchanged]
        changed |= exchanged.any(1)
    if not changed.any():
        return person
    exchanged_seen = replace(seen, points_px=read_only(points_px), score=read_only(score))
    return relocate((track, exchanged_seen), changed, cameras, timebase, min_score)


def _rays(
    person: Person, frames: slice | Int[np.ndarray, " frames"], cameras: Sequence[Camera], min_score: float
) -> SeenRays:
    _, seen = person
    points_px, score = seen.points_px[frames], seen.score[frames]
    direction = np.stack(
        [rays_in_world(camera, undistort_px(camera, points_px[:, k])) for k, camera in enumerate(cameras)], axis=1
    )
    is_seen = (score >= min_score) & (score > 0) & np.isfinite(direction).all(-1)
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    return SeenRays(np.where(is_seen[..., None], direction, 0.0), np.where(is_seen, score**2, 0.0), centers_m)


def _candidates(person: Person, limbs: LimbPair, cameras: Sequence[Camera], min_score: float) -> SideCandidates:
    blocks = [
        find_candidates(_rays(person, slice(start, start + _BLOCK), cameras, min_score), limbs)
        for start in range(0, person[0].num_frames, _BLOCK)
    ]
    return SideCandidates(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))


def _doubtful(
    track: Track3D, pairs: Sequence[LimbPair], candidates: Sequence[SideCandidates], timebase: Timebase
) -> Bool[np.ndarray, " frames"]:
    """Frames whose views agree clearly better with other labels, or in which limbs jump to the other side."""
    doubtful = np.zeros(track.num_frames, bool)
    for limbs, candidate in zip(pairs, candidates, strict=True):
        doubtful |= (candidate.cost[:, 0] < -_CLEARLY) | _jumps(track, limbs, timebase)
    reach = max(1, round(_NEAR_S * timebase.frame_rate_hz))
    near = binary_dilation(doubtful, np.ones(2 * reach + 1, bool))
    both = [joint for limbs in pairs for joint in limbs.both]
    return np.asarray(doubtful | (near & (track.views[:, both] < 2).any(1)))


def _jumps(track: Track3D, limbs: LimbPair, timebase: Timebase) -> Bool[np.ndarray, " frames"]:
    """Frames in which the limbs go on from the other side's places rather than from their own."""
    jumps = np.zeros(track.num_frames, bool)
    measured = (track.source[:, limbs.both] == Source.MEASURED).any(1)
    rows = np.flatnonzero(measured)
    if len(rows) < 2:
        return jumps
    before, after = rows[:-1], rows[1:]
    step_s = (after - before) / timebase.frame_rate_hz
    start_m = track.xyz_m[before]

    def way(from_joints: list[int]) -> Float[np.ndarray, " steps"]:
        moved_m = track.xyz_m[after][:, limbs.both] - start_m[:, from_joints]
        return np.asarray(cost_of_way(moved_m, step_s[:, None]).sum(-1))

    jumps[after] = (way(limbs.both) - way(limbs.exchanged) > _JUMP) & (step_s <= _LONGEST_STEP_S)
    return jumps


def _states(
    person: Person,
    limbs: LimbPair,
    candidates: SideCandidates,
    doubtful: Bool[np.ndarray, " frames"],
    borders: Int[np.ndarray, " borders"],
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> LimbStates:
    """States at all moments. In a stretch without doubts the labels stay as they are, or are exchanged in all views."""
    start = borders[:-1]
    is_stretch = ~doubtful[start]
    exchanged = np.where(is_stretch[:, None, None], False, candidates.exchanged[start])
    cost = np.where(is_stretch[:, None], np.inf, candidates.cost[start])
    cost[is_stretch, 0] = 0.0
    _, seen = person
    score = seen.score[:, :, limbs.both]
    weight = np.where(score >= min_score, score, 0.0) ** 2
    frames = _located_ends(np.asarray(((weight > 0).sum(-1) >= 2).sum(-1) >= 2), borders)
    rays = [_rays(person, of_moments, cameras, min_score) for of_moments in frames]
    first, last = (locate_limbs(of_moments, limbs, exchanged) for of_moments in rays)
    first_s, last_s = (of_moments / timebase.frame_rate_hz for of_moments in frames)
    return limb_states(
        (first_s, last_s),
        (first.xyz_m, last.xyz_m),
        np.where(np.isfinite(cost), first.residual * np.diff(borders)[:, None], np.inf),
        exchanged,
        rays[0].select_joints(limbs.both),
        np.add.reduceat(weight.mean(-1), start),
    )


def _located_ends(
    is_located: Bool[np.ndarray, " frames"], borders: Int[np.ndarray, " borders"]
) -> tuple[Int[np.ndarray, " moments"], Int[np.ndarray, " moments"]]:
    """First and last frame of each moment that locates the limbs; its ends if none does."""
    start, stop = borders[:-1], borders[1:]
    rows = np.arange(len(is_located))
    first = np.minimum.reduceat(np.where(is_located, rows, len(rows)), start)
    last = np.maximum.reduceat(np.where(is_located, rows, -1), start)
    return np.where(first < len(rows), first, start), np.where(last >= 0, last, stop - 1)
