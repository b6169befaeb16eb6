"""The stage ``look``: the size of a camera's images belongs to its whole video, whatever part of it is wanted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.write import encode
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import Progress
from pipeline.detection.detector import Detector
from pipeline.detection.profiles import profile_detector
from pipeline.detection.registry import NetworkHead, NetworkInput
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.stage import DETECT, LOOK
from pipeline.run.steps.detect import LOOKED_AT_FRAMES
from tests.pipeline.conftest import ring_camera
from tests.pipeline.media import write_video

NUM_FRAMES, SIZE_PX = 30, (96, 80)
# The bodies of the network are no people of one place, which the check refuses.
CONFIG = ReconstructionConfig(
    profile="fast", joints="body", chunk_frames=10, smoothing="none", appearance="off", frame_range=(10, 30), force=True
)


class WidthKeepingNetwork:
    """Network that finds a body over seven tenths of the height of each picture; keeps the widths of its input."""

    def __init__(self) -> None:
        self.widths: list[int] = []

    def __call__(self, tensor: np.ndarray) -> dict[str, np.ndarray]:
        self.widths.append(tensor.shape[3])
        shape = height, width = tensor.shape[2] // 4, tensor.shape[3] // 4
        channels = {"center": 1, "heatmap": 17, "offset": 34, "regress": 34}
        outputs = {name: np.zeros((1, number, *shape)) for name, number in channels.items()}
        middle = height // 2, width // 2
        outputs["center"][0, 0, *middle] = 0.9
        for joint in range(17):
            row, column = round((0.05 + 0.045 * joint) * height), middle[1]
            outputs["heatmap"][0, joint, row, column] = 0.8
            outputs["regress"][0, 2 * joint, *middle] = row - middle[0]
        return outputs


@pytest.fixture
def session(tmp_path: Path) -> CaptureSession:
    cameras = [replace(ring_camera(name, angle), size_px=SIZE_PX) for name, angle in (("left", 0.3), ("right", 1.9))]
    (tmp_path / "videos").mkdir()
    for camera in cameras:
        write_video(tmp_path / "videos" / f"{camera.name}.mp4", NUM_FRAMES, SIZE_PX)
    (tmp_path / "calibration.json").write_bytes(encode(cameras))
    return open_session(tmp_path / "videos", tmp_path / "calibration.json")


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> WidthKeepingNetwork:
    fake = WidthKeepingNetwork()
    detector = Detector(fake, NetworkInput("rgb", multiple=32, scaled_px=512), NetworkHead.MOVENET_MULTIPOSE, COCO_17)
    monkeypatch.setattr(profile_detector, "load_detector", lambda name: detector)
    return fake


def test_detection_takes_size_that_look_chose(session: CaptureSession, network: WidthKeepingNetwork) -> None:
    reconstruct(session, CONFIG)
    looked, detected = network.widths[: 2 * LOOKED_AT_FRAMES], network.widths[2 * LOOKED_AT_FRAMES :]
    assert set(looked) == {512}
    assert len(detected) == 2 * 20
    assert set(detected) == {320}  # the body spans 190 pixels of a height of 267; a height of 240 has more padding


@pytest.mark.slow
def test_another_part_and_cut_of_session_reuse_look(
    session: CaptureSession, network: WidthKeepingNetwork, tmp_path: Path
) -> None:
    reconstruct(session, CONFIG, cache=tmp_path / "cache")
    steps: dict[str, Progress] = {}
    other = replace(CONFIG, frame_range=None, chunk_frames=7)
    reconstruct(session, other, lambda step: steps.update({step.stage: step}), cache=tmp_path / "cache")
    assert steps[LOOK].reused == steps[LOOK].total == 2 * LOOKED_AT_FRAMES
    assert steps[DETECT].reused == 0


def test_network_alone_has_its_usual_size(session: CaptureSession, network: WidthKeepingNetwork) -> None:
    reconstruct(session, replace(CONFIG, detector="movenet-multipose"))
    assert network.widths == [512] * 40
