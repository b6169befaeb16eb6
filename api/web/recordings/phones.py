"""Connection of a phone: what it says, and what it is told."""

from dataclasses import dataclass

from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket

from api.web.errors import as_api_error
from api.web.http.rates import Pace
from api.web.http.websockets import SocketProblem
from api.web.metrics import RecordingMetrics
from api.web.recordings import messages
from api.web.recordings.intake import RecordingIntake, in_time, parsed, require_jpeg, server_s
from api.web.recordings.rooms import RecordingOver, Room, Side
from api.web.recordings.schemas import VideoSettings
from api.web.settings import Settings
from pipeline.core.problems.request_codes import RECORDING_MESSAGE, RECORDING_TOO_FAST
from pipeline.run.live.packets import PhonePicture
from worker.store.model import phone_records
from worker.store.tenant_records import TenantRecords

# Messages of a phone that change rows, in a second.
_CHANGES_PER_S = 20.0


@dataclass(frozen=True, slots=True)
class _Told:
    """Messages about a take that a phone was sent."""

    is_stopped: bool
    is_upload_wanted: bool
    is_gone: bool

    @classmethod
    def from_take(cls, take: phone_records.RecordingTake) -> "_Told":
        return cls(take.is_stopped, take.is_upload_wanted, take.is_used or take.is_discarded)


class PhoneConnection:
    """Connection of a phone that has said ``hello``. ``records``: records of the recording's tenant."""

    def __init__(
        self,
        websocket: WebSocket,
        room: Room,
        records: TenantRecords,
        settings: Settings,
        number: int,
        metrics: RecordingMetrics,
    ) -> None:
        self._websocket, self._room, self._records, self._settings = websocket, room, records, settings
        self._number, self._metrics = number, metrics
        self._thumbnails, self._changes = Pace(settings.max_thumbnails_per_s), Pace(_CHANGES_PER_S)
        self._pictures = Pace(settings.max_phone_pictures_per_s)
        self._live = messages.LiveOut(is_on=False, size_px=None)
        self._name = ""
        self._told: dict[int, _Told] = {}

    async def welcome(self) -> None:
        """Send the first message, which states everything."""
        recording, now_s, settings = self._room.recording, server_s(), self._settings
        self._require_here(recording)
        phone = recording.phone(self._number)
        self._name = phone.name if phone is not None else ""
        self._told = {take.number: _Told.from_take(take) for take in recording.takes}
        await self._send(
            messages.PhoneWelcome(
                number=self._number,
                name=self._name,
                recording_id=recording.id,
                recording=recording.name,
                expires_at=recording.expires_at,
                server_s=now_s,
                takes=tuple(_offered(take, self._number, now_s) for take in recording.takes),
                limits={
                    "message_bytes": settings.max_recording_message_bytes,
                    "messages_per_s": settings.max_recording_messages_per_s,
                    "thumbnail_bytes": settings.max_thumbnail_bytes,
                    "thumbnails_per_s": settings.max_thumbnails_per_s,
                    "picture_bytes": settings.max_phone_picture_bytes,
                    "pictures_per_s": settings.max_phone_pictures_per_s,
                    "idle_s": settings.recording_idle_s,
                },
                request_id=self._websocket.state.request_id,
            )
        )

    async def receive(self, intake: RecordingIntake) -> None:
        """Take the phone's messages until it goes; raises ``SocketProblem`` or ``WebSocketDisconnect``."""
        while True:
            content = await intake.receive()
            if isinstance(content, str):
                await self._take(content)
            elif (picture := PhonePicture.decode(content)) is not None:
                require_jpeg(picture.jpeg)
                if self._pictures.has_room():
                    self._room.take_picture(self._number, picture)
            else:
                self._show(content)

    async def send(self, side: Side) -> None:
        """Tell the phone what changes, until the recording is over for it; raises ``RecordingOver``."""
        while True:
            await side.wake.wait()
            side.wake.clear()
            if side.is_replaced:
                raise RecordingOver("replaced")
            if self._room.is_over:
                raise RecordingOver("recording")
            self._require_here(self._room.recording)
            for message in self._news(self._room.recording):
                await self._send(message)

    def _require_here(self, recording: phone_records.RecordingSession) -> None:
        phone = recording.phone(self._number)
        if phone is not None and phone.is_removed:
            raise RecordingOver("removed")

    def _show(self, content: bytes) -> None:
        require_jpeg(content)
        is_shown = self._thumbnails.has_room()
        self._metrics.thumbnail("shown" if is_shown else "dropped")
        if is_shown:
            self._room.show_thumbnail(self._number, content)

    async def _take(self, text: str) -> None:
        message = parsed(text, messages.PHONE_MESSAGES, messages.PHONE_RECEIVED)
        match message:
            case messages.ClientPing():
                await self._send(messages.Pong(t0_s=message.t0_s, server_s=server_s()))
            case messages.PhoneStatus():
                self._room.set_status(self._number, message.model_dump(mode="json", exclude={"type"}))
            case messages.PhoneHello():
                raise SocketProblem(RECORDING_MESSAGE, "A phone says hello once in a connection.")
            case _:
                if not self._changes.has_room():
                    detail = f"At most {_CHANGES_PER_S:g} messages a second may change something."
                    raise SocketProblem(RECORDING_TOO_FAST, detail)
                try:
                    recording = await run_in_threadpool(self._change, message)
                except Exception as error:
                    await self._answer(error)
                else:
                    self._room.changed(recording)

    def _change(
        self, message: messages.PhoneRename | messages.PhoneStarted | messages.PhoneStopped | messages.PhoneFile
    ) -> phone_records.RecordingSession:
        recordings, recording_id = self._records.recordings, self._room.recording.id
        facts = message.model_dump(mode="json", exclude={"type", "take"})
        match message:
            case messages.PhoneRename():
                return recordings.rename_phone(recording_id, self._number, message.name)
            case messages.PhoneStarted():
                return recordings.report_clip(recording_id, message.take, self._number, "started", facts)
            case messages.PhoneStopped():
                return recordings.report_clip(recording_id, message.take, self._number, "stopped", facts)
            case messages.PhoneFile():
                return recordings.add_file(recording_id, message.take, self._number, _clip_file(message))

    async def _answer(self, error: Exception) -> None:
        """State why something was not done; the connection continues."""
        await self._send(refusal_message(error, self._websocket.state.request_id))

    def _news(self, recording: phone_records.RecordingSession) -> list[BaseModel]:
        """Messages about what the phone was not told yet."""
        news: list[BaseModel] = []
        phone = recording.phone(self._number)
        if phone is not None and phone.name != self._name:
            self._name = phone.name
            news.append(messages.RenameOut(name=phone.name))
        live_sizes = self._room.live_sizes()
        live = messages.LiveOut(is_on=self._number in live_sizes, size_px=live_sizes.get(self._number))
        if live != self._live:
            self._live = live
            news.append(live)
        for take in recording.takes:
            news += _take_news(take, self._told.get(take.number))
            self._told[take.number] = _Told.from_take(take)
        return news

    async def _send(self, message: BaseModel) -> None:
        await send(self._websocket, message, self._settings)


