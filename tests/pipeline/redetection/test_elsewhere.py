"""Bodies whose crops were read, and bodies that are expected elsewhere by now."""

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.data.detections import Detections
from pipeline.redetection.elsewhere import expected_elsewhere
from tests.pipeline.detect.topdown.people import standing_px

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
    assert frames_elsewhere([bodies((4, marks_px))], [bodies((4, lying()))]) == [[4] if is_elsewhere else []]


def test_angles_just_beyond_half_a_turn_are_alike() -> None:
    assert frames_elsewhere([bodies((4, lying(-177.0)))], [bodies((4, lying(177.0)))]) == [[]]


def test_crops_of_other_frames_and_cameras_do_not_count() -> None:
    expected = [bodies((3, lying()), (4, lying())), bodies((4, lying()), camera="right")]
    looked_for = [bodies((4, lying())), bodies(camera="right")]
    assert frames_elsewhere(expected, looked_for) == [[3], [4]]


def test_a_neighbour_in_the_picture_is_somebody_else() -> None:
    expected = [bodies((4, lying()), (4, lying() + 2 * SIDE_PX))]
    assert frames_elsewhere(expected, [bodies((4, lying() + 0.01))]) == [[4]]
    assert frames_elsewhere(expected, [bodies((4, lying() + 2 * SIDE_PX), (4, lying()))]) == [[]]


def test_a_body_too_small_to_read_is_not_looked_for() -> None:
    assert frames_elsewhere([bodies((4, lying(scale=0.05)))], [bodies()]) == [[]]
