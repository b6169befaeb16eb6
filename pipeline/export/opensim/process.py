"""Run OpenSim in a child process (``pipeline.export.opensim.child``) with limits, and read its log."""

import json
import os
import re
import select
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

from pipeline.core.errors import printable
from pipeline.core.progress import OnShare
from pipeline.core.runtime.child_processes import module_command, uninterrupted
from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.export.opensim.child import EXIT_FAILED, READY
from pipeline.video.children import child_environment, child_error, is_caused_by_file

# Longest silence of the child: the scale tool loads a model in a second, and reading an hour of markers takes a minute.
_TIMEOUT_S = 600.0
# Computing time, as a base and for each frame; a frame takes about 10 ms.
_MAX_CPU_S, _MAX_CPU_S_A_FRAME = 120, 0.25
_READ_BYTES = 2**14
_KEPT_CHARACTERS = 600
_FRAME = re.compile(
    r"Frame (?P<frame>\d+) \(t = (?P<time_s>\S+)\):.*"
    r"RMS = (?P<rms_m>\S+), max = (?P<max_m>\S+) \((?P<marker>[^)]*)\)"
)


@dataclass(slots=True)
class OpenSimLog:
    """Content of the log of a run."""

    # Marker that was farthest off in any frame, by how much, and when
    farthest: str | None = None
    farthest_m: float = 0.0
    farthest_time_s: float = 0.0
    # The same of the frame that was solved last
    last: str | None = None
    last_m: float = 0.0
    last_time_s: float = 0.0
    num_frames: int = 0  # Number of frames that were solved
    error: str = ""  # Last error


def run_opensim(folder: Path, num_frames: int, on_share: OnShare) -> tuple[OpenSimLog, str | None]:
    """Scale the model and run the inverse kinematics of the setups in a folder.

    Parameters
    ----------
    num_frames
        Number of frames of the markers.
    on_share
        Called with the progress; an exception from it ends the child.

    Returns
    -------
        What the log says, and a sentence about what failed; ``None``: nothing did.

    Raises
    ------
    ChildError
        If the child ends for a reason other than OpenSim, such as a signal from outside.
    """
    max_cpu_s = round(_MAX_CPU_S + _MAX_CPU_S_A_FRAME * num_frames)
    command = tied_to_parent(module_command("pipeline.export.opensim.child", str(folder.absolute()), str(max_cpu_s)))
    child: subprocess.Popen[bytes] | None = None
    with tempfile.TemporaryFile() as errors:
        try:
            with uninterrupted():
                child = subprocess.Popen(  # noqa: S603 (our own interpreter and module)
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    bufsize=0,
                    env=child_environment(),
                )
            return _follow(child, num_frames, on_share, errors)
        finally:
            if child is not None:
                child.kill()
                with child:  # closes the pipe, and waits
                    pass


def _follow(
    child: "subprocess.Popen[bytes]", num_frames: int, on_share: OnShare, errors: IO[bytes]
) -> tuple[OpenSimLog, str | None]:
    """Read the log of a child to its end, and tell how it ended."""
    stdout = cast(IO[bytes], child.stdout).fileno()
    poll = select.poll()
    poll.register(stdout, select.POLLIN)
    log, rest, is_started, is_ended = OpenSimLog(), b"", False, False
    while not is_ended and poll.poll(1000 * _TIMEOUT_S):
        content = os.read(stdout, _READ_BYTES)
        is_ended = not content
        *lines, rest = (rest + content).split(b"\n")
        for line in lines:
            text = line.decode(errors="replace")
            is_started |= text.startswith(READY)
            _read_line(text, log)
        on_share(min(1.0, log.num_frames / num_frames))
    exit_code = child.wait(_TIMEOUT_S) if is_ended else None
    if exit_code == 0:
        return log, None
    errors.seek(0)
    text = errors.read().decode(errors="replace")
    if is_started and (exit_code is None or is_caused_by_file(exit_code)):
        return log, f"OpenSim did not end within its limits on time and memory{_where(log)}."
    if exit_code != EXIT_FAILED:
        raise child_error("run of OpenSim", exit_code, _TIMEOUT_S, text)
    return log, _failure(text, log)


def _read_line(line: str, log: OpenSimLog) -> None:
    """Take a line of the log into account."""
    if found := _FRAME.search(line):
        log.num_frames += 1
        log.last, log.last_m, log.last_time_s = found["marker"], float(found["max_m"]), float(found["time_s"])
        if log.last_m > log.farthest_m:
            log.farthest, log.farthest_m, log.farthest_time_s = log.last, log.last_m, log.last_time_s
    elif "[error]" in line:
        log.error = line.partition("[error]")[2].strip()


def _failure(errors: str, log: OpenSimLog) -> str:
    """Sentence about a step that failed."""
    report = json.loads(errors.strip().rpartition("\n")[2])
    step = "Scaling" if report["setup"] == "scale.xml" else "Inverse kinematics"
    # Exceptions of OpenSim have their text in the first lines, and then where in its sources they were thrown.
    reason = log.error or report["error"]
    short = printable(" ".join(reason.split()))[:_KEPT_CHARACTERS]
    return f"{step} failed{_where(log)}: {short}"


def _where(log: OpenSimLog) -> str:
    """Say which frame was solved last, and which marker was farthest off in it."""
    if log.last is None:
        return ""
    return f" after {log.last_time_s:g} s, where the marker {log.last} was {1000.0 * log.last_m:.0f} mm off"
