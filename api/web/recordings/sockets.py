"""``WS /v1/recordings/{recording_id}/connect``: phones and hosts of a recording."""

import asyncio
import contextlib
import time
from collections.abc import Coroutine
from typing import Any, Literal

import structlog
from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket, WebSocketDisconnect

from api.web.auth import Caller, joining_caller, joining_secret, websocket_caller
from api.web.contract.description import Resource
from api.web.dependencies import Services, canonical_id
from api.web.errors import ApiError, as_api_error
from api.web.http.websockets import LATER, SocketProblem, deny, problem_message, socket_problem
from api.web.metrics import RecordingMetrics
from api.web.recordings import messages
from api.web.recordings.intake import RecordingIntake, parsed, server_s
from api.web.recordings.messages import EndedOut, RecordingProblemOut
from api.web.recordings.phones import PhoneConnection, recording_limits, refusal_message, said_hello, send
from api.web.recordings.rooms import HostSide, RecordingOver, Room
from api.web.recordings.schemas import RecordingOut
from api.web.settings import Settings
from pipeline.core.problems.request_codes import LINK_UNKNOWN, RECORDING_BUSY, RECORDING_LINK_ENDED
from worker.store.errors import NotFound, PhoneRemoved
from worker.store.files.disk import DiskSpace
from worker.store.model.phone_records import RecordingSession
from worker.store.model.rights import Actor
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)

router = APIRouter(prefix="/v1")

SUBPROTOCOL = "multicap.recording"
"""Subprotocol of recordings, for clients that offer one."""

_CLOSE_S = 5.0
_CLIENT_GONE = 1005


@router.websocket("/recordings/{recording_id}/connect")
async def connect(websocket: WebSocket, recording_id: str) -> None:
    """Serve a phone or a host; ``/recordings.asyncapi.json`` describes the messages."""
    services: Services = websocket.app.state.services
    secret = joining_secret(websocket)
    if secret is not None:
        # Browsers can't read the answer to a refused WebSocket, so a phone's refusal is a message.
        await _accept(websocket)
        await _served(websocket, "phone", _phone(websocket, services, recording_id, secret))
        return
    try:
        caller = await run_in_threadpool(websocket_caller, websocket, services)
        records = _records(services, websocket, caller)
        recording = await run_in_threadpool(records.recordings.get, canonical_id(recording_id, "recording"))
    except Exception as error:
        await deny(websocket, as_api_error(error))
        return
    await _accept(websocket)
    await _served(websocket, "host", _host(websocket, services, recording.id, caller, records))


async def _accept(websocket: WebSocket) -> None:
    await websocket.accept(SUBPROTOCOL if SUBPROTOCOL in websocket.scope["subprotocols"] else None)


def _records(services: Services, websocket: WebSocket, caller: Caller) -> TenantRecords:
    actor = Actor(caller.key.id if caller.key else None, websocket.state.request_id)
    return services.store.tenant(caller.tenant, services.quotas, actor)


async def _phone(websocket: WebSocket, services: Services, recording_id: str, secret: str) -> None:
    settings, metrics = services.settings, _metrics(websocket)
    caller = await run_in_threadpool(joining_caller, websocket, services, secret)
    if caller.join is None or caller.join.recording_id != canonical_id(recording_id, "recording"):
        raise ApiError(LINK_UNKNOWN, "The link belongs to another recording.", hint="Open the link again.")
    intake = RecordingIntake(websocket, settings, must_send=True)
    with services.rooms.greeting(caller.join.recording_id, settings.max_recording_phones):
        hello = await said_hello(intake)
    records = _records(services, websocket, caller)
    try:
        joined = await run_in_threadpool(
            records.recordings.join,
            caller.join.recording_id,
            hello.phone_id,
            hello.name,
            hello.device,
            recording_limits(settings),
        )
    except PhoneRemoved:
        raise RecordingOver("removed") from None
    about = hello.model_dump(mode="json", include={"track", "capabilities", "mime_types"})
    async with services.rooms.entered(records, joined.recording.id) as room:
        room.changed(joined.recording)
        with room.phone_connected(joined.number, joined.at_s, about) as side:
            phone = PhoneConnection(websocket, room, records, settings, joined.number, metrics)
            await phone.welcome()
            # Changes while the welcome was on its way.
            side.wake.set()
            await _until_first(phone.receive(intake), phone.send(side), _watch(services, caller, room))


async def _host(
    websocket: WebSocket, services: Services, recording_id: str, caller: Caller, records: TenantRecords
) -> None:
    async with services.rooms.entered(records, recording_id) as room:
        if len(room.hosts) >= services.settings.max_recording_hosts:
            detail = f"At most {services.settings.max_recording_hosts} hosts may be connected to a recording."
            raise SocketProblem(RECORDING_BUSY, detail, LATER)
        host = HostConnection(websocket, room, records, services.settings, services.disk)
        side = HostSide()
        side.wake.set()
        room.hosts.add(side)
        try:
            room.tell()  # phones at other processes send thumbnails from now on
            await _until_first(
                host.receive(RecordingIntake(websocket, services.settings, must_send=False)),
                host.send(side),
                _watch(services, caller, room),
            )
        finally:
            room.hosts.discard(side)


async def _watch(services: Services, caller: Caller, room: Room) -> None:
    """Raise when the key or the link of the connection ends, or the recording with it."""
    with services.keys_in_use.watching(caller.credential) as ended:
        await ended.wait()
    with contextlib.suppress(NotFound):
        await services.rooms.refresh()
    if room.is_over:
        raise RecordingOver("recording")
    raise SocketProblem(RECORDING_LINK_ENDED, "The link or the key of the connection is no longer valid.")


