"""A chunk at work: its claim, its session, and its lease, which a thread renews. No science is loaded."""

import contextlib
import math
import sys
import threading
import time
import traceback
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import structlog

from worker.store.errors import DamagedDatabase
from worker.store.files.artifacts import ArtifactStore
from worker.store.model.session_records import Session
from worker.store.model.work import Claim
from worker.store.outages import find_outage
from worker.store.store import JobStore

log = structlog.get_logger()

# Time in which the work must react to the signal to stop, before its process is ended.
STOP_GRACE_S = 2.0
_LOOK_S = 0.25

# Time that a unit is foreseen to take: networks of the default profile take a tenth of a second for a frame of a camera
# (docs/lab/measurements.md), and units of other stages as long. Few units take no less than the shortest limit.
_UNIT_S = 0.1
_SHORTEST_LIMIT_S = 600.0


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
    # Copies the output, or the interim output, of an earlier stage's chunk to a file: stage, chunk, path, is interim
    copy_output: Callable[[str, int, Path, bool], None]
    found: bytes | None  # Output of the chunk if it is stored already, and only the interim output is missing
    # Reads a piece of an output that an earlier chunk of the session has kept, by its key; ``None`` without it
    piece: Callable[[str], bytes | None] = lambda _: None
    # Reads outputs of a running stage's chunks; ``None`` of a chunk that is not done
    finished: Callable[[str, slice], list[bytes | None]] = lambda *_: []


def time_limit_s(num_units: int, factor: float) -> float:
    """Time after which a chunk of some units is stopped: a multiple of its foreseen time, beyond the shortest limit.

    >>> time_limit_s(100, 10.0)
    700.0
    """
    return _SHORTEST_LIMIT_S + factor * _UNIT_S * num_units


class Lease:
    """Lease of a claimed chunk, renewed by a thread of its own.

    While the database does not respond, the work continues: it is not known to be lost. If another worker gets the
    chunk meanwhile, the lease's token is old, and reports of the work change nothing.

    - ``lease_s``: time after the last heartbeat at which the lease is lost.
    - ``heartbeat_s``: time between heartbeats.
    - ``stopping``: returns whether the worker shuts down.
    - ``on_stuck``: called from the thread when the work has not stopped within ``STOP_GRACE_S``, for example during one
      long call. A worker process ends itself here. Work of an attempt that was replaced, such as by edits of people,
      has ``lease_s``: another process would take longer to start than most calls take to end.
    - ``limit_s``: time after which the work is stopped: it renews the lease, but hangs.
    """

    def __init__(
        self,
        store: JobStore,
        claim: Claim,
        lease_s: float,
        heartbeat_s: float,
        stopping: Callable[[], bool],
        on_stuck: Callable[[], None],
        limit_s: float = math.inf,
    ) -> None:
        self._store, self._claim, self._limit_s = store, claim, limit_s
        self._lease_s, self._heartbeat_s = lease_s, heartbeat_s
        self._stopping, self._on_stuck = stopping, on_stuck
        self._done_units = 0
        self._lost = self._is_superseded = False
        self._is_too_long = False
        self._was_cut_off = False
        self._ended = threading.Event()

    @property
    def was_cut_off(self) -> bool:
        """True if a heartbeat failed because the database did not respond."""
        return self._was_cut_off

    @property
    def is_too_long(self) -> bool:
        """True if the work was stopped because it took longer than its limit."""
        return self._is_too_long

    def on_unit(self) -> None:
        """Count a unit of work; raise ``StoppedError`` if the work must stop."""
        self._done_units += 1
        self.check()

    def check(self) -> None:
        """Raise ``StoppedError`` if the work must stop."""
        if self._must_stop():
            raise StoppedError

    def _must_stop(self) -> bool:
        return self._lost or self._is_too_long or self._stopping()

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Renew the lease during the block."""
        thread = threading.Thread(
            target=self._beat_until_ended, args=[threading.get_ident()], name="lease", daemon=True
        )
        thread.start()
        try:
            yield
        finally:
            self._ended.set()
            thread.join()

    def _beat_until_ended(self, worker_thread: int) -> None:
        started_s = beat_s = time.monotonic()
        while not self._ended.wait(_LOOK_S):
            now_s = time.monotonic()
            if now_s - started_s > self._limit_s:
                self._is_too_long = True
                stack = traceback.format_stack(sys._current_frames()[worker_thread])
                log.error("chunk_too_long", chunk=self._claim.chunk_id, limit_s=self._limit_s, stack="".join(stack))
            if self._must_stop():
                break
            if now_s - beat_s < self._heartbeat_s:
                continue
            beat_s = now_s
            try:
                self._lost |= not self._beat()
                self._is_superseded = self._lost and not self._store.leases.holds(*self._held)
            except DamagedDatabase:
                self._lost = True
            except Exception as error:
                if find_outage(error) is None:
                    log.exception("heartbeat_failed", chunk=self._claim.chunk_id)
                elif not self._was_cut_off:  # logged once
                    log.warning("heartbeat_failed", chunk=self._claim.chunk_id, reason=type(error).__name__)
                self._was_cut_off = True
        end_s = time.monotonic() + (self._lease_s if self._is_superseded else STOP_GRACE_S)
        while not self._ended.wait(_LOOK_S):
            if self._stopping():
                end_s = min(end_s, time.monotonic() + STOP_GRACE_S)
            if time.monotonic() > end_s:
                self._on_stuck()
                break

    def _beat(self) -> bool:
        done_units = min(self._done_units, self._claim.unit_count)
        return self._store.leases.heartbeat(*self._held, done_units, self._lease_s)

    @property
    def _held(self) -> tuple[int, str]:
        return self._claim.chunk_id, self._claim.lease_token
