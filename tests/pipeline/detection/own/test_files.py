import json
import os
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import psutil
import pytest
from onnx import TensorProto

from pipeline.core.errors import ModelError
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.core.options.config import MotionChoices
from pipeline.core.runtime.child_processes import python_command
from pipeline.detection import models
from pipeline.detection.detector import open_detector
from pipeline.detection.entries import detected_joint_set, find_entry
from pipeline.detection.own import files
from pipeline.detection.own.files import add_own, own_names
from pipeline.detection.own_network import decode_description, encode_description, usual_network
from pipeline.detection.profiles import profile_detector
from pipeline.detection.profiles.profile_detector import open_detection
from tests.pipeline.detection.own.networks import endless, heatmaps, rtmo, simcc, write
from tests.waiting import is_alive, wait_for

ROOT = Path(__file__).parents[4]
SIMCC = usual_network("simcc", "coco-17")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "home"))
    # Other tests may have opened the network of another home.
    monkeypatch.setattr(profile_detector, "load_detector", open_detector)
    return tmp_path / "home"


def test_network_is_added_and_listed(tmp_path: Path, home: Path) -> None:
    name = add_own(write(simcc(), tmp_path / "My RTMPose_m.onnx"), SIMCC)
    assert name.startswith("own-my-rtmpose-m-")
    entry = find_entry(name)
    assert entry.own == SIMCC
    assert entry.joints == COCO_17
    assert own_names() == (name,)
    assert models.status()[-1] == models.ModelStatus(name, True, "unknown", entry.sha256)
    assert models.verify(name) == home / "models" / f"{name}.onnx"
    assert not list((home / "models").glob(".own-*"))


def test_name_depends_on_file_and_its_description(tmp_path: Path) -> None:
    path = write(simcc(), tmp_path / "net.onnx")
    names = {add_own(path, SIMCC), add_own(path, usual_network("simcc", "coco-17", (192, 256)))}
    assert len(names) == 1
    names.add(add_own(path, replace(SIMCC, channels="bgr")))
    names.add(add_own(write(simcc(size=("w", "h")), tmp_path / "net.onnx"), SIMCC))
    assert len(names) == 3


def test_heads_are_told_apart(tmp_path: Path) -> None:
    assert add_own(write(heatmaps(), tmp_path / "a.onnx"), usual_network("heatmaps", "coco-17"))
    people = rtmo(np.zeros((2, 5)), np.zeros((2, 17, 3)), size_px=320)
    name = add_own(write(people, tmp_path / "b.onnx"), usual_network("rtmo", "coco-17"), has_chosen_size=False)
    own = find_entry(name).own
    assert own is not None
    assert own.input_px == (320, 320)
    with pytest.raises(ModelError, match=r"^a\.onnx has no outputs of the head simcc: it gives \[\[1, 17, 64, 48\]\]"):
        add_own(tmp_path / "a.onnx", SIMCC)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (simcc(26), r"^net\.onnx finds 26 points, coco-17 has 17\. Use --joints halpe-26\.$"),
        (simcc(5), r"^net\.onnx finds 5 points, coco-17 has 17\.$"),
        (simcc(size=(288, 384)), r"^net\.onnx has an input of 288x384 pixels: use --input-size 288x384$"),
        (simcc(domain="com.example"), r"^net\.onnx can't be used: it needs the operator Tile of com\.example"),
    ],
)
def test_another_network_is_refused(tmp_path: Path, model: onnx.ModelProto, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        add_own(write(model, tmp_path / "net.onnx"), SIMCC)
    assert own_names() == ()


def changed(opset: int = 13, ir_version: int = 8, op_type: str = "Tile") -> onnx.ModelProto:
    """Small network with another version, or with another operator at its end."""
    model = simcc()
    model.opset_import[0].version, model.ir_version, model.graph.node[-1].op_type = opset, ir_version, op_type
    return model


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (
            changed(opset=99),
            r"its opset is 99, and ONNX Runtime [\d.]+ reads opsets up to (\d+); export it with opset \1",
        ),
        (changed(ir_version=99), r"its IR version is 99, and ONNX Runtime [\d.]+ reads versions up to \d+; export it"),
        (
            changed(op_type="Fold"),
            r"it is damaged or can't be run \(Fold: No Op registered for Fold with domain_version of 13",
        ),
        (
            changed(op_type="Gather"),
            r"can't be run \(Gather: indices element out of data bounds, idx=1 must be within",
        ),
    ],
)
def test_reason_of_onnx_runtime_is_given(tmp_path: Path, model: onnx.ModelProto, message: str) -> None:
    with pytest.raises(ModelError) as error:
        add_own(write(model, tmp_path / "net.onnx"), SIMCC)
    assert re.search(message, str(error.value))
    assert str(tmp_path) not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"no network", bytes(1000)])