async def _served(websocket: WebSocket, side: Literal["phone", "host"], way: Coroutine[Any, Any, None]) -> None:
    """Serve an accepted connection, and answer whatever ends it by a message and a close code."""
    metrics = _metrics(websocket)
    code, close_code = None, 1000
    with metrics.open.labels(side).track_inprogress():
        try:
            await way
        except WebSocketDisconnect as gone:
            close_code = gone.code or _CLIENT_GONE
        except RecordingOver as over:
            await _last(websocket, EndedOut(reason=over.reason), 1000, over.reason)
        except Exception as error:
            problem = socket_problem(error)
            code, close_code = problem.code, problem.close_code
            if close_code == 1011:
                _log.exception("recording_connection_failed", code=code)
            message = problem_message(error, websocket.state.request_id, RecordingProblemOut)
            await _last(websocket, message, close_code, code)
    metrics.ended(code)
    _log.info("recording_connection", side=side, code=code, close_code=close_code)


async def _last(websocket: WebSocket, message: EndedOut | RecordingProblemOut, close_code: int, reason: str) -> None:
    with contextlib.suppress(Exception):  # the client may be gone, or take nothing
        async with asyncio.timeout(_CLOSE_S):
            await send(websocket, message, websocket.app.state.services.settings)
            await websocket.close(close_code, reason)


async def _until_first(*ways: Coroutine[Any, Any, None]) -> None:
    """Run until one of several coroutines ends, and raise its error if it has one."""
    tasks = [asyncio.create_task(way) for way in ways]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _metrics(websocket: WebSocket) -> RecordingMetrics:
    metrics: RecordingMetrics = websocket.app.state.metrics.recordings
    return metrics


# Time from a host's request to the start and the stop of a take: phones at other processes may learn of it by rows.
_START_LEAD_S, _STOP_LEAD_S = 2.0, 1.0
# States a second at most.
_STATES_PER_S = 4.0


class HostConnection:
    """Connection of a host.

    ``records``: records of the host. ``disk``: disk of the service: no take begins on a full one, and what begins can
    be ended on it.
    """

    def __init__(
        self, websocket: WebSocket, room: Room, records: TenantRecords, settings: Settings, disk: DiskSpace
    ) -> None:
        self._websocket, self._room, self._records, self._settings = websocket, room, records, settings
        self._disk = disk
        self._shown_revision = -1

    async def receive(self, intake: RecordingIntake) -> None:
        """Take the host's messages until it goes; raises ``SocketProblem`` or ``WebSocketDisconnect``."""
        while True:
            message = parsed(await intake.receive(), messages.HOST_MESSAGES, messages.HOST_RECEIVED)
            if isinstance(message, messages.ClientPing):
                await send(self._websocket, messages.Pong(t0_s=message.t0_s, server_s=server_s()), self._settings)
                continue
            try:
                recording = await run_in_threadpool(self._change, message)
            except Exception as error:
                await send(self._websocket, refusal_message(error, self._websocket.state.request_id), self._settings)
            else:
                self._room.changed(recording)

    async def send(self, side: HostSide) -> None:
        """Show what changes until the recording is over; raises ``RecordingOver``."""
        loop, next_s = asyncio.get_running_loop(), 0.0
        while True:
            await side.wake.wait()
            side.wake.clear()
            if self._room.is_over:
                raise RecordingOver("recording")
            if side.has_news and (now_s := time.monotonic()) >= next_s:
                side.has_news, next_s = False, now_s + 1 / _STATES_PER_S
                await send(self._websocket, self._state(), self._settings)
            elif side.has_news:
                loop.call_later(next_s - now_s, side.wake.set)
            while side.thumbnails:
                number = next(iter(side.thumbnails))
                await send(self._websocket, side.thumbnails.pop(number), self._settings)

    def _change(self, message: messages.HostMessage) -> RecordingSession:
        recordings, recording_id = self._records.recordings, self._room.recording.id
        match message:
            case messages.HostStart():
                settings = {} if message.settings is None else message.settings.model_dump()
                self._disk.require_room()
                start_s, limits = server_s() + _START_LEAD_S, recording_limits(self._settings)
                return recordings.start_take(recording_id, message.name, settings, start_s, limits)
            case messages.HostStop():
                return self._disk.using_reserve(lambda: recordings.stop_take(recording_id, server_s() + _STOP_LEAD_S))
            case messages.HostRename():
                return recordings.rename_phone(recording_id, message.phone, message.name)
            case messages.HostRemove():
                return self._disk.using_reserve(lambda: recordings.remove_phone(recording_id, message.phone))
            case messages.HostUpload():
                return recordings.want_upload(recording_id, message.take)
            case messages.HostDiscard():
                return self._disk.using_reserve(lambda: recordings.discard_take(recording_id, message.take))
            case messages.ClientPing():
                raise ValueError("a ping changes nothing")

    def _state(self) -> messages.HostState:
        room, now_s = self._room, server_s()
        is_new = room.recording.revision != self._shown_revision
        self._shown_revision = room.recording.revision
        return messages.HostState(
            recording=RecordingOut.from_recording(room.recording, now_s) if is_new else None,
            live=tuple(
                messages.LivePhoneOut(
                    number=number, is_connected=phone.is_connected, status=phone.status, hello=phone.hello
                )
                for number, phone in sorted(room.live.items())
            ),
            relay="away" if room.is_relay_away else "ok",
            server_s=now_s,
            request_id=self._websocket.state.request_id,
        )


RESOURCE = Resource(router=router)
