"""Dark, blurred and frozen pictures of drawn rooms."""

import cv2
import numpy as np
import pytest

from pipeline.capture.pictures.sample_pictures import check_pictures
from pipeline.core.findings import Finding
from tests.pipeline.capture.pictures.rooms import pictures_of, room, walk

WALKS = {name: walk(seed, 6) for seed, name in enumerate(("left", "right"))}


def check(**changed: list[np.ndarray]) -> list[Finding]:
    images = {**WALKS, **changed}
    return check_pictures([pictures_of(name, images[name]) for name in images])


def darker(image: np.ndarray, factor: float) -> np.ndarray:
    return np.round(factor * image.astype(float)).astype(np.uint8)


def test_nothing_is_wrong_with_good_pictures() -> None:
    assert check() == []


def test_dark_picture() -> None:
    (finding,) = check(right=[darker(image, 0.12) for image in WALKS["right"]])
    assert (finding.code, finding.camera, finding.severity) == ("picture_dark", "right", "warning")
    assert finding.evidence == {"dark_share": 1.0, "num_pictures": 6, "pictures": [0, 5]}


@pytest.mark.parametrize("factor", [0.4, 0.6])
def test_dusk_is_not_dark(factor: float) -> None:
    assert check(right=[darker(image, factor) for image in WALKS["right"]]) == []


def test_lit_people_on_black_stage_are_not_in_dark() -> None:
    stage = [np.where(image == (240, 220, 60), image, 5).astype(np.uint8) for image in WALKS["right"]]
    assert check(right=stage) == []


def test_light_that_is_switched_on_late_is_not_most_of_time() -> None:
    assert check(right=[darker(image, 0.1 if k < 3 else 1.0) for k, image in enumerate(WALKS["right"])]) == []


def test_blurred_picture() -> None:
    (finding,) = check(left=[cv2.GaussianBlur(image, (0, 0), 4.0) for image in WALKS["left"]])
    assert (finding.code, finding.camera, finding.severity) == ("picture_blurred", "left", "warning")
    # 4 of 320 pixels are 1.25 %.
    assert 0.008 < finding.evidence["blur_share"] < 0.0125


def test_frozen_picture() -> None:
    frozen = WALKS["right"][:1] + [WALKS["right"][1]] * 5
    (finding,) = check(right=frozen)
    assert (finding.code, finding.camera, finding.severity) == ("picture_frozen", "right", "warning")
    assert finding.evidence == {
        "start_s": 1.0,
        "stop_s": 5.0,
        "other_camera": "left",
        "num_pictures": 6,
        "pictures": [1, 5],
    }


def test_picture_that_stands_still_for_less_than_half_of_time() -> None:
    assert check(right=WALKS["right"][:4] + [WALKS["right"][4]] * 2) == []


def test_nobody_moves_anywhere() -> None:
    assert check(left=[room(0)] * 6, right=[room(1)] * 6) == []


def test_camera_without_pictures_is_left_out() -> None:
    assert check(right=[]) == []
