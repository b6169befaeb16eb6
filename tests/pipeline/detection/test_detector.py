from collections.abc import Mapping

import av
import numpy as np
import pytest

from pipeline.core.errors import ModelError
from pipeline.core.joints import COCO_17
from pipeline.core.runtime.packages import samples
from pipeline.detection import models
from pipeline.detection.detector import Detector, open_detector
from pipeline.detection.profiles.profile_detector import turned
from pipeline.detection.registry import NetworkHead, NetworkInput

# In the last four, rounded sizes make the axes' scales differ.
SIZES = [(1920, 1080), (1024, 768), (1088, 1920), (333, 517), (1279, 719), (97, 41)]


def find_blob(tensor: np.ndarray) -> dict[str, np.ndarray]:
    """Fake network that detects a body with all joints at the blob of the image."""
    gray = tensor[0].sum(0).astype(float)
    height, width = gray.shape
    x, y = (gray.sum(0) @ np.arange(width), gray.sum(1) @ np.arange(height)) / gray.sum() / 4
    row, column = int(y), int(x)
    shape = (1, 34, height // 4, width // 4)
    outputs = {"offset": np.zeros(shape), "regress": np.zeros(shape)}
    outputs |= {"heatmap": np.zeros((1, 17, *shape[2:])), "center": np.zeros((1, 1, *shape[2:]))}
    outputs["heatmap"][0, :, row, column] = 0.9
    outputs["center"][0, 0, row, column] = 0.8
    outputs["offset"][0, 0::2, row, column] = y - row
    outputs["offset"][0, 1::2, row, column] = x - column
    return outputs


def draw_blob(size_px: tuple[int, int], center_px: np.ndarray, sigma_px: float) -> np.ndarray:
    width, height = size_px
    squared_px = (np.arange(width) - center_px[0]) ** 2 + ((np.arange(height) - center_px[1]) ** 2)[:, None]
    blob = (255 * np.exp(-squared_px / (2 * sigma_px**2))).round().astype(np.uint8)
    return np.repeat(blob[..., None], 3, axis=2)


def detector_of(network: Mapping[str, np.ndarray] | None = None, channels: str = "rgb") -> Detector:
    run = find_blob if network is None else lambda _: network
    network_input = NetworkInput("rgb" if channels == "rgb" else "bgr", multiple=32, scaled_px=512)
    return Detector(run, network_input, NetworkHead.MOVENET_MULTIPOSE, COCO_17)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0, 40.0])
@pytest.mark.parametrize("size_px", SIZES)
@pytest.mark.parametrize("place", [(0.31, 0.36), (0.68, 0.55)])
def test_from_image_to_map_and_back_nothing_is_shifted(
    size_px: tuple[int, int], place: tuple[float, float], turn_deg: float
) -> None:
    center_px = np.array(size_px) * place + (0.23, -0.31)
    sigma_px = 4 * max(size_px) / 512
    bodies = turned(detector_of(), turn_deg).detect(draw_blob(size_px, center_px, sigma_px))
    # 1/150 of a cell of the map; half a pixel of the network is 1/8 of a cell.
    tolerance_px = 4 * max(size_px) / 512 / 150
    np.testing.assert_allclose(bodies.keypoints_px[0], np.tile(center_px, (17, 1)), atol=tolerance_px)
    np.testing.assert_allclose(bodies.box_px[0], [*center_px, *center_px], atol=tolerance_px)
    assert bodies.center_score[0] == 0.8


