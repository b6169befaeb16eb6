"""Colours of bodies: which bins they fill, and when they are unknown."""

import numpy as np
import pytest

from pipeline.core.joints import COCO_17, COCO_18, JointSet
from pipeline.detection.appearance import NUM_BINS, PARTS, colour_histograms

RED, BLUE, PALE_RED = (200, 20, 20), (20, 20, 200), (220, 150, 150)
BLACK, GREY, WHITE = (15, 15, 15), (120, 120, 120), (240, 240, 240)
# Shoulders, hips, knees and ankles of a body that faces the camera.
PLACES_PX = {
    "shoulder": (20.0, 30.0),
    "hip": (14.0, 90.0),
    "knee": (14.0, 130.0),
    "ankle": (14.0, 170.0),
}
CENTER_PX = 100.0


def body(joints: JointSet = COCO_17) -> tuple[np.ndarray, np.ndarray]:
    """Joints and scores of one body; the joints of the head and the arms are unknown."""
    keypoints_px, score = np.full((1, len(joints.names), 2), np.nan), np.zeros((1, len(joints.names)))
    for joint, (beside_px, y_px) in PLACES_PX.items():
        for side, sign in (("left", 1), ("right", -1)):
            keypoints_px[0, joints.index(f"{side}_{joint}")] = CENTER_PX + sign * beside_px, y_px
            score[0, joints.index(f"{side}_{joint}")] = 0.9
    return keypoints_px, score


def image(torso: tuple[int, int, int], legs: tuple[int, int, int]) -> np.ndarray:
    """Picture of a green room with a person."""
    picture = np.full((200, 200, 3), (30, 160, 30), np.uint8)
    picture[25:95, 70:130] = torso
    picture[95:180, 75:125] = legs
    return picture


def measured(picture: np.ndarray, keypoints_px: np.ndarray, score: np.ndarray) -> np.ndarray:
    return colour_histograms(picture, keypoints_px, score, COCO_17)


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Hellinger distance of two histograms."""
    one, other = one / one.sum(), other / other.sum()
    return float(np.sqrt(max(0.0, 1 - np.sqrt(one * other).sum())))


def test_each_part_has_colours_of_its_clothes() -> None:
    (histograms,) = measured(image(RED, BLUE), *body())
    assert (histograms.shape, histograms.dtype) == ((len(PARTS), NUM_BINS), np.uint8)
    torso, legs = histograms
    assert torso[[12, 23]].sum() + torso[13] == torso.sum() > 250  # strong red, and no green of the room
    assert legs[[19, 20, 21]].sum() == legs.sum() > 250


def test_row_takes_little_room() -> None:
    assert len(PARTS) * NUM_BINS <= 64


def test_joint_set_with_other_numbers_gives_same() -> None:
    ours = measured(image(RED, GREY), *body())
    np.testing.assert_array_equal(colour_histograms(image(RED, GREY), *body(COCO_18), COCO_18), ours)


@pytest.mark.parametrize("light", [0.5, 0.75, 1.2])
def test_light_changes_colour_less_than_other_clothes_do(light: float) -> None:
    plain = measured(image(RED, PALE_RED), *body())[0]
    other = measured((light * image(RED, PALE_RED)).clip(0, 255).astype(np.uint8), *body())[0]
    assert distance(plain[0], measured(image(BLUE, RED), *body())[0, 0]) > 0.9
    assert distance(plain[0], other[0]) < 0.2
    assert distance(plain[1], other[1]) < 0.2


def test_clothes_without_hue_differ_by_their_brightness() -> None:
    torsos = [measured(image(colour, GREY), *body())[0, 0] for colour in (BLACK, GREY, WHITE)]
    assert all(torso[24:].sum() == torso.sum() for torso in torsos)
    assert min(distance(torsos[0], torsos[1]), distance(torsos[1], torsos[2])) > 0.9


@pytest.mark.parametrize("fault", ["missing", "low", "outside", "short"])
def test_part_without_its_joints_is_unknown(fault: str) -> None:
    keypoints_px, score = body()
    hip = COCO_17.index("left_hip")
    match fault:
        case "missing":
            keypoints_px[0, hip], score[0, hip] = np.nan, 0.0
        case "low":
            score[0, hip] = 0.1
        case "outside":
            keypoints_px[0, hip, 0] = 200.0
        case "short":
            keypoints_px = CENTER_PX + 0.04 * (keypoints_px - CENTER_PX)
    torso, legs = measured(image(RED, BLUE), keypoints_px, score)[0]
    assert not torso.any()
    # The other leg is known all the same, unless the whole body is too small.
    assert legs.any() == (fault != "short")


def test_records_of_others_change_nothing() -> None:
    rng = np.random.default_rng(3)
    picture = rng.integers(0, 256, (200, 200, 3), dtype=np.uint8)
    keypoints_px, score = (np.repeat(one, 5, axis=0) for one in body())
    keypoints_px += rng.normal(0.0, 15.0, keypoints_px.shape)
    together = measured(picture, keypoints_px, score)
    alone = [measured(picture, keypoints_px[[k]], score[[k]])[0] for k in range(5)]
    np.testing.assert_array_equal(together, alone)


def test_stored_joints_give_same_bytes_as_those_of_network() -> None:
    picture = np.random.default_rng(4).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    keypoints_px, score = (one.astype(np.float32) for one in body())
    keypoints_px += np.float32(0.1)
    np.testing.assert_array_equal(
        measured(picture, keypoints_px, score), measured(picture, keypoints_px.astype(float), score.astype(float))
    )


def test_picture_without_people_has_no_rows() -> None:
    nobody = np.empty((0, 17, 2)), np.empty((0, 17))
    assert measured(image(RED, BLUE), *nobody).shape == (0, len(PARTS), NUM_BINS)
    keypoints_px, score = body()
    assert not measured(image(RED, BLUE), keypoints_px, 0 * score).any()
