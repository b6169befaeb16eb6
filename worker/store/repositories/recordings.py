"""Recordings by phones, with their phones, takes and clips.

Each change counts the recording's revision up in its transaction: processes of the API poll the revisions of the
recordings that are open there.
"""

import contextlib
import secrets
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, Literal

from sqlalchemy import Connection, Row, Select, Table, delete, func, insert, select, update
from uuid_utils import uuid7

from worker.store.database.access import Repository, existing, newest_first
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.stored_files import forget_answers
from worker.store.database.tables import clips, phones, recordings, takes, uploads
from worker.store.errors import Conflict, NotFound, PhoneRemoved
from worker.store.model import phone_records
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.keys import digest
from worker.store.repositories.links import LINK_PREFIX, LINK_SECRET_BYTES

MAX_RECORDINGS = 100
"""Largest number of a tenant's recordings that have not ended."""
MAX_PARTS = 100
"""Largest number of parts of a clip."""

# Phones that were removed keep their numbers, so that they can't come back; so many times the phones of a recording.
_MAX_REMOVED = 4
_RECORDING = "recording, or it has ended"


class Recordings(Repository):
    """Recordings of a tenant, or of all tenants. A recording that has ended is treated as unknown."""

    def add(self, name: str, lifetime_s: float) -> tuple[phone_records.RecordingSession, str]:
        """Open a recording; returns it with the secret of its link, which can't be read again.

        Raises ``Conflict`` if the tenant has ``MAX_RECORDINGS`` already.
        """
        recording_id, access = str(uuid7()), self._access
        with access.writing() as connection:
            num_open = connection.scalar(select(func.count()).select_from(self._select().subquery())) or 0
            if num_open >= MAX_RECORDINGS:
                raise Conflict(f"There are {MAX_RECORDINGS} recordings already; delete some, or wait until they end.")
            secret, link = self._new_link()
            connection.execute(
                insert(recordings).values(
                    id=recording_id,
                    tenant=access.owner,
                    name=name,
                    created_at=now(),
                    expires_at=now() + lifetime_s,
                    **link,
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.RECORDING_CREATED, recording_id)
            return self._read(connection, recording_id), secret

    def get(self, recording_id: str) -> phone_records.RecordingSession:
        """Recording with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, recording_id)

    def page(self, limit: int = 50, after: str | None = None) -> list[phone_records.RecordingSession]:
        """Recordings, the newest first; ``after`` is the last id of the page before."""
        query = newest_first(self._select(), recordings, limit, after)
        with self._access.reading() as connection:
            return _read_recordings(connection, connection.execute(query))

    def delete(self, recording_id: str) -> None:
        """Delete a recording with the uploads of its phones that no session took; ``NotFound`` if there is none."""
        with self._locked(recording_id) as (connection, row):
            forget_answers(connection, row.tenant, recording_id)
            record_event(connection, self._access.actor, row.tenant, AuditAction.RECORDING_DELETED, recording_id)
            _delete(connection, [recording_id])

    def expire(self) -> list[str]:
        """Delete recordings that have ended, with the uploads that no session took; return their ids."""
        with self._access.writing() as connection:
            query = select(recordings.c.id).where(self._access.may_reach(recordings), recordings.c.expires_at <= now())
            ended = list(connection.scalars(query.with_for_update()))
            _delete(connection, ended)
            return ended

    def renew_link(self, recording_id: str) -> tuple[phone_records.RecordingSession, str]:
        """Make another link and end the one before; returns the recording and the secret, as ``add`` does."""
        with self._locked(recording_id) as (connection, row):
            secret, link = self._new_link()
            connection.execute(update(recordings).where(recordings.c.id == recording_id).values(**link))
            record_event(connection, self._access.actor, row.tenant, AuditAction.LINK_CREATED, link["join_id"])
            return self._changed(connection, recording_id), secret

    def revisions(self, recording_ids: Collection[str]) -> Mapping[str, int]:
        """Revisions of recordings among some that are there and have not ended."""
        query = self._select().where(recordings.c.id.in_(recording_ids))
        with self._access.reading() as connection:
            return {row.id: row.revision for row in connection.execute(query)}

    # Changes by the host.

    def start_take(
        self,
        recording_id: str,
        name: str | None,
        settings: Mapping[str, Any],
        start_s: float,
        limits: phone_records.RecordingLimits,
    ) -> phone_records.RecordingSession:
        """Begin a take that starts at a time by the service's clock.

        Raises ``Conflict`` if another take is being recorded, or there are as many as may be.
        """
        with self._locked(recording_id) as (connection, _):
            earlier = self._read(connection, recording_id).takes
            if any(take.state(start_s) is phone_records.TakeState.RECORDING for take in earlier):
                raise Conflict("A take is being recorded; stop it first.")
            if len(earlier) >= limits.takes:
                raise Conflict(f"A recording has {limits.takes} takes at most; open another one.")
            number = len(earlier) + 1
            connection.execute(
                insert(takes).values(
                    recording_id=recording_id,
                    number=number,
                    name=name or f"Take {number}",
                    start_s=start_s,
                    stop_s=start_s + limits.take_s,
                    is_stopped=False,
                    settings=dict(settings),
                    is_upload_wanted=False,
                    is_discarded=False,
                )
            )
            return self._changed(connection, recording_id)

    def stop_take(self, recording_id: str, stop_s: float) -> phone_records.RecordingSession:
        """Stop the take that is being recorded at a time; ``Conflict`` if there is none."""
        with self._locked(recording_id) as (connection, _):
            running = [
                take
                for take in self._read(connection, recording_id).takes
                if take.state(stop_s) is phone_records.TakeState.RECORDING
            ]
            if not running:
                raise Conflict("No take is being recorded.")
            take, stop_s = running[0], max(stop_s, running[0].start_s)
            return self._change(connection, takes, recording_id, take.number, stop_s=stop_s, is_stopped=True)

    def want_upload(self, recording_id: str, take: int) -> phone_records.RecordingSession:
        """Ask the phones for their clips of a take; ``Conflict`` if it was discarded."""
        with self._locked(recording_id) as (connection, _):
            self._require_take(connection, recording_id, take)
            return self._change(connection, takes, recording_id, take, is_upload_wanted=True)

    def discard_take(self, recording_id: str, take: int) -> phone_records.RecordingSession:
        """Throw a take away with its uploads; a session that was made from it stays."""
        with self._locked(recording_id) as (connection, _):
            found = self._require_take(connection, recording_id, take)
            uploaded = [file.upload_id for clip in found.clips for file in clip.files]
            connection.execute(delete(uploads).where(uploads.c.id.in_(uploaded)))
            return self._change(connection, takes, recording_id, take, is_discarded=True, is_stopped=True)

    def use_take(
        self,
        recording_id: str,
        take: int,
        session_id: str | None = None,
        job_id: str | None = None,
        calibration_id: str | None = None,
    ) -> phone_records.RecordingSession:
        """Record the session or the calibration that was made from a take, in the transaction that takes its uploads.

        A session may follow a calibration. Raises ``Conflict`` if the take was discarded, or made the same before.
        """
        with self._locked(recording_id) as (connection, _):
            found = self._require_take(connection, recording_id, take)
            if found.session_id is not None:
                raise Conflict("A capture was made from this take already.")
            if calibration_id is not None and found.calibration_id is not None:
                raise Conflict("A calibration was made from this take already.")
            made = {"session_id": session_id, "job_id": job_id, "calibration_id": calibration_id}
            values = {name: value for name, value in made.items() if value is not None}
            return self._change(connection, takes, recording_id, take, is_stopped=True, **values)

    def rename_phone(self, recording_id: str, phone: int, name: str) -> phone_records.RecordingSession:
        """Give a phone another name; ``Conflict`` if another phone has it."""
        with self._locked(recording_id) as (connection, _):
            present = self._read(connection, recording_id)
            if present.phone(phone) is None:
                raise NotFound("The recording has no such phone.")
            if any(other.name == name and other.number != phone for other in present.phones):
                raise Conflict("Another phone has this name.")
            return self._change(connection, phones, recording_id, phone, name=name)

    def remove_phone(self, recording_id: str, phone: int) -> phone_records.RecordingSession:
        """Remove a phone for good; its clips stay."""
        with self._locked(recording_id) as (connection, _):
            if self._read(connection, recording_id).phone(phone) is None:
                raise NotFound("The recording has no such phone.")
            return self._change(connection, phones, recording_id, phone, removed_at=now())

    # Changes by phones.

    def join(
        self, recording_id: str, phone_id: str, name: str | None, device: str, limits: phone_records.RecordingLimits
    ) -> phone_records.JoinedPhone:
        """Join a recording as a phone, or come back.

        ``phone_id``: secret that the phone's browser made, and keeps. ``name``: name that the phone proposes; if
        another phone has it, a number is added. Raises ``PhoneRemoved``. Raises ``Conflict``: there are as many phones
        as may be.
        """
        with self._locked(recording_id) as (connection, _):
            known = select(phones).where(phones.c.recording_id == recording_id, phones.c.sha256 == digest(phone_id))
            if (row := connection.execute(known).one_or_none()) is not None:
                if row.removed_at is not None:
                    raise PhoneRemoved
                return _joined(connection, self._read(connection, recording_id), row.number)
            present = self._read(connection, recording_id).phones
            num_there = sum(not phone.is_removed for phone in present)
            if num_there >= limits.phones or len(present) >= limits.phones * (1 + _MAX_REMOVED):
                raise Conflict(f"A recording has {limits.phones} phones at most; the host may remove one.")
            number = len(present) + 1
            connection.execute(
                insert(phones).values(
                    recording_id=recording_id,
                    number=number,
                    sha256=digest(phone_id),
                    name=_free_name(name or f"Phone {number}", {phone.name for phone in present}),
                    device=device,
                    joined_at=now(),
                )
            )
            return _joined(connection, self._changed(connection, recording_id), number)

    def phone_number(self, recording_id: str, phone_id: str) -> int:
        """Number of the phone with a secret; ``NotFound`` if there is none, or the host has removed it."""
        query = select(phones.c.number).where(
            phones.c.recording_id == recording_id, phones.c.sha256 == digest(phone_id), phones.c.removed_at.is_(None)
        )
        with self._access.reading() as connection:
            number: int | None = connection.scalar(query)
        if number is None:
            raise NotFound("The recording has no such phone.")
        return number

    def report_clip(
        self, recording_id: str, take: int, phone: int, event: Literal["started", "stopped"], facts: Mapping[str, Any]
    ) -> phone_records.RecordingSession:
        """Record what a phone says when it has begun or ended to record a take."""
        with self._locked(recording_id) as (connection, _):
            self._require_take(connection, recording_id, take)
            return self._write_clip(connection, recording_id, take, phone, {event: dict(facts)})

    def add_file(
        self, recording_id: str, take: int, phone: int, file: phone_records.ClipFile
    ) -> phone_records.RecordingSession:
        """Record a part of a clip whose upload is complete, in place of an earlier upload of the part.

        Raises ``NotFound`` if the upload is not the phone's, ``Conflict`` if the clip has ``MAX_PARTS`` already.
        """
        is_own = (uploads.c.id == file.upload_id, uploads.c.recording_id == recording_id, uploads.c.phone == phone)
        with self._locked(recording_id) as (connection, _):
            found = self._require_take(connection, recording_id, take, unused=True)
            if connection.execute(select(uploads.c.id).where(*is_own)).one_or_none() is None:
                raise NotFound("The phone has no such upload.")
            clip = found.clip(phone)
            files = {earlier.part: earlier for earlier in (clip.files if clip else ())} | {file.part: file}
            if len(files) > MAX_PARTS:
                raise Conflict(f"A clip has {MAX_PARTS} parts at most.")
            ordered = [asdict(files[part]) for part in sorted(files)]
            return self._write_clip(connection, recording_id, take, phone, {"files": ordered})

    def _new_link(self) -> tuple[str, dict[str, Any]]:
        secret = LINK_PREFIX + secrets.token_urlsafe(LINK_SECRET_BYTES)
        values = {"join_id": str(uuid7()), "join_sha256": digest(secret), "join_key_id": self._access.actor.key_id}
        return secret, values

    @contextlib.contextmanager
    def _locked(self, recording_id: str) -> Iterator[tuple[Connection, Row[Any]]]:
        """Transaction that changes a recording, and the recording's row, which is locked."""
        with self._access.writing() as connection:
            query = self._select().where(recordings.c.id == recording_id).with_for_update()
            yield connection, existing(connection.execute(query).one_or_none(), _RECORDING)

    def _select(self) -> Select[Any]:
        return select(recordings).where(self._access.may_reach(recordings), recordings.c.expires_at > now())

    def _read(self, connection: Connection, recording_id: str) -> phone_records.RecordingSession:
        rows = connection.execute(self._select().where(recordings.c.id == recording_id))
        return existing(next(iter(_read_recordings(connection, rows)), None), _RECORDING)

    def _changed(self, connection: Connection, recording_id: str) -> phone_records.RecordingSession:
        chosen = update(recordings).where(recordings.c.id == recording_id)
        connection.execute(chosen.values(revision=recordings.c.revision + 1))
        return self._read(connection, recording_id)

    def _require_take(
        self, connection: Connection, recording_id: str, number: int, *, unused: bool = False
    ) -> phone_records.RecordingTake:
        take = self._read(connection, recording_id).take(number)
        if take is None:
            raise NotFound("The recording has no such take.")
        if take.is_discarded:
            raise Conflict("The take was discarded.")
        if unused and take.is_used:
            raise Conflict("The clips of this take are in a capture already.")
        return take

    def _change(
        self, connection: Connection, table: Table, recording_id: str, number: int, **values: Any
    ) -> phone_records.RecordingSession:
        """Change the phone or the take with a number."""
        chosen = update(table).where(table.c.recording_id == recording_id, table.c.number == number)
        connection.execute(chosen.values(**values))
        return self._changed(connection, recording_id)

    def _write_clip(
        self, connection: Connection, recording_id: str, take: int, phone: int, values: Mapping[str, Any]
    ) -> phone_records.RecordingSession:
        is_clip = (clips.c.recording_id == recording_id, clips.c.take == take, clips.c.phone == phone)
        if connection.execute(update(clips).where(*is_clip).values(**values)).rowcount == 0:
            names = {"recording_id": recording_id, "take": take, "phone": phone}
            connection.execute(insert(clips).values(**{**names, "files": [], **values}))
        return self._changed(connection, recording_id)


def _joined(
    connection: Connection, recording: phone_records.RecordingSession, number: int
) -> phone_records.JoinedPhone:
    return phone_records.JoinedPhone(recording, number, connection.execute(select(now())).scalar_one())


def _free_name(name: str, taken: Collection[str]) -> str:
    """Name that no other phone has: with a number behind it if need be."""
    return next(
        other for other in (name, *(f"{name[:58]} {number}" for number in range(2, 10_000))) if other not in taken
    )


def _delete(connection: Connection, recording_ids: Collection[str]) -> None:
    """Delete recordings with unused uploads; the API removes their bytes when it finds no row."""
    connection.execute(delete(uploads).where(uploads.c.recording_id.in_(recording_ids)))
    connection.execute(delete(recordings).where(recordings.c.id.in_(recording_ids)))


def _read_recordings(connection: Connection, rows: Iterable[Row[Any]]) -> list[phone_records.RecordingSession]:
    found = list(rows)
    ids = [row.id for row in found]
    phones_by_id, takes_by_id = _rows_by_recording(connection, phones, ids), _rows_by_recording(connection, takes, ids)
    clips_by_take: defaultdict[tuple[str, int], list[phone_records.TakeClip]] = defaultdict(list)
    for row in connection.execute(select(clips).where(clips.c.recording_id.in_(ids)).order_by(clips.c.phone)):
        clips_by_take[row.recording_id, row.take].append(read(phone_records.TakeClip, row))
    return [
        read(
            phone_records.RecordingSession,
            row,
            phones=tuple(
                read(phone_records.RecordingPhone, phone, is_removed=bool(phone.removed_at))
                for phone in phones_by_id[row.id]
            ),
            takes=tuple(
                read(phone_records.RecordingTake, take, clips=tuple(clips_by_take[row.id, take.number]))
                for take in takes_by_id[row.id]
            ),
        )
        for row in found
    ]


def _rows_by_recording(connection: Connection, table: Table, ids: Collection[str]) -> Mapping[str, list[Row[Any]]]:
    rows = defaultdict[str, list[Row[Any]]](list)
    for row in connection.execute(select(table).where(table.c.recording_id.in_(ids)).order_by(table.c.number)):
        rows[row.recording_id].append(row)
    return rows
