"""Calibrations: sent as files, or made by jobs."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sqlalchemy import Connection, Row, Select, delete, insert, select, update
from uuid_utils import uuid7

from pipeline.core.options.job_choices import CalibrationChoices
from worker.store.database.access import Repository, existing, newest_first
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.stored_files import forget_answers, remove_later
from worker.store.database.tables import calibrations, jobs, sessions
from worker.store.errors import Conflict
from worker.store.files.file_keys import job_prefix, session_prefix
from worker.store.model.job_records import JobRecord
from worker.store.model.session_records import Calibration, MadeCalibration
from worker.store.model.states import FINISHED
from worker.store.repositories.audit import AuditAction, record_event


class Calibrations(Repository):
    """Calibrations of a tenant, or of all tenants."""

    def add(
        self,
        name: str,
        source: Mapping[str, Any],
        text: str,
        method: str = "file",
        report: Mapping[str, Any] | None = None,
    ) -> Calibration:
        """Add a calibration without a job: sent as a file, or made from a scene.

        The arguments are like in ``session_records.Calibration``. Raises ``QuotaExceeded``.
        """
        return self._insert(str(uuid7()), name, method, source, text, report=report)

    def begin(self, job: JobRecord, name: str) -> Calibration:
        """Add the calibration that a job will make, in the transaction that adds the job."""
        making = job.making if isinstance(job.making, CalibrationChoices) else None
        if making is None:
            raise ValueError("the job makes no calibration")
        return self._insert(job.id, name, making.method, asdict(making), None, job.session_id)

    def get(self, calibration_id: str) -> Calibration:
        """Calibration with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, calibration_id)

    def page(self, limit: int = 50, after: str | None = None) -> list[Calibration]:
        """Calibrations, the newest first; ``after`` is the last id of the page before."""
        query = newest_first(_select().where(self._access.may_reach(calibrations)), calibrations, limit, after)
        with self._access.reading() as connection:
            return [read(Calibration, row) for row in connection.execute(query)]

    def rename(self, calibration_id: str, name: str) -> Calibration:
        """Give a calibration another name; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            row = self._row(connection, calibration_id)
            changed = connection.execute(
                update(calibrations).where(calibrations.c.id == row.id, calibrations.c.name != name).values(name=name)
            )
            if changed.rowcount == 1:
                record_event(connection, self._access.actor, row.tenant, AuditAction.CALIBRATION_RENAMED, row.id)
            return self._read(connection, calibration_id)

    def delete(self, calibration_id: str) -> None:
        """Delete a calibration, the job that made it, and the session that was sent for it alone.

        Sessions that use the calibration keep a copy. Raises ``NotFound``, or ``Conflict`` if the calibration is being
        made, or another job works on the session.
        """
        with self._access.writing() as connection:
            row = self._row(connection, calibration_id)
            at_work = select(jobs.c.id).where(
                jobs.c.state.not_in(FINISHED), (jobs.c.id == row.id) | jobs.c.session_id.in_(_own_session(row))
            )
            if connection.execute(at_work.limit(1)).first() is not None:
                raise Conflict("The calibration is being made; cancel its job first.")
            for session_id in connection.scalars(_own_session(row)).all():
                for job_id in connection.scalars(select(jobs.c.id).where(jobs.c.session_id == session_id)).all():
                    remove_later(connection, job_prefix(job_id))
                remove_later(connection, session_prefix(session_id))
                connection.execute(delete(sessions).where(sessions.c.id == session_id))
            if row.method != "file":
                remove_later(connection, job_prefix(row.id))
                connection.execute(delete(jobs).where(jobs.c.id == row.id))
            forget_answers(connection, row.tenant, row.id)
            record_event(connection, self._access.actor, row.tenant, AuditAction.CALIBRATION_DELETED, row.id)
            connection.execute(delete(calibrations).where(calibrations.c.id == row.id))

    def _insert(
        self,
        calibration_id: str,
        name: str,
        method: str,
        source: Mapping[str, Any],
        text: str | None,
        session_id: str | None = None,
        report: Mapping[str, Any] | None = None,
    ) -> Calibration:
        access = self._access
        num_bytes = _num_bytes(text, report)
        with access.writing() as connection:
            access.require_room(connection, stored_bytes=num_bytes)
            connection.execute(
                insert(calibrations).values(
                    id=calibration_id,
                    tenant=access.owner,
                    name=name,
                    method=method,
                    created_at=now(),
                    source=dict(source),
                    text=text,
                    report=None if report is None else dict(report),
                    num_bytes=num_bytes,
                    session_id=session_id,
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.CALIBRATION_CREATED, calibration_id)
            return self._read(connection, calibration_id)

    def _read(self, connection: Connection, calibration_id: str) -> Calibration:
        return read(Calibration, self._row(connection, calibration_id))

    def _row(self, connection: Connection, calibration_id: str) -> Row[Any]:
        query = _select().where(calibrations.c.id == calibration_id, self._access.may_reach(calibrations))
        return existing(connection.execute(query).one_or_none(), "calibration")


def complete(connection: Connection, job_id: str, made: MadeCalibration) -> None:
    """Store the calibration that a job has made, in the transaction that ends the job."""
    values = {"text": made.text, "report": dict(made.report)}
    chosen = update(calibrations).where(calibrations.c.id == job_id)
    connection.execute(chosen.values(**values, num_bytes=_num_bytes(made.text, made.report)))


def forget_unmade(connection: Connection, job_id: str) -> None:
    """Delete the calibration that a job was to make, and has not, in the transaction that deletes the job."""
    connection.execute(delete(calibrations).where(calibrations.c.id == job_id, calibrations.c.text.is_(None)))


def _num_bytes(text: str | None, report: Mapping[str, Any] | None) -> int:
    return len((text or "").encode()) + (0 if report is None else len(json.dumps(report)))


def _select() -> Select[Any]:
    """Query of calibrations with the states and problems of their jobs."""
    return select(calibrations, jobs.c.state.label("job_state"), jobs.c.problem).outerjoin(
        jobs, jobs.c.id == calibrations.c.id
    )


def _own_session(row: Row[Any]) -> Select[Any]:
    """Query of the id of the session that was sent for a calibration alone."""
    return select(sessions.c.id).where(sessions.c.id == row.session_id, sessions.c.purpose == "calibration")
