"""Shapes from distances: found but for axes and mirror image; contradictions and missing distances are named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.capture.own_points_file import DistancesError, places_from_distances

PLACES_M = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.3], [0.2, 0.3, -0.2]])
NAMES = ("a", "b", "c", "d", "e")


def between_m(places_m: np.ndarray) -> np.ndarray:
    return np.linalg.norm(places_m[:, None] - places_m, axis=-1)


@settings(deadline=None, max_examples=50)
@given(places_m=arrays(float, (5, 3), elements=st.floats(-1.0, 1.0)), num=st.integers(3, 5))
def test_places_have_their_distances(places_m: np.ndarray, num: int) -> None:
    wanted_m = between_m(places_m[:num])
    found_m = places_from_distances(NAMES[:num], wanted_m)
    assert found_m.shape == (num, 3)
    np.testing.assert_allclose(between_m(found_m), wanted_m, atol=1e-5)


def test_errors_of_a_ruler_are_spread() -> None:
    noise_m = np.random.default_rng(0).normal(0.0, 0.002, (5, 5))
    found_m = places_from_distances(NAMES, np.where(np.eye(5), 0.0, between_m(PLACES_M) + noise_m + noise_m.T))
    np.testing.assert_allclose(between_m(found_m), between_m(PLACES_M), atol=0.012)


def test_contradiction_names_the_distance() -> None:
    wanted_m = between_m(PLACES_M)
    wanted_m[0, 1] = wanted_m[1, 0] = 2.0
    with pytest.raises(DistancesError, match=r"contradict each other, in metres: a to b is 2 \(fits "):
        places_from_distances(NAMES, wanted_m)


def test_missing_distances_are_named() -> None:
    wanted_m = between_m(PLACES_M)
    for i, j in ((0, 1), (2, 4)):
        wanted_m[i, j] = wanted_m[j, i] = np.nan
    with pytest.raises(DistancesError, match="several shapes have these distances; state a to b, c to e, too"):
        places_from_distances(NAMES, wanted_m)
