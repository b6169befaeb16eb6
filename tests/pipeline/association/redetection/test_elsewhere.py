"""Bodies whose crops were read, and bodies that are expected elsewhere by now."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.redetection.elsewhere import expected_elsewhere
from pipeline.core.data.detections import Detections
from tests.pipeline.detection.topdown.people import standing_px

SIDE_PX = float(np.ptp(standing_px(), axis=0).max())


def bodies(*places: tuple[int, np.ndarray], camera: str = "left") -> Detections:
    """Expected bodies of a camera, each in a frame."""
    marks_px = np.array([marks_px for _, marks_px in places]).reshape(-1, 17, 2)
    frames = np.array([frame for frame, _ in places], np.int64)
    return Detections(camera, frames, marks_px, np.ones((len(places), 17)), np.full((len(places), 4), np.nan))


def lying(turn_deg: float = 90.0, scale: float = 1.0) -> np.ndarray:
    """Somebody who stands, turned about the middle of the body."""
    middle_px, angle = standing_px().mean(0), np.radians(turn_deg)
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(middle_px + scale * (standing_px() - middle_px) @ axes.T)


def frames_elsewhere(expected: Sequence[Detections], looked_for: Sequence[Detections]) -> list[list[int]]:
    kept = expected_elsewhere(expected, looked_for, {"left": 0.0, "right": 0.0})
    assert [of_camera.camera for of_camera in kept] == [of_camera.camera for of_camera in expected]
    return [of_camera.frame.tolist() for of_camera in kept]


def three(marks_px: np.ndarray) -> Detections:
    """Somebody in three pictures, which are enough to be decoded again."""
    return bodies(*((frame, marks_px) for frame in (4, 5, 6)))


@pytest.mark.parametrize(
    ("marks_px", "is_elsewhere"),
    [
        (lying(), False),
        (lying() + 0.02 * SIDE_PX, False),
        (lying() + 0.5 * SIDE_PX, True),
        (lying(95.0), False),
        (lying(130.0), True),
        (lying(-90.0), True),
        (lying(scale=1.05), False),
        (lying(scale=1.5), True),
    ],
)
def test_only_another_crop_is_read_again(marks_px: np.ndarray, is_elsewhere: bool) -> None:
    assert frames_elsewhere([three(marks_px)], [three(lying())]) == [[4, 5, 6] if is_elsewhere else []]


def test_angles_just_beyond_half_a_turn_are_alike() -> None:
    assert frames_elsewhere([three(lying(-177.0))], [three(lying(177.0))]) == [[]]


def test_crops_of_other_frames_and_cameras_do_not_count() -> None:
    expected = [bodies(*((frame, lying()) for frame in range(7))), replace(three(lying()), camera="right")]
    assert frames_elsewhere(expected, [three(lying()), bodies(camera="right")]) == [[0, 1, 2, 3], [4, 5, 6]]


def test_a_neighbour_in_the_picture_is_somebody_else() -> None:
    neighbours = lying(), lying() + 2 * SIDE_PX
    expected = [bodies(*((frame, marks_px) for frame in (4, 5, 6) for marks_px in neighbours))]
    assert frames_elsewhere(expected, [three(lying() + 0.01)]) == [[4, 5, 6]]
    assert frames_elsewhere(expected, expected) == [[]]


def test_a_body_too_small_to_read_is_not_looked_for() -> None:
    assert frames_elsewhere([three(lying(scale=0.05))], [bodies()]) == [[]]


def test_pictures_are_not_decoded_again_for_one_or_two() -> None:
    expected = [bodies(*((frame, lying()) for frame in (0, 4, 4, 8))), bodies((0, lying()), (4, lying()))]
    assert frames_elsewhere(expected, [bodies(), bodies()]) == [[0, 4, 4, 8], []]
