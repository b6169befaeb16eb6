import numpy as np
import pytest

from pipeline.video.rotation import Rotator

SIZES = [(480, 640), (1080, 1920), (65, 3), (63, 129), (1, 1)]


@pytest.mark.parametrize("quarters", range(-1, 5))
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("is_view", [False, True])
def test_pixels_are_turned_exactly(size: tuple[int, int], quarters: int, is_view: bool) -> None:
    rotate, rng = Rotator(), np.random.default_rng(size)
    for _ in range(2):
        image = rng.integers(0, 256, (*size, 3), np.uint8)
        image = np.rot90(image) if is_view else image
        np.testing.assert_array_equal(rotate(image, quarters), np.rot90(image, quarters))


def test_memory_is_used_again_and_upright_pictures_are_not_copied() -> None:
    rotate, image = Rotator(), np.zeros((20, 30, 3), np.uint8)
    assert rotate(image, 0) is image
    assert np.shares_memory(rotate(image, 1), rotate(image + 1, 3))
    assert not np.shares_memory(rotate(image, 2), image)
