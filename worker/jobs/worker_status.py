"""Status of worker processes."""

from dataclasses import dataclass
from enum import StrEnum


class WorkerState(StrEnum):
    """Whether a worker process could start a chunk now."""

    STARTING = "starting"
    READY = "ready"


@dataclass(frozen=True, slots=True)
class WorkerStatus:
    """Status of a worker process, as the process reports it.

    Parameters
    ----------
    id
        Host and process id.
    activity
        Sentence about its work, without the full stop.
    done, total
        Steps of the activity; both 0 where there are none to count.
    detectors
        Names of the installed detectors.
    codes
        Digests of the stages' code that it runs.
    """

    id: str
    state: WorkerState
    activity: str
    done: int = 0
    total: int = 0
    detectors: tuple[str, ...] = ()
    codes: tuple[str, ...] = ()
