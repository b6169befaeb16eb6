"""Numbers of people who come back, by proportions and clothes, against all people who were there before.

The tracker gives a new number to whoever was hidden for longer than it waits. Until the bones of a new person are
learnt, all full seconds of sight are compared with the people who are not there: by the log-likelihood ratio that the
lengths of the limbs are of one person, like ``identity.proportions``, plus the ratio of the clothes' colours where
there are pictures, like ``identity.clothes``. The number goes back only where it is clear.

A person's colours are two means, of the earlier and of the later part of the time in sight: their distance tells how
much one person's colours vary. Once the later part is as long as the earlier one, both become the earlier one, so that
memory does not grow with the time.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.association.identity.clothes import (
    Clothes,
    Contrast,
    clothes_likelihood_ratios,
    learn_contrast,
    mean_clothes,
)
from pipeline.association.identity.proportions import NUM_LIMBS, LimbProportions, Measured, limb_lengths_m, measure
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffset, JointOffsets, JointSet
from pipeline.motion.skeleton.marks import trunk_length_m
from pipeline.motion.skeleton.model import INDEX
from pipeline.run.live.skeleton import LearntBones

# People from whose distances it is learnt what clothes tell: the time grows with the square of their number.
_MOST_LEARNT = 16

ColourOfCamera = tuple[int, UInt8[np.ndarray, "parts bins"]]
"""Position of a camera, and the colours of a detection in its picture, like ``detection.appearance``."""


class _Halves(NamedTuple):
    """Colours of the earlier and of the later part of a person's sight."""

    earlier: Clothes
    later: Clothes

    @property
    def whole(self) -> Clothes:
        return self.earlier.joined(self.later)

    def extended(self, clothes: Clothes) -> "_Halves":
        """Colours after some more time in sight."""
        if self.later.num_detections.sum() < self.earlier.num_detections.sum():
            return _Halves(self.earlier, self.later.joined(clothes))
        return _Halves(self.whole, clothes)


class LiveClothes:
    """Clothes of people by their numbers."""

    def __init__(self, num_cameras: int) -> None:
        self._num_cameras = num_cameras
        self._halves: dict[int, _Halves] = {}  # The latest people come last
        # People who were in sight together with each person, and so are others.
        self._others: dict[int, set[int]] = {}

    def __len__(self) -> int:
        return len(self._halves)

    def add(self, number: int, colours: Sequence[ColourOfCamera]) -> None:
        """Take the colours of a person's detections of some time, one at least."""
        cameras, histograms = zip(*colours, strict=True)
        clothes = mean_clothes(np.array(histograms), np.array(cameras), self._num_cameras)
        known = self._halves.pop(number, None)
        nothing = Clothes(0 * clothes.share, 0 * clothes.num_detections)
        self._halves[number] = _Halves(clothes, nothing) if known is None else known.extended(clothes)

    def meet(self, number: int, others: Iterable[int]) -> None:
        """Note that other people are in sight together with a person."""
        for other in others:
            self._others.setdefault(number, set()).add(other)
            self._others.setdefault(other, set()).add(number)

    def merge(self, number: int, former: int) -> None:
        """Give all of a person to another number, which belongs to the same person."""
        if (halves := self._halves.pop(number, None)) is not None:
            known = self._halves.get(former)
            self._halves[former] = halves if known is None else known.extended(halves.whole)
        others = self._others.pop(number, set())
        for other in others:
            self._others[other].discard(number)
        self.meet(former, others)

    def keep(self, numbers: Set[int]) -> None:
        """Forget all other people."""
        for number in (self._halves.keys() | self._others.keys()) - numbers:
            self._halves.pop(number, None)
            for other in self._others.pop(number, set()):
                self._others[other].discard(number)

    def log_ratios(self, number: int, others: Sequence[int]) -> Mapping[int, float]:
        """Log-likelihood ratios that a person is each of others, against being another; 0 where nothing tells."""
        known = [other for other in others if other in self._halves]
        ratios = dict.fromkeys(others, 0.0)
        if number in self._halves and known:
            wholes = [self._halves[other].whole for other in known]
            of_known = clothes_likelihood_ratios(self._halves[number].whole, wholes, self._contrast())
            ratios |= zip(known, of_known.tolist(), strict=True)
        return ratios

    def _contrast(self) -> Contrast:
        """How much the clothes of the latest people tell."""
        numbers = list(self._halves)[-_MOST_LEARNT:]
        halves = [self._halves[number] for number in numbers]
        are_different = [[other in self._others.get(number, ()) for other in numbers] for number in numbers]
        return learn_contrast([each.whole for each in halves], halves, np.array(are_different))


