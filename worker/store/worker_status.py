"""Status of worker processes."""

from dataclasses import dataclass
from enum import StrEnum

from pipeline.core.options.providers import CPU, Provider


class WorkerState(StrEnum):
    """Whether a worker process could start a chunk now."""

    STARTING = "starting"
    READY = "ready"


@dataclass(frozen=True, slots=True)
class WorkerStatus:
    """Status of a worker process, as the process reports it."""

    id: str  # Host and process id
    state: WorkerState
    activity: str  # Sentence about its work, without the full stop
    # Steps of the activity; both 0 where there are none to count
    done: int = 0
    total: int = 0
    detectors: tuple[str, ...] = ()  # Names of the installed detectors
    bodies: tuple[str, ...] = ()  # Names of the installed bodies of people
    formats: tuple[str, ...] = ()  # Formats of people's files that it can write
    codes: tuple[str, ...] = ()  # Digests of the stages' code that it runs
    provider: Provider = CPU  # Execution provider of its networks
    memory_bytes: int = 0  # Limit of its memory; 0: not stated
