"""Outputs over long captures: memory does not grow, whoever comes and goes."""

import contextlib
import socket
import struct
import threading
from pkgutil import resolve_name

import psutil
import pytest

from pipeline.run.live.outputs.addresses import read_outputs
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.records import LiveInstant, LivePerson
from tests.pipeline.run.live.outputs.people import JOINTS, live_instant
from tests.ports import free_port

RATE_HZ = 60.0
NUM_FIRST, NUM_MORE = 2_000, 6_000
MOST_GROWTH_BYTES = 3_000_000


def _read_all(port: int) -> None:
    """Receive frames of QTM until the server ends the connection."""
    text = b"StreamFrames AllFrames 3D Skeleton\0"
    with contextlib.suppress(ConnectionError), socket.create_connection(("127.0.0.1", port), 60) as connection:
        connection.sendall(struct.pack("<II", 8 + len(text), 1) + text)
        while connection.recv(65_536):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["qtm", "mvn", "rokoko", "lsl"])
def test_long_capture_needs_no_more_memory(scheme: str) -> None:
    """Every five seconds the four people are others, as at a busy place: two minutes of capture."""
    if scheme == "lsl":
        pytest.importorskip("pylsl", reason="pylsl is not installed (the extra `lsl`)")
    port = free_port()
    (address,) = read_outputs(["lsl://long?people=4" if scheme == "lsl" else f"{scheme}://127.0.0.1:{port}"], True)
    people = live_instant().people
    with contextlib.ExitStack() as opened:
        receiver = opened.enter_context(socket.socket(type=socket.SOCK_DGRAM))
        if scheme in {"mvn", "rokoko"}:
            receiver.bind(("127.0.0.1", port))
        output = opened.enter_context(resolve_name(address.protocol.factory)(OutputStart(address, RATE_HZ, JOINTS)))
        reader = threading.Thread(target=_read_all, args=(port + 1,))
        if scheme == "qtm":
            reader.start()
        used = []
        for number in range(NUM_FIRST + NUM_MORE):
            others = 4 * (number // 300)
            shown = (LivePerson(person.id + others, person.xyz_m, person.skeleton) for person in people)
            assert output.send(LiveInstant(number / RATE_HZ, tuple(shown), 0.0)) >= 0
            if number in {NUM_FIRST, NUM_FIRST + NUM_MORE - 1}:
                used.append(psutil.Process().memory_info().rss)
    if scheme == "qtm":
        reader.join()
    assert used[1] - used[0] < MOST_GROWTH_BYTES
