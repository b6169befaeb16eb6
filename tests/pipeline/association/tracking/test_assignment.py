import time
from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.association.tracking.initialization import assign, partition


def test_assign_maximises_total_and_refuses_negative_pairs() -> None:
    affinities = np.array([[0.9, 0.8], [0.85, 0.1], [-0.5, -0.2]])
    assert sorted(assign(affinities)) == [(0, 1), (1, 0)]


def test_assign_without_detections() -> None:
    assert assign(np.empty((2, 0))) == []


def test_partition_of_bad_triangle_drops_its_weakest_edge() -> None:
    # 0 and 1 are one person in two cameras; 2 fits both a little, but a camera can't show a person twice.
    affinities = np.array(
        [
            [-np.inf, 0.9, 0.3, -np.inf],
            [0.9, -np.inf, 0.2, 0.1],
            [0.3, 0.2, -np.inf, 0.8],
            [-np.inf, 0.1, 0.8, -np.inf],
        ]
    )
    # 0.9 + 0.8 beats 0.9 + 0.3 + 0.2.
    assert partition(affinities, np.array([0, 1, 2, 0])) == (((0, 1), (2, 3)), True)


def _best_by_enumeration(affinities: np.ndarray, groups: np.ndarray) -> float:
    """Total affinity of the best partition, by exhaustive search."""

    def partitions(nodes: list[int]) -> list[list[list[int]]]:
        if not nodes:
            return [[]]
        head, *rest = nodes
        found = []
        for size in range(len(rest) + 1):
            for others in combinations(rest, size):
                left = [node for node in rest if node not in others]
                found += [[[head, *others], *parts] for parts in partitions(left)]
        return found

    def total(parts: list[list[int]]) -> float:
        gain = 0.0
        for part in parts:
            if len({int(groups[i]) for i in part}) < len(part):
                return -np.inf
            gain += sum(affinities[i, j] for i, j in combinations(part, 2))
        return gain

    return max(total(parts) for parts in partitions(list(range(len(groups)))))


@given(
    groups=st.lists(st.integers(0, 2), min_size=2, max_size=6),
    seed=st.integers(0, 10_000),
)
def test_partition_is_exact(groups: list[int], seed: int) -> None:
    cameras = np.array(groups)
    half = np.triu(np.random.default_rng(seed).uniform(-1, 1, (len(groups), len(groups))), 1)
    affinities = half + half.T
    gain = sum(affinities[i, j] for part in partition(affinities, cameras).parts for i, j in combinations(part, 2))
    np.testing.assert_allclose(gain, _best_by_enumeration(affinities, cameras), atol=1e-6)


@given(groups=st.lists(st.integers(0, 2), min_size=2, max_size=6), seed=st.integers(0, 10_000))
def test_partition_of_people_who_stand_apart_is_exact(groups: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    person = rng.integers(0, 2, len(groups))
    same = person[:, None] == person[None, :]
    noise = np.triu(rng.uniform(-0.4, 0.1, same.shape), 1)
    affinities = np.where(same, 0.7, 0.0) + noise + noise.T
    cameras = np.array(groups)
    gain = sum(affinities[i, j] for part in partition(affinities, cameras).parts for i, j in combinations(part, 2))
    np.testing.assert_allclose(gain, _best_by_enumeration(affinities, cameras), atol=1e-6)


def test_partition_of_two_cameras_is_exact_whatever_its_size() -> None:
    num_people = 150
    affinities = np.full((2 * num_people, 2 * num_people), -np.inf)
    gain = np.random.default_rng(0).uniform(0, 1, (num_people, num_people))
    affinities[:num_people, num_people:], affinities[num_people:, :num_people] = gain, gain.T
    parts, is_exact = partition(affinities, np.repeat([0, 1], num_people))
    assert is_exact
    assert sorted((one, other - num_people) for one, other in parts) == sorted(assign(gain))


def test_large_ambiguous_partition_is_approximate_and_bounded() -> None:
    rng = np.random.default_rng(0)
    cameras = np.arange(512) % 4
    half = np.triu(rng.uniform(0.1, 1, (512, 512)), 1)
    affinities = half + half.T
    started_s = time.monotonic()
    parts, is_exact = partition(affinities, cameras)
    assert time.monotonic() - started_s < 20
    assert not is_exact
    assert all(len(set(cameras[list(part)])) == len(part) for part in parts)
    assert sum(map(len, parts)) == 512
    assert partition(affinities, cameras).parts == parts


@given(seed=st.integers(0, 10_000))
def test_camera_by_camera_finds_people_who_stand_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    person, cameras = np.tile(np.arange(30), 4), np.repeat(np.arange(4), 30)
    affinities = np.where(person[:, None] == person, rng.uniform(0.5, 1, (120, 120)), rng.uniform(-1, 0.2, (120, 120)))
    affinities = np.minimum(affinities, affinities.T)
    order = rng.permutation(120)
    parts, _ = partition(affinities[np.ix_(order, order)], cameras[order])
    assert sorted(tuple(sorted(person[order[list(part)]])) for part in parts) == [(k,) * 4 for k in range(30)]
