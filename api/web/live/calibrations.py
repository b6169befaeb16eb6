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

from api.web.dependencies import Services
from api.web.errors import ErrorItem
from api.web.http.websockets import SocketProblem
from api.web.live.connection import LiveConnection
from api.web.live.forks import ForkServer, start_limit_s
from api.web.live.problems import failed
from api.web.live.schemas import LiveCamerasStart, LiveStart
from api.web.sessions.intake import stored_calibration
from api.web.sessions.preflight import NICE, InvalidFilesError, PreflightProgram, cpu_limit_s
from pipeline.core.problems.request_codes import LIVE_FIELDS
from pipeline.core.runtime.forks import NUMBER, ForkRequest


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
