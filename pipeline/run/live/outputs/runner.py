"""Outputs of a live capture while it runs: a thread each, so that none delays the capture or another output."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pkgutil import resolve_name
from typing import Any, Literal, Self

from pipeline.core.errors import Problem
from pipeline.core.options.rules import require
from pipeline.core.problems.finding_codes import PARAMETER_RANGE
from pipeline.run.live.outputs.addresses import read_outputs
from pipeline.run.live.outputs.fingers import FingerPoses
from pipeline.run.live.outputs.output import LiveOutput, OutputStart
from pipeline.run.live.records import LiveInstant

# Instants that wait for an output; with more, the oldest is dropped.
_MAX_WAITING = 2
# Time that the end of a capture waits for an output.
_LAST_S = 2.0

OutputState = Literal["listening", "waiting", "sending", "no receiver", "failed"]
"""State of an output. Listening: no receiver has connected. Waiting: no person is there."""


@dataclass(slots=True)
class OutputStatus:
    """State of an output and its counts so far."""

    address: str
    protocol: str
    state: OutputState = "waiting"
    message: str | None = None  # Reason of the state ``failed``
    sent: int = 0  # Packets
    dropped: int = 0  # Instants that waited for too long
    failed: int = 0  # Instants that could not be sent

    def document(self) -> dict[str, Any]:
        """Status as values of JSON."""
        return asdict(self)

    def fail(self, error: Exception) -> None:
        """Count an instant that could not be sent, and take the reason."""
        self.state, self.message = "failed", str(error)
        if isinstance(error, ConnectionRefusedError):
            self.state, self.message = "no receiver", None
        elif isinstance(error, OSError):
            self.message = error.strerror or str(error)
        else:  # a fault of ours, which must neither end the capture nor stay silent
            self.message = f"internal error, {type(error).__name__}: {error}"
        self.failed += 1


class _NewestInstants:
    """Thread that handles the newest instants for outputs; their statuses get what is dropped, and what fails."""

    def __init__(self, name: str, handle: Callable[[LiveInstant], None], statuses: Sequence[OutputStatus]) -> None:
        self._handle, self._statuses = handle, statuses
        self._waiting: deque[LiveInstant] = deque()
        self._changed = threading.Condition()
        self._is_over = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join(_LAST_S)

    def put(self, instant: LiveInstant) -> None:
        """Have an instant handled soon; the oldest one that waits makes room for it."""
        with self._changed:
            if len(self._waiting) == _MAX_WAITING:
                self._waiting.popleft()
                for status in self._statuses:
                    status.dropped += 1
            self._waiting.append(instant)
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_over)
                if not self._waiting:
                    return
                instant = self._waiting.popleft()
            try:
                self._handle(instant)
            except Exception as error:
                for status in self._statuses:
                    status.fail(error)


def _sending(output: LiveOutput, status: OutputStatus) -> Callable[[LiveInstant], None]:
    idle = status.state

    def send(instant: LiveInstant) -> None:
        num_sent = output.send(instant)
        status.state, status.message = "sending" if num_sent else idle, None
        status.sent += num_sent

    return send


class LiveOutputs:
    """Outputs that send people of a live capture to other programs, to be used in a ``with`` block.

    Each output has a thread of its own. An output that is too slow leaves instants out.

    Parameters
    ----------
    addresses
        Addresses such as ``vmc://127.0.0.1:39539``.
    allow_network
        Whether other machines may be reached: the protocols have neither keys nor encryption.

    Raises
    ------
    InputError
        If addresses are wrong, unknown, or on other machines and not allowed; it names all of them.

    Examples
    --------
    >>> with LiveOutputs(["vmc://127.0.0.1:39540?people=2"]) as outputs:
    ...     outputs.begin(["nose"], 25.0)
    ...     [(output.address, output.state) for output in outputs.statuses]
    [('vmc://127.0.0.1:39540?people=2', 'waiting')]
    """

    def __init__(self, addresses: Sequence[str], *, allow_network: bool = False) -> None:
        self._addresses = read_outputs(addresses, allow_network)
        self._opened = ExitStack()
        self._show: list[Callable[[LiveInstant], None]] = []
        self.statuses: list[OutputStatus] = []
        """State and counts of each output, from ``begin`` on."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def begin(self, joints: Sequence[str], rate_hz: float) -> None:
        """Open the outputs for instants with these joints, at this rate.

        Raises ``InputError`` with all outputs that can't be opened.
        """
        problems: list[Problem] = []
        outputs: list[LiveOutput] = []
        for address in self._addresses:
            start, protocol = OutputStart(address, rate_hz, tuple(joints)), address.protocol
            try:
                output = self._opened.enter_context(resolve_name(protocol.factory)(start))
            except (OSError, RuntimeError) as error:  # RuntimeError: the library of a package is missing
                message = f"{address.text} can't be opened: {getattr(error, 'strerror', None) or error}."
                problems.append(Problem(PARAMETER_RANGE, message, field="output", hint="Choose another address."))
            else:
                # Receivers connect to servers, and to streams that have a name.
                idle: OutputState = "listening" if protocol.is_server or protocol.port is None else "waiting"
                outputs.append(output)
                self.statuses.append(OutputStatus(output.address.text, protocol.label, idle))
        require(problems)
        self._show = [
            self._thread(status.address, _sending(output, status), [status])
            for output, status in zip(outputs, self.statuses, strict=True)
        ]
        fingers = FingerPoses(joints)
        if fingers.has_fingers and outputs:
            puts = self._show

            def prepare(instant: LiveInstant) -> None:
                instant = fingers.with_fingers(instant)
                for put in puts:
                    put(instant)

            self._show = [self._thread("fingers", prepare, self.statuses)]

    def _thread(
        self, name: str, handle: Callable[[LiveInstant], None], statuses: Sequence[OutputStatus]
    ) -> Callable[[LiveInstant], None]:
        return self._opened.enter_context(_NewestInstants(name, handle, statuses)).put

    def show(self, instant: LiveInstant) -> None:
        """Have an instant sent by all outputs; returns at once."""
        for put in self._show:
            put(instant)
