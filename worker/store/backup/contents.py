"""Contents of a backup: its manifest, the files that rows of the database name, and their problems."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict, TypeAdapter
from sqlalchemy import Connection, func, select

from pipeline.capture.preflight_record import Preflight, thumbnail_name
from worker.store.backup.archive import BackupError
from worker.store.database.tables import artifacts, characters, jobs, results, sessions, uploads
from worker.store.files.file_keys import record_key, require_key, stage_key, thumbnail_key
from worker.store.model.states import JobState

MANIFEST = "manifest.json"
DATABASE = "multicap.db"
PROBLEMS = "problems.json"

FORMAT = 1

_ROWS_AT_ONCE = 50  # a session's rows may have megabytes each


class RowCounts(BaseModel):
    """Numbers of rows of a database."""

    model_config = ConfigDict(frozen=True)

    sessions: int
    jobs: dict[str, int]  # by state
    uploads: int


class BackupManifest(BaseModel):
    """First member of a backup.

    ``schema_revision`` is the database's; ``artifacts_url`` names the bucket of artifacts that are not in the
    backup.
    """

    model_config = ConfigDict(frozen=True)

    format: int
    created_at: datetime
    multicap_version: str
    schema_revision: str
    artifacts_url: str
    rows: RowCounts
    files: int
    num_bytes: int  # of all files


class FileProblem(BaseModel):
    """A file that a backup lacks, or whose digest differs. The service works without files that are not ``needed``."""

    model_config = ConfigDict(frozen=True)

    path: str  # below the data folder
    problem: Literal["missing", "unreadable", "damaged"]
    needed: bool


FILE_PROBLEMS = TypeAdapter(tuple[FileProblem, ...])


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file that a row names, with its digest if the row has one."""

    path: str  # Below the data folder
    sha256: str | None
    needed: bool  # True if a session, a job, a result or a character is lost without it


@dataclass(frozen=True, slots=True)
class BackupReport:
    """Contents of a backup, and the files that it lacks."""

    manifest: BackupManifest
    archive_bytes: int
    problems: tuple[FileProblem, ...]
    faults: tuple[str, ...] = ()

    @property
    def lost(self) -> tuple[FileProblem, ...]:
        """Files that are needed."""
        return tuple(problem for problem in self.problems if problem.needed)


def read_manifest(content: bytes) -> BackupManifest:
    """Read a manifest; ``BackupError`` if this version can't read its backup."""
    try:
        manifest = BackupManifest.model_validate_json(content)
    except ValueError as error:
        raise BackupError("The archive's manifest can't be read: it is damaged, or no backup of Multicap.") from error
    if manifest.format != FORMAT:
        raise BackupError(
            f"The backup has format {manifest.format}, made by Multicap {manifest.multicap_version}; "
            f"this version reads format {FORMAT}. Use that version."
        )
    return manifest


def count_rows(connection: Connection) -> RowCounts:
    """Count the rows of a database."""
    by_state = connection.execute(select(jobs.c.state, func.count()).group_by(jobs.c.state)).all()
    return RowCounts(
        sessions=connection.scalar(select(func.count()).select_from(sessions)) or 0,
        jobs=dict(sorted((row[0], row[1]) for row in by_state)),
        uploads=connection.scalar(select(func.count()).select_from(uploads)) or 0,
    )


def named_files(connection: Connection, with_artifacts: bool) -> dict[str, StoredFile]:
    """Files that the rows of a database name, by path.

    ``with_artifacts``: artifacts are in the data folder; else only uploads are. Raises ``ValueError`` if a row names a
    file by a malformed key.
    """
    found = list(_upload_files(connection))
    if with_artifacts:
        found += [*_session_files(connection), *_output_files(connection), *_result_files(connection)]
        found += [*_character_files(connection), *_moved_character_files(connection)]
    return {file.path: file for file in found}


def _artifact(key: str, sha256: str | None, needed: bool) -> StoredFile:
    require_key(key)
    return StoredFile(f"artifacts/{key}", sha256, needed)


def _upload_files(connection: Connection) -> Iterator[StoredFile]:
    # The file of an upload may just have been moved to a session; the client then begins the upload again.
    for upload_id in connection.scalars(select(uploads.c.id).order_by(uploads.c.id)):
        require_key(upload_id)
        yield StoredFile(f"uploads/{upload_id}", None, needed=False)


def _session_files(connection: Connection) -> Iterator[StoredFile]:
    columns = (
        *(sessions.c.id, sessions.c.files, sessions.c.record_sha256, sessions.c.preflight),
        sessions.c.videos_deleted_at,
    )
    # Sessions whose videos are fetched, or can't be used, have no files yet.
    query = select(*columns).where(sessions.c.arrival.is_(None), sessions.c.errors.is_(None)).order_by(sessions.c.id)
    rows = connection.execute(query, execution_options={"yield_per": _ROWS_AT_ONCE})
    for session_id, files, record_sha256, preflight, videos_deleted_at in rows:
        for file in files:
            if videos_deleted_at is None or file["kind"] != "video":
                yield _artifact(file["key"], file["sha256"], needed=True)
        yield _artifact(record_key(session_id), record_sha256, needed=True)
        if videos_deleted_at is not None:
            continue
        for camera, number, thumbnail in Preflight.from_json(preflight).thumbnails():
            key = thumbnail_key(session_id, thumbnail_name(camera, number))
            yield _artifact(key, thumbnail.sha256, needed=False)


def _output_files(connection: Connection) -> Iterator[StoredFile]:
    """Outputs of chunks; workers compute missing and damaged ones again."""
    query = select(artifacts).order_by(artifacts.c.session_id, artifacts.c.output_key)
    for row in connection.execute(query, execution_options={"yield_per": _ROWS_AT_ONCE}):
        yield _artifact(stage_key(row.session_id, row.output_key), row.sha256, needed=False)


def _result_files(connection: Connection) -> Iterator[StoredFile]:
    query = (
        select(results.c.key, results.c.sha256)
        .join(jobs, jobs.c.id == results.c.job_id)
        .where(jobs.c.state != JobState.EXPIRED)
        .order_by(results.c.job_id, results.c.name)
    )
    for row in connection.execute(query, execution_options={"yield_per": _ROWS_AT_ONCE}):
        yield _artifact(row.key, row.sha256, needed=True)


def _character_files(connection: Connection) -> Iterator[StoredFile]:
    for file in connection.scalars(select(characters.c.file).order_by(characters.c.id)):
        yield _artifact(file["key"], file["sha256"], needed=True)


def _moved_character_files(connection: Connection) -> Iterator[StoredFile]:
    query = select(jobs.c.character).where(jobs.c.character.is_not(None), jobs.c.state != JobState.EXPIRED)
    for character in connection.scalars(query.order_by(jobs.c.id)):
        yield _artifact(character["file"]["key"], character["file"]["sha256"], needed=True)
