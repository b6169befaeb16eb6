"""Expiry of jobs, and removals: files of the artifact store that are not needed any more, by a key or a prefix of keys.

A removal is noted in the transaction that makes the files superfluous, and carried out after it. A process that is
killed in between loses nothing: the reaper looks for removals that are due.
"""

import time
import uuid
from collections.abc import Collection, Sequence

import structlog
from sqlalchemy import delete, select, union_all

from worker.store.database.access import ServiceRepository
from worker.store.database.connection import now
from worker.store.database.stored_files import remove_later
from worker.store.database.tables import characters, jobs, removals, sessions
from worker.store.database.transitions import delete_visuals_job, lock_job, move_job
from worker.store.files.artifacts import ArtifactStore
from worker.store.files.file_keys import character_prefix, job_prefix, session_prefix
from worker.store.model.states import JobState
from worker.store.model.work import Removal
from worker.store.outages import find_outage

# Ids that one query asks for.
_MAX_IDS = 500


class Removals(ServiceRepository):
    """Removals of all tenants."""

    def expire_jobs(self) -> list[str]:
        """Expire the jobs whose retention time is over, and note their results for removal; returns the jobs' ids."""
        due = select(jobs.c.id).where(jobs.c.expires_at < now(), jobs.c.state != JobState.EXPIRED)
        with self._transactions.reading() as connection:
            found = connection.scalars(due.order_by(jobs.c.id)).all()
        expired = []
        for job_id in found:
            with self._transactions.writing() as connection:
                lock_job(connection, job_id)
                # Again: the job may have been deleted or retried before it was locked.
                if connection.scalar(due.where(jobs.c.id == job_id)) is not None:
                    move_job(connection, job_id, JobState.EXPIRED)
                    delete_visuals_job(connection, job_id)
                    remove_later(connection, job_prefix(job_id))
                    expired.append(job_id)
        return expired

    def due(self) -> list[Removal]:
        """Removals that are due, the oldest first."""
        query = select(removals.c.id, removals.c.prefix).where(removals.c.due_at <= now()).order_by(removals.c.id)
        with self._transactions.reading() as connection:
            return [Removal(row.id, row.prefix) for row in connection.execute(query)]

    def known_ids(self, ids: Sequence[str]) -> set[str]:
        """Ids among some that belong to a session, a job or a character."""
        known: set[str] = set()
        with self._transactions.reading() as connection:
            for start in range(0, len(ids), _MAX_IDS):
                some = ids[start : start + _MAX_IDS]
                queries = [select(table.c.id).where(table.c.id.in_(some)) for table in (sessions, jobs, characters)]
                known |= set(connection.scalars(union_all(*queries)))
        return known

    def add(self, prefixes: Collection[str]) -> None:
        """Note files for removal."""
        with self._transactions.writing() as connection:
            for prefix in prefixes:
                remove_later(connection, prefix)

    def done(self, removal_id: int) -> None:
        """Delete a removal that was carried out."""
        with self._transactions.writing() as connection:
            connection.execute(delete(removals).where(removals.c.id == removal_id))


log = structlog.get_logger()

# Files of a session take less than this to get their row; see ``worker.store.database.stored_files``.
_ARRIVAL_MS = 24 * 3600 * 1000


def remove_files(removals: Removals, artifacts: ArtifactStore) -> None:
    """Remove the files of all due removals. A removal that fails stays due, and is logged; an outage ends all."""
    for removal in removals.due():
        try:
            if removal.prefix.endswith("/"):
                artifacts.delete_prefix(removal.prefix)
            else:
                artifacts.delete(removal.prefix)
        except OSError as error:
            if find_outage(error) is not None:
                log.warning("removals_wait", outage=find_outage(error))
                return  # of hundreds of removals, each would wait for the store
            log.exception("removal_failed", prefix=removal.prefix)
        else:
            removals.done(removal.id)


def orphaned_prefixes(removals: Removals, artifacts: ArtifactStore) -> list[str]:
    """Prefixes of files without a row, of records that were made more than a day ago.

    The id of a record, a UUID of version 7, has the record's age. Folders with other names are not the service's.
    """
    before_ms = time.time() * 1000 - _ARRIVAL_MS
    orphans = []
    for prefix_of in (session_prefix, job_prefix, character_prefix):
        ids = [name for name in artifacts.names(prefix_of("x").removesuffix("x/")) if _is_older(name, before_ms)]
        known = removals.known_ids(ids)
        orphans += [prefix_of(record_id) for record_id in ids if record_id not in known]
    return orphans


def _is_older(name: str, before_ms: float) -> bool:
    try:
        record_id = uuid.UUID(name)
    except ValueError:
        return False
    return record_id.version == 7 and record_id.int >> 80 < before_ms