_STRETCH_S = 1.0
# Positions of a second that are kept.
_MOST_KEPT = 25
# Standard deviation of a limb measured for a second, before a capture tells, and its weight in pairs of seconds.
_USUAL_M, _USUAL_SECONDS = 0.03, 0.5
# Log-likelihood ratio from which on a person is one who was there before (odds of 55), and by how much it is above
# others. Whoever is announced is expected.
_CLEAR, _CLEAR_IF_ANNOUNCED = 4.0, 2.0
# Fewest positions of a second that are compared.
_FEWEST_KEPT = 5
# Seconds for which a body of an earlier take was measured, as far as its lengths are between this detector's marks.
_EARLIER_S = 5.0
# Time in sight together from which on two people are certainly different ones. Their seconds may begin at different
# times: when one of them is over, the other person's is at least half over, or the other way round.
_TOGETHER_S = 0.4
# People who are remembered.
_MOST_KNOWN = 64


@dataclass(slots=True, eq=False)
class _Seconds:
    """Lengths of a person's limbs by the seconds of sight."""

    sum_m: Float[np.ndarray, " limbs"]  # Sum of the medians of seconds, times the seconds for which each was measured
    duration_s: Float[np.ndarray, " limbs"]
    before: Measured | None = None  # Second that has no partner yet

    def measured(self) -> Measured:
        """All seconds as one measurement."""
        known = self.duration_s > 0
        return Measured(np.where(known, self.sum_m / np.where(known, self.duration_s, 1.0), np.nan), self.duration_s)


@dataclass(slots=True, eq=False)
class _Sight:
    """Positions and colours collected in the current second."""

    start_s: float
    seen_s: float  # Time of the latest instant
    located_m: list[Float[np.ndarray, "joints 3"]] = field(default_factory=list)
    colours: list[ColourOfCamera] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class KnownBody:
    """Body of a person who was there before: its bones, or their lengths alone if it is of an earlier take."""

    length_m: Float[np.ndarray, " bones"]
    bones: LearntBones | None


