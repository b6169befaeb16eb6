"""Interface of outputs: a protocol's class, and what it is made with."""

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from pipeline.run.live.outputs.addresses import OutputAddress
from pipeline.run.live.records import LiveInstant


@dataclass(frozen=True, slots=True)
class OutputStart:
    """Facts that an output is made with, when a capture begins."""

    address: OutputAddress  # Its host is an IP address that may be used
    rate_hz: float  # Rate of the instants
    joints: tuple[str, ...]  # Names of the joints of ``LivePerson.xyz_m``


class LiveOutput(Protocol):
    """Output of a live capture, to be used in a ``with`` block.

    A class is called with an ``OutputStart``. The block opens and closes sockets; a server answers its receivers on
    threads of its own within the block. Entering raises ``OSError`` if the address can't be used.
    """

    def __enter__(self) -> Self:
        """Open the output."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the output."""
        ...

    def ready(self) -> str:
        """Address at which receivers are reached, or connect; a server's has the port that it got."""
        ...

    def send(self, instant: LiveInstant) -> int:
        """Send the people of an instant, without waiting for receivers; return the number of packets.

        0: no receiver is connected, or there is nothing to send. Always called by one thread, in the order of time; an
        instant may be left out. Raises ``OSError`` if nothing can be sent now, ``ConnectionRefusedError`` if no
        receiver is there; the next instant is tried again.
        """
        ...
