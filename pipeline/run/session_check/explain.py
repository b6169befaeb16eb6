"""Explanations of cameras that disagree about people: exchanged, turned or mirrored.

A hypothesis says how the detections of some cameras would fit. It is accepted if it takes away most of the disagreement
of these cameras.
"""

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np
from scipy.special import bdtrc

from pipeline.capture.names import natural_key
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import Severity
from pipeline.core.joints import JointSet, other_side
from pipeline.geometry.epipolar import fundamental_matrices
from pipeline.run.session_check.sightings import (
    FAR,
    SURE,
    PeopleAgreement,
    Points,
    SimultaneousPeople,
    compare,
    ideal_px,
)

Move = Literal["as is", "90", "180", "270", "mirrored", "exchanged"]
MOVES: tuple[Move, ...] = ("90", "180", "270", "mirrored")
"""Moves of a picture; keypoint files may also have x and y exchanged."""

DOUBTFUL = 0.45
"""Disagreement of a camera from which on it needs an explanation: the mean distance is 4.5 % of a person's extent.

Cameras of good sessions have 0.15 to 0.3, with a duplicate body or a missed person now and then; cameras of wrong
calibrations have 0.6 to 1.
"""
# Share of the disagreement that an explanation may leave. A turned picture leaves more than the others: networks find
# fewer joints in it.
_LEFT = 0.7
# Up to so many cameras all orders are tried (720), beyond it exchanges of two and orders of names.
_MAX_ORDERED = 6
# Share of the pairs of bodies that agree exactly from which on the people may differ, and not the cameras. Cameras of
# right calibrations that see different people have at least 0.37; cameras that were turned by 3 degrees have 0.03 in
# the median, and 0.25 with nine tenths of the others.
_MAX_EXACT = 1 / 3
# With fewer pairs of bodies chance decides.
_MIN_COMPARED = 6
MIN_INSTANTS = 3
"""Independent instants below which chance decides."""
# Probability of as many near pairs by chance below which some of the people are the same.
_MAX_CHANCE = 0.01
# Cameras that are tried in exchanges, the most doubtful ones.
_MAX_EXCHANGED = 8


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """How detections would fit."""

    places: tuple[int, ...]  # Number of the camera whose calibration fits the detections of each camera
    moves: tuple[Move, ...]  # How the points of each camera would have to be moved

    @property
    def changed(self) -> tuple[int, ...]:
        """Cameras whose detections are moved or fit another camera's calibration."""
        pairs = enumerate(zip(self.places, self.moves, strict=True))
        return tuple(number for number, (place, move) in pairs if place != number or move != "as is")


def as_given(num_cameras: int) -> Hypothesis:
    """Hypothesis that everything is as it is given."""
    as_is: Move = "as is"
    return Hypothesis(tuple(range(num_cameras)), (as_is,) * num_cameras)


class PairDisagreement:
    """Disagreement of pairs of cameras under hypotheses; each is computed once."""

    def __init__(self, cameras: Sequence[Camera], sightings: SimultaneousPeople) -> None:
        self.num_cameras = len(cameras)
        self.names = [camera.name for camera in cameras]
        self._num_independent = sightings.num_independent
        fundamentals = fundamental_matrices(cameras)

        @cache
        def ideal(camera: int, place: int, move: Move) -> list[Points | None]:
            moved = sightings
            if move != "as is":
                size_px = cameras[camera].size_px
                moving = partial(move_points, move=move, size_px=size_px, joints=sightings.joints)
                moved = sightings.moved(camera, moving)
            return ideal_px(cameras[place], moved.points_px[camera])

        @cache
        def pair(left: tuple[int, int, Move], right: tuple[int, int, Move]) -> PeopleAgreement:
            return compare(fundamentals[left[1], right[1]], ideal(*left), ideal(*right))

        self._pair: Callable[[tuple[int, int, Move], tuple[int, int, Move]], PeopleAgreement] = pair

    def pair_agreement(self, first: int, second: int, hypothesis: Hypothesis) -> PeopleAgreement:
        """PeopleAgreement of two cameras."""
        left, right = (
            (number, hypothesis.places[number], hypothesis.moves[number]) for number in sorted((first, second))
        )
        return self._pair(left, right)

    def is_clear(self, pairs: Sequence[tuple[int, int]], hypothesis: Hypothesis) -> bool:
        """Test for a disagreement of pairs of cameras that has no other reason than that something is wrong.

        Cameras of a right calibration that see different people disagree about these, but agree exactly about the
        others, however few they are: distances of different people are spread evenly, distances of the same people are
        nearly 0.
        """
        known = [self.pair_agreement(*pair, hypothesis) for pair in pairs]
        num_compared = sum(agreement.num_pairs for agreement in known)
        num_exact = sum(agreement.exact_share * agreement.num_pairs for agreement in known if agreement.num_pairs)
        num_near = sum(agreement.near_share * agreement.num_pairs for agreement in known if agreement.num_pairs)
        num_sure = sum(agreement.sure_share * agreement.num_pairs for agreement in known if agreement.num_pairs)
        if not self._is_enough(known) or num_exact >= _MAX_EXACT * num_compared:
            return False
        # Probability that, among so many near pairs of different people, so many or more are as near as the same
        # person.
        chance = bdtrc(round(num_sure) - 1, round(num_near), SURE / FAR) if round(num_sure) else 1.0
        return bool(chance > _MAX_CHANCE)

    def disagrees(self, pairs: Sequence[tuple[int, int]], hypothesis: Hypothesis) -> bool:
        """True if pairs of cameras disagree on average, for no other reason than that something is wrong."""
        values = [self.pair_agreement(*pair, hypothesis).disagreement for pair in pairs]
        known = [value for value in values if np.isfinite(value)]
        return bool(known) and float(np.mean(known)) > DOUBTFUL and self.is_clear(pairs, hypothesis)

    def certainty(self, changed: Sequence[int], hypothesis: Hypothesis) -> Severity:
        """Severity of an explanation that changes some cameras: an error if enough people decide."""
        pairs = [pair for pair in itertools.combinations(range(self.num_cameras), 2) if set(pair) & set(changed)]
        return "error" if self._is_enough([self.pair_agreement(*pair, hypothesis) for pair in pairs]) else "warning"

    def _is_enough(self, known: Sequence[PeopleAgreement]) -> bool:
        num_instants = max((self._num_independent(agreement.instants) for agreement in known), default=0)
        return num_instants >= MIN_INSTANTS and sum(agreement.num_pairs for agreement in known) >= _MIN_COMPARED

    def pair_agreements(self, hypothesis: Hypothesis, among: Sequence[int]) -> Mapping[tuple[int, int], float]:
        """Disagreement of all pairs with one of some cameras, as far as it is known."""
        pairs = itertools.combinations(range(self.num_cameras), 2)
        values = {pair: self.pair_agreement(*pair, hypothesis).disagreement for pair in pairs if set(pair) & set(among)}
        return {pair: value for pair, value in values.items() if np.isfinite(value)}

    def camera_agreements(self, hypothesis: Hypothesis) -> list[float]:
        """Mean disagreement of each camera with the others; NaN if it is not known."""
        by_pair = self.pair_agreements(hypothesis, range(self.num_cameras))
        of_camera = [[value for pair, value in by_pair.items() if number in pair] for number in range(self.num_cameras)]
        return [float(np.mean(values)) if values else np.nan for values in of_camera]


