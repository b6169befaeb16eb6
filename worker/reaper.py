"""``python -m worker.reaper``: make good what was lost.

Frees the leases of workers that fell silent, ends what keeps failing, and publishes when work is ready that no message
may stand for any more. So a lost message, or a broker that lost all of them, costs a few seconds. Removes results whose
time is over, and files of what was deleted that are still there. Sends webhooks.
"""

import contextlib
import signal
import threading
import time
from collections.abc import Callable

import structlog

from worker.jobs.artifacts import ArtifactStore
from worker.jobs.queue import WorkQueue
from worker.jobs.removals import remove_files
from worker.jobs.store import JobStore
from worker.logs import configure_logs
from worker.settings import WorkerSettings, read_settings
from worker.webhooks import Sender, deliver_forever

log = structlog.get_logger()


def reap(store: JobStore, artifacts: ArtifactStore, publish: Callable[[], object], lease_s: float) -> None:
    """Look once; what can't be done now, such as with a database that is away, is tried again the next time."""
    try:
        if store.reap(lease_s):
            publish()
        for job_id in store.expire():
            log.info("job_expired", job=job_id)
        remove_files(store, artifacts)
    except Exception:
        log.exception("reap_failed")


def main() -> None:
    """Reap until SIGTERM or SIGINT."""
    configure_logs()
    settings = read_settings(WorkerSettings)
    store, queue = JobStore(settings.resolved_database_url), WorkQueue(settings.broker_url)
    artifacts = settings.open_artifacts()
    # Beside the rest: whom a webhook goes to may be slow.
    threading.Thread(target=deliver_forever, args=[store, Sender(settings.webhook_private)], daemon=True).start()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(settings.reap_interval_s)
            reap(store, artifacts, queue.publish, settings.lease_s)


if __name__ == "__main__":
    main()
