import numpy as np
import pytest

from pipeline.validation.evaluation.mpjpe import MotFrame, box_overlap, score_mot


def frame(people: list[int], tracks: list[int], pairs: list[tuple[int, int]]) -> MotFrame:
    similarity = np.zeros((len(people), len(tracks)))
    for person, track in pairs:
        similarity[people.index(person), tracks.index(track)] = 0.9
    return MotFrame(np.array(people, dtype=np.int64), np.array(tracks, dtype=np.int64), similarity)


def test_all_right() -> None:
    scores = score_mot([frame([1, 2], [7, 9], [(1, 7), (2, 9)])] * 10)
    assert (scores.mota, scores.idf1, scores.switches) == (1.0, 1.0, 0)


def test_miss_ghost_and_switch() -> None:
    right = frame([1], [7], [(1, 7)])
    scores = score_mot([right, frame([1], [], []), frame([1], [7, 8], [(1, 7)]), *[frame([1], [9], [(1, 9)])] * 2])
    assert (scores.missed, scores.false_positives, scores.switches) == (1, 1, 1)
    assert scores.mota == pytest.approx(1 - 3 / 5)
    # Track 7 or 9 fits best with 2 of 5 true frames; 5 frames were found.
    assert scores.idf1 == pytest.approx(2 * 2 / (5 + 5))


def test_nobody_there() -> None:
    scores = score_mot([frame([], [1], [])])
    assert (scores.mota, scores.idf1, scores.false_positives) == (None, None, 1)


def test_overlap_of_boxes() -> None:
    boxes = np.array([[0.0, 0.0, 2.0, 2.0], [5.0, 5.0, 6.0, 6.0], [1.0, 1.0, 1.0, 1.0]])
    np.testing.assert_allclose(box_overlap(boxes[:1], np.array([[1.0, 0.0, 3.0, 2.0]])), [[1 / 3]])
    np.testing.assert_allclose(box_overlap(boxes, boxes), np.diag([1.0, 1.0, 0.0]))