class Identities:
    """Numbers of the people of a live capture.

    ``joints``: joint set of the detector. ``bodies``: lengths of the skeleton's bones of people of earlier takes, in
    metres; they have the first numbers. ``offsets``: offsets of the detector's marks from the joints' centres.
    """

    def __init__(
        self,
        joints: JointSet,
        num_cameras: int,
        bodies: Sequence[Float[np.ndarray, " bones"]],
        offsets: JointOffsets = MARKED_AT_CENTERS,
    ) -> None:
        self._joints = joints
        self._first = len(bodies)
        self._number: dict[int, int] = {}  # of the people followed by the tracker, by its number
        self._known: dict[int, KnownBody] = {}
        self._seconds: dict[int, _Seconds] = {}
        self._clothes = LiveClothes(num_cameras)
        self._sight: dict[int, _Sight] = {}
        # Squares of the differences of seconds, and their number, as identity.proportions estimates the spread.
        self._count = np.full(NUM_LIMBS, _USUAL_SECONDS)
        self._square_m2 = _USUAL_M**2 * self._count
        for number, length_m in enumerate(bodies, 1):
            self._known[number] = KnownBody(np.asarray(length_m), None)
            limbs_m = limbs_of_bones_m(np.asarray(length_m), offsets)
            self._seconds[number] = _Seconds(_EARLIER_S * limbs_m, np.full(NUM_LIMBS, _EARLIER_S))

    def __len__(self) -> int:
        of_sights = sum(len(sight.located_m) + len(sight.colours) for sight in self._sight.values())
        return len(self._seconds) + len(self._clothes) + len(self._number) + of_sights

    def person_number(self, tracked: int) -> int:
        """Number of a person by the tracker's number."""
        return self._number.setdefault(tracked, tracked + self._first)

    def keep(self, tracked: Set[int]) -> None:
        """Forget positions of people no longer followed by the tracker, and the first of very many people.

        People who were announced stay.
        """
        self._number = {key: number for key, number in self._number.items() if key in tracked}
        present = set(self._number.values())
        self._sight = {number: sight for number, sight in self._sight.items() if number in present}
        # Whoever left without bones can't be recognised.
        self._seconds = {n: seconds for n, seconds in self._seconds.items() if n in present or n in self._known}
        absent = [number for number in self._known if number > self._first and number not in present]
        for number in absent[: max(0, len(self._known) - _MOST_KNOWN)]:
            del self._known[number]
            self._seconds.pop(number, None)
        self._clothes.keep(self._seconds.keys())

    def see(
        self,
        tracked: int,
        time_s: float,
        xyz_m: Float[np.ndarray, "joints 3"],
        colours: Mapping[int, UInt8[np.ndarray, "parts bins"]],
    ) -> KnownBody | None:
        """Take a person's located joints at an instant, and the colours of the clothes.

        ``tracked``: the tracker's number of the person. ``xyz_m``: world positions in metres, NaN where unknown.
        ``colours``: colours of the person's detections by the positions of their cameras, like
        ``detection.appearance``; none where they were not measured. Returns body of the person who was there before, if
        this is clear now; from then on ``person_number`` gives that person's number. Only people without bones are
        compared.
        """
        number = self.person_number(tracked)
        sight = self._sight.setdefault(number, _Sight(time_s, time_s))
        if time_s - sight.start_s >= 2 * _STRETCH_S:  # hidden meanwhile
            sight = self._sight[number] = _Sight(time_s, time_s)
        sight.seen_s = time_s
        step_s = _STRETCH_S / _MOST_KEPT
        if time_s - sight.start_s >= len(sight.located_m) * step_s:
            sight.located_m.append(xyz_m)
        sight.colours += colours.items()
        if time_s - sight.start_s < _STRETCH_S - step_s / 2:
            return None
        self._sight[number] = _Sight(sight.start_s + _STRETCH_S, time_s)
        if len(sight.located_m) < _FEWEST_KEPT:
            return None
        self._add_second(number, np.array(sight.located_m))
        if sight.colours:
            self._clothes.add(number, sight.colours)
            self._clothes.meet(number, self._together(number, sight))
        if number in self._known:
            return None
        former = self._former(number)
        if former is None:
            return None
        self._number[tracked] = former
        self._sight[former] = self._sight.pop(number)
        self._merge(self._seconds.pop(number), self._seconds[former])
        self._clothes.merge(number, former)
        return self._known[former]

    def learn(self, tracked: int, bones: LearntBones) -> None:
        """Note the bones of a person; who comes back is recognised from now on."""
        self._known[self.person_number(tracked)] = KnownBody(bones.length_m, bones)

    def _add_second(self, number: int, located_m: Float[np.ndarray, "instants joints 3"]) -> None:
        source = np.where(np.isfinite(located_m[..., 0]), Source.MEASURED, Source.ABSENT)
        nothing = np.zeros(source.shape)
        track = Track3D(1, 0, located_m, nothing, source, nothing, np.zeros(source.shape, int))
        second = measure(limb_lengths_m(track, self._joints), len(located_m) / _STRETCH_S)
        seconds = self._seconds.setdefault(number, _Seconds(np.zeros(NUM_LIMBS), np.zeros(NUM_LIMBS)))
        seconds.sum_m += second.duration_s * np.nan_to_num(second.median_m)
        seconds.duration_s += second.duration_s
        if seconds.before is None:
            seconds.before = second
            return
        difference_m = second.median_m - seconds.before.median_m
        weight = np.minimum(second.duration_s, seconds.before.duration_s)
        known = np.isfinite(difference_m)
        self._square_m2 += np.where(known, difference_m**2 / 2 * weight, 0.0)
        self._count += known
        seconds.before = None

    def _together(self, number: int, second: _Sight) -> Iterator[int]:
        """Numbers of the people who were in sight together with a person in a second that is over."""
        for other, sight in self._sight.items():
            both_s = min(second.seen_s, sight.seen_s) - max(second.start_s, sight.start_s)
            if other != number and both_s >= _TOGETHER_S:
                yield other

    def _former(self, number: int) -> int | None:
        """Index of the absent person that matches; ``None`` if no person matches clearly."""
        present = set(self._number.values())
        # People who were located too seldom in each second have bones, which need fewer positions, and no lengths.
        absent = [known for known in self._known if known not in present and known in self._seconds]
        if not absent:
            return None
        odds = self.log_odds(number, absent)
        best, *others = sorted(odds, key=lambda other: -odds[other])
        threshold = _CLEAR if self._known[best].bones is not None else _CLEAR_IF_ANNOUNCED
        is_clear = odds[best] > threshold and all(odds[best] > odds[other] + _CLEAR for other in others)
        return best if is_clear else None

    def log_odds(self, number: int, others: Sequence[int]) -> Mapping[int, float]:
        """Log-likelihood ratios that a person is each of others, against being another person."""
        numbers = [number, *others]
        # The proportions of all people tell what an unknown person is like.
        measured = [self._seconds[n].measured() for n in numbers]
        proportions = LimbProportions(measured, np.sqrt(self._square_m2 / self._count))
        information, pull = proportions.information, proportions.pull
        alone = proportions.log_likelihood(information, pull)
        together = proportions.log_likelihood(information[1:] + information[0], pull[1:] + pull[0])
        odds = zip(others, (together - alone[1:] - alone[0]).tolist(), strict=True)
        clothes = self._clothes.log_ratios(number, others)
        return {other: of_other + clothes[other] for other, of_other in odds}

    @staticmethod
    def _merge(seconds: _Seconds, into: _Seconds) -> None:
        into.sum_m += seconds.sum_m
        into.duration_s += seconds.duration_s


