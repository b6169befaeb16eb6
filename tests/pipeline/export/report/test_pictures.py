"""Moments of a report's pictures, and their size."""

import cv2
import numpy as np

from pipeline.core.joints import COCO_17
from pipeline.export.quality.views import person_views
from pipeline.export.report.pictures import LONG_SIDE_PX, Moment, choose_moments, draw_picture, presence
from tests.pipeline.export.test_overlay import CAMERA, LARGE, standing
from tests.pipeline.export.viewer.takes import take
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

NAN = np.nan


def moments(num_people: list[int], error_px: list[float], num_cameras: int = 4) -> list[Moment]:
    return choose_moments(np.array(num_people), np.array(error_px), num_cameras)


def test_moments() -> None:
    errors = [NAN, 2.0, 3.0, 2.0, 30.0, NAN]
    fullest, worst = moments([0, 1, 2, 2, 2, 1], errors)
    assert fullest.frame == 3
    assert (worst.frame, worst.title) == (4, "Largest reprojection error (30.0 px)")
    # Many cameras have pictures of one moment.
    assert [one.frame for one in moments([0, 1, 2, 2, 2, 1], errors, num_cameras=17)] == [3]
    assert [one.frame for one in moments([0, 0, 0, 0], [NAN] * 4)] == [2]
    assert [one.frame for one in moments([1, 1, 1], [1.0, 5.0, 1.0])] == [1]


def test_presence_counts_people_and_takes_worst_error() -> None:
    people = take(track_of(walker(60), 1, 7), track_of(walker(30) + 1.0, 2, 50))
    num_people, error_px = presence(people, person_views(people))
    assert num_people.tolist() == [0] * 7 + [1] * 43 + [2] * 17 + [1] * 13 + [0] * 20
    assert np.isnan(error_px[:7]).all()


def test_presence_of_nobody_is_zero() -> None:
    nobody = take(num_frames=10)
    num_people, error_px = presence(nobody, person_views(nobody))
    assert num_people.tolist() == [0] * 10
    assert np.isnan(error_px).all()


def test_pictures_are_small_and_show_people() -> None:
    grey = np.full((1200, 1600, 3), 90, np.uint8)
    size_px, jpeg = draw_picture(grey, LARGE, {1: standing(0.0)[1]}, COCO_17)
    assert size_px == (LONG_SIDE_PX, 600)
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (600, 800, 3)
    assert (np.abs(image.astype(int) - 90) > 60).any(-1).sum() > 500


def test_without_video_ground_is_dark() -> None:
    size_px, jpeg = draw_picture(None, CAMERA, {}, COCO_17)
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert size_px == (640, 480)
    assert image.max() < 60
