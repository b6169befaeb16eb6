"""Colours of bodies on their way from detection to association: measured again if need be, and kept nowhere."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.association.tracking.observations import Detections2D
from pipeline.calibration.write import encode
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.detection import chunk
from pipeline.detection.appearance import NUM_BINS, PARTS, colour_histograms
from pipeline.detection.detector import Detector
from pipeline.detection.profiles import profile_detector
from pipeline.detection.registry import NetworkHead, NetworkInput
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.methods import Association
from tests.pipeline.conftest import ring_camera
from tests.pipeline.media import write_video

NUM_FRAMES, SIZE_PX = 24, (96, 80)
NUM_COLOURED = 19  # the other pictures are too dark for the network
# Both cameras show the same bodies, which the check refuses.
CONFIG = ReconstructionConfig(detector="movenet-multipose", chunk_frames=10, smoothing="none", force=True)


class CountingNetwork:
    """Network that finds a body at the same place of each picture but the darkest; counts its pictures."""

    def __init__(self) -> None:
        self.num_images = 0

    def __call__(self, tensor: np.ndarray) -> dict[str, np.ndarray]:
        self.num_images += 1
        shape = tensor.shape[2] // 4, tensor.shape[3] // 4
        outputs = {"offset": np.zeros((1, 34, *shape)), "regress": np.zeros((1, 34, *shape))}
        outputs |= {"heatmap": np.zeros((1, 17, *shape)), "center": np.zeros((1, 1, *shape))}
        if tensor[0, :, -200, 20].mean() < 30.0:
            return outputs
        outputs["center"][0, 0, 50, 60] = 0.9
        for joint, row in (("shoulder", 10), ("hip", 50), ("knee", 70), ("ankle", 90)):
            for side, column in (("left", 80), ("right", 40)):
                number = COCO_17.index(f"{side}_{joint}")
                outputs["heatmap"][0, number, row, column] = 0.8
                outputs["regress"][0, 2 * number : 2 * number + 2, 50, 60] = row - 50, column - 60
        return outputs


@pytest.fixture
def session(tmp_path: Path) -> CaptureSession:
    cameras = [replace(ring_camera(name, angle), size_px=SIZE_PX) for name, angle in (("left", 0.3), ("right", 1.9))]
    folder = tmp_path / "videos"
    folder.mkdir()
    for camera in cameras:
        write_video(folder / f"{camera.name}.mp4", NUM_FRAMES, SIZE_PX)
    (tmp_path / "calibration.json").write_bytes(encode(cameras))
    return open_session(folder, tmp_path / "calibration.json")


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> CountingNetwork:
    fake = CountingNetwork()
    detector = Detector(fake, NetworkInput("rgb", multiple=32, scaled_px=512), NetworkHead.MOVENET_MULTIPOSE, COCO_17)
    monkeypatch.setattr(profile_detector, "load_detector", lambda name: detector)
    return fake


@pytest.fixture
def tracked(monkeypatch: pytest.MonkeyPatch) -> list[Detections2D]:
    """Bodies that were tracked, in the order of the calls."""
    calls: list[Detections2D] = []

    track = Association.track

    def recorded(self: Association, bodies: Detections2D, *others: Any) -> Any:
        calls.append(bodies)
        return track(self, bodies, *others)

    monkeypatch.setattr(Association, "track", recorded)
    return calls


def arrays_in(folder: Path) -> set[str]:
    """Names of the arrays in a cache's archives."""
    names: set[str] = set()
    for path in folder.iterdir():
        content = path.read_bytes()[32:]
        if content.startswith(b"PK"):
            names |= set(np.load(io.BytesIO(content)).files)
    return names


def test_colours_reach_tracker_and_stay_in_no_cache(
    session: CaptureSession, network: CountingNetwork, tracked: list[Detections2D], tmp_path: Path
) -> None:
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    (bodies,) = tracked
    assert bodies.colour.shape == (len(bodies.frame), len(PARTS), NUM_BINS)
    assert bodies.colour.any(-1).all()
    assert len(np.unique(bodies.colour, axis=0)) > 10  # pictures differ from frame to frame
    names = arrays_in(tmp_path / "cache")
    assert "keypoints_px" in names
    assert not any("colour" in name for name in names)


@pytest.mark.slow
def test_colours_for_another_association_need_no_network(
    session: CaptureSession, network: CountingNetwork, tracked: list[Detections2D], tmp_path: Path
) -> None:
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    num_images = network.num_images
    reconstruct(session, replace(CONFIG, tracking={"alpha_3d_m": 0.3}), cache=tmp_path / "cache")
    assert network.num_images == num_images
    first, again = tracked
    np.testing.assert_array_equal(again.colour, first.colour)
    np.testing.assert_array_equal(again.seen_px, first.seen_px)


def test_nothing_is_decoded_for_people_who_are_tracked_already(
    session: CaptureSession,
    network: CountingNetwork,
    tracked: list[Detections2D],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    monkeypatch.setattr(chunk, "measure_colours", None)
    reconstruct(session, replace(CONFIG, smoothing="one-euro"), cache=tmp_path / "cache")
    assert len(tracked) == 1


@pytest.mark.slow
def test_damaged_output_is_detected_again_with_colours(
    session: CaptureSession, network: CountingNetwork, tracked: list[Detections2D], tmp_path: Path
) -> None:
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    for path in (tmp_path / "cache").iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    network.num_images = 0
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    first, again = tracked
    np.testing.assert_array_equal(again.colour, first.colour)


@pytest.mark.slow
def test_cut_into_chunks_changes_no_byte(
    session: CaptureSession, network: CountingNetwork, tracked: list[Detections2D]
) -> None:
    for chunk_frames in (5, 10, 100):
        reconstruct(session, replace(CONFIG, chunk_frames=chunk_frames))
    first, *others = tracked
    assert len(first.colour) == 2 * NUM_COLOURED
    for other in others:
        np.testing.assert_array_equal(other.colour, first.colour)


@pytest.mark.slow
@pytest.mark.parametrize("choice", [{"appearance": "off"}, {"method": "clustering"}])
def test_colours_that_nobody_asks_for_are_not_measured(
    session: CaptureSession,
    network: CountingNetwork,
    tracked: list[Detections2D],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    choice: dict[str, Any],
) -> None:
    calls = []

    def counted(*values: Any) -> np.ndarray:
        calls.append(values)
        return colour_histograms(*values)

    monkeypatch.setattr("pipeline.detection.chunk.colour_histograms", counted)
    reconstruct(session, replace(CONFIG, **choice), cache=tmp_path / "cache")
    assert calls == []
    assert [bodies.colour.size for bodies in tracked] == [0] * len(tracked)
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    assert len(calls) == 2 * NUM_FRAMES