@pytest.mark.parametrize("size_px", SIZES)
def test_cell_of_map_lies_where_its_pixels_do(size_px: tuple[int, int]) -> None:
    """Position of a peak computed by hand, from sizes of the network's input and pixel centres."""
    long_side = max(size_px)
    seen_px = [round(side * 512 / long_side) for side in size_px]
    height, width = (-(-side // 32) * 32 // 4 for side in seen_px[::-1])
    outputs = {name: np.zeros((1, n, height, width)) for name, n in (("offset", 34), ("regress", 34), ("heatmap", 17))}
    outputs["center"] = np.zeros((1, 1, height, width))
    outputs["center"][0, 0, 5, 6] = outputs["heatmap"][0, :, 5, 6] = 0.9
    outputs["offset"][0, 1::2, 5, 6] = 0.25
    image = np.zeros((size_px[1], size_px[0], 3), np.uint8)
    x_px, y_px = 4 * 6.25, 4 * 5.0
    expected_px = [(x_px + 0.5) * size_px[0] / seen_px[0] - 0.5, (y_px + 0.5) * size_px[1] / seen_px[1] - 0.5]
    np.testing.assert_allclose(detector_of(outputs).detect(image).keypoints_px[0, 0], expected_px, atol=1e-9)


def test_colours_come_in_order_that_network_wants() -> None:
    image = np.full((64, 64, 3), (10, 20, 30), np.uint8)
    rgb, _ = detector_of().prepare(image)
    bgr, _ = detector_of(channels="bgr").prepare(image)
    assert rgb.shape == (1, 3, 512, 512)
    assert rgb.dtype == np.float32
    assert rgb[0, :, 100, 100].tolist() == [10, 20, 30]
    assert bgr[0, :, 100, 100].tolist() == [30, 20, 10]


def test_unknown_network_is_said() -> None:
    with pytest.raises(ModelError, match="Known: movenet-multipose"):
        open_detector("posenet")


@pytest.fixture(scope="module")
def detector() -> Detector:
    models.install("movenet-multipose")
    return open_detector()


@pytest.fixture(scope="module")
def image_rgb() -> np.ndarray:
    with av.open(samples.install().videos["cam01"]) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def test_people_of_sample_are_found(detector: Detector, image_rgb: np.ndarray) -> None:
    bodies = detector.detect(image_rgb)
    walker, watcher, bystander = bodies.keypoints_px
    # Places at which one sees them in the picture.
    names = ("nose", "left_shoulder", "right_ankle", "left_ankle")
    expected_px = [(484, 417), (524, 498), (335, 1002), (422, 1084)]
    np.testing.assert_allclose(walker[COCO_17.indices(names)], expected_px, atol=20)
    ankles = COCO_17.indices(("right_ankle", "left_ankle"))
    np.testing.assert_allclose(watcher[ankles], [(703, 1649), (571, 1693)], atol=20)
    np.testing.assert_allclose(bystander[COCO_17.index("nose")], (79, 343), atol=20)
    assert (bodies.center_score > 0.8).all()
    assert np.isfinite(bodies.keypoints_px).all()


def test_mirrored_image_gives_mirrored_people(detector: Detector, image_rgb: np.ndarray) -> None:
    bodies = detector.detect(image_rgb)
    mirrored = detector.detect(np.ascontiguousarray(image_rgb[:, ::-1]))
    swapped = [
        COCO_17.index(name.replace("left", "?").replace("right", "left").replace("?", "right"))
        for name in COCO_17.names
    ]
    order = [int(np.argmin(np.abs(1087 - mirrored.keypoints_px[:, 0, 0] - x))) for x in bodies.keypoints_px[:, 0, 0]]
    back_px = mirrored.keypoints_px[order][:, swapped] * (-1, 1) + (1087, 0)
    sure = (bodies.score > 0.5) & (mirrored.score[order][:, swapped] > 0.5)
    shift_px = np.median((bodies.keypoints_px - back_px)[sure], axis=0)
    # Mirroring doubles a bias: half a pixel of the network would be 3.75 px here, a cell 30 px.
    assert sure.sum() > 30
    np.testing.assert_allclose(shift_px, 0, atol=1.5)


@pytest.mark.parametrize("turn_deg", [90.0, 180.0, 270.0])
def test_hanging_camera_sees_people_of_upright_one(detector: Detector, image_rgb: np.ndarray, turn_deg: float) -> None:
    bodies = detector.detect(image_rgb)
    hanging = turned(detector, turn_deg).detect(np.ascontiguousarray(np.rot90(image_rgb, -round(turn_deg / 90))))
    # Positions in the upright picture, by the picture's shape alone.
    x, y = hanging.keypoints_px[..., 0], hanging.keypoints_px[..., 1]
    upright = {90.0: (y, 1919 - x), 180.0: (1087 - x, 1919 - y), 270.0: (1087 - y, x)}[turn_deg]
    upright_px = np.stack(upright, axis=-1)
    assert len(upright_px) == len(bodies.keypoints_px) == 3
    np.testing.assert_allclose(upright_px, bodies.keypoints_px, atol=1e-9)
    np.testing.assert_array_equal(hanging.score, bodies.score)
    np.testing.assert_allclose(hanging.box_px[:, :2], hanging.keypoints_px.min(1))
    np.testing.assert_allclose(hanging.box_px[:, 2:], hanging.keypoints_px.max(1))


def test_same_image_gives_same_bytes(detector: Detector, image_rgb: np.ndarray) -> None:
    first, second = detector.detect(image_rgb), open_detector().detect(image_rgb)
    assert first.keypoints_px.tobytes() == second.keypoints_px.tobytes()
    assert first.score.tobytes() == second.score.tobytes()
    assert not first.keypoints_px.flags.writeable
