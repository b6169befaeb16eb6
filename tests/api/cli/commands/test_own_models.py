from pathlib import Path

import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.detection.own.files import own_names
from tests.pipeline.detection.own.networks import simcc, write
from worker.store.spec import JobSpec

runner = CliRunner()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["net.onnx"], "Give --from"),
        (["net.onnx", "--head", "simcc"], "net.onnx needs --head with one of simcc"),
        (["net.onnx", "--head", "yolo", "--joints", "coco-17"], "net.onnx needs --head with one of simcc"),
        (["net.onnx", "--head", "simcc", "--joints", "coco-17", "--input-size", "5"], "such as 192x256"),
        (["net.onnx", "--head", "simcc", "--joints", "coco-17", "--input-size", "0x5"], "have 1 to 2048 pixels"),
        (["net.onnx", "--head", "simcc", "--joints", "coco-17", "--std", "1,0,1"], "none of them 0"),
        (["net.onnx", "--head", "simcc", "--joints", "coco-17", "--mean", "1,2"], "such as 1,2,3"),
        (["net.onnx", "--head", "simcc", "--joints", "coco-17", "--channels", "rbg"], "rgb or bgr"),
        (["gone.onnx", "--head", "simcc", "--joints", "coco-17"], "gone.onnx can't be read"),
    ],
)
def test_own_networks_that_can_not_be_added(arguments: list[str], message: str) -> None:
    result = runner.invoke(app, ["models", "add", *arguments])
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())


def test_own_network_is_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    path = write(simcc(), tmp_path / "net.onnx")
    result = runner.invoke(
        app, ["models", "add", str(path), "--head", "simcc", "--joints", "coco-17", "--std", "1,2,3"]
    )
    (name,) = own_names()
    assert name in result.output.replace("\n", "")
    assert JobSpec(detector=name).config.detector == name
    with pytest.raises(ValidationError):
        JobSpec.model_validate({"detector": "own-net"})
