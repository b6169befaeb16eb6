"""``python -m worker.run.health``: exit with 0 if a worker process of this machine reports to the database, else 1.

It is the health check of a worker's container or pod.
"""

import contextlib
import socket
import sys

from sqlalchemy.exc import SQLAlchemyError

from worker.run.settings import WorkerSettings, read_settings
from worker.store.store import JobStore


def main() -> None:
    """Look for a row of this machine in the list of workers."""
    settings = read_settings(WorkerSettings)
    with contextlib.closing(JobStore(settings.resolved_database_url)) as store:
        try:
            hosts = {worker.id.rpartition(":")[0] for worker in store.workers.all()}
        except SQLAlchemyError as error:
            sys.exit(f"error: The database does not respond ({type(error).__name__}).")
    if socket.gethostname() not in hosts:
        sys.exit("error: No worker process of this machine reports to the database.")


if __name__ == "__main__":
    main()
