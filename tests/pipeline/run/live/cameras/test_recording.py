"""Recording of cameras for a moment: a video of each, with the times at which its pictures were taken."""

import errno
import json
import os
import threading
from io import BytesIO
from pathlib import Path
from typing import Any

import av
import pytest

from pipeline.run.live.cameras import feed
from pipeline.run.live.cameras.recording import run
from pipeline.run.live.cameras.stream_program import _usual_problem
from pipeline.run.live.packets import CaptureAnswer, framed, read_message
from tests.pipeline.run.live.cameras.servers import SIZE_PX, encoded_pictures, mjpeg_camera, rtsp_camera, serving


class OpenPipe(BytesIO):
    """Pipe with a start whose other side stays open."""

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(size)
        if not content:
            threading.Event().wait()
        return content


def recorded(folder: Path, *addresses: str, duration_s: float = 1.0) -> tuple[int, list[tuple[CaptureAnswer, Any]]]:
    """Exit code, and all answers."""
    sources = [
        {"camera": f"cam_{place}", "kind": address.partition(":")[0], "address": address, "host": None}
        for place, address in enumerate(addresses)
    ]
    start = {"sources": sources, "duration_s": duration_s, "folder": str(folder)}
    answers, found = BytesIO(), []
    code = run(OpenPipe(framed(json.dumps(start).encode())), answers)
    answers.seek(0)
    while (answer := read_message(answers)) is not None:
        found.append((CaptureAnswer(answer[:1]), json.loads(answer[1:])))
    return code, found


@pytest.mark.slow
def test_each_camera_becomes_a_video(tmp_path: Path) -> None:
    with serving(mjpeg_camera(10, 20.0)) as one, serving(rtsp_camera(encoded_pictures(20), 10.0, [0.0])) as other:
        code, answers = recorded(tmp_path, f"http://127.0.0.1:{one.port}/", f"rtsp://127.0.0.1:{other.port}/")
    assert code == 0, answers
    (told, notice), (end, content) = answers
    assert (code, told, end) == (0, CaptureAnswer.TOLD, CaptureAnswer.END)
    assert notice["message"] == "The cameras are open, and are recorded for 1 s."
    assert min(content["offsets_s"]) == 0.0 <= max(content["offsets_s"])
    num_frames = 0
    for place, rate_hz in enumerate((20.0, 10.0)):
        with av.open(str(tmp_path / f"{place}.mkv")) as video:
            frames = list(video.decode(video=0))
        assert {(frame.width, frame.height) for frame in frames} == {SIZE_PX}
        duration_s = float(frames[-1].time or 0.0)
        assert duration_s > 0.8
        assert (len(frames) - 1) / duration_s == pytest.approx(rate_hz, rel=0.3)
        num_frames += len(frames)
    assert content["received"] == num_frames


def test_recording_that_ends_early_keeps_first_pictures(tmp_path: Path) -> None:
    with serving(mjpeg_camera(10, 20.0)) as one, serving(mjpeg_camera(10, 20.0)) as other:
        sources = [
            {"camera": str(place), "kind": "http", "address": f"http://127.0.0.1:{server.port}/", "host": None}
            for place, server in enumerate((one, other))
        ]
        start = json.dumps({"sources": sources, "duration_s": 60.0, "folder": str(tmp_path)}).encode()
        answers = BytesIO()
        assert run(BytesIO(framed(start)), answers) == 0
    answers.seek(0)
    content = json.loads((read_message(answers) or b"")[1:])
    assert content["received"] >= 2
    for place in range(2):
        with av.open(str(tmp_path / f"{place}.mkv")) as video:
            assert next(video.decode(video=0)).width == SIZE_PX[0]


def test_camera_without_process_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_request: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(feed, "StreamProcess", refused)
    code, ((kind, (problem,)),) = recorded(tmp_path, "http://127.0.0.1:1/")
    assert (code, kind, problem["camera"]) == (2, CaptureAnswer.REFUSED, "cam_0")
    assert "can't be started" in problem["message"]


def test_full_disk_is_named() -> None:
    for number in (errno.ENOSPC, errno.EFBIG):
        problem = _usual_problem(OSError(number, os.strerror(number)))
        assert (problem.message, problem.hint) == (
            "The disk has no room for the recording.",
            "Record for a shorter time, or free room on the service's disk.",
        )


@pytest.mark.slow
def test_all_cameras_that_fail_are_named(tmp_path: Path) -> None:
    with serving(mjpeg_camera(10, 20.0)) as one:
        addresses = (f"http://127.0.0.1:{one.port}/", "http://127.0.0.1:1/", "rtsp://127.0.0.1:1/")
        code, ((kind, problems),) = recorded(tmp_path, *addresses)
    assert (code, kind) == (2, CaptureAnswer.REFUSED)
    assert [(problem["camera"], problem["code"]) for problem in problems] == [
        ("cam_1", "stream_refused"),
        ("cam_2", "stream_refused"),
    ]
