"""The most likely sides of arms and legs over time: a chain whose states are candidates of both limb pairs.

The cost of a path, as a negative logarithm of its probability, is the sum over the moments of

- the disagreement of the views;
- the labels against the detector's: each view counts with its score;
- the motion of each joint since the moment before, up to a limit, as the speed of limbs is unknown;
- arms against legs: shoulders that are turned by more than a quarter against the hips, knees that bend backwards.

The path of least cost is found by dynamic programming (Viterbi 1967).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.identity.limbs import LimbPair
from pipeline.association.identity.side_candidates import NUM_CANDIDATES, SCALE_M, LocatedLimbs, SeenRays

NUM_STATES = 2 * NUM_CANDIDATES
"""States of a limb pair: its candidates, and each of them with left and right exchanged in all views."""
_PER_RESIDUAL = 4.0
_PER_LABEL = 1.0
# Usual distance of a joint from its last place: an error, and the way that it goes in a second.
_ERROR_M, _SPEED_M_S = 0.04, 2.5
# Most that one joint's motion costs.
_MOST_OF_JOINT = 3.0
_PER_TWIST, _PER_KNEE = 3.0, 2.0
# Widths of hips and shoulders across the trunk that tell their direction, and bends of a knee that tell its side.
_WIDTH_M, _BEND_M = 0.15, 0.08
# Longest time over which places are remembered for a view that is alone.
_MEMORY_S = 0.5
# Growth of the distance at which a lone view counts by half.
_SPREAD_M_S = 1.5


def cost_of_way(
    moved_m: Float[np.ndarray, "*batch joints 3"], step_s: float | Float[np.ndarray, "*batch 1"]
) -> Float[np.ndarray, "*batch joints"]:
    """Cost of each joint's way in a time, up to a limit; 0 for a joint that is not known at both ends."""
    usual_m = _ERROR_M + _SPEED_M_S * step_s
    ratio = (moved_m**2).sum(-1) / (2 * usual_m**2)
    return np.asarray(np.nan_to_num(np.minimum(ratio, _MOST_OF_JOINT), nan=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class LimbStates:
    """States of a limb pair at some moments: frames, or stretches of frames whose sides are alike."""

    # Times of the first and the last frame of each moment that locate the limbs, and their joints then, left and right,
    # in the world in metres; NaN where fewer than two views see one
    first_s: Float[np.ndarray, " moments"]
    last_s: Float[np.ndarray, " moments"]
    first_m: Float[np.ndarray, "moments states 2 joints 3"]
    last_m: Float[np.ndarray, "moments states 2 joints 3"]
    cost: Float[np.ndarray, "moments states"]
    exchanged: Bool[np.ndarray, "moments states cameras"]  # Views whose labels are exchanged
    rays: SeenRays  # Rays of the left limb's joints, then of the right one's, at the first frame of each moment


class LimbMoments(NamedTuple):
    """A limb pair at some moments: doubtful frames, and stretches without doubts."""

    # First and last frame that locates the limbs; the moment's own if none does
    first: Int[np.ndarray, " moments"]
    last: Int[np.ndarray, " moments"]
    num_frames: Int[np.ndarray, " moments"]
    exchanged: Bool[np.ndarray, "moments candidates cameras"]
    is_candidate: Bool[np.ndarray, "moments candidates"]
    label_weight: Float[np.ndarray, "moments cameras"]  # Sum over the frames, 0 where a view sees nothing


def limb_states(
    moments: LimbMoments, first: LocatedLimbs, last: LocatedLimbs, rays: SeenRays, frame_rate_hz: float
) -> LimbStates:
    """States of a limb pair from the candidates at the first and at the last frame of each moment."""
    against = (moments.exchanged * moments.label_weight[:, None]).sum(-1)
    whole = moments.label_weight.sum(-1)[:, None]
    residual = np.where(moments.is_candidate, first.residual * moments.num_frames[:, None], np.inf)
    disagreement = _PER_RESIDUAL * residual
    first_m, last_m = (np.concatenate([at.xyz_m, at.xyz_m[:, :, ::-1]], axis=1) for at in (first, last))
    return LimbStates(
        moments.first / frame_rate_hz,
        moments.last / frame_rate_hz,
        first_m,
        last_m,
        np.concatenate([disagreement + _PER_LABEL * against, disagreement + _PER_LABEL * (whole - against)], axis=1),
        np.concatenate([moments.exchanged, ~moments.exchanged], axis=1) & (moments.label_weight > 0)[:, None],
        rays,
    )


def most_likely(
    pairs: Sequence[LimbPair], blocks: Iterable[Sequence[LimbStates]], num_frames: Int[np.ndarray, " moments"]
) -> tuple[Bool[np.ndarray, "moments cameras"], Bool[np.ndarray, "moments cameras"]]:
    """Find the exchanged views of arms and legs on the path of least cost.

    ``blocks`` are the states of both limb pairs at consecutive moments; each block is read once. ``num_frames`` are
    the frames of each moment; the costs of both limb pairs are of all frames.
    """
    limbs = [_Limbs(pair) for pair in pairs]
    total = np.zeros((NUM_STATES, NUM_STATES))
    came_from = np.empty((len(num_frames), 2, NUM_STATES, NUM_STATES), np.uint8)
    first = 0
    for states in blocks:
        for pair, of_pair in zip(limbs, states, strict=True):
            pair.enter(of_pair)
        last = first + len(states[0].cost)
        for moment, (previous, frames) in enumerate(zip(came_from[first:last], num_frames[first:last], strict=True)):
            (from_arms, of_arms), (from_legs, of_legs) = (pair.step(moment) for pair in limbs)
            # Both limb pairs change independently: first all arms for each state of the legs, then the legs.
            by_arms = total[:, None] + from_arms[:, :, None]
            best_arms = by_arms.argmin(0)
            by_legs = by_arms.min(0)[:, :, None] + from_legs[None]
            best_legs = by_legs.argmin(1)
            previous[:] = np.take_along_axis(best_arms, best_legs, axis=1), best_legs
            total = by_legs.min(1) + of_arms[:, None] + of_legs
            if any(pair.is_located[moment] for pair in limbs):
                total += frames * _cost_of_anatomy(*(pair.place_m for pair in limbs))
            total -= total.min()
            for pair in limbs:
                pair.remember(moment)
        first = last
    paths = np.empty((2, len(num_frames)), np.int64)
    state = np.array(np.unravel_index(total.argmin(), total.shape))
    for moment in reversed(range(len(num_frames))):
        paths[:, moment] = state
        state = came_from[moment, :, state[0], state[1]].astype(np.int64)
    return limbs[0].exchanged_on(paths[0]), limbs[1].exchanged_on(paths[1])


class _Limbs:
    """A limb pair on its way through the chain, with the places of its joints in each state."""

    def __init__(self, limbs: LimbPair) -> None:
        self._exchanged: list[Bool[np.ndarray, "_ states cameras"]] = []
        self._seen_s = -np.inf
        self.place_m = np.full((NUM_STATES, 2, len(limbs.left), 3), np.nan)

    def enter(self, states: LimbStates) -> None:
        """Go on to the states of the next block of moments."""
        self._states = states
        self._exchanged.append(states.exchanged.copy())
        # Moments at which two views see a joint
        self.is_located = np.isfinite(states.first_m[:, 0, ..., 0]).any((1, 2))

    def step(self, moment: int) -> tuple[Float[np.ndarray, "states states"], Float[np.ndarray, " states"]]:
        """Cost of each state after each state of the moment before, and of each state by itself.

        Where fewer than two views see the limbs the states stay as they are, and a lone view follows them.
        """
        since_s = float(self._states.first_s[moment]) - self._seen_s
        if not self.is_located[moment]:
            stays = np.where(np.eye(NUM_STATES, dtype=bool), 0.0, np.inf)
            return stays, self._follow(moment, since_s)
        here_m = self._states.first_m[moment]
        moved = np.zeros((NUM_STATES, NUM_STATES))
        if np.isfinite(self._seen_s):
            moved = cost_of_way(here_m[None] - self.place_m[:, None], since_s).sum((-1, -2))
        self.place_m = here_m
        return moved, self._states.cost[moment]

    def remember(self, moment: int) -> None:
        """Keep the places at the end of a moment."""
        if self.is_located[moment]:
            self.place_m, self._seen_s = self._states.last_m[moment], float(self._states.last_s[moment])

    def exchanged_on(self, path: np.ndarray) -> Bool[np.ndarray, "moments cameras"]:
        """Exchanged views in the states of a path."""
        return np.concatenate(self._exchanged)[np.arange(len(path)), path]

    def _follow(self, moment: int, since_s: float) -> Float[np.ndarray, " states"]:
        """Cost of a moment at which views are alone, with the better label of each for every state."""
        rays = self._states.rays
        if since_s > _MEMORY_S or not rays.weight[moment].any():
            return np.zeros(NUM_STATES)
        scale_m = SCALE_M + _SPREAD_M_S * since_s
        kept = self._against(moment, self.place_m, scale_m)
        other = self._against(moment, self.place_m[:, ::-1], scale_m) + _PER_LABEL * rays.weight[moment].mean(-1)
        self._exchanged[-1][moment] = (other < kept) & rays.weight[moment].any(-1)
        return np.asarray(np.minimum(kept, other).sum(-1))

    def _against(
        self, moment: int, place_m: Float[np.ndarray, "states 2 joints 3"], scale_m: float
    ) -> Float[np.ndarray, "states cameras"]:
        """Cost of places in each view by itself."""
        rays, xyz_m = self._states.rays, place_m.reshape(NUM_STATES, -1, 3)
        far = [_far_from(rays, moment, camera, xyz_m, scale_m**2) for camera in range(len(rays.center_m))]
        return _PER_RESIDUAL * np.stack(far, axis=-1)


def _far_from(
    rays: SeenRays, moment: int, camera: int, xyz_m: Float[np.ndarray, "states joints 3"], scale_m2: float
) -> Float[np.ndarray, " states"]:
    """Disagreement of one view with places of joints, in observations with score 1."""
    direction = rays.direction[moment, camera]
    from_center_m = xyz_m - rays.center_m[camera]
    off_m = from_center_m - (from_center_m * direction).sum(-1, keepdims=True) * direction
    off_m2 = (off_m**2).sum(-1)
    return np.asarray(np.nan_to_num(rays.weight[moment, camera] * off_m2 / (off_m2 + scale_m2), nan=0.0).sum(-1))


def _cost_of_anatomy(
    arms_m: Float[np.ndarray, "states 2 joints 3"], legs_m: Float[np.ndarray, "states 2 joints 3"]
) -> Float[np.ndarray, "states states"]:
    """Cost of arms with legs in all states: a twisted trunk, knees that bend backwards; 0 where joints are unknown."""
    shoulders_m, hips_m = arms_m[:, :, 0], legs_m[:, :, 0]
    up = _unit(shoulders_m.mean(1)[:, None] - hips_m.mean(1)[None])
    across_shoulders = _perpendicular((shoulders_m[:, 0] - shoulders_m[:, 1])[:, None], up)
    across_hips = _perpendicular((hips_m[:, 0] - hips_m[:, 1])[None], up)
    width_m = np.minimum(np.linalg.norm(across_shoulders, axis=-1), np.linalg.norm(across_hips, axis=-1))
    against = -(_unit(across_shoulders) * _unit(across_hips)).sum(-1)
    cost = _PER_TWIST * np.maximum(against, 0.0) * np.minimum(width_m / _WIDTH_M, 1.0)
    if legs_m.shape[2] > 2:
        forward = _unit(np.cross(across_hips, up))
        bend_m = legs_m[:, :, 1] - (legs_m[:, :, 0] + legs_m[:, :, 2]) / 2
        backwards = -(bend_m[None] * forward[:, :, None]).sum(-1) / _BEND_M
        cost = np.nan_to_num(cost, nan=0.0) + _PER_KNEE * np.nan_to_num(np.clip(backwards, 0.0, 1.0), nan=0.0).sum(-1)
    return np.asarray(np.nan_to_num(cost, nan=0.0))


def _unit(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9))


def _perpendicular(
    vector: Float[np.ndarray, "*#batch 3"], axis: Float[np.ndarray, "*#batch 3"]
) -> Float[np.ndarray, "*batch 3"]:
    return np.asarray(vector - (vector * axis).sum(-1, keepdims=True) * axis)
