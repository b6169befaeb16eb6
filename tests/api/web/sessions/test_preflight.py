"""Preflight of a session's files: results, problems, limits and crashes of the child process."""

import concurrent.futures
import io
import os
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest
from structlog.testing import capture_logs

from api.web.errors import ApiError
from api.web.http.bodies.form import Form, ReceivedFile
from api.web.sessions.preflight import InvalidFilesError, PreflightProgram, allowance_s
from api.web.settings import GIB, Settings
from tests.api.conftest import NO_BROKER, Live, form, problem_of, running
from tests.hostile.keypoints import keypoint_files, simulate
from worker.store.model.rights import Scope


def test_check_that_crashes_is_services_fault(live: Live) -> None:
    answer = live.client.post("/v1/sessions", files=form(1, b"CRASH"))
    problem_of(answer, 500, "preflight_failed")
    assert "secret" not in answer.text
    assert live.kept() == []


def test_check_that_says_too_much(live: Live) -> None:
    problem_of(live.client.post("/v1/sessions", files=form(1, b"BABEL")), 500, "preflight_failed")


def test_check_that_hangs_is_killed(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(preflight_timeout_s=0.5)) as live:
        started_s = time.monotonic()
        problem = problem_of(live.client.post("/v1/sessions", files=form(1, b"HANG!")), 422, "invalid_request")
        assert time.monotonic() - started_s < 5
        assert problem["errors"][0]["code"] == "preflight_timeout"
        assert live.kept() == []
        assert not [child for child in psutil.Process().children(recursive=True) if "preflight.py" in child.cmdline()]


def test_check_is_killed_with_its_children(tmp_path: Path) -> None:
    script = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(47.11)'])"
    with pytest.raises(InvalidFilesError):
        PreflightProgram((sys.executable, "-c", script), 1.0, 1000, 1000, GIB).check([], tmp_path / "record")
    deadline_s = time.monotonic() + 120
    while any("47.11" in str(process.info["cmdline"]) for process in psutil.process_iter(["cmdline"])):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


