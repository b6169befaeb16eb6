"""One side for one limb: left and right of a person's arms and legs, over all views and time together.

Detectors call left right, mostly in bodies that lean, stand on their hands or turn somersaults, and each view by
itself. Where another labelling of the views agrees clearly better, or limbs seem to jump to the other side, a chain
over the frames decides (``chain``). Stretches without such doubts are one link of the chain, so that a session without
them costs next to nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int
from scipy.ndimage import binary_dilation

from pipeline.association.identity.limbs import LimbPair, arms_and_legs
from pipeline.association.identity.merging import relocate
from pipeline.association.identity.side_candidates import SeenRays, SideCandidates, find_candidates, locate_limbs
from pipeline.association.identity.side_chain import LimbMoments, LimbStates, cost_of_way, limb_states, most_likely
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
    candidates = _candidates(person, pairs, cameras, min_score)
    doubtful = _doubtful(track, pairs, candidates, timebase)
    if not doubtful.any():
        return person
    starts = doubtful | np.append(False, doubtful[:-1])
    starts[0] = True
    borders = np.append(np.flatnonzero(starts), len(doubtful))
    num_frames = np.diff(borders)
    moments = [_moments(of_pair, doubtful, borders) for of_pair in candidates]
    blocks = (
        [
            _states(person, limbs, LimbMoments(*(values[block] for values in of_pair)), cameras, timebase, min_score)
            for limbs, of_pair in zip(pairs, moments, strict=True)
        ]
        for block in large_arrays.blocks(len(num_frames))
    )
    points_px, score = large_arrays.copy(seen.points_px), large_arrays.copy(seen.score)
    changed = np.zeros(track.num_frames, bool)
    for limbs, of_moments in zip(pairs, most_likely(pairs, blocks, num_frames), strict=True):
        exchanged = np.repeat(of_moments, num_frames, axis=0)
        for view, frames in enumerate(exchanged.T):
            for values in (points_px, score):
                of_view = values[frames, view]
                of_view[:, limbs.both] = of_view[:, limbs.exchanged]
                values[frames, view] = of_view
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


def _candidates(
    person: Person, pairs: Sequence[LimbPair], cameras: Sequence[Camera], min_score: float
) -> list[SideCandidates]:
    """Candidates of each limb pair."""
    in_blocks = (_rays(person, block, cameras, min_score) for block in large_arrays.blocks(person[0].num_frames))
    by_block = [[find_candidates(rays, limbs) for limbs in pairs] for rays in in_blocks]
    return [
        SideCandidates(*(np.concatenate(parts) for parts in zip(*of_pair, strict=True)))
        for of_pair in zip(*by_block, strict=True)
    ]


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
    measured = np.flatnonzero((track.source[:, limbs.both] == Source.MEASURED).any(1))
    for block in large_arrays.blocks(len(measured) - 1):
        rows = measured[block.start : block.stop + 1]
        step_s, xyz_m = np.diff(rows) / timebase.frame_rate_hz, track.xyz_m[rows]
        kept, exchanged = (
            cost_of_way(xyz_m[1:, limbs.both] - xyz_m[:-1, joints], step_s[:, None]).sum(-1)
            for joints in (limbs.both, limbs.exchanged)
        )
        jumps[rows[1:]] = (kept - exchanged > _JUMP) & (step_s <= _LONGEST_STEP_S)
    return jumps


def _moments(
    candidates: SideCandidates, doubtful: Bool[np.ndarray, " frames"], borders: Int[np.ndarray, " borders"]
) -> LimbMoments:
    """Moments between borders. In a stretch the labels stay as they are, or are exchanged in all views."""
    start = borders[:-1]
    is_stretch = ~doubtful[start]
    exchanged, is_candidate = candidates.exchanged[start], np.isfinite(candidates.cost[start])
    exchanged[is_stretch] = False
    is_candidate[is_stretch] = np.arange(is_candidate.shape[1]) == 0
    return LimbMoments(
        *_located_ends(candidates.is_located, borders),
        np.diff(borders),
        exchanged,
        is_candidate,
        np.add.reduceat(candidates.label_weight, start),
    )


def _states(
    person: Person,
    limbs: LimbPair,
    moments: LimbMoments,
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> LimbStates:
    rays = _rays(person, moments.first, cameras, min_score)
    first = locate_limbs(rays, limbs, moments.exchanged)
    last_m, rows = first.xyz_m.copy(), moments.last != moments.first
    later = _rays(person, moments.last[rows], cameras, min_score)
    last_m[rows] = locate_limbs(later, limbs, moments.exchanged[rows]).xyz_m
    last = first._replace(xyz_m=last_m)
    return limb_states(moments, first, last, rays.select_joints(limbs.both), timebase.frame_rate_hz)


def _located_ends(
    is_located: Bool[np.ndarray, " frames"], borders: Int[np.ndarray, " borders"]
) -> tuple[Int[np.ndarray, " moments"], Int[np.ndarray, " moments"]]:
    """First and last frame of each moment that locates the limbs; its ends if none does."""
    start, stop = borders[:-1], borders[1:]
    rows = np.arange(len(is_located))
    first = np.minimum.reduceat(np.where(is_located, rows, len(rows)), start)
    last = np.maximum.reduceat(np.where(is_located, rows, -1), start)
    return np.where(first < len(rows), first, start), np.where(last >= 0, last, stop - 1)
