"""Work of the workers: processes, plans, claims of chunks, their outputs, files to remove, and figures of all of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import PeopleEdit
from pipeline.core.options.providers import CPU, Provider
from worker.store.model.character_records import JobCharacter
from worker.store.model.job_records import Making, job_config
from worker.store.spec import JobSpec


class Precedence(IntEnum):
    """Order of a tenant's work: edits of people, and then jobs by the priorities of their specs."""

    EDITS = -1
    PREVIEW = 0
    NORMAL = 1
    BATCH = 2


@dataclass(frozen=True, slots=True)
class Ability:
    """Abilities of a worker process."""

    codes: frozenset[str] | None = None  # Digests of the stages' code that it runs; ``None``: any
    gpu_codes: frozenset[str] = frozenset()  # Of these, the digests of networks on a GPU
    reserves_gpu: bool = False  # True if it leaves all other work to workers without a GPU, while there are any
    memory_bytes: int | None = None  # Memory of the process; ``None``: not stated
    machine_bytes: int | None = None  # Memory of all chunks that run on its machine at once; ``None``: without limit


ANY_CHUNK = Ability()
"""Ability to run any chunk."""


@dataclass(frozen=True, slots=True)
class ChunkPlan:
    """A chunk to be worked on. Its progress counts ``unit_count`` units, such as frames of a camera."""

    index: int
    payload: Mapping[
        str, Any
    ]  # JSON object; in a map {"start_frame", "stop_frame"}, and "camera" for chunks of a camera
    unit_count: int
    output_key: str  # content-addressed key of its output, without the prefix of the session
    memory_bytes: int = 0  # memory that it is foreseen to need; 0: not known


@dataclass(frozen=True, slots=True)
class StagePlan:
    """A stage: its chunks may run at once; it becomes ready when the stage before it is done."""

    name: str  # As in ``pipeline.run.engine.plan``
    # At least one; may be iterated more than once. There may be thousands, so a plan derives them one at a time.
    chunks: Iterable[ChunkPlan]
    code_sha256: str  # Digest of the code that can run the chunks, as in ``pipeline.run.engine.code``
    # Identity of the execution provider that runs its networks, see ``pipeline.core.options.providers``; empty: the
    # CPU, or none
    provider: str = ""


@dataclass(frozen=True, slots=True)
class Remake:
    """Plan of the files of a job that are made again."""

    stages: Sequence[StagePlan]
    # The job that makes its visuals has something to make; it reads videos
    has_visuals: bool
    needs_videos: bool


@dataclass(frozen=True, slots=True)
class Claim:
    """Chunk that a worker holds by a lease; reports need its ``lease_token``."""

    chunk_id: int
    job_id: str
    session_id: str
    stage: str
    index: int
    payload: Mapping[str, Any]
    unit_count: int
    output_key: str
    spec: JobSpec
    lease_token: str
    attempt: int  # try of the chunk, from 1
    job_attempt: int
    trace: str | None  # W3C traceparent of the request for the job
    making: Making | None = None  # like ``JobRecord``, as the next two
    edits: tuple[PeopleEdit, ...] = ()
    revision: int = 0
    reconstruction_id: str | None = None  # reconstruction of which it makes visuals
    provider: str = ""  # identity of the execution provider of the job's networks
    character: JobCharacter | None = None  # like ``JobRecord``

    @property
    def config(self) -> ReconstructionConfig:
        """Configuration of the job."""
        return job_config(self.spec, self.making, self.edits, self.revision, self.character)

    @property
    def listed_by(self) -> str:
        """Id of the job that lists the result files of the chunk."""
        return self.reconstruction_id or self.job_id


@dataclass(frozen=True, slots=True)
class ChunkOutput:
    """Output of a chunk; ``sha256`` is ``None`` until the chunk is done."""

    index: int
    key: str  # as ``ChunkPlan.output_key``
    sha256: str | None


@dataclass(frozen=True, slots=True)
class KeptPiece:
    """Stored piece of an output, which later chunks of the session find by its key."""

    key: str
    sha256: str
    num_bytes: int


@dataclass(frozen=True, slots=True)
class Change:
    """Progress of a job: the id of its last event, and the number of its finished units."""

    event: int
    done: int


@dataclass(frozen=True, slots=True)
class Removal:
    """Files of the artifact store to be removed, by the prefix of their keys."""

    id: int
    prefix: str


@dataclass(frozen=True, slots=True)
class RunningChunk:
    """A chunk at work, for monitoring."""

    tenant: str
    job_id: str
    stage: str
    index: int
    age_s: float  # Time since its last try began
    still_s: float  # Time since its last progress, or since its last try began
    progress: float  # Share of its units that are done, from 0 to 1


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of all jobs, for monitoring."""

    totals: Mapping[tuple[str, str], float]  # Totals by name and label; see ``worker.store.database.totals``
    # Numbers by state; chunks of unfinished jobs only
    jobs: Mapping[str, int]
    chunks: Mapping[str, int]
    longest_queued_s: float  # Time that the first job in the queue has waited; 0 without one
    running: Sequence[RunningChunk]  # As many as there are workers at work


class WorkerState(StrEnum):
    """Readiness of a worker process for a chunk."""

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
