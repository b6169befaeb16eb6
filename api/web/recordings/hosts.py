"""Connection of a host: what it asks for, and what it sees."""

import asyncio
import time

from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket

from api.web.recordings import messages
from api.web.recordings.intake import RecordingIntake, parsed, server_s
from api.web.recordings.phones import recording_limits, refusal_message, send
from api.web.recordings.rooms import HostSide, RecordingOver, Room
from api.web.recordings.schemas import RecordingOut
from api.web.settings import Settings
from worker.store.files.disk import DiskSpace
from worker.store.model.phone_records import RecordingSession
from worker.store.tenant_records import TenantRecords

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
