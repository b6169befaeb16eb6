"""``python -m worker [--workers N]``: run Celery's worker with N processes."""

import argparse
import signal
import sys

import structlog

from pipeline.core.runtime.resources import collect_seldom, raise_descriptor_limit
from pipeline.detection.providers.find import current_provider
from pipeline.run.engine.code import stage_codes
from worker.run import tasks
from worker.run.app import create_celery
from worker.run.logs import configure_logs
from worker.run.presence import compile_kernels
from worker.run.settings import WorkerSettings, read_settings, require_usable_database
from worker.store.files.disk import keep_files_private
from worker.store.queue import Queue
from worker.store.store import JobStore


def main() -> None:
    """Work until SIGTERM."""
    collect_seldom()
    keep_files_private()
    raise_descriptor_limit()
    parser = argparse.ArgumentParser(prog=f"python -m {__package__}", description="Work on jobs.")
    parser.add_argument("--workers", type=int, default=1, help="Number of worker processes; each works on one chunk.")
    workers = parser.parse_args().workers
    settings = read_settings(WorkerSettings)
    configure_logs(settings.log_level)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # until Celery sets its own handler
    store = JobStore(settings.resolved_database_url)
    require_usable_database(store)
    compile_kernels(store)
    store.close()
    tasks.report_loading()
    # Both are found once, for all forked children.
    stage_codes()
    provider = current_provider()
    if provider.note:
        structlog.get_logger().warning("provider_fallback", reason=provider.note)
    celery = create_celery(settings)
    celery.worker_main(
        [
            "--quiet",
            "worker",
            "--concurrency",
            str(workers),
            "--queues",
            ",".join((Queue.ALL, Queue.GPU if provider.is_gpu else Queue.CPU)),
            "--without-gossip",
            "--without-mingle",
            "--loglevel",
            "WARNING",
        ]
    )


if __name__ == "__main__":
    main()
