"""``WS /v1/live``: a live capture for as long as a WebSocket is open; and the cameras of the service's machine."""

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import structlog
from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket, WebSocketDisconnect

from api.web.auth import CallerDep, websocket_caller
from api.web.contract.description import Resource
from api.web.dependencies import Services, ServicesDep
from api.web.errors import ApiError, as_api_error
from api.web.http.websockets import SocketProblem, deny, problem_message
from api.web.live import schemas
from api.web.live.calibrations import calibration_file, record_calibration
from api.web.live.cameras import allows_private, relay_cameras, relay_pattern
from api.web.live.connection import LiveConnection
from api.web.live.forks import start_limit_s
from api.web.live.intake import Intake, read_start
from api.web.live.keeping import KeptPackets, keep_session
from api.web.live.problems import failed, is_fault, refused
from api.web.live.process import CaptureProcess, capture_process
from api.web.live.relay import Outgoing, Relay
from api.web.metrics import LiveMetrics
from api.web.sessions.receiving import spool_folder
from pipeline.core.problems.request_codes import LIVE_MESSAGE
from pipeline.run.live.cameras.sources import find_devices
from pipeline.run.live.outputs.addresses import OUTPUTS
from pipeline.run.live.packets import CaptureAnswer

_log = structlog.get_logger(__name__)

router = APIRouter(prefix="/v1")

SUBPROTOCOL = "multicap.live"
"""Subprotocol of live captures, for clients that offer one."""

_CLOSE_S = 5.0
_CLIENT_GONE = 1005


@router.websocket("/live")
async def live(websocket: WebSocket) -> None:
    """Compute a live capture; ``/live.asyncapi.json`` describes the messages."""
    services: Services = websocket.app.state.services
    metrics: LiveMetrics = websocket.app.state.metrics.live
    with contextlib.ExitStack() as held:
        try:
            caller = await run_in_threadpool(websocket_caller, websocket, services)
            held.enter_context(services.live_places.taken(caller.owner))
            ended = held.enter_context(services.keys_in_use.watching(caller.credential))
        except Exception as error:
            refusal = as_api_error(error)
            metrics.refused(refusal.code)
            await deny(websocket, refusal)
            return
        # Browsers ask for one of the subprotocols that they offered; that with the key is not repeated.
        await websocket.accept(SUBPROTOCOL if SUBPROTOCOL in websocket.scope["subprotocols"] else None)
        with metrics.open.track_inprogress():
            metrics.ended(await _serve(LiveConnection(websocket, services, caller, ended)))


async def _serve(connection: LiveConnection) -> str | None:
    """Compute a capture, and answer whatever ends it early by a problem and a close code; return the problem's code."""
    started_s, websocket, caller = time.monotonic(), connection.websocket, connection.caller
    code, close_code = None, 1000
    try:
        await _capture(connection)
        await websocket.close()
    except WebSocketDisconnect as gone:
        code, close_code = "client_disconnected", gone.code or _CLIENT_GONE
    except Exception as error:
        problem = problem_message(error, connection.request_id, schemas.LiveProblemOut)
        code, close_code = problem.code, problem.close_code
        if not isinstance(error, SocketProblem | ApiError):
            _log.exception("live_capture_failed", code=code)
        with contextlib.suppress(Exception):  # the client may be gone, or take nothing
            async with asyncio.timeout(_CLOSE_S):
                await connection.send(problem)
                await websocket.close(close_code, code)
    finally:
        key = caller.key
        seconds = round(time.monotonic() - started_s, 4)
        tenant = {"tenant": key.tenant, "key": key.id} if key else {}
        if is_fault(code, close_code):
            connection.services.live_places.note_bad(caller.owner)
        _log.info("live_capture", code=code, close_code=close_code, seconds=seconds, **tenant)
    return code


