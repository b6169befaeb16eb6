"""Preflight: the check of a client's files in a child process with limits on time, memory and output.

The web API never opens a client's file. The programs ``python -m pipeline.capture.preflight``,
``pipeline.export.character.check_character`` and ``pipeline.calibration.on_request`` open them and print one JSON
object: what they contain, or ``{"problems": [...]}``.
"""

import errno
import json
import math
import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal, TypeVar

import structlog
from pydantic import BaseModel, ConfigDict, ValidationError

from api.web.characters.schemas import BoneOut, JointOut, Method
from api.web.errors import ApiError, ErrorItem
from api.web.http.bodies import form_kinds
from api.web.http.bodies.form import Form
from pipeline.capture.preflight_record import Preflight, thumbnail_name
from pipeline.core.findings import Finding
from pipeline.core.problems.request_codes import PREFLIGHT_FAILED, PREFLIGHT_TIMEOUT
from pipeline.core.runtime.resources import lower_priority

_log = structlog.get_logger(__name__)

_EXIT_BAD_INPUT = 2
_EXIT_DISK_FULL = 4
_LOGGED_BYTES = 4000
# More than a JPEG of 320 x 320 pixels of noise.
_MAX_THUMBNAIL_BYTES = 2**18
NICE = 5
"""Niceness of the programs, between the API's responses and the workers: a client waits for the check."""
# Several times the time of a check on two cores, measured with good files that have few bytes a frame.
_S_PER_FILE = 0.2
_S_PER_VIDEO_BYTE = 60 / 2**30
_S_PER_KEYPOINTS_BYTE = 1800 / 2**30
# Share of the time after which no further picture is looked at: a session is not refused for its pictures.
_PICTURES_SHARE = 0.5
_S_PER_CHARACTER_BYTE = 60 / 2**30
# Time of sending the files over a connection of some 140 Mbit/s.
_S_PER_SENT_BYTE = 60 / 2**30


def allowance_s(form: Form) -> float:
    """Time that the check of a form's files may take in addition to ``PreflightProgram.timeout_s``."""
    views, beside = (*form.videos, *form.keypoints, *form.points), form.files.get(form_kinds.LABORATORY, ())
    of_videos = sum(file.num_bytes for file in form.videos) * _S_PER_VIDEO_BYTE
    of_keypoints = sum(file.num_bytes for file in (*form.keypoints, *form.points, *beside)) * _S_PER_KEYPOINTS_BYTE
    return len(views) * _S_PER_FILE + of_videos + of_keypoints


def further_wait_s(form: Form) -> float:
    """Further time that a form's files may wait for their check: about the time of sending them again."""
    return sum(file.num_bytes for file in (*form.videos, *form.keypoints, *form.points)) * _S_PER_SENT_BYTE


def character_wait_s(num_bytes: int) -> float:
    """Further time that a character's file may wait for its check: about the time of sending it again."""
    return num_bytes * _S_PER_SENT_BYTE


class _Printed(BaseModel):
    """Base of what the programs print."""

    model_config = ConfigDict(frozen=True)


_Contents = TypeVar("_Contents", bound=_Printed)


class CharacterFacts(_Printed):
    """Facts about a character's file."""

    format: Literal["GLB", "VRM 0.x", "VRM 1.0", "FBX"]
    method: Method
    stature: float  # Height in the rest pose, in the file's unit; of FBX in metres
    num_bones: int
    num_vertices: int  # Of meshes that bones move


class CharacterBones(_Printed):
    """Bones of a character, as ``mapping.BoneMapping`` says; lists of bones are their names."""

    joints: tuple[JointOut, ...]
    spine: tuple[str, ...]
    neck: tuple[str, ...]
    twists: dict[str, str]
    at_rest: tuple[str, ...]
    warnings: tuple[Finding, ...]
    skeleton: tuple[BoneOut, ...]


class CharacterContents(CharacterFacts, CharacterBones):
    """Contents of a character's file, as the program prints them."""


class CalibrationContents(_Printed):
    """Contents of a calibration file, as the program prints them.

    ``format``, ``units``, ``axes``: see ``pipeline.calibration.contents.CameraFile``.
    """

    format: str
    units: str
    axes: str
    warnings: tuple[Finding, ...]
    text: str  # The calibration in metres, in Multicap's format
    report: dict[str, Any] | None = None  # Of a calibration that was made, see ``pipeline.calibration.report``