def test_another_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "net.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=r"^net\.onnx can't be used: it "):
        add_own(tmp_path / "net.onnx", SIMCC)


@pytest.mark.slow
def test_network_without_end_is_refused(tmp_path: Path) -> None:
    # By the limit of processor time: the limit of the clock is longer.
    with pytest.raises(ModelError, match=r"loop\.onnx can't be used: it gave no output for one image"):
        add_own(write(endless(), tmp_path / "loop.onnx"), SIMCC, has_chosen_size=False)
    assert files._TIMEOUT_S <= 60


def test_check_ends_with_its_command(tmp_path: Path) -> None:
    path = write(endless(), tmp_path / "loop.onnx")
    program = (
        "import sys; from pathlib import Path; from pipeline.detection.own.files import add_own; "
        "from pipeline.detection.own_network import usual_network; "
        "add_own(Path(sys.argv[1]), usual_network('simcc', 'coco-17'))"
    )
    command = subprocess.Popen(python_command("-c", program, str(path)), env=os.environ | {"PYTHONPATH": str(ROOT)})
    try:
        parent = psutil.Process(command.pid)
        wait_for(lambda: any("pipeline.detection.own.check_network" in child.cmdline() for child in parent.children()))
        (check,) = parent.children()
        wait_for(lambda: "pipeline.core.runtime.parent_watch" not in check.cmdline())
    finally:
        command.kill()
        command.wait()
    wait_for(lambda: not is_alive(check))


def test_weights_in_another_file_are_refused(tmp_path: Path) -> None:
    model = simcc()
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    with pytest.raises(ModelError, match="its weights are in another file; export it as one file"):
        add_own(write(model, tmp_path / "net.onnx"), SIMCC)


def test_missing_and_huge_file_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ModelError, match=r"^net\.onnx can't be read or copied: No such file"):
        add_own(tmp_path / "net.onnx", SIMCC)
    monkeypatch.setattr(files, "_MAX_BYTES", 100)
    with pytest.raises(ModelError, match=r"^net\.onnx is larger than networks may be"):
        add_own(write(simcc(), tmp_path / "net.onnx"), SIMCC)


def test_changed_files_are_noticed(tmp_path: Path, home: Path) -> None:
    name = add_own(write(simcc(), tmp_path / "net.onnx"), SIMCC)
    description = home / "models" / f"{name}.json"
    description.write_text(description.read_text().replace("123.675", "0"))
    with pytest.raises(ModelError, match=rf"file of the network {name} was changed\. Add it again"):
        find_entry(name)
    assert not models.status()[-1].installed
    description.write_bytes(b"{")
    with pytest.raises(ModelError, match=rf"^{name}\.json is damaged"):
        find_entry(name)


@pytest.mark.parametrize("name", ["own-", "own-x", "own-../../x-0123456789ab", "own-gone-0123456789ab"])
def test_unknown_network_says_how_to_add_it(name: str) -> None:
    with pytest.raises(ModelError, match=r"There is no network .*multicap models add FILE"):
        find_entry(name)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("head", "x"),
        ("layout", "x"),
        ("channels", "x"),
        ("input_px", [0, 5]),
        ("std", [1, 1, 0]),
        ("mean", [1]),
        ("std", "x"),
    ],
)
def test_descriptions_are_read_back(field: str, value: object) -> None:
    content = encode_description(SIMCC)
    assert decode_description(content, "a.json") == SIMCC
    with pytest.raises(ModelError, match=r"^a\.json is damaged"):
        decode_description(json.dumps(json.loads(content) | {field: value}).encode(), "a.json")


def test_added_network_is_opened_as_detector(tmp_path: Path) -> None:
    boxes, keypoints = np.array([[0, 0, 1, 1, 0.9]]), np.tile([64.0, 32.0, 0.9], (1, 26, 1))
    path = write(rtmo(boxes, keypoints), tmp_path / "net.onnx")
    networks = MotionChoices(detector=add_own(path, usual_network("rtmo", "halpe-26"))).networks
    detector = open_detection(networks, "body")
    assert detector.joints == detected_joint_set(networks, "body") == BODY_FEET
    bodies = detector.detect(np.zeros((320, 640, 3), np.uint8))
    np.testing.assert_allclose(bodies.keypoints_px, np.tile([64.0, 32.0], (1, 21, 1)))


def test_network_of_crops_needs_multipose(tmp_path: Path) -> None:
    networks = MotionChoices(detector=add_own(write(simcc(), tmp_path / "net.onnx"), SIMCC)).networks
    with pytest.raises(ModelError, match="movenet-multipose is not installed"):
        open_detection(networks, "body")
