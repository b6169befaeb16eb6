"""``python -m api.cli.benchmark.receivers``: receivers of live outputs, in a process of their own.

The words are the port of a receiver of VMC, the number of connections that come and go, and ``hang`` or ``read`` with
the port of a server of Qualisys' protocol, whose stream a receiver asks for. Until stdin is closed datagrams are
received; then their arrivals are printed as JSON: times of the instants, and of the monotonic clock.
"""

import contextlib
import json
import socket
import struct
import sys
import threading
import time
from collections.abc import Sequence

_COMMAND = 1
_TIME = b"/VMC/Ext/T\0\0,f\0\0"


def _command(text: str) -> bytes:
    content = text.encode() + b"\0"
    return struct.pack("<II", 8 + len(content), _COMMAND) + content


def stream(port: int, *, reads: bool) -> None:
    """Ask for a stream of skeletons, and read it for ever or never."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(_command("Version 1.22") + _command("StreamFrames AllFrames 3D Skeleton"))
        while reads and connection.recv(65_536):
            pass
        threading.Event().wait()


def come_and_go(port: int, num_connections: int) -> None:
    """Open so many connections, of which the oldest makes room for the next one, again and again."""
    opened: list[socket.socket] = []
    while True:
        with contextlib.suppress(OSError):
            opened.append(socket.create_connection(("127.0.0.1", port), timeout=1.0))
            opened[-1].sendall(_command("StreamFrames AllFrames 3D"))
        if len(opened) >= num_connections:
            opened.pop(0).close()


def main(words: Sequence[str]) -> int:
    """Receive until stdin is closed; print the arrivals."""
    vmc_port, num_connections, kind, server_port = int(words[0]), int(words[1]), words[2], int(words[3])
    arrivals: list[tuple[float, float]] = []
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", vmc_port))

    def receive() -> None:
        while True:
            packet = receiver.recv(65_536)
            arrived_s = time.monotonic()
            place = packet.find(_TIME)
            if place >= 0:
                arrivals.append((struct.unpack_from(">f", packet, place + len(_TIME))[0], arrived_s))

    threading.Thread(target=receive, daemon=True).start()
    if server_port:
        threading.Thread(target=stream, args=[server_port], kwargs={"reads": kind == "read"}, daemon=True).start()
        if num_connections:
            # Later than the stream: a server ends connections without a stream for new ones.
            coming = threading.Timer(1.0, come_and_go, [server_port, num_connections])
            coming.daemon = True
            coming.start()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.read()
    sys.stdout.write(json.dumps(arrivals))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
