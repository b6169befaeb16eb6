"""Remaining error of declared times: by how much cameras that should be synchronised are not."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.capture.synchronization.groups import match_pairs, match_people
from pipeline.capture.synchronization.motions import STEP_S, BodyMotion, find_motions
from pipeline.capture.synchronization.refine_clocks import refine_clocks
from pipeline.capture.synchronization.synchronize import NOTHING_KNOWN, camera_clocks, shows_drift, synchronize
from pipeline.core.data.cameras import Camera, CameraClock, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet

HALF_A_FRAME = 0.5
"""Error in frames above which a camera is wrong."""
# Partners of each camera beside the tree of strongest pairs.
_PARTNERS = 3
MAX_PAIRS = _PARTNERS + 1
"""Largest number of pairs a camera that are compared."""
# Instants of all matches, and steps, that tell whether declared times are right.
_INSTANTS, _STEPS = 8000, 3
# Share of the joints in motion that agree at the declared times: 0.6 to 0.8 if they are right, 0.45 if a camera is late
# by a frame and a half.
_AGREES = 0.5


@dataclass(frozen=True, slots=True)
class RemainingOffset:
    """Error of a camera's declared times."""

    camera: str  # Name of the camera
    # Time by which the camera's frames were taken later than declared, compared with the cameras that agree
    late_s: float
    sigma_s: float  # Standard deviation
    period_s: float  # Period of the camera's frames

    @property
    def frames(self) -> float:
        """Error in periods of the camera's frames."""
        return self.late_s / self.period_s

    @property
    def is_wrong(self) -> bool:
        """True if the declared times are wrong by more than half a frame, and the measurement can tell."""
        return abs(self.frames) > HALF_A_FRAME and abs(self.late_s) > 3.0 * self.sigma_s


def remaining_offsets(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections], joints: JointSet
) -> tuple[RemainingOffset, ...]:
    """Measure the error of declared times from people in motion, for checks before or after a take.

    The pairs of cameras are few, so that the cost grows with the cameras. Clocks are refined from the declared times
    first. Only cameras whose people do not agree there are compared at other lags.

    ``times``, ``detections``: declared frame times and bodies by camera name, such as from
    ``pipeline.run.engine.local.detect_people`` or of ``KeypointSession``. A few seconds in which people move are
    enough. Returns one for each camera, in their order; empty if the clocks can't be measured with certainty, as when
    no one moves.

    ``[offset for offset in remaining_offsets(...) if offset.is_wrong]`` are the cameras to warn of.
    """
    motions = find_motions(cameras, times, detections, joints)
    if len({motion.camera for motion in motions}) < len(cameras):
        return ()
    pairs = strongest_pairs(motions, len(cameras))
    matched = match_pairs(cameras, motions, np.zeros(len(cameras), int), pairs)
    offsets = _offsets(_refined(cameras, times, motions, matched, pairs), times)
    shares = _shares(len(cameras), motions, matched, pairs)
    agreeing = {
        offset.camera: 0.0
        for offset, share in zip(offsets, shares, strict=True)
        if share >= _AGREES and abs(offset.late_s) + 3.0 * offset.sigma_s <= HALF_A_FRAME * offset.period_s
    }
    if len(agreeing) == len(cameras):
        return offsets
    near_s = agreeing if len(agreeing) > 2 else NOTHING_KNOWN
    synchronization = synchronize(
        cameras, times, detections, joints, dict.fromkeys(times, 0.0), near_s=near_s, pairs=pairs
    )
    return _offsets(synchronization.clocks, times) if synchronization.is_certain else ()


