"""`multicap live`: wrong options at once, the sample as cameras, an end by Ctrl-C."""

import json
import signal
import socket
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.commands.live import _stopped_by_signals
from api.cli.main import app
from pipeline.core.runtime.packages.samples import locate
from pipeline.detection.models import status
from tests.pipeline.capture.test_session import calibration

runner = CliRunner()


def test_everything_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "old").touch()
    rig = calibration(tmp_path / "rig.json", ["a", "b"])
    options = ["--camera=a=gone.mp4", "--camera=c=rtsp://camera/", f"--keep={tmp_path / 'kept'}"]
    (tmp_path / "lines.jsonl").write_text("{}")
    options += ["--output=far", "--output=vmc://192.0.2.1", f"--output=vmc://127.0.0.1:{'9' * 5000}"]
    options += ["--output=vmc://localhost", "--output=vmc://127.0.0.1:39539"]
    options += [f"--lines={tmp_path / 'lines.jsonl'}", "--profile=fast", "--json"]
    result = runner.invoke(app, ["live", f"--calibration={rig}", *options])
    assert result.exit_code == 2
    problems = json.loads(result.stdout)["problems"]
    assert [(problem["code"], problem["camera"] or problem["field"]) for problem in problems] == [
        ("video_missing", "a"),
        ("camera_source", "c"),
        ("parameter_range", "output"),
        ("parameter_range", "output"),
        ("parameter_range", "output"),
        ("parameter_range", "output"),
        ("output_exists", "keep"),
        ("output_exists", "lines"),
    ]
    assert str(tmp_path) not in result.stdout


def test_pattern_needs_no_calibration_and_takes_none(tmp_path: Path) -> None:
    rig = calibration(tmp_path / "rig.json", ["a", "b"])
    stated = [f"--calibration={rig}", "--sync=5", "--output=vmc://far:0"]
    result = runner.invoke(app, ["live", "--test-pattern", *stated, "--json"])
    assert [problem["field"] for problem in json.loads(result.stdout)["problems"]] == ["calibration", "sync", "output"]
    result = runner.invoke(app, ["live", "--json"])
    assert [problem["code"] for problem in json.loads(result.stdout)["problems"]] == ["calibration_missing"]


def test_pattern_reaches_receiver_until_interrupted(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60)

        def interrupt() -> None:
            receiver.recv(65_536)
            receiver.recv(65_536)
            signal.raise_signal(signal.SIGINT)

        interrupting = threading.Thread(target=interrupt)
        interrupting.start()
        address = f"osc://127.0.0.1:{receiver.getsockname()[1]}?people=1"
        result = runner.invoke(app, ["live", "--test-pattern", f"--output={address}", "--json"])
        interrupting.join()
    assert result.exit_code == 0, result.output
    ready, *instants, ended = [json.loads(line) for line in result.stdout.splitlines()]
    assert (ready["cameras"], ready["frame_rate_hz"]) == ([], 60.0)
    assert len([line for line in instants if line["type"] == "instant"]) == ended["instants"] > 0
    (output,) = ended["outputs"]
    assert (output["address"], output["state"]) == (address, "sending")
    assert output["sent"] >= 2


def test_wrong_calibration_and_profile_are_sentences(tmp_path: Path) -> None:
    result = runner.invoke(app, ["live", f"--calibration={tmp_path / 'none.toml'}", "--camera=a=b.mp4"])
    assert (result.exit_code, "does not exist" in result.stderr) == (2, True)
    result = runner.invoke(app, ["live", "--calibration=c.toml", "--camera=a=b.mp4", "--profile=quick"])
    assert (result.exit_code, "fast" in result.stderr, "Traceback" in result.stderr) == (2, True, False)


def test_interruption_ends_capture_and_second_ends_command() -> None:
    stops = []
    with _stopped_by_signals(lambda: stops.append(1)):
        signal.raise_signal(signal.SIGINT)
        assert stops == [1]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert stops == [1]


@pytest.mark.slow
def test_sample_videos_are_cameras(tmp_path: Path) -> None:
    """Two people of the sample reach a file, a folder and a receiver of VMC."""
    if (sample := locate()) is None or not any(network.installed for network in status()):
        pytest.skip("the sample capture or the networks are not installed")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        options = [f"--output=vmc://127.0.0.1:{receiver.getsockname()[1]}", f"--keep={tmp_path / 'kept'}"]
        options += [f"--camera={name}={path}" for name, path in sample.videos.items()]
        result = runner.invoke(app, ["live", f"--calibration={sample.calibration}", *options, "--preview=0", "--json"])
    assert result.exit_code == 0, result.output
    assert "Preview: http://127.0.0.1:" in result.stderr
    ready, *instants, ended = [json.loads(line) for line in result.stdout.splitlines()]
    assert (ready["type"], ended["type"]) == ("ready", "ended")
    assert [camera["state"] for camera in ended["cameras"]] == ["ended"] * 4
    assert all(camera["detected"] + camera["dropped"] == camera["decoded"] == 100 for camera in ended["cameras"])
    assert len([line for line in instants if line["type"] == "instant"]) == ended["instants"] > 0
    assert (tmp_path / "kept" / "timestamps.csv").read_text().count("\n") > 4
