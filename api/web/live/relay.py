"""Relay of a live capture between its WebSocket and its process, with a backlog in each direction."""

import asyncio
import json
import time
from collections import deque
from collections.abc import Coroutine, Sequence
from functools import partial
from typing import Any

from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from api.web.http.rates import Pace
from api.web.http.websockets import SocketProblem
from api.web.live.backlog import Backlog, Waiting
from api.web.live.connection import LiveConnection
from api.web.live.intake import Intake, wrong_keypoints
from api.web.live.keeping import KeptPackets
from api.web.live.problems import failed
from api.web.live.process import CaptureProcess
from api.web.live.schemas import DroppedOut, LiveCountsOut, LiveEnd, LiveInstantOut, LiveKeypoints
from pipeline.core.problems.request_codes import LIVE_IDLE, LIVE_TOO_FAST
from pipeline.run.live.packets import CaptureAnswer, Dropped, with_dropped

# Backlogs of a connection: some seconds of a few cameras, and of instants.
_MAX_FRAMES, _MAX_INSTANTS = 1024, 256
_MAX_BACKLOG_BYTES = 8 * 2**20
# Frames that the process has and has not answered yet: the next one waits in its pipe.
_MAX_AT_PROCESS = 2
# Of the rate of the cameras: faster clients wait, in pauses of this length. Files that are played faster are welcome.
_MAX_SPEED, _PAUSE_S = 4.0, 0.05
_WATCH_S = 0.25
_TYPED = b'{"type"'


class Outgoing:
    """Messages of a capture's process to its client, with their backlog; ``kept`` holds packets, if they are kept."""

    def __init__(
        self,
        connection: LiveConnection,
        process: CaptureProcess,
        kept: KeptPackets | None = None,
        cameras: Sequence[str] = (),
    ) -> None:
        self._connection, self._process, self.kept, self.cameras = connection, process, kept, cameras
        self._settings, self._metrics = connection.settings, connection.metrics
        self._instants = Backlog(_MAX_INSTANTS, _MAX_BACKLOG_BYTES, partial(self._metrics.dropped, "instant"))
        self._num_received = 0
        self._counts: dict[str, Any] = {}

    @property
    def dropped(self) -> Dropped:
        """Messages that were dropped so far."""
        return Dropped(0, self._instants.num_dropped)

    @property
    def counts(self) -> LiveCountsOut:
        """Numbers of frames so far."""
        return LiveCountsOut(
            received=self._num_received,
            taken=self._counts.get("taken", 0),
            late=self._counts.get("late", 0),
            too_late=self._counts.get("dropped", 0),
        )

    async def _send(self) -> None:
        """Send instants as the client takes them."""
        async for content, since_s in self._instants.taken():
            # The instants of JSON begin with a brace, and state no type yet.
            message: dict[str, Any] = {"type": "websocket.send"}
            is_instant = not content.startswith(_TYPED)
            if not is_instant:
                message["text"] = content.decode()
            elif content[:1] == b"{":
                message["text"] = self._head() + content[1:].decode()
            else:
                message["bytes"] = with_dropped(content, self.dropped)
            try:
                async with asyncio.timeout(self._settings.live_idle_s):
                    await self._connection.websocket.send(message)
            except TimeoutError:
                detail = f"The client took nothing for {self._settings.live_idle_s:g} s."
                raise SocketProblem(LIVE_IDLE, detail) from None
            if is_instant:
                self._metrics.sent(since_s)

    def _head(self) -> str:
        dropped = DroppedOut(**self.dropped._asdict())
        return f'{{"type":"{LiveInstantOut.model_fields["type"].default}","dropped":{dropped.model_dump_json()},'


