"""Peaks, fields and bodies of a synthetic network with known outputs."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.data.detections import MapGrid
from pipeline.core.data.turns import upright_size_px
from pipeline.core.joints import COCO_18
from pipeline.detection.chunk import stack_fields
from pipeline.detection.decoders.fields import find_peaks, grid_on_image
from pipeline.detection.decoders.grouping import group
from pipeline.detection.decoders.openpose import LIMBS, decode_openpose
from pipeline.detection.detector import Detector
from pipeline.detection.entries import REGISTRY
from pipeline.detection.letterbox import fit_letterbox
from pipeline.detection.profiles.profile_detector import turned
from pipeline.detection.registry import FieldGrid, NetworkHead, NetworkInput
from pipeline.geometry.fields import connectivity, quantise

# In the last three, rounded sizes make the axes' scales differ.
SIZES = [(1920, 1080), (1088, 1920), (640, 480), (333, 517), (1279, 719), (411, 305)]
SHIFTS = [(0.0, 0.0), (0.6, 0.0)]
SIGMA_CELLS = 0.9


def gaussian(shape: tuple[int, int], center: np.ndarray, sigma: float = SIGMA_CELLS) -> np.ndarray:
    height, width = shape
    squared = (np.arange(width) - center[0]) ** 2 + ((np.arange(height) - center[1]) ** 2)[:, None]
    return np.asarray(np.exp(-squared / (2 * sigma**2)), np.float32)


def find_blob(shift_px: tuple[float, float]) -> Detector:
    """Fake network of stride 8 with all joints at the blob of the image, moved by the network's shift."""

    def run(tensor: np.ndarray) -> Mapping[str, np.ndarray]:
        gray = tensor[0].sum(0).astype(float)
        height, width = gray.shape
        x, y = np.array([gray.sum(0) @ np.arange(width), gray.sum(1) @ np.arange(height)]) / gray.sum()
        cells = (np.array([x, y]) + shift_px - 3.5) / 8
        heatmap = gaussian((height // 8, width // 8), cells)
        pafs = np.zeros((1, 38, height // 8, width // 8), np.float32)
        return {"heatmaps": np.tile(0.9 * heatmap, (1, 19, 1, 1)), "pafs": pafs}

    network_input = NetworkInput("bgr", multiple=8, scaled_px=480, scaled_side="height")
    return Detector(run, network_input, NetworkHead.OPENPOSE, COCO_18, FieldGrid(8, shift_px, 0.3))


@pytest.mark.parametrize("size_px", SIZES)
@pytest.mark.parametrize("shift_px", SHIFTS)
@pytest.mark.parametrize("place", [(0.31, 0.36), pytest.param((0.68, 0.55), marks=pytest.mark.slow)])
@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0, 130.0])
def test_from_image_to_map_and_back_nothing_is_shifted(
    size_px: tuple[int, int], shift_px: tuple[float, float], place: tuple[float, float], turn_deg: float
) -> None:
    center_px = np.array(size_px) * place + (0.23, -0.31)
    height_px = upright_size_px(size_px, turn_deg)[1]
    sigma_px = 4 * height_px / 480
    width, height = size_px
    squared_px = (np.arange(width) - center_px[0]) ** 2 + ((np.arange(height) - center_px[1]) ** 2)[:, None]
    image = np.repeat((255 * np.exp(-squared_px / (2 * sigma_px**2))).round().astype(np.uint8)[..., None], 3, axis=2)
    found = turned(find_blob(shift_px), turn_deg).detect_fields(image)
    assert found.joint.tolist() == list(range(18))
    cell_px = 8 * height_px / 480
    np.testing.assert_allclose(found.points_px, np.tile(center_px, (18, 1)), atol=cell_px / 30)
    np.testing.assert_allclose(found.grid.map_from_image(found.grid.image_from_map(found.points_px)), found.points_px)


def draw_limb(begin: np.ndarray, end: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Field of a limb between two cells: unit vectors within a cell and a half of the segment."""
    unit = (end - begin) / np.linalg.norm(end - begin)
    cells = np.stack(np.meshgrid(np.arange(shape[1]), np.arange(shape[0])), axis=-1) - begin
    along, across = cells @ unit, cells @ np.array([-unit[1], unit[0]])
    inside = (along > -1) & (along < np.linalg.norm(end - begin) + 1) & (np.abs(across) < 1.5)
    return np.where(inside, unit[:, None, None], 0.0)


@given(
    turn_deg=st.one_of(st.floats(0.0, 359.0), st.sampled_from([0.0, 90.0, 180.0, 270.0])), limb_deg=st.floats(0, 360)
)
def test_fields_of_turned_picture_connect_same_points(turn_deg: float, limb_deg: float) -> None:
    """A limb of the picture, as a network draws its field that sees the picture turned."""
    letterbox = fit_letterbox((640, 480), 1.0, 8, turn_deg)
    grid = grid_on_image(FieldGrid(8, (0.0, 0.0), 0.3), letterbox)
    direction = np.array([np.cos(np.radians(limb_deg)), np.sin(np.radians(limb_deg))])
    begin_px, end_px = np.array([320.0, 240.0]) - 60 * direction, np.array([320.0, 240.0]) + 60 * direction
    begin, end = (grid.map_from_image(point_px) for point_px in (begin_px, end_px))
    np.testing.assert_allclose(8 * begin + 3.5, letterbox.network_from_image(begin_px), atol=1e-8)
    width, height = (side // 8 for side in letterbox.padded_size_px)
    fields = quantise(draw_limb(begin, end, (height, width))[None])
    pairs = np.array([begin, end, begin]), np.array([end, begin, begin + (end - begin)[::-1] * (1, -1)])
    mean, _ = connectivity(fields, np.zeros(3, int), *pairs)
    np.testing.assert_allclose(mean[:2], [1.0, -1.0], atol=0.05)
    assert abs(mean[2]) < 0.5  # across the limb


@pytest.mark.parametrize("center", [(10.0, 7.0), (10.25, 7.5), (10.5, 7.9), (3.3, 12.7)])
def test_peaks_are_found_within_thirtieth_of_cell(center: tuple[float, float]) -> None:
    heatmaps = np.stack([0.8 * gaussian((20, 24), np.array(center)), np.zeros((20, 24), np.float32)])
    joint, cells, score = find_peaks(heatmaps)
    assert joint.tolist() == [0]
    np.testing.assert_allclose(cells, [center], atol=1 / 30)
    assert 0.5 < score[0] <= 0.8


def test_two_peaks_in_one_map_and_none_in_noise() -> None:
    rng = np.random.default_rng(1)
    heatmap = np.maximum(gaussian((20, 24), np.array([6.2, 9.0])), 0.5 * gaussian((20, 24), np.array([9.4, 9.0])))
    joint, cells, _ = find_peaks(np.stack([heatmap, 0.005 * rng.standard_normal((20, 24)).astype(np.float32)]))
    assert joint.tolist() == [0, 0]
    np.testing.assert_allclose(np.sort(cells[:, 0]), [6.2, 9.4], atol=0.1)


def test_peaks_at_border_and_on_padding() -> None:
    heatmaps = np.zeros((1, 19, 10, 12), np.float32)
    heatmaps[0, 0, 0, 0], heatmaps[0, 1, 5, 11] = 0.9, 0.9
    outputs = {"heatmaps": heatmaps, "pafs": np.zeros((1, 38, 10, 12), np.float32)}
    found = decode_openpose(outputs, MapGrid((3.5, 3.5), (8.0, 8.0)), (88, 80))  # eleven cells are on the image
    assert found.joint.tolist() == [0]
    assert (np.abs(found.points_px[0] - 3.5) < 4).all()


def people(*offsets_cells: tuple[float, float]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Maps of people who stand apart, and joints (people, joints, 2) in cells."""
    standing = {
        "neck": (0, 0), "shoulder": (2, 0), "hip": (1.2, 7), "nose": (0, -2), "elbow": (3, 3.5), "wrist": (3.5, 7),
        "knee": (1.3, 11), "ankle": (1.4, 15), "eye": (0.5, -2.5), "ear": (1, -2.2),
    }  # fmt: skip
    joints = np.array([standing[name.rpartition("_")[2]] for name in COCO_18.names])
    joints[[name.startswith("right") for name in COCO_18.names], 0] *= -1
    every = np.array([joints + offset for offset in offsets_cells])
    shape = 30, 60
    heatmaps = np.zeros((1, 19, *shape), np.float32)
    pafs = np.zeros((1, 38, *shape), np.float32)
    channels = {tuple(LIMBS[k].tolist()): c for k, c in enumerate(CHANNELS)}
    rows, columns = np.indices(shape)
    for body in every:
        for j, cells in enumerate(body):
            heatmaps[0, j] = np.maximum(heatmaps[0, j], gaussian(shape, cells, 0.6))
        for (first, second), channel in channels.items():
            along = body[second] - body[first]
            length = np.linalg.norm(along)
            unit = along / length
            x, y = columns - body[first, 0], rows - body[first, 1]
            on = (np.abs(x * unit[1] - y * unit[0]) <= 1) & (x * unit[0] + y * unit[1] >= -0.5)
            on &= x * unit[0] + y * unit[1] <= length + 0.5
            pafs[0, channel][on], pafs[0, channel + 1][on] = unit
    return {"heatmaps": heatmaps, "pafs": pafs}, every


# The x channel of each limb, as OpenPose's COCO model has them.
CHANNELS = [12, 20, 0, 6, 28, 14, 22, 16, 24, 2, 8, 4, 10, 30, 32, 34, 36, 18, 26]


def test_bodies_are_grouped_and_are_nobody_elses() -> None:
    outputs, every = people((15.0, 6.0), (30.0, 7.0), (44.0, 5.0))
    grid = MapGrid((3.5, 3.5), (8.0, 8.0))
    bodies = group(decode_openpose(outputs, grid, (480, 240)), LIMBS, 18)
    assert len(bodies.score) == 3
    order = np.argsort(bodies.keypoints_px[:, 1, 0])
    np.testing.assert_allclose(bodies.keypoints_px[order], grid.image_from_map(every), atol=2.0)
    assert (bodies.score > 0.3).all()
    assert (np.diff(bodies.center_score) <= 0.05).all()
    np.testing.assert_allclose(bodies.box_px[:, :2], bodies.keypoints_px.min(1))


def test_half_body_is_one_and_stray_peak_is_none() -> None:
    outputs, _ = people((15.0, 6.0))
    below = [j for j, name in enumerate(COCO_18.names) if name.endswith(("knee", "ankle", "hip"))]
    outputs["heatmaps"][0, below] = 0.0
    outputs["heatmaps"][0, 4, 25, 50] = 0.9
    (body,) = group(decode_openpose(outputs, MapGrid((3.5, 3.5), (8.0, 8.0)), (480, 240)), LIMBS, 18).keypoints_px
    assert np.isnan(body[below]).all()
    assert np.isfinite(np.delete(body, below, axis=0)).all()
    empty = {name: np.zeros_like(maps) for name, maps in outputs.items()}
    assert group(decode_openpose(empty, MapGrid((3.5, 3.5), (8.0, 8.0)), (480, 240)), LIMBS, 18).score.shape == (0, 18)


def test_frames_without_peaks_stack() -> None:
    outputs, _ = people((15.0, 6.0))
    grid = MapGrid((3.5, 3.5), (8.0, 8.0))
    full = decode_openpose(outputs, grid, (480, 240))
    empty = decode_openpose({name: np.zeros_like(maps) for name, maps in outputs.items()}, grid, (480, 240))
    stacked = stack_fields("left", [(7, empty), (8, full)])
    assert stacked.fields.shape == (2, 19, 2, 30, 60)
    assert set(stacked.peak_row.tolist()) == {1}
    assert stack_fields("left", []).frame.shape == (0,)


def test_registrys_networks_with_fields_are_those_of_this_kind() -> None:
    assert {entry.name for entry in REGISTRY.values() if entry.fields is not None} == {
        entry.name for entry in REGISTRY.values() if entry.head is NetworkHead.OPENPOSE
    }
