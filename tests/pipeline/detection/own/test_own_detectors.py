from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from pipeline.core.data.arrays import read_only
from pipeline.core.joints import COCO_17
from pipeline.detection.bodies import BodyDetector, ImageBodies
from pipeline.detection.letterbox import PictureTurn
from pipeline.detection.network import open_network
from pipeline.detection.own.own_detectors import as_input, crop_matrix, open_own
from pipeline.detection.own_network import usual_network
from tests.pipeline.detection.own.networks import heatmaps, rtmo, simcc, write

SIZE = (400, 300)


class OneBody:
    """Detector of a body whose joints lie in a box, and of a body without joints that count."""

    joints = COCO_17

    def detect(self, image_rgb: np.ndarray) -> ImageBodies:
        keypoints_px = np.full((2, 17, 2), np.nan)
        keypoints_px[0, :2] = [(120.0, 80.0), (220.0, 240.0)]
        score = np.zeros((2, 17))
        score[0, :2] = 0.9
        return ImageBodies(read_only(keypoints_px), read_only(score), np.zeros((2, 4)), np.array([0.8, 0.7]))


def image_of(x: float, y: float) -> np.ndarray:
    """Bright blob at a place of a black image."""
    squared = (np.arange(SIZE[0]) - x) ** 2 + ((np.arange(SIZE[1]) - y) ** 2)[:, None]
    return np.repeat((255 * np.exp(-squared / 50)).round().astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize(("head", "model"), [("simcc", simcc()), ("heatmaps", heatmaps())])
@pytest.mark.parametrize("place", [(150.0, 100.0), (201.3, 222.6)])
@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0, 50.0])
def test_points_of_crop_are_in_pixels_of_image(
    head: str, model: onnx.ModelProto, place: tuple[float, float], turn_deg: float, tmp_path: Path
) -> None:
    own = usual_network("simcc" if head == "simcc" else "heatmaps", "coco-17")
    own = replace(own, mean=(0.0, 0.0, 0.0), std=(255.0, 255.0, 255.0))
    # The network's outputs are means over a whole axis: small numbers.
    network = open_network(write(model, tmp_path / "net.onnx"))
    strong = lambda tensor: {name: 20 * value for name, value in network(tensor).items()}  # noqa: E731
    detector = open_own(strong, own, OneBody(), turn_deg)
    assert isinstance(detector, BodyDetector)
    bodies = detector.detect(image_of(*place))
    assert bodies.keypoints_px.shape == (1, 17, 2)
    np.testing.assert_allclose(bodies.keypoints_px[0], np.tile(place, (17, 1)), atol=0.6 if head == "simcc" else 1.6)
    np.testing.assert_allclose(bodies.center_score, [0.8])


def test_uncertain_points_are_left_out(tmp_path: Path) -> None:
    network = open_network(write(simcc(), tmp_path / "net.onnx"))
    own = replace(usual_network("simcc", "coco-17"), mean=(0.0, 0.0, 0.0), std=(255.0, 255.0, 255.0))
    assert len(open_own(network, own, OneBody()).detect(image_of(150, 100)).score) == 0


def test_people_of_one_stage_are_scaled_to_image(tmp_path: Path) -> None:
    keypoints = np.tile([64.0, 32.0, 0.9], (2, 17, 1))
    keypoints[0, 5] = (10.0, 20.0, 0.1)
    boxes = np.array([[0, 0, 1, 1, 0.95], [0, 0, 1, 1, 0.2]])
    network = open_network(write(rtmo(boxes, keypoints), tmp_path / "net.onnx"))
    bodies = open_own(network, usual_network("rtmo", "coco-17"), None).detect(image_of(5, 5))
    # 400 x 300 pixels become 640 x 480.
    assert len(bodies.score) == 1
    np.testing.assert_allclose(bodies.keypoints_px[0, 0], [40, 20])
    assert np.isnan(bodies.keypoints_px[0, 5]).all()
    assert bodies.score[0, 5] == 0
    np.testing.assert_allclose(bodies.box_px[0], [40, 20, 40, 20])


@pytest.mark.parametrize(("head", "shorter"), [("simcc", 0), ("heatmaps", 1)])
def test_box_around_joints_is_in_middle_of_crop(head: str, shorter: int) -> None:
    own = usual_network("simcc" if head == "simcc" else "heatmaps", "coco-17")
    matrix = crop_matrix(np.array([(100.0, 50.0), (140.0, 250.0)]), own, PictureTurn(SIZE, 0.0))
    np.testing.assert_allclose(matrix @ [120, 150, 1], [(192 - shorter) / 2, (256 - shorter) / 2])
    # 1.4 x 200 pixels of height, and so 210 pixels of width.
    assert matrix[0, 0] == pytest.approx((192 - shorter) / 210)


def test_crop_is_turned_upright() -> None:
    own = usual_network("simcc", "coco-17")
    # A person with the head to the right: 200 pixels long, which is the height of the turned box.
    matrix = crop_matrix(np.array([(250.0, 140.0), (50.0, 100.0)]), own, PictureTurn(SIZE, 90.0))
    np.testing.assert_allclose(matrix @ [150, 120, 1], [192 / 2, 256 / 2])
    scale = 192 / 210
    np.testing.assert_allclose(matrix @ [250, 120, 1], [192 / 2, 256 / 2 - 100 * scale])


def test_people_of_one_stage_are_turned_back(tmp_path: Path) -> None:
    keypoints = np.tile([64.0, 32.0, 0.9], (1, 17, 1))
    boxes = np.array([[0, 0, 1, 1, 0.95]])
    network = open_network(write(rtmo(boxes, keypoints), tmp_path / "net.onnx"))
    bodies = open_own(network, usual_network("rtmo", "coco-17"), None, 90.0).detect(image_of(5, 5))
    # 300 x 400 pixels become 480 x 640: 40 pixels from the left of the turned picture, which is the top of the image.
    np.testing.assert_allclose(bodies.keypoints_px[0, 0], [399 - 20, 40])


def test_colours_are_normalised_in_network_s_order() -> None:
    own = replace(usual_network("simcc", "coco-17"), channels="bgr", mean=(1.0, 2.0, 3.0), std=(2.0, 4.0, 5.0))
    tensor = as_input(np.full((4, 6, 3), (10, 20, 30), np.uint8), own)
    assert tensor.shape == (1, 3, 4, 6)
    np.testing.assert_allclose(tensor[0, :, 0, 0], [(30 - 1) / 2, (20 - 2) / 4, (10 - 3) / 5])
