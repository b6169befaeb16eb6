"""Memory of the service while it receives large forms and sends large archives."""

import os
from collections.abc import Callable, Iterator

import pytest

from api.web.settings import GIB, MIB, Settings
from tests.api.conftest import running
from tests.api.processes import peak_bytes, serving

BOUNDARY = "xyz"


def session(num_bytes: int) -> Iterator[bytes]:
    head = '--xyz\r\nContent-Disposition: form-data; name="{}"; filename="{}"\r\n\r\n'
    yield head.format("calibration", "c.toml").encode() + b"[cam_0]\r\n"
    yield head.format("videos", "cam_0.mp4").encode()
    block = os.urandom(MIB)
    for _ in range(num_bytes // MIB):
        yield block
    yield b"\r\n--xyz--\r\n"


def growth_bytes(settings: Settings, num_bytes: int) -> int:
    headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
    with serving(settings) as (client, process):
        assert client.post("/v1/sessions", content=session(MIB), headers=headers).status_code == 201
        before = peak_bytes(process)
        answer = client.post("/v1/sessions", content=session(num_bytes), headers=headers)
        assert answer.status_code == 201, answer.text
        assert answer.json()["files"][0]["num_bytes"] == num_bytes
        return peak_bytes(process) - before


def archive_growth_bytes(settings: Settings, num_bytes: int) -> int:
    """Growth of the service's peak memory by a large archive of results, after a small archive."""
    with running(settings) as live:
        small = live.job_id()
        live.finish(small)
        large = live.job_id()
        live.finish(large, os.urandom(num_bytes))
    with serving(settings) as (client, process):
        assert client.get(f"/v1/jobs/{small}/results.zip").status_code == 200
        before = peak_bytes(process)
        with client.stream("GET", f"/v1/jobs/{large}/results.zip") as answer:
            assert answer.status_code == 200
            assert sum(len(block) for block in answer.iter_bytes()) > num_bytes
        return peak_bytes(process) - before


def test_archive_takes_no_memory(make_settings: Callable[..., Settings]) -> None:
    assert archive_growth_bytes(make_settings(), 192 * MIB) <= 12 * MIB


def test_upload_takes_no_memory(make_settings: Callable[..., Settings]) -> None:
    assert growth_bytes(make_settings(), 192 * MIB) <= 12 * MIB


@pytest.mark.benchmark
def test_two_gigabytes_take_no_memory(make_settings: Callable[..., Settings]) -> None:
    assert growth_bytes(make_settings(), 2 * GIB) <= 64 * MIB
