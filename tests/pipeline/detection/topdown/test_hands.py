from dataclasses import replace

import numpy as np
import pytest

from pipeline.detection.topdown.hands import CROP_PX, Hand, decode_hand, hand_region, palm_length_px, without_doubles
from pipeline.detection.topdown.regions import Region
from tests.pipeline.detection.topdown.people import landmarks_px

REGION = Region((500.0, 300.0), 200.0, 0.5)
WRIST_PX = np.array([480.0, 340.0])
LEFT, RIGHT = 0, 1


def hand_px(wrist_px: np.ndarray = WRIST_PX, palm_px: float = 40.0) -> np.ndarray:
    """Wrist and fingers of an upright hand: knuckles a palm above the wrist, tips two palms above."""
    points = np.zeros((21, 2))
    for finger in range(5):
        for joint in range(4):
            points[1 + 4 * finger + joint] = (0.2 * (finger - 2), -1 - joint / 3)
    return wrist_px + palm_px * points


def outputs_of(points_px: np.ndarray, presence: float = 0.9, right: float = 0.1) -> dict[str, np.ndarray]:
    raw = np.zeros((21, 3), np.float32)
    raw[:, :2] = REGION.crop_from_image(points_px, CROP_PX)
    return {
        "landmarks": raw.reshape(1, 63),
        "presence": np.array([[presence]], np.float32),
        "handedness": np.array([[right]], np.float32),
    }


def test_region_of_hand_reaches_beyond_fingers() -> None:
    """Wrist (350, 230), index (352, 270) and little finger (360, 264): the hand points down."""
    region = hand_region(landmarks_px(), LEFT)
    assert region is not None
    knuckles_px = (2 * np.array([352.0, 270.0]) + (360.0, 264.0)) / 3
    along_px = knuckles_px - (350.0, 230.0)
    np.testing.assert_allclose(region.center_px, knuckles_px + 0.2 * along_px)
    assert region.side_px == pytest.approx(2 * 1.89 * np.linalg.norm(along_px))
    wrist, knuckles = region.crop_from_image(np.array([(350.0, 230.0), knuckles_px]), CROP_PX)
    assert wrist[0] == pytest.approx(111.5)
    assert wrist[1] > knuckles[1] > 111.5


def test_small_hands_and_missing_landmarks_have_no_region() -> None:
    center_px = landmarks_px().mean(0)
    assert hand_region(center_px + 0.2 * (landmarks_px() - center_px), RIGHT) is None
    assert hand_region(landmarks_px() * np.nan, RIGHT) is None


def test_hand_is_decoded_to_pixels_of_image() -> None:
    hand = decode_hand(outputs_of(hand_px()), REGION, 3, LEFT, WRIST_PX + np.array((4.0, 0.0)))
    assert hand is not None
    assert (hand.body, hand.side) == (3, LEFT)
    np.testing.assert_allclose(hand.points_px, hand_px(), atol=1e-3)
    assert hand.palm_px == pytest.approx(palm_length_px(hand_px()), abs=1e-3)
    assert hand.wrist_distance == pytest.approx(4 / hand.palm_px, abs=1e-3)


def test_handedness_confirms_but_does_not_decide() -> None:
    scores = {}
    for side in (LEFT, RIGHT):
        for right in (0.1, 0.9):
            hand = decode_hand(outputs_of(hand_px(), right=right), REGION, 0, side, WRIST_PX)
            assert hand is not None
            scores[side, right] = hand.score
    assert scores[LEFT, 0.1] == scores[RIGHT, 0.9] == pytest.approx(0.9)
    assert scores[LEFT, 0.9] == scores[RIGHT, 0.1] < 0.9


@pytest.mark.parametrize(
    ("points_px", "presence", "wrist_px"),
    [
        (hand_px(), 0.4, WRIST_PX),
        (hand_px(palm_px=15.0), 0.9, WRIST_PX),
        (hand_px(), 0.9, WRIST_PX + np.array((30.0, 0.0))),
        (hand_px(), 0.9, WRIST_PX * np.nan),
        (hand_px() * np.nan, 0.9, WRIST_PX),
    ],
    ids=["absent", "small", "on another wrist", "without a wrist", "without landmarks"],
)
def test_no_hand(points_px: np.ndarray, presence: float, wrist_px: np.ndarray) -> None:
    assert decode_hand(outputs_of(points_px, presence), REGION, 0, LEFT, wrist_px) is None


def test_foreshortened_palm_is_measured_across() -> None:
    flat_px = hand_px() * (1.0, 0.01)
    across_px = np.linalg.norm(flat_px[17] - flat_px[5])
    assert palm_length_px(flat_px) == pytest.approx(across_px)


def test_hand_in_two_crops_belongs_to_nearer_wrist() -> None:
    far = Hand(0, LEFT, hand_px() + 2.0, 0.95, 40.0, 0.5)
    near = Hand(1, RIGHT, hand_px(), 0.7, 40.0, 0.1)
    other = replace(far, body=2, points_px=hand_px() + np.array((40.0, 0.0)))
    kept = without_doubles([far, near, other])
    assert {(hand.body, hand.side) for hand in kept} == {(1, RIGHT), (2, LEFT)}
