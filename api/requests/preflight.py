"""Preflight of a session: a child process with limits checks its files, which may be hostile.

The API does not open videos and calibrations. The program ``python -m pipeline.capture.preflight`` does, and prints one
JSON object: the preflight record, or ``{"problems": [...]}``.
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
# Priority after the API and before the workers: a client waits for the answer.
_NICE = 5
# Several times the time of a check on two cores, for good files with very few bytes a frame.
_S_PER_FILE = 0.2
_S_PER_VIDEO_BYTE = 60 / 2**30
_S_PER_KEYPOINTS_BYTE = 1800 / 2**30
# At a line of about 140 Mbit/s.
_S_PER_SENT_BYTE = 60 / 2**30


def allowance_s(form: Form) -> float:
    """Time for the check of a form's files, on top of ``PreflightProgram.timeout_s``: more for more or larger files."""
    views = (*form.videos, *form.keypoints)
    of_videos = sum(file.num_bytes for file in form.videos) * _S_PER_VIDEO_BYTE
    of_keypoints = sum(file.num_bytes for file in form.keypoints) * _S_PER_KEYPOINTS_BYTE
    return len(views) * _S_PER_FILE + of_videos + of_keypoints


def further_wait_s(form: Form) -> float:
    """Additional time that a form waits for its check: about the time to send its files again."""
    return sum(file.num_bytes for file in (*form.videos, *form.keypoints)) * _S_PER_SENT_BYTE


@dataclass(frozen=True, slots=True)
class PreflightProgram:
    """Program that checks files, with its limits.

    Parameters
    ----------
    command
        Program and first arguments.
    timeout_s
        Time limit, on top of the allowance for the files (``allowance_s``); then it is killed with its children.
    max_bytes
        Maximum size of its output.
    max_record_bytes
        Maximum size of the file that it writes for the workers.
    max_memory_bytes
        Maximum memory.
    """

    command: tuple[str, ...]
    timeout_s: float
    max_bytes: int
    max_record_bytes: int
    max_memory_bytes: int

    def check(self, arguments: Sequence[str], record: Path, allowance_s: float = 0.0) -> Preflight:
        """Check the files of a session.

        Parameters
        ----------
        arguments
            Files of the session, and facts about them that the client stated.
        record
            Path of the file that the program writes for the workers. The caller removes its folder, because a killed
            program leaves temporary files there.
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
            # Ends children of an API process that was killed, for which nobody waits any more.
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
                # A living child was not waited for yet, so its id still names its own process group.
                if child.returncode is None:
                    os.killpg(child.pid, signal.SIGKILL)


class InvalidFilesError(Exception):
    """The files are no valid session; ``errors`` lists all problems."""

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