def move_points(points_px: Points, move: Move, size_px: tuple[int, int], joints: JointSet) -> Points:
    """Turn points clockwise about the middle of the picture, mirror them, or exchange x and y.

    In a mirrored picture a network takes the left side of a body for the right one, so mirroring exchanges the sides.
    """
    if move == "exchanged":
        return points_px[..., ::-1]
    middle_px = (np.array(size_px) - 1.0) / 2.0
    x, y = np.moveaxis(points_px - middle_px, -1, 0)
    moved = {"as is": (x, y), "90": (-y, x), "180": (-x, -y), "270": (y, -x), "mirrored": (-x, y)}[move]
    points_px = np.stack(moved, axis=-1) + middle_px
    return points_px[:, joints.indices(tuple(map(other_side, joints.names)))] if move == "mirrored" else points_px


def explain(evidence: PairDisagreement, doubted: Collection[int]) -> Hypothesis:
    """Find the hypothesis that explains most of the disagreement of doubted cameras, one step after the other.

    Each step exchanges cameras, or moves the points of one camera or of all; it must leave at most 0.7 of the
    disagreement of the cameras that it changes.
    """
    believed = as_given(evidence.num_cameras)
    # Each step makes at least one camera agree.
    for _ in doubted:
        step = _best_step(evidence, believed, doubted)
        if step is None:
            return believed
        believed = step
    return believed


def _best_step(evidence: PairDisagreement, believed: Hypothesis, doubted: Collection[int]) -> Hypothesis | None:
    agreements = evidence.camera_agreements(believed)
    doubtful = sorted(
        (number for number in doubted if agreements[number] > DOUBTFUL),
        key=lambda number: -agreements[number],
    )
    best, best_gain = None, 0.0
    for candidate in _candidates(believed, doubtful, evidence.names):
        changed = [
            number
            for number in range(evidence.num_cameras)
            if (candidate.places[number], candidate.moves[number]) != (believed.places[number], believed.moves[number])
        ]
        before, after = evidence.pair_agreements(believed, changed), evidence.pair_agreements(candidate, changed)
        gain = sum(before.values()) - sum(after.values())
        is_explained = (
            bool(before) and before.keys() == after.keys() and sum(after.values()) <= _LEFT * sum(before.values())
        )
        if is_explained and gain > best_gain:
            best, best_gain = candidate, gain
    return best


def _candidates(believed: Hypothesis, doubtful: Sequence[int], names: Sequence[str]) -> Iterator[Hypothesis]:
    if not doubtful:
        return
    for number in doubtful:
        for move in (*MOVES, "exchanged"):
            moves = (*believed.moves[:number], move, *believed.moves[number + 1 :])
            yield Hypothesis(believed.places, moves)
    num_cameras = len(believed.places)
    if len(doubtful) == num_cameras:
        for move in (*MOVES, "exchanged"):
            yield Hypothesis(believed.places, (move,) * num_cameras)
    if num_cameras <= _MAX_ORDERED:
        for order in itertools.permutations(range(num_cameras)):
            yield Hypothesis(tuple(believed.places[place] for place in order), believed.moves)
        return
    for order in _orders_of_names(names):
        yield Hypothesis(tuple(believed.places[place] for place in order), believed.moves)
    for first, second in itertools.combinations(doubtful[:_MAX_EXCHANGED], 2):
        places = list(believed.places)
        places[first], places[second] = places[second], places[first]
        yield Hypothesis(tuple(places), believed.moves)


def _orders_of_names(names: Sequence[str]) -> Iterator[tuple[int, ...]]:
    """Orders in which files are paired with cameras by mistake: alphabetical for natural, or one place further on."""
    natural = sorted(range(len(names)), key=lambda number: natural_key(names[number]))
    alphabetical = sorted(range(len(names)), key=lambda number: names[number])
    further = [*natural[1:], natural[0]]
    for given, paired in ((natural, alphabetical), (natural, further)):
        place_of = dict(zip(given, paired, strict=True))
        order = tuple(place_of[number] for number in range(len(names)))
        yield order
        yield tuple(order.index(number) for number in range(len(names)))