def run_program(
    program: "PreflightProgram",
    command: Sequence[str],
    timeout_s: float,
    temporary: Path,
    output: IO[bytes],
    log: IO[bytes],
) -> int:
    """Run a command with the limits of a program; return its exit code.

    ``temporary`` is the folder of its temporary files; ``output`` and ``log`` take what it prints. Raises
    ``TimeoutError`` behind ``timeout_s``; the command is killed with all its children.
    """
    with subprocess.Popen(  # noqa: S603 - the command is the operator's, the files' names are absolute paths
        command,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=log,
        env=os.environ | {"TMPDIR": str(temporary)},
        start_new_session=True,
    ) as child:
        resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (program.max_record_bytes, program.max_record_bytes))
        # Limit for the child of a killed API process: then no process waits for it and applies the timeout.
        resource.prlimit(child.pid, resource.RLIMIT_CPU, (cpu_limit_s(timeout_s), resource.RLIM_INFINITY))
        resource.prlimit(child.pid, resource.RLIMIT_DATA, (program.max_memory_bytes, program.max_memory_bytes))
        lower_priority(NICE, child.pid)
        try:
            return child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise TimeoutError from None
        finally:
            # A child that was not waited for keeps its process id, so the group is its own.
            if child.returncode is None:
                os.killpg(child.pid, signal.SIGKILL)


def cpu_limit_s(timeout_s: float) -> int:
    """Limit on the computing time of a program that may take so long."""
    return math.ceil(4 * timeout_s)


RunProgram = Callable[["PreflightProgram", Sequence[str], float, Path, IO[bytes], IO[bytes]], int]
"""Function that runs a program as ``run_program`` does."""


