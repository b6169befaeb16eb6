"""Colours of clothes as evidence: what distances say, and that uniforms say nothing."""

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.association.identity.clothes import (
    MAX_LOG_RATIO,
    Clothes,
    ColourDistances,
    Contrast,
    clothes_likelihood_ratios,
    learn_contrast,
    log_likelihood_ratios,
    mean_clothes,
)

NUM_CAMERAS, NUM_BINS = 3, 32
CONTRAST = Contrast(ColourDistances(0.1, 0.7, 0.2), ColourDistances(0.3, 0.7, 0.2))


def shirt(first_bin: int) -> np.ndarray:
    """Histograms of both parts with most of their weight in four bins."""
    share = np.full((2, NUM_BINS), 1.0)
    share[:, np.arange(first_bin, first_bin + 4) % NUM_BINS] = 60.0
    return share / share.sum(-1, keepdims=True)


def tint(share: np.ndarray, camera: int) -> np.ndarray:
    """Colours as a camera with its own white balance shows them: shifted by a share of a bin for each camera."""
    return (1 - 0.3 * camera) * share + 0.3 * camera * np.roll(share, 1, axis=-1)


def seen(
    first_bin: int, rng: np.random.Generator, cameras: Sequence[int] = range(NUM_CAMERAS), num_each: int = 20
) -> Clothes:
    """Clothes of a piece: detections with noise, in some cameras."""
    camera = np.repeat(np.array(cameras, int), num_each)
    noisy = [tint(shirt(first_bin), one) * rng.uniform(0.3, 1.0, (2, NUM_BINS)) for one in camera]
    bytes_of = [np.rint(255 * one / one.sum(-1, keepdims=True)).astype(np.uint8) for one in noisy]
    return mean_clothes(np.array(bytes_of, np.uint8).reshape(-1, 2, NUM_BINS), camera, NUM_CAMERAS)


def learnt(shirts: Sequence[int], num_pieces: int = 4, seed: int = 1) -> tuple[list[Clothes], Contrast]:
    """Pieces of people who are there together again and again, piece after piece, and their contrast."""
    rng = np.random.default_rng(seed)
    pieces = [seen(one, rng) for _ in range(num_pieces) for one in shirts]
    halves = [(seen(one, rng, num_each=10), seen(one, rng, num_each=10)) for _ in range(num_pieces) for one in shirts]
    time = np.repeat(np.arange(num_pieces), len(shirts))
    return pieces, learn_contrast(pieces, halves, (time[:, None] == time) & ~np.eye(len(time), dtype=bool))


def log_likelihood_ratio(first: Clothes, second: Clothes, contrast: Contrast) -> float:
    return float(log_likelihood_ratios([first, second], contrast)[0, 1])


def test_mean_counts_only_detections_with_part() -> None:
    colour = np.zeros((4, 2, NUM_BINS), np.uint8)
    colour[0, 0, 3], colour[1, 0, 5], colour[2, 1, 7] = 255, 255, 200
    clothes = mean_clothes(colour, np.array([0, 0, 2, 2]), NUM_CAMERAS)
    assert clothes.num_detections.tolist() == [[2, 0], [0, 0], [0, 1]]
    assert clothes.share[0, 0, [3, 5]].tolist() == [0.5, 0.5]
    assert clothes.share[2, 1, 7] == 1.0
    assert clothes.share.sum() == 2.0


def test_clothes_speak_for_equal_and_against_other_persons() -> None:
    rng = np.random.default_rng(2)
    one, again, other = seen(0, rng), seen(0, rng), seen(16, rng)
    assert log_likelihood_ratio(one, again, CONTRAST) == MAX_LOG_RATIO
    assert log_likelihood_ratio(one, other, CONTRAST) == -MAX_LOG_RATIO


def test_ratio_is_that_of_two_normal_distributions() -> None:
    distances = ColourDistances(0.2, 0.6, 0.3)
    at = np.array([0.1, 0.25, 0.4, 0.55])
    log_density = [-0.5 * ((at - mean) / 0.3) ** 2 for mean in (0.2, 0.6)]
    np.testing.assert_allclose(distances.log_ratio(at), log_density[0] - log_density[1], atol=1e-12)


def test_pieces_are_compared_in_cameras_that_saw_both() -> None:
    rng = np.random.default_rng(3)
    silent = Contrast(ColourDistances(0.3, 0.3, 0.2), CONTRAST.across_cameras)
    assert log_likelihood_ratio(seen(0, rng), seen(16, rng, [0]), silent) == 0.0
    assert log_likelihood_ratio(seen(0, rng, [1, 2]), seen(16, rng, [0]), silent) < 0.0
    apart = log_likelihood_ratio(seen(0, rng, [0]), seen(0, rng, [1]), CONTRAST)
    far = log_likelihood_ratio(seen(0, rng, [0]), seen(16, rng, [1]), CONTRAST)
    assert far < 0 < apart