@pytest.mark.slow
def test_check_that_is_killed_leaves_no_unpacked_file(
    make_settings: Callable[..., Settings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The real preflight hangs after it has unpacked an archive."""
    system, modules = tmp_path / "system", tmp_path / "modules"
    system.mkdir()
    modules.mkdir()
    hang = (
        "import sys\n"
        "if 'pipeline.capture.preflight' in sys.orig_argv:\n"
        "    import pathlib, time\n"
        "    import pipeline.capture.keypoints\n"
        "    def hang(folder, *_, **__):\n"
        f"        pathlib.Path({str(tmp_path / 'unpacked')!r}).write_text(str(folder))\n"
        "        assert (folder / 'cam_0' / 'a.json').is_file()\n"
        "        time.sleep(300)\n"
        "    pipeline.capture.keypoints.open_keypoints = hang\n"
    )
    (modules / "sitecustomize.py").write_text(hang, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(modules), prepend=os.pathsep)
    monkeypatch.setenv("TMPDIR", str(system))
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("a.json", "{}")
    parts: list[tuple[str, Any]] = [("keypoints", ("cam_0.zip", content.getvalue())), form(0)[0]]
    command = Settings().preflight_command
    with running(make_settings(preflight_command=command, preflight_timeout_s=30.0)) as live:
        problem = problem_of(live.client.post("/v1/sessions", files=parts), 422, "invalid_request")
        assert [error["code"] for error in problem["errors"]] == ["preflight_timeout"]
        assert not Path((tmp_path / "unpacked").read_text()).exists()
        assert list(live.settings.spool_dir.iterdir()) == []
    assert list(system.iterdir()) == []


@pytest.mark.parametrize(
    ("script", "status"),
    [
        ("print('{}')", 500),
        ("print('[]')", 500),
        ("print('{')", 500),
        ("print('[' * 100000)", 500),
        ("print('{\"problems\": []}'); raise SystemExit(2)", 500),
        ("print('{\"problems\": [{}]}'); raise SystemExit(2)", 500),
        ("raise SystemExit(2)", 500),
        ("import os; os.kill(os.getpid(), 11)", 500),
    ],
)
def test_check_that_makes_no_sense(tmp_path: Path, script: str, status: int) -> None:
    with pytest.raises(ApiError) as raised:
        PreflightProgram((sys.executable, "-c", script), 10.0, 1_000_000, 1000, GIB).check([], tmp_path / "record")
    assert raised.value.status == status


@pytest.mark.slow
def test_checks_beyond_limit_wait_without_holding_others_up(make_settings: Callable[..., Settings]) -> None:
    with (
        running(make_settings(max_parallel_preflights=1, preflight_timeout_s=1.0)) as live,
        concurrent.futures.ThreadPoolExecutor(3) as pool,
    ):
        started_s = time.monotonic()
        hanging = [pool.submit(live.client.post, "/v1/sessions", files=form(1, b"HANG!")) for _ in range(3)]
        time.sleep(0.2)
        assert live.client.get("/healthz").status_code == 200
        assert not all(one.done() for one in hanging)
        assert {answer.result().status_code for answer in hanging} == {422}
        assert time.monotonic() - started_s > 2.9


def test_check_whose_own_child_fails_is_not_files_fault(
    make_settings: Callable[..., Settings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The child of the real preflight, which probes a video, is killed; the log has the reason."""
    kill = "import os, sys\nif 'pipeline.video.probe' in sys.orig_argv: os.kill(os.getpid(), 9)\n"
    (tmp_path / "sitecustomize.py").write_text(kill, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with capture_logs() as logged, running(make_settings(preflight_command=Settings().preflight_command)) as live:
        matroska = form(2, b"\x1aE\xdf\xa3")
        problem = problem_of(live.client.post("/v1/sessions", files=matroska), 500, "preflight_failed")
        assert live.kept() == []
    assert problem["retryable"]
    (entry,) = (line for line in logged if line["event"] == "preflight_failed")
    assert "SIGKILL" in entry["log"]


def test_session_whose_record_is_too_large_is_refused(tmp_path: Path) -> None:
    """The real preflight has a limit far below the size of its record."""
    files = keypoint_files(simulate(duration_s=1.0))
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    archives = [str(tmp_path / name) for name in files if name.endswith(".zip")]
    rest = ["--calibration", str(tmp_path / "calibration.json"), "--timestamps", str(tmp_path / "timestamps.csv")]
    spool = tmp_path / "spool"
    spool.mkdir()
    command = Settings().preflight_command
    words = ["--keypoints", *archives, *rest]
    assert PreflightProgram(command, 60.0, 1_000_000, 10_000_000, 3 * GIB).check(words, spool / "record").cameras
    assert (spool / "record").stat().st_size > 15_000
    with pytest.raises(InvalidFilesError) as raised:
        PreflightProgram(command, 60.0, 1_000_000, 15_000, 3 * GIB).check(words, spool / "record")
    (error,) = raised.value.errors
    assert error.code == "session_too_large"
    assert error.message == "The check of the files needs more memory than the service allows, or stores more."


def test_session_of_too_many_joints_is_refused(tmp_path: Path) -> None:
    files = keypoint_files(simulate())
    kinds = {".zip": "keypoints", ".csv": "timestamps", ".json": "calibration"}
    parts = [(kinds[Path(name).suffix], (name, content)) for name, content in files.items()]
    with running(Settings(data_dir=tmp_path / "data", broker_url=NO_BROKER, max_session_joints=100)) as live:
        answer = live.client.post("/v1/sessions", files=parts)
    assert answer.status_code == 422
    assert {error["code"] for error in answer.json()["errors"]} == {"session_too_large"}


@pytest.mark.slow
def test_hanging_checks_of_tenant_delay_no_other_tenant(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(preflight_timeout_s=6.0)) as live, concurrent.futures.ThreadPoolExecutor(4) as pool:
        keys = [live.services.store.keys.add(name, name, frozenset(Scope))[1] for name in ("bad", "good")]
        bad, good = ({"Authorization": f"Bearer {key}"} for key in keys)
        hanging = [
            pool.submit(live.client.post, "/v1/sessions", files=form(1, b"HANG!"), headers=bad) for _ in range(4)
        ]
        time.sleep(0.5)  # all of them are there
        assert live.client.post("/v1/sessions", files=form(), headers=good).status_code == 201
        assert not any(answer.done() for answer in hanging)
        assert {answer.result().status_code for answer in hanging} == {422}


@pytest.mark.slow
def test_without_keys_clients_take_turns_by_address(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(preflight_timeout_s=6.0)) as live, concurrent.futures.ThreadPoolExecutor(4) as pool:
        hanging = [pool.submit(live.client.post, "/v1/sessions", files=form(1, b"HANG!")) for _ in range(4)]
        time.sleep(0.5)  # all of them are there
        transport = httpx2.HTTPTransport(local_address="127.0.0.2")
        with httpx2.Client(base_url=live.client.base_url, transport=transport, timeout=180) as other:
            assert other.post("/v1/sessions", files=form()).status_code == 201
        assert not any(answer.done() for answer in hanging)


@pytest.mark.slow
def test_check_that_waits_too_long_is_refused_with_retry_after(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings(preflight_timeout_s=5.0, preflight_wait_s=0.3, max_parallel_preflights=1)
    with running(settings) as live, concurrent.futures.ThreadPoolExecutor(1) as pool:
        hanging = pool.submit(live.client.post, "/v1/sessions", files=form(1, b"HANG!"))
        time.sleep(0.5)
        answer = live.client.post("/v1/sessions", files=form())
        assert problem_of(answer, 429, "too_many_checks")["retryable"]
        assert int(answer.headers["retry-after"]) > 0
        transport = httpx2.HTTPTransport(local_address="127.0.0.2")
        with httpx2.Client(base_url=live.client.base_url, transport=transport, timeout=180) as other:
            problem_of(other.post("/v1/sessions", files=form()), 503, "checks_busy")
        assert hanging.result().status_code == 422
        assert live.kept() == []


@pytest.mark.slow
def test_large_files_wait_longer_for_their_check(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings(preflight_timeout_s=3.0, preflight_wait_s=0.1, max_parallel_preflights=1)
    with running(settings) as live, concurrent.futures.ThreadPoolExecutor(1) as pool:
        hanging = pool.submit(live.client.post, "/v1/sessions", files=form(1, b"HANG!"))
        time.sleep(0.5)
        large = form(2, bytes(32 * 2**20))  # 64 MiB add 3.75 s
        assert live.client.post("/v1/sessions", files=large).status_code != 429
        assert hanging.result().status_code == 422


@pytest.mark.parametrize(
    ("num_views", "num_bytes", "seconds"),
    [(2, 1000, 0.4), (31, 2 * GIB, 31 * 0.2 + 31 * 120), (64, 1000, 12.8)],
)
def test_time_of_check_grows_with_its_files(num_views: int, num_bytes: int, seconds: float) -> None:
    videos = tuple(ReceivedFile(f"{k}.mp4", Path(f"{k}.mp4"), num_bytes, "") for k in range(num_views))
    of_videos = Form({"videos": videos}, {}, ())
    assert allowance_s(of_videos) == pytest.approx(seconds, abs=0.01)
    of_keypoints = allowance_s(Form({"keypoints": videos}, {}, ()))
    assert of_keypoints - 0.2 * num_views == pytest.approx(30 * (seconds - 0.2 * num_views), abs=0.2)
