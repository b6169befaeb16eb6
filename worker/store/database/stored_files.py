"""Rows that name stored files: listed results, files to be removed, and kept answers that name a deleted record.

Result files are listed when their chunk is finished, and dropped when files of a newer revision replace them.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from datetime import timedelta

from sqlalchemy import ColumnElement, Connection, Text, cast, delete, insert, select
from uuid_utils import uuid7

from pipeline.core.options.job_choices import VISUAL_KINDS
from worker.store.database.access import Repository
from worker.store.database.connection import now
from worker.store.database.tables import idempotency_keys, removals, results
from worker.store.model.job_records import Result

# Files of a session take less than this to reach the artifact store; a session that is not added by then never is.
_ARRIVAL = timedelta(days=1)
# A worker that was frozen while its job ended or was deleted may still write: look again when no such worker can be
# left.
_AGAIN_AFTER = timedelta(hours=2)


def remove_later(connection: Connection, prefix: str) -> None:
    """Note files to be removed after the transaction: all under a prefix, or one by its key."""
    for wait_s in (0.0, _AGAIN_AFTER.total_seconds()):
        connection.execute(insert(removals).values(prefix=prefix, due_at=now() + wait_s))


def remove_unless_kept(connection: Connection, prefix: str) -> None:
    """Note files that are about to be stored to be removed after a day, unless ``keep`` is called before."""
    connection.execute(insert(removals).values(prefix=prefix, due_at=now() + _ARRIVAL.total_seconds()))


class StoringRepository(Repository):
    """Records with stored files, all under the prefix of the record's id."""

    _prefix: Callable[[str], str]

    def reserve_id(self) -> str:
        """Make the id of a record whose files are about to be stored; they are removed after a day without ``add``."""
        record_id = str(uuid7())
        with self._access.writing() as connection:
            remove_unless_kept(connection, self._prefix(record_id))
        return record_id


def keep(connection: Connection, prefix: str) -> bool:
    """Delete the removals of some files; ``False`` if the files are removed already."""
    return connection.execute(delete(removals).where(removals.c.prefix == prefix)).rowcount > 0


def forget_answers(connection: Connection, tenant: str, record_id: str) -> None:
    """Forget the idempotency keys of a tenant whose answers have the id of a deleted record: they have its name too."""
    answer = cast(idempotency_keys.c.answer, Text)
    is_answered = (idempotency_keys.c.tenant == tenant) & answer.contains(record_id)
    connection.execute(delete(idempotency_keys).where(is_answered))


def list_results(connection: Connection, job_id: str, files: Sequence[Result]) -> None:
    """List result files of a locked job; each takes the place of the file of the same name."""
    if files:
        folders = _drop(connection, job_id, results.c.name.in_([file.name for file in files]))
        connection.execute(insert(results), [{"job_id": job_id, **asdict(file)} for file in files])
        _remove_unlisted(connection, job_id, folders)


def drop_results(connection: Connection, job_id: str, condition: ColumnElement[bool]) -> None:
    """Drop the rows of a locked job that meet a condition, and note their files for removal."""
    _remove_unlisted(connection, job_id, _drop(connection, job_id, condition))


def remove_unlisted(connection: Connection, job_id: str, prefix: str) -> None:
    """Note the files under a prefix for removal, unless a row of the job names one of them."""
    listed = select(results.c.name).where(results.c.job_id == job_id, results.c.key.startswith(prefix, autoescape=True))
    if connection.execute(listed.limit(1)).first() is None:
        remove_later(connection, prefix)


def has_visuals(connection: Connection, job_id: str) -> bool:
    """Return whether overlay videos, a report or a recording of a job are listed."""
    listed = select(results.c.name).where(results.c.job_id == job_id, results.c.kind.in_(VISUAL_KINDS))
    return connection.execute(listed.limit(1)).first() is not None


def _drop(connection: Connection, job_id: str, condition: ColumnElement[bool]) -> Collection[str]:
    """Drop the rows that meet a condition; returns the prefixes of their keys."""
    in_job = results.c.job_id == job_id
    keys = connection.scalars(select(results.c.key).where(in_job, condition)).all()
    connection.execute(delete(results).where(in_job, condition))
    return sorted({f"{key.rpartition('/')[0]}/" for key in keys})


def _remove_unlisted(connection: Connection, job_id: str, prefixes: Collection[str]) -> None:
    for prefix in prefixes:
        remove_unlisted(connection, job_id, prefix)
