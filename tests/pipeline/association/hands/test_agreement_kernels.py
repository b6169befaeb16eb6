"""Choice of the hands that views agree on."""

import numpy as np
import pytest

from pipeline.association.hands.agreement_kernels import Agreement, choose_hands

CENTERS_M = np.array([[4.0, 0.0, 1.5], [0.0, 4.0, 1.5], [-4.0, 0.0, 1.5], [0.0, -4.0, 1.5]])
WRISTS_M = np.array([[0.4, 0.0, 1.0], [-0.4, 0.0, 1.0]])
PALM_M = np.array([[0.02, 0.02, 0.0], [0.03, 0.08, 0.0], [0.01, 0.09, 0.01], [-0.01, 0.085, 0.01], [-0.03, 0.075, 0.0]])


def rays_to(points_m: np.ndarray) -> np.ndarray:
    """Unit rays of all cameras to both hands, (1, cameras, 2, knuckles, 3)."""
    away_m = points_m[None] - CENTERS_M[:, None, None]
    return (away_m / np.linalg.norm(away_m, axis=-1, keepdims=True))[None]


def chosen_hands(rays: np.ndarray, weights: np.ndarray, wrists_m: np.ndarray = WRISTS_M) -> list[list[int]]:
    num_views, num_knuckles = rays.shape[1], rays.shape[3]
    agreement = Agreement(
        0.04, 0.14, 0.0076, 0.8, np.empty((num_knuckles, 3)), np.empty((2, num_knuckles, 3)), np.empty((num_views, 2))
    )
    chosen = np.empty((1, num_views, 2), np.int64)
    choose_hands(agreement, rays, weights, CENTERS_M, wrists_m[None], chosen)
    result: list[list[int]] = chosen[0].tolist()
    return result


@pytest.fixture
def rays() -> np.ndarray:
    return rays_to(WRISTS_M[:, None] + PALM_M)


@pytest.fixture
def weights() -> np.ndarray:
    return np.full((1, 4, 2), 0.7)


def test_views_that_agree_keep_their_hands(rays: np.ndarray, weights: np.ndarray) -> None:
    assert chosen_hands(rays, weights) == [[0, 1]] * 4


def test_exchanged_view_is_exchanged_back(rays: np.ndarray, weights: np.ndarray) -> None:
    rays[0, 2] = rays[0, 2, ::-1].copy()
    assert chosen_hands(rays, weights) == [[0, 1], [0, 1], [1, 0], [0, 1]]


def test_hand_without_its_detection_is_found_by_other(rays: np.ndarray, weights: np.ndarray) -> None:
    """A camera reports the left hand as the right one, and no left hand."""
    rays[0, 1, 1], rays[0, 1, 0] = rays[0, 1, 0], np.nan
    weights[0, 1, 0] = 0.0
    assert chosen_hands(rays, weights)[1] == [1, -1]


def test_hand_elsewhere_is_dropped(rays: np.ndarray, weights: np.ndarray) -> None:
    rays[0, 0, 0] = rays_to(WRISTS_M[:, None] + PALM_M + [0.0, 0.0, 0.3])[0, 0, 0]
    assert chosen_hands(rays, weights) == [[-1, 1], [0, 1], [0, 1], [0, 1]]


def test_hand_of_one_view_is_dropped(rays: np.ndarray, weights: np.ndarray) -> None:
    weights[0, 1:, 0] = 0.0
    assert chosen_hands(rays, weights) == [[-1, 1]] * 4


def test_two_views_that_disagree_give_nothing(rays: np.ndarray, weights: np.ndarray) -> None:
    weights[0, 2:, 0] = 0.0
    rays[0, 1, 0] = rays_to(WRISTS_M[:, None] + PALM_M + [0.0, 0.0, 0.1])[0, 1, 0]
    assert chosen_hands(rays, weights) == [[-1, 1]] * 4


@pytest.mark.slow
def test_views_from_opposite_sides_do_not_tell_depth(weights: np.ndarray) -> None:
    in_line_m = np.array([[[0.0, y, 1.5] for y in (0.0, 0.01, 0.02, 0.03, 0.04)]] * 2)
    weights[0, [1, 3]] = 0.0
    assert chosen_hands(rays_to(in_line_m), weights, in_line_m[:, 0]) == [[-1, -1]] * 4


def test_without_wrist_there_is_no_hand(rays: np.ndarray, weights: np.ndarray) -> None:
    wrists_m = WRISTS_M.copy()
    wrists_m[1] = np.nan
    assert chosen_hands(rays, weights, wrists_m) == [[0, -1]] * 4


def test_hand_is_of_one_side(weights: np.ndarray) -> None:
    """Folded hands: both sides could have either hand."""
    wrists_m = np.array([[0.02, 0.0, 1.0], [-0.02, 0.0, 1.0]])
    chosen = chosen_hands(rays_to(wrists_m[:, None] + PALM_M), weights, wrists_m)
    assert chosen == [[0, 1]] * 4
