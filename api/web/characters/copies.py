"""Copies of characters for jobs: a job's files stay what they are when the character is changed or deleted."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from api.web.characters.intake import download_of
from api.web.dependencies import Services
from api.web.downloads import opened
from worker.store.errors import Conflict, NotFound
from worker.store.files.artifacts import job_character_key, job_prefix
from worker.store.model.characters import JobCharacter
from worker.store.outages import is_perhaps_recorded
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords


@contextlib.contextmanager
def copied_character(
    services: Services, records: TenantRecords, spec: JobSpec
) -> Iterator[tuple[str, JobCharacter] | None]:
    """Copy the character of a spec for a new job; the block records the job under the id.

    If the block fails, the copy is removed; the reaper removes that of a process that is killed in between. ``None``
    in the block: the spec has no character.

    Raises
    ------
    Conflict
        If the character was deleted meanwhile.
    ApiError
        If its file is missing or damaged, or there is no room on the disk.
    """
    if spec.character is None:
        yield None
        return
    try:
        character = records.characters.get(str(spec.character))
    except NotFound:
        raise Conflict("The character was deleted meanwhile.") from None
    services.disk.require_room(character.file.num_bytes)
    job_id = services.store.jobs.reserve_id()
    file = replace(character.file, key=job_character_key(job_id))
    with contextlib.ExitStack() as undo:
        undo.callback(services.artifacts.delete_prefix, job_prefix(job_id))
        services.settings.spool_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=services.settings.spool_dir) as folder:
            path = Path(folder) / "file"
            with opened(services, download_of(character)) as source, path.open("xb") as copy:
                shutil.copyfileobj(source, copy)
            services.artifacts.put_file(file.key, path)
        try:
            yield job_id, JobCharacter(character.id, file, character.corrections)
        except Exception as error:
            if is_perhaps_recorded(error):
                undo.pop_all()
            raise
        undo.pop_all()
