"""Fields that no reader reads: a lens or a size is found by its numbers, other values are not mistaken for one."""

from typing import Any

import pytest

from pipeline.calibration.reading import lens_fields, size_fields

LENS = [-0.21, 0.07, 0.001, -0.002, 0.003, 0.02, -0.01, 0.004, 1e-4, 2e-4, 3e-4, 4e-4, 0.0, 0.0]
MATRIX = [[905.0, 0.0, 655.0], [0.0, 903.0, 351.0], [0.0, 0.0, 1.0]]


def names(fields: dict[str, Any], distortion: Any = None) -> list[str]:
    return list(lens_fields(fields, frozenset({"known"}), distortion))


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
@pytest.mark.parametrize(
    "name",
    [
        "discCoef",
        "dist_params",
        "distorsion",
        "Dist",
        "coeffs",
        "kc",
        "abc",
        "R_lens",
        "rgb_distortion",
        "firstDist",
        "lens_terms",
    ],
)
def test_list_as_long_as_lens_is_found_under_any_name(name: str, count: int) -> None:
    lens = LENS[:count]
    assert names({name: lens}) == names({name: [lens]}) == names({name: [[number] for number in lens]}) == [name]


@pytest.mark.parametrize(
    "fields",
    [
        {"k1": -0.2},
        {"K_2": 0.1},
        {"p1": 0.01},
        {"radialDistortion1": 0.1},
        {"kappa1": 1e-3},
        {"k": [0.1, 0.2, 0.3]},
        {"RadialDistortion": [-0.4, 0.18]},
        {"TangentialDistortion": [0.01, 0.0]},
        {"lens_correction": LENS[:5]},
        {"distorsions": [0.1]},
        {"coefs": [0.1, 0.2]},
        {"distortion_type": "brown"},
        {"distCoefs": [[0.1, 0.2], [0.3, 0.4]]},
    ],
)
def test_coefficients_are_found_by_name_whatever_their_number(fields: dict[str, Any]) -> None:
    assert names(fields) == [*fields]


def test_numbers_beyond_any_lens_are_found_too() -> None:
    assert names({"a": [1e308, 0.5, 1e308, 0.5], "b": [float("inf"), 0.5] * 6}) == ["a", "b"]


def test_lens_inside_another_field_is_named_by_its_path() -> None:
    assert names({"sensor": {"lens": {"c": LENS[:5]}, "gain": 3}}) == ["sensor.lens.c"]


@pytest.mark.parametrize(
    "fields",
    [
        {"known": LENS[:5]},
        {"spare": [0.0] * 5, "k1": 0.0, "extra": None, "empty": [], "missing": [None] * 4},
        {"quaternion": [0.5, -0.5, 0.5, 0.5], "identity": [0, 0, 0, 1], "q": [0.18257, 0.36515, 0.54772, 0.7303]},
        {"floor": [0.0, 0.6, 0.8, -1.3]},
        {"P": [905, 0, 655, 12.5, 0, 903, 351, -3.25, 0.36, 0.48, 0.8, 1.5]},
        {"crop": [0.1, 0.1, 0.8, 0.9], "area": [0, 0, 1280, 720], "boardCorners": [0.5] * 8, "white_rgba": [0.4] * 4},
        {"errors": [0.31, 0.29, 0.4, 0.35, 0.3], "rms_by_view": [0.2] * 12, "std_deviations": [0.01] * 8},
        {
            "distortion_std": [0.01] * 5,
            "distCoeffsStdDeviations": [0.01] * 8,
            "k1_error": 0.01,
        },
        {"timestamps": [0.01, 0.02, 0.03, 0.05]},
        {"distance": [1.1, 1.2, 1.3], "distance_m": 3.4, "undistorted": True, "undistort_map": [0.5] * 3},
        {"focal": [905.5, 903.2], "translation_2": [0.1, 0.2, 0.3], "E": [[0.1] * 3] * 3},
        {"serial": "k1", "k": "none", "gain": 3.5, "frames": [3, 4, 5, 20], "neighbours": [1, 2, 3, 4]},
    ],
)
def test_other_values_are_no_lens(fields: dict[str, Any]) -> None:
    assert names(fields) == []


def test_field_that_repeats_distortion_is_no_other_lens() -> None:
    assert names({"dist_original": LENS[:5]}, [LENS[:5]]) == []
    assert names({"dist_original": LENS[:5]}, LENS[1:6]) == ["dist_original"]


@pytest.mark.parametrize(
    ("fields", "found"),
    [
        ({"dims": [1280, 720]}, ["dims"]),
        ({"rows_and_columns": [[720], [1280]]}, ["rows_and_columns"]),
        ({"sensor": {"width": 1280, "height": 720}}, ["sensor.width", "sensor.height"]),
        ({"cols": 1280.0}, ["cols"]),
        ({"centre": [655, 351], "focal": [905, 903], "offset": [655.5, 351.5]}, []),
        ({"board_width": 9, "board": [9, 6], "grid": [20, 15], "range": [-5, 1280], "years": [12021, 12022]}, []),
        ({"exposure": 1280, "known": [1280, 720]}, []),
    ],
)
def test_size_is_pair_around_principal_point(fields: dict[str, Any], found: list[str]) -> None:
    assert list(size_fields(fields, frozenset({"known"}), MATRIX)) == found


@pytest.mark.parametrize("matrix", [None, "none", [[1.0]], [[float("nan")] * 3] * 3])
def test_size_is_not_looked_for_without_matrix(matrix: Any) -> None:
    assert list(size_fields({"dims": [1280, 720]}, frozenset(), matrix)) == []
