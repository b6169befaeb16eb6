"""The same video in two cameras, and videos that only look alike."""

import numpy as np
import pytest

from pipeline.capture.pictures.sample_pictures import same_video, similar_views
from tests.pipeline.capture.pictures.rooms import pictures_of, room, walk


def encoded_again(image: np.ndarray, seed: int) -> np.ndarray:
    """Picture with other brightness and contrast, and with errors as of a codec."""
    rng = np.random.default_rng(seed)
    return np.clip(10 + 0.9 * image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8)


FIRST = pictures_of("cam_0", walk(0, 4))


def test_encoded_copy_is_found_and_named() -> None:
    copy = pictures_of("cam_2", [encoded_again(image, seed) for seed, image in enumerate(walk(0, 4))])
    cameras = [FIRST, pictures_of("cam_1", walk(1, 4)), copy]
    assert similar_views(cameras) == [(0, 2)]
    finding = same_video(FIRST, copy, FIRST.figures, copy.figures)
    assert finding is not None
    assert (finding.code, finding.camera, finding.severity) == ("same_video", "cam_2", "warning")
    assert finding.evidence["other_camera"] == "cam_0"
    assert finding.evidence["similarity"] > 0.9
    assert finding.evidence["pictures"] == [2]


def test_same_view_with_other_people_is_no_copy() -> None:
    """As of cameras in a symmetric place, or of the camera's take before."""
    other = pictures_of("cam_1", walk(0, 4, from_px=150))
    assert similar_views([FIRST, other]) == [(0, 1)]
    assert same_video(FIRST, other, FIRST.figures, other.figures) is None


def test_same_view_in_which_nothing_moves_is_copy() -> None:
    one, other = (pictures_of(name, [encoded_again(room(0), 0)] * 3) for name in ("cam_0", "cam_1"))
    finding = same_video(one, other, one.figures, other.figures)
    assert finding is not None
    assert finding.evidence["similarity"] == 1.0


@pytest.mark.parametrize("seeds", [(0, 1), (2, 3), (4, 5)])
def test_other_views_are_not_alike(seeds: tuple[int, int]) -> None:
    assert similar_views([pictures_of(str(seed), walk(seed, 4)) for seed in seeds]) == []


def test_pictures_without_detail_are_not_alike() -> None:
    assert similar_views([pictures_of(name, [np.full((90, 160, 3), 90, np.uint8)] * 3) for name in "ab"]) == []


def test_too_few_pictures_say_nothing() -> None:
    assert same_video(FIRST, FIRST, FIRST.figures[:2], FIRST.figures[:2]) is None
