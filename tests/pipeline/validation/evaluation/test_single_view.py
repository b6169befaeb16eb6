import numpy as np

from pipeline.validation.evaluation.datasets.shelf_tracking import track_boxes

LEFT, RIGHT = [0.0, 0.0, 10.0, 20.0], [50.0, 0.0, 60.0, 20.0]


def test_boxes_that_overlap_are_one_track() -> None:
    moved = [2.0, 1.0, 12.0, 21.0]
    found = track_boxes(np.array([0, 0, 1, 1]), np.array([LEFT, RIGHT, RIGHT, moved]))
    assert found.tolist() == [0, 1, 1, 0]


def test_missed_frame_or_leap_ends_track() -> None:
    assert track_boxes(np.array([0, 2]), np.array([LEFT, LEFT])).tolist() == [0, 1]
    assert track_boxes(np.array([0, 1]), np.array([LEFT, RIGHT])).tolist() == [0, 1]


def test_nobody() -> None:
    assert track_boxes(np.empty(0, int), np.empty((0, 4))).tolist() == []
