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
from pipeline.run.live.outputs.addresses import OutputProtocol, read_outputs
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


class _NewestInstants:
    """Thread that handles the newest instants; ``drop`` is called for each that waited for too long."""

    def __init__(self, name: str, handle: Callable[[LiveInstant], None], drop: Callable[[], None]) -> None:
        self._handle, self._drop = handle, drop
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
                self._drop()
            self._waiting.append(instant)
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_over)
                if not self._waiting:
                    return
                instant = self._waiting.popleft()
            self._handle(instant)


class _StatedOutput:
    """Output with its state and counts."""

    def __init__(self, output: LiveOutput, protocol: OutputProtocol) -> None:
        self._output = output
        # Receivers connect to servers, and to streams that have a name.
        self._idle: OutputState = "listening" if protocol.is_server or protocol.port is None else "waiting"
        self.status = OutputStatus(output.ready(), protocol.label, self._idle)

    def send(self, instant: LiveInstant) -> None:
        """Send an instant."""
        status = self.status
        try:
            num_sent = self._output.send(instant)
        except ConnectionRefusedError:
            status.state, status.message = "no receiver", None
            status.failed += 1
        except OSError as error:
            status.state, status.message = "failed", error.strerror or str(error)
            status.failed += 1
        else:
            status.state, status.message = "sending" if num_sent else self._idle, None
            status.sent += num_sent

    def drop(self) -> None:
        """Count an instant that waited for too long."""
        self.status.dropped += 1


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
        outputs: list[_StatedOutput] = []
        for address in self._addresses:
            start = OutputStart(address, rate_hz, tuple(joints))
            try:
                output = self._opened.enter_context(resolve_name(address.protocol.factory)(start))
            except OSError as error:
                message = f"{address.text} can't be opened: {error.strerror or error}."
                problems.append(Problem(PARAMETER_RANGE, message, field="output", hint="Choose another address."))
            else:
                outputs.append(_StatedOutput(output, address.protocol))
        require(problems)
        self.statuses += [output.status for output in outputs]
        threads = [self._thread(output.status.address, output.send, output.drop) for output in outputs]
        puts: list[Callable[[LiveInstant], None]] = [thread.put for thread in threads]
        fingers = FingerPoses(joints)

        def prepare(instant: LiveInstant) -> None:
            instant = fingers.with_fingers(instant)
            for put in puts:
                put(instant)

        def drop() -> None:
            for output in outputs:
                output.drop()

        self._show = [self._thread("fingers", prepare, drop).put] if fingers.has_fingers and outputs else puts

    def _thread(self, name: str, handle: Callable[[LiveInstant], None], drop: Callable[[], None]) -> _NewestInstants:
        return self._opened.enter_context(_NewestInstants(name, handle, drop))

    def show(self, instant: LiveInstant) -> None:
        """Have an instant sent by all outputs; returns at once."""
        for put in self._show:
            put(instant)
