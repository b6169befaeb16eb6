"""Removal of files that no row of the database needs: due removals, and orphans.

Orphans are files of sessions, jobs and characters that the database does not know, as after a restore of an older
backup.
"""

import time
import uuid

import structlog

from worker.store.files.artifacts import ArtifactStore
from worker.store.files.file_keys import character_prefix, job_prefix, session_prefix
from worker.store.outages import find_outage
from worker.store.repositories.work.expiry import Removals

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
