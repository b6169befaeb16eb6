"""Live captures whose cameras the service opens: rules of their addresses, and their process."""

import asyncio
import contextlib
import dataclasses
import ipaddress
import json
import socket
import time
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

from starlette.concurrency import run_in_threadpool

from api.web.auth import Caller
from api.web.dependencies import canonical_id
from api.web.errors import ErrorItem, pointer_to
from api.web.http.websockets import WRONG_FIELDS, SocketProblem
from api.web.live.connection import LiveConnection
from api.web.live.forks import start_limit_s
from api.web.live.intake import read_end
from api.web.live.keeping import KeptPackets
from api.web.live.problems import failed, refused
from api.web.live.process import CaptureProcess, camera_process
from api.web.live.relay import Outgoing, all_or_first_error
from api.web.live.schemas import LiveCamerasStart, LivePatternStart, LiveReady, LiveRecordStart
from api.web.recordings.rooms import LiveTaker, Size
from api.web.sessions.manifest import CameraManifest
from api.web.settings import Settings
from pipeline.core.errors import listed_names
from pipeline.core.problems.finding_codes import CAMERA_SOURCE, PARAMETER_RANGE
from pipeline.core.problems.request_codes import LIVE_FIELDS, MISSING_FIELD
from pipeline.run.live.cameras import sources as camera_sources
from pipeline.run.live.packets import CaptureAnswer
from worker.run.webhooks.addresses import url_fault
from worker.run.webhooks.sender import RefusedAddressError, resolve
from worker.store.errors import NotFound
from worker.store.tenant_records import TenantRecords

_RESOLVE_S = 10.0  # of all names of a start
_PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443}
_PRIVATE_HINT = "The operator allows private addresses, outputs and cameras of the machine by MULTICAP_LIVE_PRIVATE."

_NO_OUTPUTS = ErrorItem(
    code=PARAMETER_RANGE,
    message="The service sends people to no other program.",
    hint=_PRIVATE_HINT,
    pointer="/outputs",
)


def allows_private(settings: Settings, caller: Caller) -> bool:
    """True if a caller may open cameras of this machine and of private networks, and use outputs."""
    return caller.key is None if settings.live_private is None else settings.live_private


def read_cameras(
    start: LiveCamerasStart | LiveRecordStart,
    known: Collection[str] | None,
    is_private: bool,
    require_phone: Callable[[str], str],
) -> list[camera_sources.CameraSource]:
    """Sources of the cameras of a start; raises ``SocketProblem`` with all that is wrong.

    Names of hosts are resolved here where only public addresses are allowed, and the checked address is what is opened.
    ``known`` are the names of the calibrated cameras; ``None``: there is no calibration yet. With ``is_private``
    cameras of this machine and of private networks are allowed. ``require_phone`` refuses what is no phone; it returns
    the address in one form, because ids may have capital letters.
    """
    errors: list[ErrorItem] = []
    sources: list[camera_sources.CameraSource] = []
    devices = camera_sources.find_devices() if is_private else {}
    resolve_end_s = time.monotonic() + _RESOLVE_S
    for place, (name, text) in enumerate((camera.camera, camera.source.strip()) for camera in start.cameras):
        names = [camera.camera for camera in start.cameras[:place]]
        for code, message, hint in camera_sources.name_problems(name, [name] if known is None else list(known), names):
            pointer = pointer_to("cameras", place, "camera")
            errors.append(ErrorItem(code=code, message=message, hint=hint, pointer=pointer, camera=name))
        try:
            source = _source(name, text, devices, None if is_private else resolve_end_s, require_phone)
        except WrongSourceError as wrong:
            code, message, hint = wrong.args
            pointer = pointer_to("cameras", place, "source")
            errors.append(ErrorItem(code=code, message=message, hint=hint, pointer=pointer, camera=name))
        else:
            # Two names may have one IP address, and be two cameras behind it.
            if (source.address, source.host) in {(earlier.address, earlier.host) for earlier in sources}:
                pointer = pointer_to("cameras", place, "source")
                errors.append(
                    ErrorItem(code=CAMERA_SOURCE, message=camera_sources.REPEATED_SOURCE, pointer=pointer, camera=name)
                )
            sources.append(source)
    if isinstance(start, LiveCamerasStart) and start.outputs and not is_private:
        errors.append(_NO_OUTPUTS)
    if isinstance(start, LiveRecordStart) and (start.board is None) == (not start.stature_m):
        message = "A calibration has either a board or the statures of people."
        errors.append(ErrorItem(code=MISSING_FIELD, message=message, pointer="/board"))
    if errors:
        raise SocketProblem(LIVE_FIELDS, WRONG_FIELDS, errors=errors)
    return sources


