from collections.abc import Mapping

import numpy as np
import pytest

from pipeline.detection.network import MAX_DIFFERENCE, differs_by, noise


def of_cpu(image: np.ndarray) -> Mapping[str, np.ndarray]:
    return {"sum": image.sum((2, 3)), "double": 2 * image}


def test_noise_fills_range_and_is_same_every_time() -> None:
    picture = noise((96, 160))
    assert picture.shape == (1, 3, 96, 160)
    assert picture.dtype == np.float32
    assert 0.0 <= picture.min() < 0.3
    assert 0.7 < picture.max() <= 1.0
    np.testing.assert_array_equal(picture, noise((96, 160)))


def test_equal_outputs_do_not_differ() -> None:
    assert differs_by(of_cpu, of_cpu, (1, 3, 64, 96)) == 0.0


def test_sizes_that_are_not_fixed_are_chosen() -> None:
    assert differs_by(of_cpu, of_cpu, ("batch", 3, "height", "width")) == 0.0


@pytest.mark.parametrize(
    ("type_", "agrees"), [(np.float32, True), (np.float16, True), ("bfloat16", False)], ids=["single", "half", "bfloat"]
)
def test_precision_of_mantissa_decides(type_: object, agrees: bool) -> None:
    def reduced(image: np.ndarray) -> Mapping[str, np.ndarray]:
        if type_ == "bfloat16":  # the upper half of a single-precision number
            bits = np.ascontiguousarray(image).view(np.uint32) & np.uint32(0xFFFF0000)
            image = bits.view(np.float32)
        else:
            image = image.astype(type_).astype(np.float32)  # type: ignore[call-overload]
        return of_cpu(image)

    assert (differs_by(reduced, of_cpu, (1, 3, 64, 96)) <= MAX_DIFFERENCE) is agrees


def test_values_that_are_not_finite_differ_infinitely() -> None:
    def broken(image: np.ndarray) -> Mapping[str, np.ndarray]:
        return {**of_cpu(image), "sum": np.full((1, 3), np.nan, np.float32)}

    assert differs_by(broken, of_cpu, (1, 3, 64, 96)) == np.inf


def test_outputs_of_another_shape_differ_infinitely() -> None:
    def cut(image: np.ndarray) -> Mapping[str, np.ndarray]:
        return {**of_cpu(image), "double": image[:, :, 1:]}

    assert differs_by(cut, of_cpu, (1, 3, 64, 96)) == np.inf
