"""A chunk at work: its claim, its session, and its way to the worker that holds it. No science is loaded."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from worker.store.files.artifacts import ArtifactStore
from worker.store.model.sessions import Session
from worker.store.model.work import Claim


class StoppedError(Exception):
    """The work is no longer wanted here: the lease is lost, the job is canceled, or the worker shuts down."""


class DamagedOutputsError(Exception):
    """Stored outputs of ``chunks``, indices of an earlier ``stage``, are damaged or missing."""

    def __init__(self, stage: str, chunks: Collection[int]) -> None:
        super().__init__(f"{len(chunks)} outputs of the stage {stage} are damaged")
        self.stage, self.chunks = stage, chunks


class OutputReader(Protocol):
    """Reads outputs of an earlier stage's chunks."""

    def __call__(self, stage: str, chunks: slice = ...) -> list[bytes]:
        """Outputs in the chunks' order, by default of all chunks. Raises ``DamagedOutputsError``."""


@dataclass(frozen=True, slots=True)
class Work:
    """One chunk to run."""

    # The claimed chunk, and the session of its job
    claim: Claim
    session: Session
    artifacts: ArtifactStore  # Store of the session's files
    outputs: OutputReader  # Reads outputs of an earlier stage's chunks
    scratch: Path  # Folder for temporary files and result files, which is removed after the chunk
    # Call it after each unit of work; raises ``StoppedError`` when the work is no longer wanted
    on_unit: Callable[[], None]
    check: Callable[[], None]  # Call it during long steps that are no unit; raises ``StoppedError`` likewise
    interim: OutputReader  # Reads their interim outputs
    found: bytes | None  # Output of the chunk if it is stored already, and only the interim output is missing
    # Reads a piece of an output that an earlier chunk of the session has kept, by its key; ``None`` without it
    piece: Callable[[str], bytes | None] = lambda _: None