@pytest.mark.parametrize("cameras", [[], [0]])
def test_unknown_values_have_no_weight(cameras: list[int]) -> None:
    rng = np.random.default_rng(4)
    nobody = seen(0, rng, cameras, num_each=4)  # too few detections
    assert log_likelihood_ratio(nobody, seen(0, rng), CONTRAST) == 0.0
    assert log_likelihood_ratio(seen(16, rng), nobody, CONTRAST) == 0.0
    uncoloured = mean_clothes(np.zeros((30, 0, 0), np.uint8), np.zeros(30, int), NUM_CAMERAS)
    assert log_likelihood_ratio(uncoloured, uncoloured, CONTRAST) == 0.0
    assert log_likelihood_ratios([], CONTRAST).shape == (0, 0)


def test_all_pairs_are_as_each_pair() -> None:
    rng = np.random.default_rng(5)
    pieces = [seen(0, rng), seen(9, rng, [0]), seen(9, rng, [1, 2]), seen(3, rng, [2]), seen(0, rng, [])]
    ratios = log_likelihood_ratios(pieces, CONTRAST)
    np.testing.assert_array_equal(ratios, ratios.T)
    for k, one in enumerate(pieces):
        assert ratios[k, k] == 0.0
        for j in range(k):
            assert ratios[j, k] == pytest.approx(log_likelihood_ratio(pieces[j], one, CONTRAST), rel=1e-12)


def test_piece_against_others_is_row_of_all_pairs() -> None:
    rng = np.random.default_rng(5)
    pieces = [seen(0, rng, [0]), seen(9, rng), seen(9, rng, [1, 2]), seen(0, rng), seen(0, rng, [])]
    row = clothes_likelihood_ratios(pieces[0], pieces[1:], CONTRAST)
    np.testing.assert_allclose(row, log_likelihood_ratios(pieces, CONTRAST)[0, 1:], rtol=1e-12)
    assert row[2] > 0.0 > row[0]


def test_two_pieces_together_are_as_one_piece() -> None:
    rng = np.random.default_rng(6)
    colour = rng.integers(0, 40, (60, 2, NUM_BINS)).astype(np.uint8)
    colour[:10, 1] = 0
    colour = np.where(
        colour.any(-1, keepdims=True), np.rint(255 * colour / np.maximum(colour.sum(-1), 1)[..., None]), 0
    )
    camera = np.repeat([0, 0, 2], 20)
    whole, *parts = (
        mean_clothes(colour[rows].astype(np.uint8), camera[rows], NUM_CAMERAS)
        for rows in (slice(None), slice(0, 25), slice(25, None))
    )
    together = parts[0].joined(parts[1])
    np.testing.assert_array_equal(together.num_detections, whole.num_detections)
    # Sums of a histogram's bytes differ a little from 255.
    np.testing.assert_allclose(together.share, whole.share, atol=1e-3)
    np.testing.assert_array_equal(together.share[1], 0.0)


def test_different_clothes_have_contrast() -> None:
    pieces, contrast = learnt([0, 8, 20])
    assert contrast.within_camera.different - contrast.within_camera.same > 0.4
    ratios = log_likelihood_ratios(pieces, contrast)
    person = np.tile(np.arange(3), 4)
    is_same = person[:, None] == person
    np.fill_diagonal(is_same, False)
    assert ratios[is_same].min() > 2.0
    assert ratios[person[:, None] != person].max() < -2.0


@pytest.mark.parametrize("num_people", [2, 5])
def test_uniforms_say_nothing(num_people: int) -> None:
    pieces, contrast = learnt([4] * num_people)
    assert np.abs(log_likelihood_ratios(pieces, contrast)).max() < 0.1


def test_clothes_of_teams_tell_teams_not_persons() -> None:
    pieces, contrast = learnt([0, 0, 0, 16, 16, 16])
    ratios = log_likelihood_ratios(pieces, contrast)
    team = np.tile([0, 0, 0, 1, 1, 1], 4)
    is_same = team[:, None] == team
    np.fill_diagonal(is_same, False)
    # Bayes: of five others two are of the same team, log(5 / 2) is 0.9.
    assert 0.3 < np.median(ratios[is_same]) < 2.0
    assert ratios[team[:, None] != team].max() < -1.0


def test_people_who_are_never_there_together_say_nothing() -> None:
    rng = np.random.default_rng(6)
    one, other = pieces = [seen(0, rng), seen(16, rng)]
    halves = [(piece, piece) for piece in pieces]
    contrast = learn_contrast(pieces, halves, np.zeros((2, 2), bool))
    assert log_likelihood_ratio(one, other, contrast) == 0.0
    assert learn_contrast([], [], np.zeros((0, 0), bool)).within_camera.log_ratio(np.array([0.1, 0.9])).tolist() == [
        0,
        0,
    ]


def test_one_pair_of_people_says_less_than_many() -> None:
    _, one_pair = learnt([0, 16], num_pieces=1)
    _, many = learnt([0, 16], num_pieces=6)
    assert one_pair.within_camera.different < many.within_camera.different - 0.2
    assert one_pair.within_camera.log_ratio(np.array([0.1]))[0] > 0.5
