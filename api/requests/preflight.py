"""Check a session's files in a process of its own, with limits: the files are a stranger's.

The API knows nothing of videos and calibrations. The program ``python -m pipeline.capture.preflight``
opens them and prints one JSON object: the session, or ``{"problems": [...]}``.
"""

import errno
import json
import math
import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import structlog
from pydantic import BaseModel, ConfigDict, ValidationError

from api.errors import ApiError, ErrorItem
from api.requests.form import Form
from pipeline.capture.preflight_record import Preflight
from worker.process.priorities import stand_back

_log = structlog.get_logger(__name__)

_EXIT_BAD_INPUT = 2
_EXIT_DISK_FULL = 4
_LOGGED_BYTES = 4000
# Behind the API's answers, before the workers: a client waits for it.
_NICE = 5
# Several times what a check needs on two cores, of good files with as few bytes a frame as there are.
_S_PER_FILE = 0.2
_S_PER_VIDEO_BYTE = 60 / 2**30
_S_PER_KEYPOINTS_BYTE = 1800 / 2**30
# Over a line of some 140 Mbit/s.
_S_PER_SENT_BYTE = 60 / 2**30


def allowance_s(form: Form) -> float:
    """Time for the check of a form's files, on top of ``PreflightProgram.timeout_s``: more for more or larger files."""
    views = (*form.videos, *form.keypoints)
    of_videos = sum(file.num_bytes for file in form.videos) * _S_PER_VIDEO_BYTE
    of_keypoints = sum(file.num_bytes for file in form.keypoints) * _S_PER_KEYPOINTS_BYTE
    return len(views) * _S_PER_FILE + of_videos + of_keypoints


def further_wait_s(form: Form) -> float:
    """How much longer a form's files wait for their check: about as long as it would take to send them again."""
    return sum(file.num_bytes for file in (*form.videos, *form.keypoints)) * _S_PER_SENT_BYTE


@dataclass(frozen=True, slots=True)
class PreflightProgram:
    """A program that checks files, and how much of it is borne.

    Parameters
    ----------
    command
        Program and first arguments.
    timeout_s
        How long it may take beside what its files are worth (``allowance_s``); then it is killed with all its children.
    max_bytes
        How much it may say.
    max_record_bytes
        How much it may write.
    max_memory_bytes
        How much memory it may take.
    """

    command: tuple[str, ...]
    timeout_s: float
    max_bytes: int
    max_record_bytes: int
    max_memory_bytes: int

    def check(self, arguments: Sequence[str], record: Path, allowance_s: float = 0.0) -> Preflight:
        """Find out what a session is.

        Parameters
        ----------
        arguments
            The files of the session, and what was said of them.
        record
            Where the program is to keep what the workers need to know of the files. The program's temporary files go
            to the same folder, which the caller removes: a program that is killed leaves them behind.
        allowance_s
            Time for these files, on top of ``timeout_s``.

        Returns
        -------
            Record that the program printed.

        Raises
        ------
        InvalidFilesError
            With everything that is wrong with the files.
        ApiError
            500 if the program itself fails.
        OSError
            If the disk is full.
        """
        with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as log:
            command = [*self.command, *arguments, "--record", str(record)]
            exit_code = self._run(command, self.timeout_s + allowance_s, record.parent, output, log)
            said = _read(output, self.max_bytes)
            if exit_code == 0 and record.is_file() and (found := _parsed(said)) is not None:
                return found
            if exit_code == _EXIT_BAD_INPUT and (problems := _problems(said)):
                raise InvalidFilesError(problems)
            if exit_code == _EXIT_DISK_FULL:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            _log.error("preflight_failed", exit_code=exit_code, said=len(said), log=_tail(log))
        raise ApiError("preflight_failed", "The check of the files failed; the log says why.", retryable=True)

    def _run(self, command: Sequence[str], timeout_s: float, temporary: Path, output: IO[bytes], log: IO[bytes]) -> int:
        with subprocess.Popen(  # noqa: S603 - the command is the operator's, the files' names are absolute paths
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=log,
            env=os.environ | {"TMPDIR": str(temporary)},
            start_new_session=True,
        ) as child:
            resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (self.max_record_bytes, self.max_record_bytes))
            # For children of an API process that was killed: nobody waits for them any more.
            resource.prlimit(child.pid, resource.RLIMIT_CPU, (math.ceil(4 * timeout_s), resource.RLIM_INFINITY))
            resource.prlimit(child.pid, resource.RLIMIT_DATA, (self.max_memory_bytes, self.max_memory_bytes))
            stand_back(_NICE, child.pid)
            try:
                return child.wait(timeout_s)
            except subprocess.TimeoutExpired:
                _log.warning("preflight_timeout", timeout_s=timeout_s)
                message = f"The check of the files took longer than {timeout_s:.3g} s."
                hint = "Send fewer or smaller files at once, or the same files when the service is less busy."
                raise InvalidFilesError([ErrorItem(code="preflight_timeout", message=message, hint=hint)]) from None
            finally:
                # Not yet waited for when it is alive, so that the number is still its own and its children's.
                if child.returncode is None:
                    os.killpg(child.pid, signal.SIGKILL)


class InvalidFilesError(Exception):
    """The files are no session; ``errors`` says all that is wrong with them."""

    def __init__(self, errors: Sequence[ErrorItem]) -> None:
        super().__init__(f"{len(errors)} problems")
        self.errors = tuple(errors)


class _Problems(BaseModel):
    model_config = ConfigDict(frozen=True)

    problems: tuple[ErrorItem, ...]


def _read(file: IO[bytes], max_bytes: int) -> bytes:
    file.seek(0)
    content = file.read(max_bytes + 1)
    return content if len(content) <= max_bytes else b""


def _tail(file: IO[bytes]) -> str:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _LOGGED_BYTES))
    return file.read().decode(errors="replace")


def _parsed(said: bytes) -> Preflight | None:
    try:
        return Preflight.from_json(json.loads(said))
    except (ValueError, RecursionError):
        return None


def _problems(said: bytes) -> tuple[ErrorItem, ...]:
    try:
        return _Problems.model_validate_json(said).problems
    except ValidationError:
        return ()
