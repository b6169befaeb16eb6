"""Search for chains: gains of changes, and limits."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.association.identity import joining
from pipeline.association.identity.joining import TrackletLinks, chain_doubts, join
from pipeline.association.identity.proportions import NUM_LIMBS, LimbProportions, Measured
from pipeline.association.identity.tracklets import Ends, Tracklet, link_scores


def session_of(seed: int, count: int) -> TrackletLinks:
    """Tracklets at random places and times, of three builds."""
    rng = np.random.default_rng(seed)
    starts = np.sort(rng.integers(0, 500, count))
    stops = starts + rng.integers(20, 120, count)
    builds_m = 0.4 * rng.normal(1.0, 0.06, (3, NUM_LIMBS))
    measured = [
        Measured(builds_m[rng.integers(3)] + rng.normal(0, 0.005, NUM_LIMBS), np.full(NUM_LIMBS, 2.0))
        for _ in range(count)
    ]
    places_m = rng.uniform(-2, 2, (2, count, 3))

    def ends(frames: np.ndarray, xyz_m: np.ndarray) -> Ends:
        return Ends(frames / 25.0, xyz_m, np.zeros_like(xyz_m), np.arange(count), np.full(count, -1))

    tracklets = [Tracklet(k, int(start), int(stop)) for k, (start, stop) in enumerate(zip(starts, stops, strict=True))]
    proportions = LimbProportions(measured, np.full(NUM_LIMBS, 0.01))
    return TrackletLinks(tracklets, ends(starts, places_m[0]), ends(stops - 1, places_m[1]), proportions, 16.0)


def value(session: TrackletLinks, chain: tuple[int, ...]) -> float:
    """Log-likelihood of a chain, term by term."""
    members = list(chain)
    links = link_scores(
        session.last.rows(np.array(members[:-1], int)), session.first.rows(np.array(members[1:], int)), 16.0
    )
    proportions = session.proportions
    return float(
        links.sum()
        + proportions.log_likelihood(proportions.information[members].sum(0), proportions.pull[members].sum(0))
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_chains_in_time_order_are_optimal_for_two(seed: int) -> None:
    session = session_of(seed, 9)
    chains = join(session)
    assert sorted(number for chain in chains for number in chain) == list(range(9))
    for chain in chains:
        for before, after in pairwise(chain):
            assert session.tracklets[before].stop_frame <= session.tracklets[after].start_frame
    for one in [*chains, ()]:
        for other in chains:
            if one == other:
                continue
            now = value(session, one) + value(session, other)
            for a in range(len(one) + 1):
                for b in range(len(other) + 1):
                    changed = one[:a] + other[b:], other[:b] + one[a:]
                    assert sum(value(session, chain) for chain in changed) <= now + 1e-6 or not all(
                        in_order(session, chain) for chain in changed
                    )


def in_order(session: TrackletLinks, chain: tuple[int, ...]) -> bool:
    return all(
        session.tracklets[before].stop_frame <= session.tracklets[after].start_frame
        for before, after in pairwise(chain)
    )


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_doubts_are_about_other_chains(seed: int) -> None:
    session = session_of(seed, 9)
    chains = join(session)
    for number, doubts in enumerate(chain_doubts(session, chains)):
        for doubt in doubts:
            assert 0.5 - 1e-9 <= doubt.confidence < 0.99
            assert doubt.other != number
            assert -1 <= doubt.other < len(chains)


def test_hostile_number_of_tracklets_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    session = session_of(3, 40)
    monkeypatch.setattr(joining, "_MOST_ENDS", 10)
    monkeypatch.setattr(joining, "_MOST_CHAINS", 5)
    monkeypatch.setattr(joining, "_MOST_CHANGES", 3)
    chains = join(session)
    assert sorted(number for chain in chains for number in chain) == list(range(40))
    assert len(chain_doubts(session, chains)) == len(chains)


def test_nobody_is_as_fast_and_time_does_not_run_back() -> None:
    def end(time_s: float, x_m: float) -> Ends:
        return Ends(*(np.array([value]) for value in (time_s, [x_m, 0.0, 0.0], [0.0, 0.0, 0.0], 0, -1)))

    assert np.isneginf(link_scores(end(1.0, 0.0), end(1.1, 5.0), 20.0)).all()
    assert np.isneginf(link_scores(end(1.0, 0.0), end(0.9, 0.0), 20.0)).all()
    assert np.isneginf(link_scores(end(1.0, 0.0), end(602.0, 0.0), 20.0)).all()
    near, far, late = (link_scores(end(1.0, 0.0), end(*at), 20.0)[0] for at in ((1.2, 0.1), (1.2, 1.0), (9.0, 0.1)))
    assert near > far > -np.inf
    assert near > late > -np.inf
