"""Calibrations of live captures: files of clients are checked in a fork, as they come from strangers."""

import json
import os
import socket
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO

from starlette.concurrency import run_in_threadpool

from api.web.calibrations.intake import CALIBRATION_FORM, CheckedCalibration, begun_calibration, check_calibration
from api.web.dependencies import Services
from api.web.errors import ErrorItem
from api.web.http.bodies.form import Form, Parts
from api.web.http.bodies.form_kinds import SPEC, VIDEOS
from api.web.http.bodies.validation import NO_PLACES
from api.web.http.websockets import SocketProblem
from api.web.live.cameras import record_cameras
from api.web.live.connection import LiveConnection
from api.web.live.forks import ForkServer, start_limit_s
from api.web.live.problems import failed
from api.web.live.schemas import LiveCamerasStart, LiveRecorded, LiveRecordStart, LiveStart
from api.web.sessions.intake import stored_calibration
from api.web.sessions.manifest import CameraManifest
from api.web.sessions.preflight import NICE, InvalidFilesError, PreflightProgram, cpu_limit_s
from api.web.sessions.receiving import Sent
from pipeline.core.problems.request_codes import LIVE_FIELDS
from pipeline.core.runtime.forks import NUMBER, ForkRequest
from worker.store.tenant_records import TenantRecords


async def calibration_file(connection: LiveConnection, start: LiveStart | LiveCamerasStart, folder: Path) -> Path:
    """File of the calibration in metres, Z up; raises ``SocketProblem`` with all that is wrong."""
    if start.calibration_id is not None:
        content = await run_in_threadpool(stored_calibration, connection.records, str(start.calibration_id))
        if not isinstance(content, str):
            code, message, hint = content
            item = ErrorItem(code=code, message=message, pointer="/calibration_id", hint=hint)
            raise SocketProblem(LIVE_FIELDS, message, errors=[item])
    else:
        content = await _sent_calibration(connection, start, folder)
    num_cameras, max_cameras = len(json.loads(content)["cameras"]), connection.settings.max_cameras
    if num_cameras > max_cameras:
        message = f"The calibration has {num_cameras} cameras; at most {max_cameras} are allowed."
        raise SocketProblem(LIVE_FIELDS, message)
    path = folder / "calibration.json"
    await run_in_threadpool(path.write_text, content, "utf-8")
    return path


async def _sent_calibration(connection: LiveConnection, start: LiveStart | LiveCamerasStart, folder: Path) -> str:
    path, services, owner = folder / "sent.json", connection.services, connection.caller.owner
    await run_in_threadpool(path.write_text, json.dumps(start.calibration), "utf-8")
    arguments = ["--calibration", str(path), f"--up={start.up}"]
    if start.units is not None:
        arguments.append(f"--units={start.units}")
    try:
        async with services.live_places.starting():
            contents = await services.checks.run(owner, _program(services).read_calibration, arguments, folder)
    except InvalidFilesError as invalid:
        errors = [item.model_copy(update={"pointer": "/calibration", "file": None}) for item in invalid.errors]
        raise SocketProblem(LIVE_FIELDS, "The calibration is wrong.", errors=errors) from None
    return contents.text


def _program(services: Services) -> PreflightProgram:
    """Check of files, by a fork."""
    run = partial(_run_fork, services.live_forks, start_limit_s(services.settings))
    return replace(services.preflight, command=(), run=run)


def _run_fork(
    server: ForkServer,
    start_s: float,
    program: PreflightProgram,
    arguments: Sequence[str],
    timeout_s: float,
    temporary: Path,
    output: IO[bytes],
    log: IO[bytes],
) -> int:
    """Check a calibration in a fork, as ``run_program`` runs a program."""
    limits = (program.max_memory_bytes, program.max_record_bytes, cpu_limit_s(timeout_s))
    request = ForkRequest("calibration", tuple(arguments), str(temporary), *limits, NICE)
    with Path(os.devnull).open("rb") as nothing:
        fork = server.fork(request, (nothing.fileno(), output.fileno(), log.fileno()))
    with fork:
        # The fork begins when the server has loaded its modules.
        fork.settimeout(start_s)
        _number(fork)
        fork.settimeout(timeout_s)
        return _number(fork)


def _number(fork: socket.socket) -> int:
    if len(content := fork.recv(NUMBER.size)) < NUMBER.size:
        raise failed()  # the server has ended
    number: int = NUMBER.unpack(content)[0]
    return number


async def record_calibration(connection: LiveConnection, start: LiveRecordStart, folder: Path) -> LiveRecorded:
    """Record cameras, and begin their calibration; raises ``SocketProblem`` or ``ApiError`` with all that is wrong."""
    services, records, owner = connection.services, connection.records, connection.caller.owner
    await run_in_threadpool(records.require_room, 0)
    videos = await record_cameras(connection, start, folder)
    choices = start.spec(tuple(camera.model_dump(mode="json") for camera in videos), "live")
    spec = json.dumps({name: value for name, value in choices.items() if value not in (None, [])})
    form = await services.checks.run(owner, _form, services, folder, videos)
    sent = Sent(folder, CALIBRATION_FORM, replace(form, documents={SPEC: spec.encode()}), None, NO_PLACES)
    checked = await check_calibration(owner, services, records, sent)
    return await run_in_threadpool(_begin, services, records, checked)


def _form(services: Services, folder: Path, videos: dict[CameraManifest, Path]) -> Form:
    """Form with the videos, as a client would send it."""
    parts = Parts(folder, services.limits, CALIBRATION_FORM, NO_PLACES)
    for camera, path in videos.items():
        parts.adopt(VIDEOS, str(camera.file), path)
    return parts.form((SPEC,))


def _begin(services: Services, records: TenantRecords, checked: CheckedCalibration) -> LiveRecorded:
    with begun_calibration(services, records, checked) as (_, job):
        return LiveRecorded(calibration_id=job.id)
