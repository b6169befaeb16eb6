"""Unreliable connection: a proxy that cuts connections in the middle."""

import contextlib
import random
import socket
import threading
from collections import deque
from collections.abc import Iterator, Sequence

_BLOCK_BYTES = 2**16


class BreakingLine:
    """Proxy on a free port of loopback.

        Parameters
        ----------
        ports
    Ports of the processes of the service, which take turns at connections and may be stopped.
        cuts
    Number of connections that are cut, each after a part of the client's bytes; other connections are not cut.
        most_bytes
    Largest number of bytes before a cut.
    """

    def __init__(self, ports: Sequence[int], cuts: int, most_bytes: int, seed: int) -> None:
        self.cuts_made = 0
        self._ports, self._cuts, self._most_bytes = deque(ports), cuts, most_bytes
        self._random = random.Random(seed)  # noqa: S311 - it is to be repeated
        self._lock = threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=128)
        self._open: set[socket.socket] = set()

    @property
    def port(self) -> int:
        return int(self._listening.getsockname()[1])

    def serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listening.accept()
                threading.Thread(target=self._pass_on, args=[client, self._turn()], daemon=True).start()

    def close(self) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for one in list(self._open):
            self._cut(one)

    def _turn(self) -> list[int]:
        """Ports in the order in which they are tried, another one first each time."""
        self._ports.rotate(-1)
        return list(self._ports)

    def _pass_on(self, client: socket.socket, ports: Sequence[int]) -> None:
        for port in ports:  # as a balancer does: a process that is down is passed over
            with contextlib.suppress(OSError):
                service = socket.create_connection(("127.0.0.1", port), timeout=180)
                break
        else:
            client.close()
            return
        both = {client, service}
        self._open |= both
        back = threading.Thread(target=self._copy, args=[service, client], daemon=True)
        back.start()
        # HEAD, POST and responses are shorter than any cut.
        num_bytes, last = 0, self._random.randrange(1000, self._most_bytes)
        with contextlib.suppress(OSError):
            while data := client.recv(_BLOCK_BYTES):
                service.sendall(data)
                num_bytes += len(data)
                if num_bytes > last and self._may_cut():
                    break
            else:
                service.shutdown(socket.SHUT_WR)
                back.join()
        for one in both:
            self._cut(one)
        self._open -= both

    def _may_cut(self) -> bool:
        with self._lock:
            if self.cuts_made == self._cuts:
                return False
            self.cuts_made += 1
            return True

    def _copy(self, source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(_BLOCK_BYTES):
                target.sendall(data)
        # Close the client's side even if the service was killed, so that the client does not wait for a response.
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def _cut(self, one: socket.socket) -> None:
        with contextlib.suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)
        one.close()


@contextlib.contextmanager
def breaking_line(ports: Sequence[int], cuts: int, most_bytes: int, seed: int = 0) -> Iterator[BreakingLine]:
    line = BreakingLine(ports, cuts, most_bytes, seed)
    thread = threading.Thread(target=line.serve, daemon=True)
    thread.start()
    try:
        yield line
    finally:
        line.close()
        thread.join(10)
