"""Datagrams to receivers of UDP, and packets of OSC whose numbers change."""

import socket
import struct
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pythonosc.osc_message_builder import OscMessageBuilder

from pipeline.run.live.outputs.output import LiveOutput
from pipeline.run.live.records import LiveInstant

_FLOAT_BYTES = 4
_SIZE = struct.Struct(">i")
_BUNDLE = b"#bundle\0" + struct.pack(">q", 1)  # To be applied at once


class DatagramOutput(LiveOutput):
    """Output whose packets go to one or more ports of a machine; no packet waits for a receiver."""

    num_ports = 1
    """Number of ports, from the port of the address on."""

    def __enter__(self) -> Self:
        self._sockets: dict[int, socket.socket] = {}
        for port in range(self.address.port, self.address.port + self.num_ports):
            sender = self._sockets[port] = socket.socket(
                socket.AF_INET6 if ":" in self.address.host else socket.AF_INET, socket.SOCK_DGRAM
            )
            sender.setblocking(False)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            sender.connect((self.address.host, port))  # so that a machine's answer that no receiver is there is told
        return self

    def __exit__(self, *error: object) -> None:
        for sender in self._sockets.values():
            sender.close()

    def send(self, instant: LiveInstant) -> int:
        """See ``LiveOutput``. Raises ``OSError`` if none of several packets could be sent."""
        num_sent = 0
        last_error: OSError | None = None
        for port, packet in self.packets(instant):
            try:
                self._sockets[port].send(packet)
                num_sent += 1
            except ConnectionRefusedError as error:  # answer to the packet before, in the place of which this one goes
                last_error = error
                self._sockets[port].send(packet)
            except OSError as error:
                last_error = error
        if last_error is not None and not num_sent:
            raise last_error
        return num_sent

    @abstractmethod
    def packets(self, instant: LiveInstant) -> Iterator[tuple[int, bytes]]:
        """Ports and packets of an instant."""


class OscTemplate:
    """Bundle of OSC messages, which receivers apply at once; its numbers change from packet to packet.

    A message is an address, texts and whole numbers that stay, and a count of numbers behind them.

    >>> template = OscTemplate([("/person/1/nose", (), 3), ("/person/1/neck", (), 3)])
    >>> len(template.packet([0.5, -1.0, 1.6, 0.5, -1.0, 1.4])), len(template.packet([0.5, -1.0, 1.6], [0]))
    (96, 56)
    """

    def __init__(self, messages: Iterable[tuple[str, Sequence[str | int], int]]) -> None:
        self._heads: list[tuple[bytes, int]] = []
        for address, fixed, num_numbers in messages:
            builder = OscMessageBuilder(address)
            for value in (*fixed, *[0.0] * num_numbers):
                builder.add_arg(value)
            message, num_bytes = builder.build(), num_numbers * _FLOAT_BYTES
            head = _SIZE.pack(message.size) + message.dgram[: message.size - num_bytes]
            self._heads.append((head, num_bytes))

    def packet(self, numbers: ArrayLike, messages: Iterable[int] | None = None) -> bytes:
        """Packet with the numbers of its messages, in their order; ``messages``: places of the messages to send."""
        content, place, parts = np.asarray(numbers, ">f4").tobytes(), 0, [_BUNDLE]
        for head, num_bytes in self._heads if messages is None else map(self._heads.__getitem__, messages):
            parts += head, content[place : place + num_bytes]
            place += num_bytes
        return b"".join(parts)
