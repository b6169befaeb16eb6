"""``python -m worker.reaper``: make good what was lost.

Frees the leases of workers that fell silent, ends what keeps failing, and publishes when work is ready that no message
may stand for any more. So a lost message, or a broker that lost all of them, costs a few seconds. Removes results whose
time is over.
"""

import contextlib
import signal
import time
from collections.abc import Callable

import structlog

from worker.jobs.artifacts import ArtifactStore, LocalArtifacts
from worker.jobs.queue import WorkQueue
from worker.jobs.store import JobStore
from worker.logs import configure_logs
from worker.settings import WorkerSettings

log = structlog.get_logger()


def reap(store: JobStore, publish: Callable[[], object]) -> None:
    """Look once; a database that is away is tried again the next time."""
    try:
        if store.reap() > 0:
            publish()
    except Exception:
        log.exception("reap_failed")


def expire(store: JobStore, artifacts: ArtifactStore) -> None:
    """Remove results whose time is over. The files go first: whoever dies in between does it again."""
    try:
        for job_id, keys in store.due().items():
            for key in keys:
                artifacts.delete(key)
            if store.expire(job_id):
                log.info("job_expired", job=job_id, files=len(keys))
    except Exception:
        log.exception("expire_failed")


def main() -> None:
    """Reap until SIGTERM or SIGINT."""
    configure_logs()
    settings = WorkerSettings()
    store, queue = JobStore(settings.resolved_database_url), WorkQueue(settings.broker_url)
    artifacts = LocalArtifacts(settings.artifacts_dir)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(settings.reap_interval_s)
            reap(store, queue.publish)
            expire(store, artifacts)


if __name__ == "__main__":
    main()
