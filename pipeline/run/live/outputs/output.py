"""Interface of outputs: a protocol's class, and what it is made with."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Self

from pipeline.run.live.outputs.addresses import OutputAddress
from pipeline.run.live.outputs.slots import PersonSlots
from pipeline.run.live.records import LiveInstant


@dataclass(frozen=True, slots=True)
class OutputStart:
    """Facts that an output is made with, when a capture begins."""

    address: OutputAddress  # Its host is an IP address that may be used
    rate_hz: float  # Rate of the instants
    joints: tuple[str, ...]  # Names of the joints of ``LivePerson.xyz_m``


class LiveOutput(ABC):
    """Output of a live capture, to be used in a ``with`` block.

    The block opens and closes sockets; a server answers its receivers on threads of its own within the block. Entering
    raises ``OSError`` if the address can't be used. ``num_people``: number of people who are sent, from the first on.
    """

    def __init__(self, start: OutputStart, num_people: int = 32) -> None:
        self.address, self.rate_hz, self.joints = start.address, start.rate_hz, start.joints
        self.slots = PersonSlots(num_people)
        self._first_s: float | None = None

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, *error: object) -> None:
        """Close the output."""

    @abstractmethod
    def send(self, instant: LiveInstant) -> int:
        """Send the people of an instant, without waiting for receivers; return the number of packets.

        0: no receiver is connected, or there is nothing to send. Always called by one thread, in the order of time; an
        instant may be left out. Raises ``OSError`` if nothing can be sent now, ``ConnectionRefusedError`` if no
        receiver is there; the next instant is tried again.
        """

    def elapsed_s(self, instant: LiveInstant) -> float:
        """Time since the first instant for which this was called."""
        self._first_s = instant.time_s if self._first_s is None else self._first_s
        return instant.time_s - self._first_s