def limbs_of_bones_m(
    length_m: Float[np.ndarray, " bones"], offsets: JointOffsets = MARKED_AT_CENTERS
) -> Float[np.ndarray, " limbs"]:
    """Lengths of the limbs of ``identity.proportions`` from the lengths of a skeleton's bones, in metres.

    Shoulders and hips are where a detector with such offsets marks them on a person who stands upright.
    """
    trunk_m = trunk_length_m(length_m)

    def mean_length_m(kind: str) -> float:
        return float(length_m[[INDEX[f"Left{kind}"], INDEX[f"Right{kind}"]]].mean())

    def mark_m(kind: str, outwards_m: float, up_m: float) -> Float[np.ndarray, " 3"]:
        offset = offsets.get(kind, JointOffset())
        return np.array([outwards_m, 0.0, up_m]) + trunk_m * np.array([offset.outwards, offset.forward, offset.up])

    shoulder_m, hip_m = mark_m("shoulder", mean_length_m("Arm"), trunk_m), mark_m("hip", mean_length_m("UpLeg"), 0.0)
    flank_m = float(np.linalg.norm(shoulder_m - hip_m))
    limbs_m = [mean_length_m("ForeArm"), mean_length_m("Hand"), mean_length_m("Leg"), mean_length_m("Foot")]
    return np.array([*limbs_m, flank_m, 2 * shoulder_m[0], 2 * hip_m[0]])
