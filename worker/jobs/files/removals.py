"""Removal of files that are not needed any more."""

import structlog

from worker.jobs.files.artifacts import ArtifactStore
from worker.jobs.repositories.work.removals import Removals

log = structlog.get_logger()


def remove_files(removals: Removals, artifacts: ArtifactStore) -> None:
    """Remove the files of all due removals. A removal that fails stays due, and is logged."""
    for removal in removals.due():
        try:
            artifacts.delete_prefix(removal.prefix)
        except OSError:
            log.exception("removal_failed", prefix=removal.prefix)
        else:
            removals.done(removal.id)
