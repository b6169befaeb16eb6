"""Broken and hostile clients of live captures; as a program they attack a service all at once.

``python -m tests.api.web.live.hostile_clients ADDRESS START NUMBER``: ``START`` is a right first message, in JSON.
"""

import contextlib
import json
import random
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import websockets.sync.client
from websockets.sync.client import ClientConnection

from tests.api.web.live.messages import keypoints_message, packet

Way = Callable[[ClientConnection, str], None]
"""Behaviour of a client with a connection; the text is a right first message."""


def silent(connection: ClientConnection, start: str) -> None:
    drain(connection)


def babbles(connection: ClientConnection, start: str) -> None:
    connection.send("{" * 50_000)
    drain(connection)


def sends_nan(connection: ClientConnection, start: str) -> None:
    connection.send(start)
    connection.recv(60)
    connection.send(json.dumps(keypoints_message() | {"people": [[[float("nan")] * 3] * 17]}))
    drain(connection)


def sends_10_mb(connection: ClientConnection, start: str) -> None:
    connection.send(bytes(10_000_000))
    drain(connection)


def floods(connection: ClientConnection, start: str) -> None:
    connection.send(start)
    for number in range(5000):
        connection.send(packet(time_s=number * 1e-3))
    drain(connection)


def reads_nothing(connection: ClientConnection, start: str) -> None:
    connection.send(start)
    for number in range(150):
        connection.send(packet(time_s=200.0 + number * 1e-3))
    time.sleep(1.0)
    connection.socket.shutdown(socket.SHUT_RDWR)


def crashes_the_computation(connection: ClientConnection, start: str) -> None:
    connection.send(start)
    connection.send(packet(time_s=random.choice([666.0, 999.0])))  # noqa: S311
    drain(connection)


def vanishes(connection: ClientConnection, start: str) -> None:
    connection.send(json.dumps(json.loads(start) | {"keep": True}))
    connection.send(packet())
    connection.socket.shutdown(socket.SHUT_RDWR)


HOSTILE: tuple[Way, ...] = (
    *(silent, babbles, sends_nan, sends_10_mb, floods, reads_nothing, crashes_the_computation, vanishes),
)


def drain(connection: ClientConnection) -> None:
    while True:
        connection.recv(60)


def attack(address: str, way: Way, start: str) -> None:
    """Open a connection and do as the way says, whatever becomes of it: refusals, closed connections, time-outs."""
    with (
        contextlib.suppress(websockets.WebSocketException, OSError, TimeoutError),
        websockets.sync.client.connect(address, max_size=None, open_timeout=60, close_timeout=20) as connection,
    ):
        way(connection, start)


def attack_by(address: str, start: dict[str, Any], num_clients: int) -> list[threading.Thread]:
    """Let clients attack a service, one after the other in 20 ms, each by another way."""
    threads = []
    for number in range(num_clients):
        way = HOSTILE[number % len(HOSTILE)]
        threads.append(threading.Thread(target=attack, args=(address, way, json.dumps(start))))
        threads[-1].start()
        time.sleep(0.02)
    return threads


if __name__ == "__main__":
    for thread in attack_by(sys.argv[1], json.loads(sys.argv[2]), int(sys.argv[3])):
        thread.join()
