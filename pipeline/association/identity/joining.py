"""Join tracklets to people: the partition with the greatest likelihood over the whole session.

A person is a chain of tracklets, one after the other in time. Its log-likelihood is the log-likelihood of its body
proportions (``proportions``) plus the log-likelihood ratios of its links (``links``). The search starts from the best
links by pairs of tracklets, an assignment that is solved exactly, and then changes pairs of chains while the likelihood
of the whole session grows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.association.identity.proportions import LimbProportions
from pipeline.association.identity.tracklets import Ends, Tracklet, link_scores
from pipeline.core.data.people import Doubt

Chain = tuple[int, ...]
# A change that gains less is rounding error. And the logarithm of the odds from which on there is no doubt: 0.99.
_LEAST_GAIN = 1e-6
_CERTAIN = 4.6
# Limits of the work for a hostile session: ends of tracklets that are assigned, chains that are changed, and changes.
# The longest are taken. Sessions of ten people for ten minutes have a tenth of that.
_MOST_ENDS, _MOST_CHAINS, _MOST_CHANGES = 2_000, 200, 2_000


@dataclass(frozen=True, slots=True)
class TrackletLinks:
    """Tracklets of a session, and what links them."""

    tracklets: Sequence[Tracklet]  # All tracklets, sorted by first frame
    # Their ends
    first: Ends
    last: Ends
    proportions: LimbProportions  # Their body proportions, in the same order
    area_m2: float  # See ``links.viewed_area_m2``
    # Log-likelihood ratios of their clothes (``clothes``); ``None`` if colours are not known
    clothes: Float[np.ndarray, "tracklets tracklets"] | None = None

    def links(self, before: Int[np.ndarray, "*batch"], after: Int[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """Log-likelihood ratios of links by all but body proportions; minus infinity where a link is impossible."""
        scores = link_scores(self.last.rows(before), self.first.rows(after), self.area_m2)
        return scores if self.clothes is None else scores + self.clothes[before, after]


def join(session: TrackletLinks) -> list[Chain]:
    """Join tracklets to chains, a person each, in order of their first tracklets."""
    chains = sorted(_first_chains(session), key=lambda chain: -_num_frames(session, chain))
    search = _Search(session, chains[:_MOST_CHAINS])
    search.run()
    return sorted([*filter(None, search.chains), *chains[_MOST_CHAINS:]])


def chain_doubts(session: TrackletLinks, chains: Sequence[Chain]) -> list[list[Doubt]]:
    """Doubts about each of the joined chains, in order of time; the other person is the number of a chain, or -1."""
    by_length = sorted(range(len(chains)), key=lambda number: -_num_frames(session, chains[number]))[:_MOST_CHAINS]
    doubts: list[list[Doubt]] = [[] for _ in chains]
    for number, chain_doubts in zip(
        by_length, _Search(session, [chains[chain] for chain in by_length]).doubts(), strict=True
    ):
        doubts[number] = [
            doubt._replace(other=by_length[doubt.other] if doubt.other >= 0 else -1) for doubt in chain_doubts
        ]
    return doubts


def _num_frames(session: TrackletLinks, chain: Chain) -> int:
    return sum(session.tracklets[number].stop_frame - session.tracklets[number].start_frame for number in chain)


def _first_chains(session: TrackletLinks) -> list[Chain]:
    """Chains by the assignment with the greatest sum of scores of pairs; tracks go on at encounters."""
    count = len(session.tracklets)
    following = np.full(count, -1)
    cut_before = {(tracklet.track, tracklet.cut_before): number for number, tracklet in enumerate(session.tracklets)}
    for number, tracklet in enumerate(session.tracklets):
        if tracklet.cut_after >= 0:
            following[number] = cut_before[tracklet.track, tracklet.cut_after]
    length = np.array([tracklet.stop_frame - tracklet.start_frame for tracklet in session.tracklets], int)
    ends = _longest(np.flatnonzero(session.last.cut < 0), length)
    starts = _longest(np.flatnonzero(session.first.cut < 0), length)
    gain = _pair_gains(session, ends, starts)
    rows, columns = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
    chosen = gain[rows, columns] > _LEAST_GAIN
    following[ends[rows[chosen]]] = starts[columns[chosen]]
    return list(_follow(following))


def _longest(tracklets: Int[np.ndarray, " n"], length: Int[np.ndarray, " _"]) -> Int[np.ndarray, " most"]:
    """The longest of some tracklets, in their order."""
    return np.sort(tracklets[np.argsort(-length[tracklets], kind="stable")[:_MOST_ENDS]])


def _pair_gains(
    session: TrackletLinks, ends: Int[np.ndarray, " ends"], starts: Int[np.ndarray, " starts"]
) -> Float[np.ndarray, "ends starts"]:
    proportions = session.proportions
    alone = proportions.log_likelihood(proportions.information, proportions.pull)
    gain = session.links(*np.broadcast_arrays(ends[:, None], starts[None]))
    for row, end in enumerate(ends.tolist()):
        together = proportions.log_likelihood(
            proportions.information[end] + proportions.information[starts],
            proportions.pull[end] + proportions.pull[starts],
        )
        gain[row] += together - alone[end] - alone[starts]
    return gain


def _follow(following: Int[np.ndarray, " n"]) -> Iterator[Chain]:
    """Chains of tracklets from each tracklet's follower, -1 for none."""
    begins = np.ones(len(following), bool)
    begins[following[following >= 0]] = False
    for start in np.flatnonzero(begins).tolist():
        chain = [start]
        while following[chain[-1]] >= 0:
            chain.append(int(following[chain[-1]]))
        yield tuple(chain)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums over the first tracklets of a chain, and the scores of the links up to each; from none to all."""

    information: Float[np.ndarray, "borders limbs"]
    pull: Float[np.ndarray, "borders limbs"]
    links: Float[np.ndarray, " borders"]


@dataclass(frozen=True, slots=True, eq=False)
class _Exchanges:
    """Exchanges of the ends of two chains: numbers of tracklets that stay, and gains of the likelihood."""

    kept: Int[np.ndarray, "exchanges 2"]
    gain: Float[np.ndarray, " exchanges"]


class _Search:
    """Search for the most likely chains by exchanges of their ends; an empty chain is the place of new people."""

    def __init__(self, session: TrackletLinks, chains: Sequence[Chain]) -> None:
        self._session = session
        self.chains: list[Chain] = [*chains, ()]
        self._sums = [self._sum(chain) for chain in self.chains]
        self._start = np.array([tracklet.start_frame for tracklet in session.tracklets])
        self._stop = np.array([tracklet.stop_frame for tracklet in session.tracklets])

    def run(self) -> None:
        """Change pairs of chains, the greatest gain first, until nothing is gained."""
        best = {pair: self._best(*pair) for pair in self._pairs(range(len(self.chains)))}
        for _ in range(_MOST_CHANGES if best else 0):
            (first, second), (gain, left, right) = max(best.items(), key=lambda entry: entry[1][0])
            if gain <= _LEAST_GAIN:
                return
            self._set(first, left)
            self._set(second, right)
            changed = [first, second]
            if () not in self.chains:
                self.chains.append(())
                self._sums.append(self._sum(()))
                changed.append(len(self.chains) - 1)
            best |= {pair: self._best(*pair) for pair in self._pairs(changed)}

    def doubts(self) -> list[list[Doubt]]:
        """See ``chain_doubts``: the best exchange at each border of a chain, if it is nearly as likely."""
        best_links: list[dict[int, tuple[float, int]]] = [{} for _ in self.chains]
        for first in range(len(self.chains)):
            for second in range(first + 1, len(self.chains)):
                exchanges = self._exchanges(first, second)
                for kept, gain in zip(exchanges.kept.tolist(), exchanges.gain.tolist(), strict=True):
                    for chain, twin, border in ((first, second, kept[0]), (second, first, kept[1])):
                        if gain > best_links[chain].get(border, (-np.inf, 0))[0]:
                            best_links[chain][border] = gain, twin if self.chains[twin] else -1
        return [
            [
                Doubt(self._frame(chain, border), _probability(-gain), other)
                for border, (gain, other) in sorted(of_chain.items())
                if gain > -_CERTAIN
            ]
            for chain, of_chain in zip(self.chains, best_links, strict=True)
            if chain
        ]

    def _frame(self, chain: Chain, border: int) -> int:
        return int(self._start[chain[border]]) if border < len(chain) else int(self._stop[chain[-1]])

    def _pairs(self, changed: Sequence[int] | range) -> set[tuple[int, int]]:
        every = range(len(self.chains))
        return {(min(first, second), max(first, second)) for first in changed for second in every if first != second}

    def _set(self, number: int, chain: Chain) -> None:
        self.chains[number] = chain
        self._sums[number] = self._sum(chain)

    def _sum(self, chain: Chain) -> _Sums:
        session, members = self._session, np.array(chain, int)
        scores = session.links(members[:-1], members[1:])
        return _Sums(
            _from_zero(session.proportions.information[members]),
            _from_zero(session.proportions.pull[members]),
            np.concatenate([np.zeros(min(2, len(chain) + 1)), np.cumsum(scores)]),
        )

    def _best(self, first: int, second: int) -> tuple[float, Chain, Chain]:
        """Gain of the best change of two chains, and the chains after it."""
        left, right = self.chains[first], self.chains[second]
        options: list[tuple[float, Chain, Chain]] = [(-np.inf, left, right)]
        exchanges = self._exchanges(first, second)
        if len(exchanges.gain):
            best = int(np.argmax(exchanges.gain))
            kept = exchanges.kept[best].tolist()
            gain = float(exchanges.gain[best])
            options.append((gain, left[: kept[0]] + right[kept[1] :], right[: kept[1]] + left[kept[0] :]))
        now = self._value(left) + self._value(right)
        for outer, inner in ((left, right), (right, left)):
            if whole := self._inserted(outer, inner):
                options.append((self._value(whole) - now, whole, ()))
        return max(options, key=lambda option: option[0])

    def _inserted(self, outer: Chain, inner: Chain) -> Chain:
        """Chain with another one in a gap between two of its tracklets; empty if there is no such gap."""
        if len(outer) < 2 or not inner:
            return ()
        border = int(np.searchsorted(self._start[list(outer)], self._start[inner[0]]))
        fits = (
            0 < border < len(outer)
            and self._stop[outer[border - 1]] <= self._start[inner[0]]
            and self._stop[inner[-1]] <= self._start[outer[border]]
        )
        return (*outer[:border], *inner, *outer[border:]) if fits else ()

    def _value(self, chain: Chain) -> float:
        sums = self._sum(chain)
        value = self._session.proportions.log_likelihood(sums.information[-1], sums.pull[-1])
        return float(value + sums.links[-1])

    def _exchanges(self, first: int, second: int) -> _Exchanges:
        """All exchanges of the ends of two chains that keep the order of time."""
        kept = self._borders(self.chains[first], self.chains[second])
        sums = self._sums[first], self._sums[second]
        gain = np.zeros(len(kept))
        for head, tail in ((0, 1), (1, 0)):
            links, possible = self._joined(head, tail, (first, second), kept)
            gain += np.where(possible, links, -np.inf)
            information = _head(sums[head].information, kept[:, head]) + _tail(sums[tail].information, kept[:, tail])
            pull = _head(sums[head].pull, kept[:, head]) + _tail(sums[tail].pull, kept[:, tail])
            gain += self._session.proportions.log_likelihood(information, pull)
        for of_chain in sums:
            gain -= self._session.proportions.log_likelihood(of_chain.information[-1], of_chain.pull[-1])
            gain -= of_chain.links[-1]
        return _Exchanges(kept, gain)

    def _borders(self, first_chain: Chain, second_chain: Chain) -> Int[np.ndarray, "exchanges 2"]:
        """Numbers of tracklets that each chain may keep, except for exchanges that change nothing."""
        left, right = np.array(first_chain, int), np.array(second_chain, int)
        # The next tracklet of each chain must not begin before the last kept one of the other chain ends.
        stop = [np.append(-np.inf, self._stop[chain]) for chain in (left, right)]
        start = [np.append(self._start[chain], np.inf) for chain in (left, right)]
        lowest = np.searchsorted(start[1], stop[0], side="left")
        highest = np.searchsorted(stop[1], start[0], side="right") - 1
        counts = np.maximum(highest - lowest + 1, 0)
        first = np.repeat(np.arange(len(left) + 1), counts)
        place = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
        kept = np.column_stack([first, np.repeat(lowest, counts) + place])
        nothing = (kept == 0).all(-1) | (kept == [len(left), len(right)]).all(-1)
        return kept[~nothing]

    def _joined(
        self, head: int, tail: int, chains: tuple[int, int], kept: Int[np.ndarray, "exchanges 2"]
    ) -> tuple[Float[np.ndarray, " exchanges"], np.ndarray]:
        front, back = self.chains[chains[head]], self.chains[chains[tail]]
        before, after = self._sums[chains[head]], self._sums[chains[tail]]
        links = before.links[kept[:, head]]
        # The link at the border itself belongs neither to the head nor to the tail.
        begins = np.minimum(kept[:, tail] + 1, len(back))
        links = links + after.links[-1] - after.links[begins]
        both = (kept[:, head] > 0) & (kept[:, tail] < len(back))
        scores = np.zeros(len(kept))
        if both.any():
            ends = np.array(front, int)[kept[both, head] - 1]
            starts = np.array(back, int)[kept[both, tail]]
            scores[both] = self._session.links(ends, starts)
        return links + scores, np.isfinite(scores)


def _from_zero(values: Float[np.ndarray, "n limbs"]) -> Float[np.ndarray, "borders limbs"]:
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])


def _head(sums: np.ndarray, kept: np.ndarray) -> np.ndarray:
    return np.asarray(sums[kept])


def _tail(sums: np.ndarray, kept: np.ndarray) -> np.ndarray:
    return np.asarray(sums[-1] - sums[kept])


def _probability(log_odds: float) -> float:
    return float(1 / (1 + np.exp(-log_odds)))