def _source(
    name: str, text: str, devices: dict[str, str], resolve_end_s: float | None, require_phone: Callable[[str], str]
) -> camera_sources.CameraSource:
    """Source of a text; ``resolve_end_s`` is the end of the time for names, ``None``: all addresses are allowed."""
    scheme, sign, _ = text.partition("://")
    if text in devices:
        return camera_sources.CameraSource(name, "device", text)
    if sign and scheme == "phone":
        return camera_sources.CameraSource(name, "phone", require_phone(text))
    if not sign:
        listed = f"Its cameras are {', '.join(devices)}." if devices else "It has none."
        further = listed if resolve_end_s is None else _PRIVATE_HINT
        hint = f"Write an address such as rtsp://192.168.0.10/stream. {further}"
        raise WrongSourceError(CAMERA_SOURCE, "The service's machine has no such camera that may be opened.", hint)
    if (kind := camera_sources.SCHEMES.get(scheme.lower())) is None:
        raise WrongSourceError(*camera_sources.unsupported(scheme[:40]))
    if fault := url_fault(text):
        raise WrongSourceError(CAMERA_SOURCE, fault, "Correct the address.")
    if resolve_end_s is None:
        return camera_sources.CameraSource(name, kind, text)
    url, left_s = urlsplit(text), max(0.0, resolve_end_s - time.monotonic())
    try:
        address = resolve(url.hostname or "", url.port or _PORTS[scheme.lower()], False, left_s)
    except RefusedAddressError:
        raise WrongSourceError(CAMERA_SOURCE, "The address is not public.", _PRIVATE_HINT) from None
    except (OSError, UnicodeError):  # of the name servers, or the time
        raise WrongSourceError(CAMERA_SOURCE, "The name can't be resolved.", "Correct the address.") from None
    return camera_sources.CameraSource(name, kind, _at(url, address).geturl(), url.netloc.rpartition("@")[2])


def _at(url: SplitResult, address: str) -> SplitResult:
    """Address of a stream with an IP address in the place of its host."""
    user, sign, _ = url.netloc.rpartition("@")
    host = f"[{address}]" if ipaddress.ip_address(address).version == 6 else address
    port = "" if url.port is None else f":{url.port}"
    return url._replace(netloc=f"{user}{sign}{host}{port}")


async def relay_cameras(connection: LiveConnection, start: LiveCamerasStart, calibration: Path) -> Outgoing:
    """Compute a live capture from cameras until the client's ``end``; raises ``SocketProblem`` if it can't begin."""
    cameras = json.loads(await run_in_threadpool(calibration.read_text))["cameras"]
    known = {camera["name"]: camera.get("size_px") for camera in cameras}
    content = {
        "calibration": str(calibration),
        "choices": {"profile": start.profile, "joints": start.joints},
        **start.model_dump(include={"sync_s", "outputs", "format", "keep"}),
    }
    _, relay = await _relayed(
        connection, start, known, connection.settings.live_cameras_command, content, calibration.parent
    )
    return relay


async def relay_pattern(connection: LiveConnection, start: LivePatternStart, folder: Path) -> Outgoing:
    """Simulate a person until the client's ``end``; raises ``SocketProblem`` if outputs can't be opened."""
    if start.outputs and not allows_private(connection.settings, connection.caller):
        raise SocketProblem(LIVE_FIELDS, WRONG_FIELDS, errors=[_NO_OUTPUTS])
    with connection.services.live_places.with_cameras():
        async with camera_process(connection.settings.live_cameras_command, folder, []) as process:
            await process.send(json.dumps(start.model_dump(include={"outputs", "format"})).encode())
            relay = _CameraRelay(connection, process, start, folder)
            await relay.run()
    return relay


async def record_cameras(
    connection: LiveConnection, start: LiveRecordStart, folder: Path
) -> dict[CameraManifest, Path]:
    """Record cameras for a moment; return their videos by their cameras with offsets.

    Raises ``SocketProblem`` if they can't be recorded.
    """
    filmed = folder / "filmed"
    filmed.mkdir()
    content = {"duration_s": start.duration_s, "folder": str(filmed)}
    sources, relay = await _relayed(
        connection, start, None, connection.settings.live_recording_command, content, folder
    )
    return {
        CameraManifest(name=source.camera, file=f"camera-{place}.mkv", offset_s=offset_s): filmed / f"{place}.mkv"
        for place, (source, offset_s) in enumerate(zip(sources, relay.answer["offsets_s"], strict=True))
    }


async def _relayed(
    connection: LiveConnection,
    start: LiveCamerasStart | LiveRecordStart,
    known: Mapping[str, tuple[int, int] | None] | None,
    command: Sequence[str],
    content: dict[str, Any],
    folder: Path,
) -> "tuple[list[camera_sources.CameraSource], _CameraRelay]":
    """Check the cameras, and relay a program that opens them to its end; ``known``: sizes of calibrated cameras."""
    is_private = allows_private(connection.settings, connection.caller)
    require = partial(require_phone, connection.records)
    sources = await run_in_threadpool(read_cameras, start, known, is_private, require)
    with connection.services.live_places.with_cameras():
        async with phones_taken(connection, sources, known or {}) as opened:
            pictures = [source.pictures for source in opened if source.pictures is not None]
            content["sources"] = [dataclasses.asdict(source) for source in opened]
            async with camera_process(command, folder, pictures) as process:
                await process.send(json.dumps(content).encode())
                relay = _CameraRelay(connection, process, start, folder)
                await relay.run()
    return sources, relay