class Relay(Outgoing):
    """Relay of one capture; ``rate_hz`` is the rate of the frames of all cameras together."""

    def __init__(
        self,
        connection: LiveConnection,
        process: CaptureProcess,
        intake: Intake,
        kept: KeptPackets | None,
        cameras: Sequence[str],
        rate_hz: float,
    ) -> None:
        super().__init__(connection, process, kept, cameras)
        self._intake = intake
        self._frames = Backlog(_MAX_FRAMES, _MAX_BACKLOG_BYTES, partial(self._metrics.dropped, "frame"))
        self._pace = Pace(_MAX_SPEED * rate_hz)
        self._room = asyncio.Semaphore(_MAX_AT_PROCESS)
        # Times at which the frames came that the process has and has not answered.
        self._at_process: deque[float] = deque()
        self._answered_s = time.monotonic()

    @property
    def dropped(self) -> Dropped:
        """Messages that were dropped so far."""
        return Dropped(self._frames.num_dropped, self._instants.num_dropped)

    async def run(self) -> None:
        """Relay until the client's ``end`` was computed and everything was sent.

        Raises ``SocketProblem`` or ``WebSocketDisconnect`` if the capture ends early.
        """
        ways = (self._receive(), self._feed(), self._collect(), self._send())
        await all_or_first_error(ways, (self._watch_process(), self._connection.watch_key()))

    async def _receive(self) -> None:
        """Take the client's messages until its ``end``."""
        pace = Pace(self._settings.max_live_messages_per_s)
        while True:
            message = await self._connection.receive()
            since_s = time.monotonic()
            if not pace.has_room():
                per_s = self._settings.max_live_messages_per_s
                raise SocketProblem(LIVE_TOO_FAST, f"At most {per_s:g} messages a second are allowed.")
            if (text := message.get("text")) is None:
                packet = self._intake.from_packet(message["bytes"])
            else:
                content = await _parsed(text)
                if isinstance(content, LiveEnd):
                    self._frames.close()
                    return
                packet = self._intake.from_text(content)
            await self._keep_pace()
            self._num_received += 1
            self._metrics.frames.inc()
            if self.kept is not None:
                await self.kept.add(packet)
            self._frames.put(packet, since_s)
            # Messages that have come already are received without a pause: a flood would hold up all other captures.
            await asyncio.sleep(0)

    async def _keep_pace(self) -> None:
        """Wait if the client is much faster than its cameras; what it sends meanwhile waits at its side."""
        while not self._pace.has_room():
            self._process.stand_behind()
            await asyncio.sleep(_PAUSE_S)

    async def _feed(self) -> None:
        """Pass frames on to the process as it takes them."""
        async for packet in self._frames.taken():
            await self._pass_on(packet)
        await self._pass_on(Waiting(b"", time.monotonic()))

    async def _pass_on(self, message: Waiting) -> None:
        await self._room.acquire()
        if not self._at_process:
            self._answered_s = time.monotonic()
        self._at_process.append(message.since_s)
        await self._process.send(message.content)

    async def _collect(self) -> None:
        """Collect the answers of the process until its last one."""
        while True:
            kind, content = await self._process.answer()
            self._answered_s = time.monotonic()
            if kind is CaptureAnswer.INSTANT:
                self._instants.put(content, self._at_process[0])
            else:
                self._counts = json.loads(content)
                self._at_process.popleft()
                self._room.release()
            if kind is CaptureAnswer.END:
                self._instants.close()
                return

    async def _watch_process(self) -> None:
        """Raise ``SocketProblem`` if the process does not answer in time."""
        while True:
            await asyncio.sleep(_WATCH_S)
            if self._at_process and time.monotonic() > self._answered_s + self._settings.live_answer_s:
                raise failed()


async def _parsed(text: str) -> LiveKeypoints | LiveEnd:
    try:
        return LiveKeypoints.model_validate_json(text)
    except ValidationError:
        try:
            return LiveEnd.model_validate_json(text)
        except ValidationError:
            # A message may have tens of thousands of unknown fields.
            raise await run_in_threadpool(wrong_keypoints, text) from None


async def all_or_first_error(
    ways: tuple[Coroutine[Any, Any, None], ...], watches: tuple[Coroutine[Any, Any, None], ...]
) -> None:
    """Run coroutines until all of ``ways`` have ended, or one of all raises an error, which is raised."""
    needed, others = ([asyncio.create_task(way) for way in group] for group in (ways, watches))
    running = {*needed, *others}
    try:
        while not all(task.done() for task in needed):
            done, running = await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
