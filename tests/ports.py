"""Ports for servers that tests start as programs of their own."""

import random
import socket

# Linux gives ports from 32768 on to clients and to servers that ask for any port.
_PORTS = range(20_000, 32_768)


def free_port() -> int:
    """Port of 127.0.0.1, free for TCP and UDP, that no other program gets before a server listens on it."""
    while True:
        port = random.SystemRandom().choice(_PORTS)
        try:
            with socket.create_server(("127.0.0.1", port)), socket.socket(type=socket.SOCK_DGRAM) as datagrams:
                datagrams.bind(("127.0.0.1", port))
                return port
        except OSError:
            continue
