"""``python -m worker [--workers N]``: Celery's worker with as many processes."""

import argparse

from worker.app import create_celery
from worker.settings import WorkerSettings, read_settings


def main() -> None:
    """Work until SIGTERM."""
    parser = argparse.ArgumentParser(prog="python -m worker", description="Work on jobs.")
    parser.add_argument("--workers", type=int, default=1, help="Chunks worked on at once, a process each.")
    workers = parser.parse_args().workers
    celery = create_celery(read_settings(WorkerSettings))
    celery.worker_main(
        [
            "--quiet",
            "worker",
            "--concurrency",
            str(workers),
            "--without-gossip",
            "--without-mingle",
            "--loglevel",
            "WARNING",
        ]
    )


if __name__ == "__main__":
    main()
