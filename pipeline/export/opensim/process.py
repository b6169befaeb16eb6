"""Run OpenSim in a child process (``pipeline.export.opensim.child``) with limits, and read its log."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

from pipeline.core.errors import printable
from pipeline.core.progress import OnShare
from pipeline.core.runtime.confinement import BeyondLimitsError, ChildLimits, FileRefusedError, run_confined

# Longest silence of the child: the scale tool loads a model in a second, and reading an hour of markers takes a minute.
_TIMEOUT_S = 600.0
# Computing time, as a base and for each frame; a frame takes about 10 ms.
_MAX_CPU_S, _MAX_CPU_S_A_FRAME = 120, 0.25
_MAX_FILE_BYTES = 2**31
_MAX_OPEN_FILES = 256
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

    ``num_frames``: number of frames of the markers. ``on_share``: called with the progress; an exception from it ends
    the child. Returns what the log says, and a sentence about what failed; ``None``: nothing did. Raises ``ChildError``
    if the child ends for a reason other than OpenSim, such as a signal from outside.
    """
    log, rest = OpenSimLog(), b""

    def follow(content: bytes) -> None:
        nonlocal rest
        *lines, rest = (rest + content).split(b"\n")
        for line in lines:
            _read_line(line.decode(errors="replace"), log)
        on_share(min(1.0, log.num_frames / num_frames))

    limits = ChildLimits(
        cpu_s=round(_MAX_CPU_S + _MAX_CPU_S_A_FRAME * num_frames),
        file_bytes=_MAX_FILE_BYTES,
        open_files=_MAX_OPEN_FILES,
    )
    try:
        run_confined(
            "pipeline.export.opensim.child",
            [str(folder.absolute())],
            limits,
            task="run of OpenSim",
            timeout_s=_TIMEOUT_S,
            on_output=follow,
        )
    except BeyondLimitsError:
        return log, f"OpenSim did not end within its limits on time and memory{_where(log)}."
    except FileRefusedError as error:
        return log, _failure(str(error), log)
    return log, None


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
