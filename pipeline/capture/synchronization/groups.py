"""Groups: motions of several cameras that are one person, and the pairs of motions that are compared."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.capture.synchronization.motions import BodyMotion
from pipeline.capture.synchronization.pair_curves import match_motions, pair_values
from pipeline.capture.synchronization.refine_clocks import Match
from pipeline.core.data.cameras import Camera


def match_people(
    cameras: Sequence[Camera],
    motions: Sequence[BodyMotion],
    offsets: Int[np.ndarray, " cameras"],
    pairs: Sequence[Match],
) -> list[Match]:
    """Match motions of all cameras at coarse offsets.

    The best matches join motions to people, as long as no camera sees a person twice at an instant. Then all motions of
    a person are compared with each other, also those whose cameras disagree more than ``pairs`` allows. Offsets are of
    each camera's own time, in grid steps; ``pairs`` of cameras are compared. Returns pairs of numbers of motions, in
    order.
    """
    candidates: list[tuple[float, int, int]] = []
    for first, second in pairs:
        left = [number for number, motion in enumerate(motions) if motion.camera == first]
        right = [number for number, motion in enumerate(motions) if motion.camera == second]
        lag = int(offsets[second] - offsets[first])
        value = _values(cameras, [motions[k] for k in left], [motions[k] for k in right], lag)
        matched = match_motions([motions[k] for k in left], [motions[k] for k in right], value, lag)
        candidates += [(float(value[a, b]), left[a], right[b]) for a, b in matched]
    members: dict[int, list[int]] = {number: [number] for number in range(len(motions))}
    group = list(range(len(motions)))
    for _, left_motion, right_motion in sorted(candidates, key=lambda match: (-match[0], match[1:])):
        a, b = group[left_motion], group[right_motion]
        if a != b and not _sees_twice(members[a], members[b], motions, offsets):
            for number in members[b]:
                group[number] = a
            members[a] += members.pop(b)
    wanted = frozenset(pairs)
    return sorted(
        (number, other)
        for own in members.values()
        for number in own
        for other in own
        if (motions[number].camera, motions[other].camera) in wanted
        and _shares(motions[number], motions[other], offsets)
    )


def _values(
    cameras: Sequence[Camera], left: Sequence[BodyMotion], right: Sequence[BodyMotion], lag: int
) -> Float[np.ndarray, "left right"]:
    if not left or not right:
        return np.zeros((len(left), len(right)))
    return pair_values(cameras, left, right, np.array([lag]))[..., 0]


def _span(motion: BodyMotion, offsets: Int[np.ndarray, " cameras"]) -> range:
    shift = int(offsets[motion.camera])
    return range(motion.first + shift, motion.stop + shift)


def _shares(first: BodyMotion, second: BodyMotion, offsets: Int[np.ndarray, " cameras"]) -> bool:
    a, b = _span(first, offsets), _span(second, offsets)
    return max(a.start, b.start) < min(a.stop, b.stop)


def _sees_twice(
    some: Sequence[int], others: Sequence[int], motions: Sequence[BodyMotion], offsets: Int[np.ndarray, " cameras"]
) -> bool:
    return any(
        motions[number].camera == motions[other].camera and _shares(motions[number], motions[other], offsets)
        for number in some
        for other in others
    )
