"""Work in a thread: results, errors in words, and tasks that are stopped while they wait."""

import threading
import time
from pathlib import Path

import pytest

from api.blender.extension.answers import RequestError
from api.blender.extension.capture_folder import find_capture
from api.blender.extension.tasks import BackgroundTask
from tests.waiting import wait_for


def ended(task: BackgroundTask) -> BackgroundTask:
    task.start()
    assert task.join(30.0)
    return task


def test_result_tells_its_progress() -> None:
    def work(task: BackgroundTask) -> int:
        task.report(0.5, "half")
        return 7

    task = ended(BackgroundTask("Count", work))
    assert (task.result, task.fraction, task.text, task.error) == (7, 0.5, "half", "")
    assert task.is_over
    assert not task.is_stopped


def test_errors_are_sentences(tmp_path: Path) -> None:
    def refuse(_task: BackgroundTask) -> None:
        raise RequestError("It is full.")

    assert ended(BackgroundTask("a", refuse)).error == "It is full."
    missing = BackgroundTask("a", lambda _task: (tmp_path / "secret" / "x").read_bytes())
    assert ended(missing).error == "A file can't be read or written: No such file or directory."
    assert ended(BackgroundTask("a", lambda _task: 1 / 0)).error == "The extension failed: ZeroDivisionError."


def test_stopped_task_is_over_at_once() -> None:
    waits, goes_on = threading.Event(), threading.Event()

    def work(task: BackgroundTask) -> str:
        waits.set()
        goes_on.wait(60)  # A call that a silent service holds up
        task.report(0.9)
        return "late"

    task = BackgroundTask("a", work).start()
    assert waits.wait(30)
    assert not task.is_over
    task.stop()
    assert task.is_over
    assert not task.join(0.05)
    goes_on.set()
    assert task.join(30)
    assert (task.result, task.fraction, task.error) == (None, None, "")


def test_pause_ends_with_task() -> None:
    task = BackgroundTask("a", lambda task: task.sleep(600.0)).start()
    start_s = time.monotonic()
    task.stop()
    assert task.join(60)
    assert time.monotonic() - start_s < 300.0
    wait_for(lambda: task.is_over, timeout_s=10)


def test_files_of_folder(tmp_path: Path) -> None:
    for name in ("b.MP4", "a.mov", "._a.mov", "notes.md", "calib.toml"):
        (tmp_path / name).write_bytes(b"12")
    files = find_capture(tmp_path)
    assert [path.name for path in files.videos] == ["a.mov", "b.MP4"]
    assert (files.calibration.name, files.num_bytes) == ("calib.toml", 6)
    (tmp_path / "other.json").touch()
    with pytest.raises(RequestError, match=r"2 files that may be a calibration: calib\.toml, other\.json\. Choose one"):
        find_capture(tmp_path)
    assert find_capture(tmp_path, tmp_path / "other.json").calibration.name == "other.json"
    with pytest.raises(RequestError, match=r"no file none\.toml"):
        find_capture(tmp_path, tmp_path / "none.toml")
    (tmp_path / "a.mov").unlink()
    with pytest.raises(RequestError, match="has 1 videos"):
        find_capture(tmp_path)
    with pytest.raises(RequestError, match="Choose the folder"):
        find_capture(tmp_path / "none")