async def _capture(connection: LiveConnection) -> None:
    services = connection.services
    first = await connection.receive()
    if (text := first.get("text")) is None:
        raise SocketProblem(LIVE_MESSAGE, "The first message is start, in JSON.")
    start = await run_in_threadpool(read_start, text)
    async with spool_folder(services.settings.spool_dir) as folder:
        services.disk.require_room()
        if isinstance(start, schemas.LivePatternStart):
            await connection.send(_ended(await relay_pattern(connection, start, folder)))
            return
        if isinstance(start, schemas.LiveRecordStart):
            await connection.send(await record_calibration(connection, start, folder))
            return
        if start.keep:
            await run_in_threadpool(connection.records.require_room, 0)
        calibration = await calibration_file(connection, start, folder)
        if isinstance(start, schemas.LiveCamerasStart):
            relay = await relay_cameras(connection, start, calibration)
        else:
            relay = await _relay_keypoints(connection, start, calibration)
        session_id = None
        if (kept := relay.kept) is not None:
            session_id = await keep_session(connection, kept, start.name, calibration, relay.cameras)
        await connection.send(_ended(relay, session_id))


def _ended(relay: Outgoing, session_id: str | None = None) -> schemas.LiveEnded:
    return schemas.LiveEnded(
        counts=relay.counts,
        dropped=schemas.DroppedOut(**relay.dropped._asdict()),
        session_id=session_id,
        kept_frames=0 if relay.kept is None else relay.kept.num_frames,
    )


async def _relay_keypoints(connection: LiveConnection, start: schemas.LiveStart, calibration: Path) -> Relay:
    """Relay keypoints of a client until their end."""
    services, settings = connection.services, connection.settings
    async with _ready(services, start, calibration) as (process, ready):
        cameras: Sequence[str] = ready["cameras"]
        kept = KeptPackets(services, calibration.parent, start.layout) if start.keep else None
        intake = Intake(cameras, start.layout, settings.max_live_people)
        rate_hz = start.frame_rate_hz * len(cameras)
        relay = Relay(connection, process, intake, kept, cameras, rate_hz)
        limits = {
            "message_bytes": settings.max_live_message_bytes,
            "messages_per_s": settings.max_live_messages_per_s,
            "people": settings.max_live_people,
            "idle_s": settings.live_idle_s,
        }
        request_id = connection.request_id
        await connection.send(schemas.LiveReady(**ready, layout=start.layout, limits=limits, request_id=request_id))
        await relay.run()
    return relay


@contextlib.asynccontextmanager
async def _ready(
    services: Services, start: schemas.LiveStart, calibration: Path
) -> AsyncIterator[tuple[CaptureProcess, dict[str, Any]]]:
    """Process that has begun, and the contents of its first answer; raises ``SocketProblem``."""
    settings = services.settings
    content = {
        "calibration": str(calibration),
        "layout": start.layout,
        "settings": start.settings(),
        "format": start.format,
        "joint_centers": start.joint_centers,
    }
    async with contextlib.AsyncExitStack() as held:
        async with services.live_places.starting():
            try:
                async with asyncio.timeout(start_limit_s(settings)):
                    process = await held.enter_async_context(
                        capture_process(services.live_forks, calibration.parent, settings.live_memory_bytes)
                    )
                    await process.send(json.dumps(content).encode())
                    kind, answer = await process.answer()
            except TimeoutError:
                raise failed() from None
        if kind is CaptureAnswer.REFUSED:
            raise refused(answer)
        yield process, json.loads(answer)


@router.get("/live/devices", tags=["live"], summary="List cameras of the service's machine")
def list_live_devices(services: ServicesDep, caller: CallerDep) -> schemas.LiveDevicesOut:
    """List the cameras of the service's machine and the protocols of outputs that live captures may use."""
    is_allowed = allows_private(services.settings, caller)
    devices = find_devices() if is_allowed else {}
    protocols = (
        schemas.LiveProtocolOut(
            scheme=scheme,
            label=protocol.label,
            port=protocol.port,
            is_server=protocol.is_server,
            has_people="people" in protocol.options,
        )
        for scheme, protocol in OUTPUTS.items()
        if is_allowed
    )
    return schemas.LiveDevicesOut(
        allows_private=is_allowed,
        devices=tuple(schemas.LiveDeviceOut(device=device, name=name) for device, name in devices.items()),
        protocols=tuple(protocols),
    )


RESOURCE = Resource(router=router)
