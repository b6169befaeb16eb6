"""`multicap live` with RTSP cameras on loopback: one dies and comes back, and Ctrl-C ends the capture."""

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO, Any

import psutil
import pytest

from pipeline.detection.models import status
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.run.live.cameras.servers import LoopbackServer, encoded_pictures, rtsp_camera

pytestmark = pytest.mark.slow
WAIT_S = 120.0


def follow(output: IO[str], lines: list[dict[str, Any]]) -> None:
    lines.extend(json.loads(line) for line in output)


def wait_for(lines: list[dict[str, Any]], text: str) -> None:
    """Wait for a line with a text."""
    end_s = time.monotonic() + WAIT_S
    while not any(text in json.dumps(line) for line in list(lines)):
        assert time.monotonic() < end_s, lines
        time.sleep(0.05)


def test_camera_dies_and_comes_back(tmp_path: Path) -> None:
    if not any(network.installed for network in status()):
        pytest.skip("the networks are not installed")
    rig = calibration(tmp_path / "rig.json", ["a", "b"])
    camera = rtsp_camera(encoded_pictures(20), 10.0, [0.0])
    with LoopbackServer(camera) as first, LoopbackServer(camera) as second:
        sources = [f"--camera={name}=rtsp://127.0.0.1:{server.port}/" for name, server in (("a", first), ("b", second))]
        command = [sys.executable, "-m", "api.cli.main", "live", f"--calibration={rig}", *sources, "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            lines: list[dict[str, Any]] = []
            reader = threading.Thread(target=follow, args=[process.stdout, lines])
            reader.start()
            wait_for(lines, '"sequence": 5')
            second.close()
            wait_for(lines, "b is lost")
            with LoopbackServer(camera, second.port):
                wait_for(lines, "b is open again")
                children = psutil.Process(process.pid).children(recursive=True)
                process.send_signal(signal.SIGINT)
                assert process.wait(30) == 0
            reader.join()
    gone, alive = psutil.wait_procs(children, 10)
    assert (len(gone), alive) == (len(children), [])
    assert (lines[0]["type"], lines[-1]["type"]) == ("ready", "ended")
    assert [(camera["name"], camera["lost"]) for camera in lines[-1]["cameras"]] == [("a", 0), ("b", 1)]
    assert lines[0]["frame_rate_hz"] == pytest.approx(10.0, rel=0.1)
