import concurrent.futures
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from api.errors import ApiError
from api.preflight import InvalidFilesError, Preflight
from api.settings import Settings
from tests.api.conftest import Live, form, problem_of, running


def test_check_that_crashes_is_the_services_fault(live: Live) -> None:
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
        Preflight((sys.executable, "-c", script), 1.0, 1000, 1000).check([], tmp_path / "record")
    deadline_s = time.monotonic() + 5
    while any("47.11" in str(process.info["cmdline"]) for process in psutil.process_iter(["cmdline"])):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


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
        Preflight((sys.executable, "-c", script), 10.0, 1_000_000, 1000).check([], tmp_path / "record")
    assert raised.value.status == status


def test_checks_beyond_the_limit_wait_without_holding_others_up(make_settings: Callable[..., Settings]) -> None:
    with (
        running(make_settings(max_parallel_preflights=1, preflight_timeout_s=1.0)) as live,
        concurrent.futures.ThreadPoolExecutor(3) as pool,
    ):
        started_s = time.monotonic()
        hanging = [pool.submit(live.client.post, "/v1/sessions", files=form(1, b"HANG!")) for _ in range(3)]
        time.sleep(0.2)
        asked_s = time.monotonic()
        assert live.client.get("/healthz").status_code == 200
        assert time.monotonic() - asked_s < 0.5
        assert {answer.result().status_code for answer in hanging} == {422}
        assert time.monotonic() - started_s > 2.9
