"""Removal of files that are not needed any more."""

import structlog

from worker.store.files.artifacts import ArtifactStore
from worker.store.outages import outage_of
from worker.store.repositories.work.removals import Removals

log = structlog.get_logger()


def remove_files(removals: Removals, artifacts: ArtifactStore) -> None:
    """Remove the files of all due removals. A removal that fails stays due, and is logged; an outage ends all."""
    for removal in removals.due():
        try:
            if removal.prefix.endswith("/"):
                artifacts.delete_prefix(removal.prefix)
            else:
                artifacts.delete(removal.prefix)
        except OSError as error:
            if outage_of(error) is not None:
                log.warning("removals_wait", outage=outage_of(error))
                return  # of hundreds of removals, each would wait for the store
            log.exception("removal_failed", prefix=removal.prefix)
        else:
            removals.done(removal.id)
