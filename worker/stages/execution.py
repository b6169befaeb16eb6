"""What a stage function is given and what it gives back."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from worker.jobs.files.artifacts import ArtifactStore
from worker.jobs.model import Claim, ResultWarning, Session


class StoppedError(Exception):
    """The work is no longer wanted here: the lease is lost, the job is canceled, or the worker shuts down."""


class DamagedOutputsError(Exception):
    """Stored outputs of ``chunks``, indices of an earlier ``stage``, are damaged or missing."""

    def __init__(self, stage: str, chunks: Collection[int]) -> None:
        super().__init__(f"{len(chunks)} outputs of the stage {stage} are damaged")
        self.stage, self.chunks = stage, chunks


class Outputs(Protocol):
    """Reads what chunks of an earlier stage left."""

    def __call__(self, stage: str, chunks: slice = ...) -> list[bytes]:
        """In the chunks' order; of all of them, or of some. Raises ``DamagedOutputsError``."""


@dataclass(frozen=True, slots=True)
class Work:
    """One chunk to run.

    Parameters
    ----------
    claim, session
        What to do, on what.
    artifacts
        Where the session's files are.
    outputs
        Reads what chunks of an earlier stage left.
    scratch
        A folder for result files, which is gone after the chunk.
    on_unit
        To be called after each unit of work (a frame, a person); raises ``StoppedError`` when the work is no longer
        wanted.
    check
        To be called during long steps that are no unit; raises ``StoppedError`` likewise.
    """

    claim: Claim
    session: Session
    artifacts: ArtifactStore
    outputs: Outputs
    scratch: Path
    on_unit: Callable[[], None]
    check: Callable[[], None]


@dataclass(frozen=True, slots=True)
class ResultFile:
    """A file for the client; whoever keeps it may take it away from ``path``."""

    name: str
    kind: str
    person: str | None
    media_type: str
    path: Path


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outputs of a chunk: its artifact; if it is the last stage's, result files for the client and their warnings."""

    content: bytes
    files: tuple[ResultFile, ...] = ()
    warnings: tuple[ResultWarning, ...] = ()


StageFunction = Callable[[Work], Outcome]
Stages = Mapping[str, StageFunction]
