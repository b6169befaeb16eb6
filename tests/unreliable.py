"""TCP proxy before a server that can be told to have an outage: refuse, hang, answer 503, or break off."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from typing import Literal

Mode = Literal["forward", "unavailable", "slow_down", "forbidden", "hang", "reset", "refuse", "break_off"]

_RESPONSES = {
    "unavailable": b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
    "slow_down": b"HTTP/1.1 429 Too Many Requests\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
    "forbidden": b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
}
_BLOCK_BYTES = 2**16


class UnreliableProxy:
    """TCP proxy on loopback. ``mode`` decides what it does with new and open connections, at any time.

    Parameters
    ----------
    port
        Port of the server on loopback.
    """

    def __init__(self, port: int) -> None:
        self._target = ("127.0.0.1", port)
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=128)
        self.port = int(self._listening.getsockname()[1])
        self.mode: Mode = "forward"
        self.num_connections = 0
        # Bytes of a response after which it breaks off, in the mode ``break_off``.
        self.break_after = 0
        self._open: set[socket.socket] = set()

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def set(self, mode: Mode) -> None:
        """Change the mode; an outage ends the open connections, except for ``hang``, which keeps them silent."""
        self.mode = mode
        if mode not in {"forward", "hang", "break_off"}:
            for one in list(self._open):
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def serve(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            self.num_connections += 1
            threading.Thread(target=self._handle, args=[client], daemon=True).start()

    def close(self) -> None:
        # Wakes the thread that accepts.
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for one in list(self._open):
            one.close()

    def _handle(self, client: socket.socket) -> None:
        self._open.add(client)
        try:
            if self.mode in {"refuse", "reset"}:
                # Without lingering the peer gets a reset.
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
                if self.mode == "reset":
                    client.recv(1)
                return
            if self.mode in _RESPONSES:
                self._answer(client, _RESPONSES[self.mode])
                return
            with socket.create_connection(self._target) as server:
                self._open.add(server)
                thread = threading.Thread(target=self._pump, args=[client, server, False], daemon=True)
                thread.start()
                self._pump(server, client, True)
                thread.join()
        except OSError:
            return
        finally:
            self._open.discard(client)
            client.close()

    def _answer(self, client: socket.socket, response: bytes) -> None:
        """Read a request with its body, so that the answer is not lost to a reset, and answer."""
        head = b""
        while b"\r\n\r\n" not in head:
            if not (data := client.recv(_BLOCK_BYTES)):
                return
            head += data
        head, _, body = head.partition(b"\r\n\r\n")
        length = 0
        for line in head.split(b"\r\n"):
            name, _, value = line.partition(b":")
            if name.lower() == b"content-length":
                length = int(value)
            if name.lower() == b"expect":
                length = 0
        left = length - len(body)
        while left > 0 and (data := client.recv(min(left, _BLOCK_BYTES))):
            left -= len(data)
        client.sendall(response)

    def _pump(self, source: socket.socket, target: socket.socket, is_response: bool) -> None:
        num_bytes = 0
        try:
            while data := source.recv(_BLOCK_BYTES):
                while self.mode == "hang":
                    time.sleep(0.05)
                if self.mode not in {"forward", "break_off"}:
                    return
                if is_response and self.mode == "break_off":
                    left = self.break_after - num_bytes
                    if len(data) > left:
                        target.sendall(data[: max(0, left)])
                        return
                target.sendall(data)
                num_bytes += len(data)
        except OSError:
            return
        finally:
            for one in (source, target):
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
            self._open.discard(target)


@contextlib.contextmanager
def unreliable(port: int) -> Iterator[UnreliableProxy]:
    """Run a proxy before a server during the block."""
    proxy = UnreliableProxy(port)
    thread = threading.Thread(target=proxy.serve, daemon=True)
    thread.start()
    try:
        yield proxy
    finally:
        proxy.close()
        thread.join(10)
