"""A chunk at work: its claim, its session, and its way to the worker that holds it. No science is loaded."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from worker.jobs.files.artifacts import ArtifactStore
from worker.jobs.model.sessions import Session
from worker.jobs.model.work import Claim


class StoppedError(Exception):
    """The work is no longer wanted here: the lease is lost, the job is canceled, or the worker shuts down."""


class DamagedOutputsError(Exception):
    """Stored outputs of ``chunks``, indices of an earlier ``stage``, are damaged or missing."""

    def __init__(self, stage: str, chunks: Collection[int]) -> None:
        super().__init__(f"{len(chunks)} outputs of the stage {stage} are damaged")
        self.stage, self.chunks = stage, chunks


class Outputs(Protocol):
    """Reads outputs of an earlier stage's chunks."""

    def __call__(self, stage: str, chunks: slice = ...) -> list[bytes]:
        """Outputs in the chunks' order, by default of all chunks. Raises ``DamagedOutputsError``."""


@dataclass(frozen=True, slots=True)
class Work:
    """One chunk to run.

    Parameters
    ----------
    claim, session
        The claimed chunk, and the session of its job.
    artifacts
        Store of the session's files.
    outputs
        Reads outputs of an earlier stage's chunks.
    scratch
        Folder for temporary files and result files, which is removed after the chunk.
    on_unit
        Call it after each unit of work; raises ``StoppedError`` when the work is no longer wanted.
    check
        Call it during long steps that are no unit; raises ``StoppedError`` likewise.
    interim
        Reads the interim outputs of all chunks of an earlier stage, by its name. Raises ``DamagedOutputsError``.
    found
        Output of the chunk if it is stored already, and only the interim output is missing.
    piece
        Reads a piece of an output that an earlier chunk of the session has kept, by its key; ``None`` without it.
    """

    claim: Claim
    session: Session
    artifacts: ArtifactStore
    outputs: Outputs
    scratch: Path
    on_unit: Callable[[], None]
    check: Callable[[], None]
    interim: Callable[[str], list[bytes]]
    found: bytes | None
    piece: Callable[[str], bytes | None] = lambda _: None