@dataclass(frozen=True, slots=True)
class PreflightProgram:
    """Programs that check files, with their limits.

    - ``command``: program of sessions and calibrations, with its first arguments.
    - ``timeout_s``: time limit in addition to the time for the files (``allowance_s``); then it is killed with all its
      children.
    - ``max_bytes``: largest size of the printed output.
    - ``max_record_bytes``: largest size of a written file.
    - ``max_memory_bytes``: largest memory of the process.
    - ``character_command``, ``calibration_command``: programs of characters and of calibrations, with their first
      arguments.
    - ``run``: function that runs a program, see ``run_program``.
    """

    command: tuple[str, ...]
    timeout_s: float
    max_bytes: int
    max_record_bytes: int
    max_memory_bytes: int
    character_command: tuple[str, ...] = ()
    calibration_command: tuple[str, ...] = ()
    run: RunProgram = run_program

    def check(
        self, arguments: Sequence[str], record: Path, allowance_s: float = 0.0, thumbnails: Path | None = None
    ) -> Preflight:
        """Check the files of a session.

        - ``arguments``: files of the session and the choices of its manifest, as arguments of the program.
        - ``record``: path to which the program writes the data for workers. The program's temporary files go to the
          same folder, which the caller removes: a killed program leaves them behind.
        - ``allowance_s``: time for these files, in addition to ``timeout_s``.
        - ``thumbnails``: empty folder to which small copies of pictures are written, if the session is to be
          reconstructed.

        Returns the printed record. Raises ``InvalidFilesError`` if the files are not a session; with everything that is
        wrong. Raises ``ApiError``: 500 if the program itself fails. Raises ``OSError`` if the disk is full.
        """
        written = ["--record", str(record)]
        if thumbnails is not None:
            pictures_s = _PICTURES_SHARE * (self.timeout_s + allowance_s)
            written += ["--thumbnails", str(thumbnails), f"--pictures-s={pictures_s}"]
        session = _parsed(self._answer([*self.command, *arguments, *written], record.parent, allowance_s))
        if session is None or not record.is_file() or not _has_thumbnails(session, thumbnails):
            raise _failed()
        return session

    def read_calibration(self, arguments: Sequence[str], folder: Path) -> CalibrationContents:
        """Read a calibration: ``arguments`` are its file and choices; ``folder`` and errors as ``calibration_task``."""
        return self._contents(CalibrationContents, [*self.command, *arguments], folder, 0.0)

    def calibration_task(self, task: str, arguments: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        """Do a task of ``pipeline.calibration.on_request``, with the arguments of its function.

        ``folder``: folder for temporary files, which the caller removes. Returns what the program printed. Raises
        ``InvalidFilesError``, ``ApiError``, ``OSError`` as ``check``.
        """
        path = folder / "request.json"
        path.write_text(json.dumps({"task": task, **arguments}), "utf-8")
        answer: dict[str, Any] = json.loads(self._answer([*self.calibration_command, str(path)], folder, 0.0))
        return answer

    def read_character(self, file: Path, corrections: Mapping[str, str | None], folder: Path) -> CharacterContents:
        """Read a character.

        ``corrections``: bones by joint, in place of the recognised bones; ``None``: the joint has no bone. ``folder``
        and errors as ``calibration_task``.
        """
        allowance_s = file.stat().st_size * _S_PER_CHARACTER_BYTE
        with tempfile.NamedTemporaryFile(dir=folder) as table:
            table.write(json.dumps({"bones": dict(corrections)}).encode())
            table.flush()
            command = [*self.character_command, str(file), "--bones", table.name]
            return self._contents(CharacterContents, command, folder, allowance_s)

    def _contents(self, model: type[_Contents], command: Sequence[str], folder: Path, allowance_s: float) -> _Contents:
        try:
            return model.model_validate_json(self._answer(command, folder, allowance_s))
        except ValidationError:
            raise _failed() from None

    def _answer(self, command: Sequence[str], folder: Path, allowance_s: float) -> bytes:
        """Run a program, and return what it prints about usable files."""
        with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as log:
            timeout_s = self.timeout_s + allowance_s
            try:
                exit_code = self.run(self, command, timeout_s, folder, output, log)
            except TimeoutError:
                raise _too_slow(timeout_s) from None
            printed = _read(output, self.max_bytes)
            if exit_code == 0 and printed:
                return printed
            if exit_code == _EXIT_BAD_INPUT and (problems := _problems(printed)):
                raise InvalidFilesError(problems)
            if exit_code == _EXIT_DISK_FULL:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            _log.error("preflight_failed", exit_code=exit_code, output_bytes=len(printed), log=_tail(log))
        raise _failed()


class InvalidFilesError(Exception):
    """The files are not a session; ``errors`` lists everything that is wrong with them."""

    def __init__(self, errors: Sequence[ErrorItem]) -> None:
        super().__init__(f"{len(errors)} problems")
        self.errors = tuple(errors)


class _Problems(_Printed):
    problems: tuple[ErrorItem, ...]


def _too_slow(timeout_s: float) -> InvalidFilesError:
    _log.warning("preflight_timeout", timeout_s=timeout_s)
    message = f"The check of the files took longer than {timeout_s:.3g} s."
    hint = "Send fewer or smaller files, or send the same files again when the service is less busy."
    return InvalidFilesError([ErrorItem(code=PREFLIGHT_TIMEOUT, message=message, hint=hint)])


def _failed() -> ApiError:
    return ApiError(PREFLIGHT_FAILED, "The check of the files failed; the log says why.", retryable=True)


def _read(file: IO[bytes], max_bytes: int) -> bytes:
    file.seek(0)
    content = file.read(max_bytes + 1)
    return content if len(content) <= max_bytes else b""


def _tail(file: IO[bytes]) -> str:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _LOGGED_BYTES))
    return file.read().decode(errors="replace")


def _parsed(printed: bytes) -> Preflight | None:
    try:
        return Preflight.from_json(json.loads(printed))
    except (ValueError, RecursionError):
        return None


def _has_thumbnails(session: Preflight, folder: Path | None) -> bool:
    """True if all thumbnails of a session are files of the sizes that it states, and small."""
    for camera, number, thumbnail in session.thumbnails():
        path = (folder or Path()) / thumbnail_name(camera, number)
        if not path.is_file() or not path.stat().st_size == thumbnail.num_bytes <= _MAX_THUMBNAIL_BYTES:
            return False
    return True


def _problems(printed: bytes) -> tuple[ErrorItem, ...]:
    try:
        return _Problems.model_validate_json(printed).problems
    except ValidationError:
        return ()
