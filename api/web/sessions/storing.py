"""Sessions that were checked: their files go to the artifact store, and their rows to the database."""

import contextlib
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import UUID

from uuid_utils import uuid7

from api.web.dependencies import Services
from api.web.http.bodies import form_kinds
from api.web.http.bodies.form import Form
from api.web.jobs.queueing import queued_job
from api.web.sessions.manifest import Manifest
from api.web.settings import Settings
from api.web.uploads.intake import source_name
from pipeline.capture.preflight_record import Preflight, thumbnail_name
from worker.store.files.file_keys import input_key, record_key, session_prefix, thumbnail_key
from worker.store.model.job_records import JobRecord
from worker.store.model.session_records import InputFile, Purpose, Session
from worker.store.outages import undo_on_failure
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

# Kinds of files that differ from the name of the form's part.
_KINDS = {form_kinds.VIDEOS: "video", form_kinds.INTRINSICS: form_kinds.CALIBRATION}

# Ranges of frames of a take, and the fewest frames of one: each chunk decodes from the keyframe before it.
_MIN_RANGES, _MIN_CHUNK_FRAMES = 4, 25


@dataclass(frozen=True, slots=True)
class CheckedSession:
    """A session without errors whose files are not in the artifact store yet."""

    form: Form
    manifest: Manifest
    spec: JobSpec
    preflight: Preflight
    record_path: Path  # File that the preflight wrote for the workers
    upload_ids: tuple[str, ...]
    thumbnails: Path | None = None  # Folder with the thumbnails that the preflight wrote
    # Names of uploads and URLs, if some files are fetched: then the form's files are empty, and not checked
    awaited: form_kinds.UploadedFootage | None = None


@dataclass(frozen=True, slots=True)
class NewSession:
    """A session that is in the artifact store and not in the database yet.

    ``arrival`` is the request of a session whose videos are fetched, and ``fetches`` are the arguments of their
    uploads: see ``Uploads.add``.
    """

    id: str
    name: str
    files: tuple[InputFile, ...]
    preflight: Preflight
    upload_ids: tuple[str, ...]
    metadata: Mapping[str, Any]
    record_sha256: str
    chunk_frames: int
    arrival: Mapping[str, Any] | None = None
    fetches: tuple[tuple[Any, ...], ...] = field(default=(), repr=False)

    def add_to(self, work: TenantRecords, purpose: Purpose = "capture") -> Session:
        """Record the session, and that its uploads are used or reserved, in an open transaction."""
        if self.arrival is None:
            work.uploads.use(self.upload_ids)
        session = work.sessions.add(
            self.name,
            self.files,
            self.preflight,
            self.id,
            self.metadata,
            self.record_sha256,
            purpose,
            self.chunk_frames,
            self.arrival,
        )
        if self.arrival is not None:
            for fetch in self.fetches:
                work.uploads.add(*fetch)
            work.arrivals.reserve(self.id, self.upload_ids)
        return session


def new_session(services: Services, checked: CheckedSession, session_id: str | None = None) -> NewSession:
    """Name the files of a session in the artifact store, before they are there; ``None``: the session gets an id."""
    session_id = session_id or services.store.sessions.reserve_id()
    if checked.awaited is not None:
        return _awaiting(services, checked, checked.awaited, session_id)
    sources = [(part, file) for part, files in checked.form.files.items() for file in files]
    with checked.record_path.open("rb") as content:
        record_sha256 = hashlib.file_digest(content, "sha256").hexdigest()
    return NewSession(
        id=session_id,
        name=checked.manifest.name,
        files=tuple(
            InputFile(
                name=file.name,
                kind=_KINDS.get(part, part),
                key=input_key(session_id, index, file.name),
                num_bytes=file.num_bytes,
                sha256=file.sha256,
            )
            for index, (part, file) in enumerate(sources)
        ),
        preflight=checked.preflight,
        upload_ids=checked.upload_ids,
        metadata=checked.manifest.metadata,
        record_sha256=record_sha256,
        chunk_frames=_chunk_frames(services.settings, checked.preflight.timebase.num_frames),
    )


def _awaiting(
    services: Services, checked: CheckedSession, names: form_kinds.UploadedFootage, session_id: str
) -> NewSession:
    """Session whose videos are fetched."""
    fetches, videos = [], list(names.videos)
    for index, url in enumerate(names.videos):
        if isinstance(url, str):
            upload_id, keep_s = str(uuid7()), services.settings.upload_keep_s
            fetches.append((upload_id, source_name(url), 0, "", keep_s, services.uploads.name, url))
            videos[index] = UUID(upload_id)
    body = names.model_copy(update={"videos": tuple(videos)})
    return NewSession(
        id=session_id,
        name=checked.manifest.name,
        files=(),
        preflight=checked.preflight,
        upload_ids=body.upload_ids(),
        metadata=checked.manifest.metadata,
        record_sha256="",
        chunk_frames=0,
        # The spec is the job's, which waits for the session.
        arrival=body.model_dump(mode="json", exclude_unset=True, exclude={form_kinds.SPEC}),
        fetches=tuple(fetches),
    )


def _chunk_frames(settings: Settings, num_frames: int) -> int:
    """Frames of a camera in a chunk: fewer of a short take, so that its first people are there before its last."""
    return min(settings.chunk_frames, max(_MIN_CHUNK_FRAMES, -(-num_frames // _MIN_RANGES)))


@contextlib.contextmanager
def stored(services: Services, checked: CheckedSession, new: NewSession | None = None) -> Iterator[NewSession]:
    """Put the files of a session into the artifact store; the block records the session in the database.

    Files that are fetched are put there later. If the block fails, the files are removed; else the files of its
    uploads are. The reaper removes the files of a process that is killed in between, and of a transaction whose answer
    was lost, if it was not committed.
    """
    new = new or new_session(services, checked)
    with undo_on_failure() as undo:
        for upload_id, *_ in new.fetches:
            undo.callback(services.uploads.remove, upload_id)
            services.uploads.create(0, upload_id)
        if new.arrival is None:
            undo.callback(services.artifacts.delete_prefix, session_prefix(new.id))
            put_files(services, checked, new)
        yield new
    for upload_id in checked.upload_ids if new.arrival is None else ():
        services.uploads.remove(upload_id)


def put_files(services: Services, checked: CheckedSession, new: NewSession) -> None:
    """Put the files of a session into the artifact store."""
    sources = [file for files in checked.form.files.values() for file in files]
    for file, source in zip(new.files, sources, strict=True):
        services.artifacts.put_file(file.key, source.path)
    services.artifacts.put_file(record_key(new.id), checked.record_path)
    if checked.thumbnails is not None:
        for camera, number, _ in checked.preflight.thumbnails():
            name = thumbnail_name(camera, number)
            services.artifacts.put_file(thumbnail_key(new.id, name), checked.thumbnails / name)


@contextlib.contextmanager
def session_and_job(
    services: Services, records: TenantRecords, checked: CheckedSession
) -> Iterator[tuple[TenantRecords, JobRecord]]:
    """Store the files of a session and record it with its job; both or neither.

    The block gets the open transaction and the job. A worker is woken after it.
    """
    new = new_session(services, checked)
    files = stored(services, checked, new)
    with queued_job(services, records, new, checked.spec, files, new.add_to) as (work, job):
        yield work, job