class _CameraRelay(Outgoing):
    """Relay of a capture whose cameras the service opens; ``folder`` is the folder of the connection."""

    def __init__(
        self,
        connection: LiveConnection,
        process: CaptureProcess,
        start: LiveCamerasStart | LivePatternStart | LiveRecordStart,
        folder: Path,
    ) -> None:
        super().__init__(connection, process)
        self._start, self._folder = start, folder
        # Longest time until the next answer
        self._limit_s = start_limit_s(self._settings) + (start.duration_s if isinstance(start, LiveRecordStart) else 0)

    @property
    def answer(self) -> dict[str, Any]:
        """Last answer of the process."""
        return self._counts

    async def run(self) -> None:
        """Relay until the end; raises ``SocketProblem`` or ``WebSocketDisconnect`` if the capture ends early."""
        await all_or_first_error((self._collect(), self._send()), (self._receive(), self._connection.watch_key()))

    async def _receive(self) -> None:
        """Take the client's ``end``, behind which only its leaving matters."""
        read_end(await self._connection.receive(may_idle=True))
        self._limit_s = start_limit_s(self._settings)  # pictures whose people are being detected are waited for
        self._process.writer.write_eof()
        await self._connection.receive(may_idle=True)

    async def _collect(self) -> None:
        """Collect the answers of the process until its last one; cameras that are on tell something each second."""
        while True:
            try:
                async with asyncio.timeout(self._limit_s):
                    kind, content = await self._process.answer()
            except TimeoutError:
                raise failed() from None
            loop_s = asyncio.get_running_loop().time()
            match kind:
                case CaptureAnswer.READY:
                    self._limit_s = self._settings.live_answer_s
                    self._instants.put(self._ready(content), loop_s)
                case CaptureAnswer.REFUSED:
                    raise refused(content)
                case CaptureAnswer.KEPT if self.kept is not None:
                    await self.kept.add(content)
                case CaptureAnswer.INSTANT | CaptureAnswer.TOLD:
                    self._instants.put(content, loop_s)
                case CaptureAnswer.END:
                    self._counts = json.loads(content)
                    self._num_received = self._counts["received"]
                    self._instants.close()
                    return

    def _ready(self, content: bytes) -> bytes:
        """Message ``ready``; what is kept begins."""
        ready = LiveReady(**json.loads(content), limits={}, request_id=self._connection.request_id)
        self.cameras = ready.cameras
        if isinstance(self._start, LiveCamerasStart) and self._start.keep:
            self.kept = KeptPackets(self._connection.services, self._folder, ready.layout)
        return ready.model_dump_json().encode()


class WrongSourceError(Exception):
    """A source of a camera can't be opened: code, message and hint."""


def require_phone(records: TenantRecords, source: str) -> str:
    """Address ``phone://RECORDING_ID/NUMBER`` of a phone of the tenant; raises ``WrongSourceError`` without one."""
    try:
        recording_id, number = _parts(source)
        phones = records.recordings.get(recording_id).phones
    except NotFound:
        message, hint = "There is no such recording, or it has ended.", "Choose a phone of a recording."
        raise WrongSourceError(CAMERA_SOURCE, message, hint) from None
    known = {str(phone.number): phone.name for phone in phones if not phone.is_removed}
    if number not in known:
        names = listed_names([f"{one} ({name})" for one, name in known.items()])
        hint = f"Its phones are {names}." if known else "Let phones join it first."
        raise WrongSourceError(CAMERA_SOURCE, "The recording has no such phone.", hint)
    return f"phone://{recording_id}/{number}"


@contextlib.asynccontextmanager
async def phones_taken(
    connection: LiveConnection, sources: Sequence[camera_sources.CameraSource], sizes_px: Mapping[str, Size]
) -> AsyncIterator[list[camera_sources.CameraSource]]:
    """Have pictures of phones taken during the block; the sources with the sockets that bring them.

    ``sizes_px``: sizes at which cameras were calibrated, by their names.
    """
    opened = list(sources)
    async with contextlib.AsyncExitStack() as held:
        for place, source in enumerate(sources):
            if source.kind != "phone":
                continue
            recording_id, number = _parts(source.address)
            # Packets are whole or are not sent at all, so that a decoder that is started again finds its place.
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            held.enter_context(ours)
            held.enter_context(theirs)
            room = await held.enter_async_context(connection.services.rooms.entered(connection.records, recording_id))
            held.enter_context(room.taking(LiveTaker(int(number), sizes_px.get(source.camera), ours)))
            opened[place] = replace(source, pictures=theirs.fileno())
        yield opened


def _parts(source: str) -> tuple[str, str]:
    """Id of the recording and number of the phone, as it was stated; raises ``NotFound`` for no id."""
    recording_id, _, number = source.partition("://")[2].partition("/")
    return canonical_id(recording_id, "recording"), number
