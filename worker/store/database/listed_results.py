"""Rows of result files: listed when their chunk is finished, dropped when files of a newer revision replace them."""

from collections.abc import Collection, Sequence
from dataclasses import asdict

from sqlalchemy import ColumnElement, Connection, delete, insert, select

from pipeline.core.options.job_choices import VISUAL_KINDS
from worker.store.database.removal_notes import remove_later
from worker.store.database.tables import results
from worker.store.model.jobs import Result


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
    of_job = results.c.job_id == job_id
    keys = connection.scalars(select(results.c.key).where(of_job, condition)).all()
    connection.execute(delete(results).where(of_job, condition))
    return sorted({f"{key.rpartition('/')[0]}/" for key in keys})


def _remove_unlisted(connection: Connection, job_id: str, prefixes: Collection[str]) -> None:
    for prefix in prefixes:
        remove_unlisted(connection, job_id, prefix)