def strongest_pairs(motions: Sequence[BodyMotion], num_cameras: int) -> list[tuple[int, int]]:
    """Pairs of cameras that see most motion at the same seconds: a tree (Kruskal 1956), and partners of each camera."""
    num_steps = round(1.0 / STEP_S)
    second = np.array([step // num_steps for motion in motions for step in range(motion.first, motion.stop)], int)
    camera = np.repeat([motion.camera for motion in motions], [len(motion.points) for motion in motions]).astype(int)
    moving = [np.minimum(1.0, np.nan_to_num(motion.path)).sum(1) for motion in motions]
    seconds, column = np.unique(second, return_inverse=True)
    seen = np.zeros((num_cameras, len(seconds)))
    np.add.at(seen, (camera, column), np.concatenate(moving) if moving else [])
    shared = np.array([np.minimum(own, seen).sum(1) for own in seen])
    group, pairs = np.arange(num_cameras), set()
    for first, other in sorted(itertools.combinations(range(num_cameras), 2), key=lambda pair: -shared[pair]):
        if group[first] != group[other]:
            group[group == group[other]] = group[first]
            pairs.add((first, other))
    np.fill_diagonal(shared, -1.0)
    for first, partners in enumerate(np.argsort(-shared, axis=1, kind="stable")[:, : min(_PARTNERS, num_cameras - 1)]):
        pairs |= {(min(first, other), max(first, other)) for other in partners.tolist()}
    return sorted(pairs)


def _refined(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    motions: Sequence[BodyMotion],
    matched: Sequence[Sequence[tuple[float, int, int]]],
    pairs: Sequence[tuple[int, int]],
) -> Sequence[CameraClock]:
    """Clocks near the declared times, from the motions that match there."""
    start = np.zeros(len(cameras), int)
    matches = match_people(matched, motions, start, pairs)
    fine = refine_clocks(
        cameras, motions, matches, start.astype(float), shows_drift(motions), max_instants=_INSTANTS, max_steps=_STEPS
    )
    return camera_clocks(cameras, times, fine)


def _shares(
    num_cameras: int,
    motions: Sequence[BodyMotion],
    matched: Sequence[Sequence[tuple[float, int, int]]],
    pairs: Sequence[tuple[int, int]],
) -> Float[np.ndarray, " cameras"]:
    """Agreement of each camera with its partners at the declared times, as a share of the joints in motion."""
    gain, weight, moving = np.zeros((3, num_cameras))
    for motion in motions:
        moving[motion.camera] += np.nan_to_num(np.minimum(1.0, motion.path)).sum()
    for pair, matches in zip(pairs, matched, strict=True):
        gain[list(pair)] += sum(value for value, _, _ in matches)
        weight[list(pair)] += moving[list(pair)].min()
    return gain / np.maximum(weight, 1e-9)


def _offsets(clocks: Sequence[CameraClock], times: Mapping[str, FrameTimes]) -> tuple[RemainingOffset, ...]:
    """Errors of declared times in the middle of each camera's frames."""
    late_s = []
    for clock in clocks:
        middle_s = times[clock.camera].time_s[[0, -1]].mean(keepdims=True)
        late_s.append(float(clock.session_s(middle_s)[0] - middle_s[0]))
    periods_s = [float(np.median(np.diff(times[clock.camera].time_s))) for clock in clocks]
    agreed_s = _agreed_s(np.array(late_s), np.array(periods_s))
    return tuple(
        RemainingOffset(clock.camera, value_s - agreed_s, clock.sigma_s, period_s)
        for clock, value_s, period_s in zip(clocks, late_s, periods_s, strict=True)
    )


def _agreed_s(late_s: Float[np.ndarray, " cameras"], periods_s: Float[np.ndarray, " cameras"]) -> float:
    """Lateness of the camera from which the fewest others differ by more than half a frame; the first of several.

    A mean of two cameras would be a quarter of a frame from each, where they are half a frame apart.
    """
    apart = np.abs(late_s[:, None] - late_s) / periods_s
    order = np.lexsort((apart.sum(1).round(6), (apart > HALF_A_FRAME).sum(1)))
    near = apart[order[0]] <= HALF_A_FRAME
    return float(np.median(late_s[near])) if near.sum() > 2 else float(late_s[order[0]])
