"""One pass or two, at the sizes of a camera."""

import numpy as np
import pytest

from pipeline.core.joints import COCO_17
from pipeline.core.options.config import Networks
from pipeline.detection.detector import Detector
from pipeline.detection.profiles import profile_detector
from pipeline.detection.profiles.profile_detector import BodyDetector, open_detection
from pipeline.detection.profiles.sizes import CameraSizes
from pipeline.detection.registry import NetworkHead, NetworkInput

IMAGE_RGB = np.zeros((180, 320, 3), np.uint8)


@pytest.fixture
def shapes(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Widths and heights of the images that the network was given."""
    given: list[tuple[int, int]] = []

    def network(tensor: np.ndarray) -> dict[str, np.ndarray]:
        given.append((tensor.shape[3], tensor.shape[2]))
        shape = tensor.shape[2] // 4, tensor.shape[3] // 4
        channels = {"center": 1, "heatmap": 17, "offset": 34, "regress": 34}
        return {name: np.zeros((1, number, *shape)) for name, number in channels.items()}

    detector = Detector(
        network, NetworkInput("rgb", multiple=32, scaled_px=512), NetworkHead.MOVENET_MULTIPOSE, COCO_17
    )
    monkeypatch.setattr(profile_detector, "load_detector", lambda name: detector)
    return given


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        (None, [(512, 288)]),
        (CameraSizes((384,)), [(384, 224)]),
        (CameraSizes((320, 640), border_px=90.0), [(320, 192), (640, 384)]),
    ],
)
def test_images_have_sizes_of_camera(
    shapes: list[tuple[int, int]], sizes: CameraSizes | None, expected: list[tuple[int, int]]
) -> None:
    opened = open_detection(Networks("movenet-multipose"), "body", sizes)
    assert isinstance(opened, BodyDetector)
    assert opened.joints == COCO_17
    assert len(opened.detect(IMAGE_RGB).score) == 0
    assert shapes == expected
