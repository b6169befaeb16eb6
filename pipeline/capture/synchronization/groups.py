"""Groups: motions of several cameras that are one person, and the pairs of motions that are compared."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from pipeline.capture.synchronization.motions import BodyMotion
from pipeline.capture.synchronization.pair_curves import match_motions, pair_values
from pipeline.capture.synchronization.refine_clocks import Match
from pipeline.core.data.cameras import Camera


def match_pairs(
    cameras: Sequence[Camera],
    motions: Sequence[BodyMotion],
    offsets: Int[np.ndarray, " cameras"],
    pairs: Sequence[Match],
) -> list[list[tuple[float, int, int]]]:
    """Match the motions of each pair of cameras at coarse offsets, in grid steps of each camera's own time.

    Returns for each pair the agreement of motions that match, see ``pair_values``, and their numbers; the best first.
    """
    numbers: list[list[int]] = [[] for _ in cameras]
    for number, motion in enumerate(motions):
        numbers[motion.camera].append(number)
    matched = []
    for first, second in pairs:
        left, right, lag = numbers[first], numbers[second], int(offsets[second] - offsets[first])
        sides = [motions[k] for k in left], [motions[k] for k in right]
        value = pair_values(cameras, *sides, np.array([lag]))[..., 0]
        matches = match_motions(*sides, value, lag)
        matched.append([(float(value[a, b]), left[a], right[b]) for a, b in matches])
    return matched


def match_people(
    matched: Sequence[Sequence[tuple[float, int, int]]],
    motions: Sequence[BodyMotion],
    offsets: Int[np.ndarray, " cameras"],
    pairs: Sequence[Match],
) -> list[Match]:
    """Join matched motions to people, the best first, as long as no camera sees a person twice at an instant.

    Then all motions of a person are compared with each other, also those whose cameras disagree more than ``pairs``
    allows. ``matched`` is the result of ``match_pairs``. Returns pairs of numbers of motions, in order.
    """
    members: dict[int, list[int]] = {number: [number] for number in range(len(motions))}
    group = list(range(len(motions)))
    for _, left_motion, right_motion in sorted(itertools.chain(*matched), key=lambda match: (-match[0], match[1:])):
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