async def said_hello(intake: RecordingIntake) -> messages.PhoneHello:
    """First message of a phone; raises ``SocketProblem`` for another one."""
    message = parsed(await intake.receive(), messages.PHONE_MESSAGES, (messages.PhoneHello,))
    if not isinstance(message, messages.PhoneHello):
        raise SocketProblem(RECORDING_MESSAGE, "The first message of a phone is hello.")
    return message


async def send(websocket: WebSocket, message: BaseModel | bytes, settings: Settings) -> None:
    """Send a message; raises ``SocketProblem`` if the client does not take it in time."""
    if isinstance(message, bytes):
        way = websocket.send_bytes(message)
    else:
        way = websocket.send_text(message.model_dump_json())
    await in_time(way, settings.recording_idle_s, "The client took nothing")


def refusal_message(error: Exception, request_id: str) -> messages.RecordingProblemOut:
    """Message about something that was not done, after which the connection continues."""
    refusal = as_api_error(error)
    return messages.RecordingProblemOut(
        code=refusal.code,
        detail=refusal.detail,
        errors=tuple(refusal.errors),
        hint=refusal.hint,
        retryable=refusal.retryable,
        close_code=None,
        request_id=request_id,
    )


def recording_limits(settings: Settings) -> phone_records.RecordingLimits:
    """Limits of recordings of this service."""
    return phone_records.RecordingLimits(
        settings.max_recording_phones, settings.max_recording_takes, settings.max_take_s
    )


def _take_news(take: phone_records.RecordingTake, told: _Told | None) -> list[BaseModel]:
    is_gone = take.is_used or take.is_discarded
    if told is None:
        if take.is_stopped or is_gone:
            return []  # it was over before the phone could begin
        settings = VideoSettings(**take.settings) if take.settings else None
        return [
            messages.StartOut(
                take=take.number, name=take.name, at_server_s=take.start_s, latest_stop_s=take.stop_s, settings=settings
            )
        ]
    news: list[BaseModel] = []
    if take.is_stopped and not told.is_stopped:
        news.append(
            messages.StopOut(
                take=take.number, at_server_s=min(take.stop_s, server_s() + 1.0) if is_gone else take.stop_s
            )
        )
    if is_gone and not told.is_gone:
        news.append(messages.DeleteOut(take=take.number))
    elif take.is_upload_wanted and not told.is_upload_wanted:
        news.append(messages.UploadOut(take=take.number))
    return news


def _offered(take: phone_records.RecordingTake, phone: int, now_s: float) -> messages.OfferedTake:
    clip, state = take.clip(phone), take.state(now_s)
    return messages.OfferedTake(
        number=take.number,
        name=take.name,
        state=state,
        start_s=take.start_s,
        stop_s=take.stop_s,
        settings=VideoSettings(**take.settings) if take.settings else None,
        is_upload_wanted=take.is_upload_wanted
        and state in {phone_records.TakeState.RECORDING, phone_records.TakeState.RECORDED},
        parts=tuple(file.part for file in clip.files) if clip is not None else (),
    )


def _clip_file(message: messages.PhoneFile) -> phone_records.ClipFile:
    known = {"type", "take", "part", "upload_id", "num_bytes", "first_frame_s", "std_s", "duration_s"}
    return phone_records.ClipFile(
        part=message.part,
        upload_id=str(message.upload_id),
        num_bytes=message.num_bytes,
        first_frame_s=message.first_frame_s,
        std_s=message.std_s,
        duration_s=message.duration_s,
        facts=message.model_dump(mode="json", exclude=known),
    )
