"""``python -m worker.reaper``: repair what was lost, remove what has expired, and send webhooks.

The reaper frees the leases of workers that stopped responding, ends chunks that keep failing, and publishes a message
while work is ready: a lost message, or a broker that lost all messages, costs a few seconds. It removes expired results
and the remaining files of deleted sessions. It plans jobs again whose code no worker runs any more, and queues overlay
videos and reports of jobs whose edits rest.
"""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

import structlog

from pipeline.stages.code import stage_codes
from pipeline.stages.plan import DEFAULT_CHUNK_FRAMES
from worker.jobs.errors import Conflict, DamagedDatabase, NotFound
from worker.jobs.files.artifacts import ArtifactStore
from worker.jobs.files.disk import DiskSpace
from worker.jobs.files.private_files import keep_files_private
from worker.jobs.files.removals import remove_files
from worker.jobs.queue import WorkQueue
from worker.jobs.store import JobStore
from worker.planning import plan_job, plan_visuals
from worker.process.descriptors import raise_descriptor_limit
from worker.settings import WorkerSettings, read_settings, require_usable_database
from worker.telemetry.logs import configure_logs
from worker.webhooks.sender import Sender, deliver_forever

log = structlog.get_logger()


def reap(
    store: JobStore,
    artifacts: ArtifactStore,
    disk: DiskSpace,
    publish: Callable[[], object],
    lease_s: float,
    chunk_frames: int = DEFAULT_CHUNK_FRAMES,
    visuals_rest_s: float = 0.0,
) -> None:
    """Run all steps once. A step that fails, for example because the database does not respond, is logged.

    Parameters
    ----------
    visuals_rest_s
        Time after the last edit of a job's people at which its overlay videos and its report are made anew; 0: never.

    Raises
    ------
    DamagedDatabase
        If SQLite can't read its file.
    """

    def free_leases() -> None:
        if store.leases.reap(lease_s):
            publish()

    def plan_again() -> None:
        for job_id in store.plans.unclaimable():
            if not store.plans.is_run(stage_codes().values()):
                return  # workers of this version may start later
            job = store.jobs.get(job_id)
            session = store.sessions.get(job.session_id)
            stages = plan_job(
                session, job.spec, chunk_frames, making=job.making, edits=job.edits, revision=job.revision
            )
            if store.plans.replace(job_id, stages):
                log.info("job_planned_again", job=job_id)
                publish()

    def queue_visuals() -> None:
        for job_id in store.visuals.due(visuals_rest_s) if visuals_rest_s > 0 and disk.has_room() else ():
            job = store.jobs.get(job_id)
            stages = plan_visuals(store.sessions.get(job.session_id), job, chunk_frames)
            with contextlib.suppress(Conflict, NotFound):  # it was edited or deleted since
                store.visuals.add(job_id, stages, job.revision)
                log.info("visuals_queued", job=job_id)
                publish()

    def expire() -> None:
        for job_id in disk.using_reserve(store.removals.expire_jobs):
            log.info("job_expired", job=job_id)

    def remove() -> None:
        disk.using_reserve(lambda: remove_files(store.removals, artifacts))

    # Each step runs even if another fails: on a full disk the last step makes space for the others.
    for step in (free_leases, plan_again, queue_visuals, expire, remove):
        try:
            step()
        except DamagedDatabase:
            raise
        except Exception:
            log.exception("reap_failed", step=step.__name__)


def main() -> None:
    """Reap until SIGTERM or SIGINT."""
    keep_files_private()
    raise_descriptor_limit()
    settings = read_settings(WorkerSettings)
    configure_logs(settings.log_level)
    store, queue = JobStore(settings.resolved_database_url), WorkQueue(settings.broker_url)
    require_usable_database(store)
    artifacts = settings.open_artifacts()
    disk = DiskSpace(settings.data_dir, settings.headroom_bytes)
    # A thread of its own, because receivers of webhooks may be slow.
    threading.Thread(target=deliver_forever, args=[store, Sender(settings.webhook_private)], daemon=True).start()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    exit_code = 0
    try:
        while True:
            reap(
                store, artifacts, disk, queue.publish, settings.lease_s, settings.chunk_frames, settings.visuals_rest_s
            )
            time.sleep(settings.reap_interval_s)
    except KeyboardInterrupt:
        pass
    except DamagedDatabase as error:
        sys.stderr.write(f"error: {error}\n{error.instructions()}\n")
        sys.stderr.flush()
        exit_code = 1
    # End without waiting for webhooks that are being sent: they are sent again when their leases end.
    os._exit(exit_code)


if __name__ == "__main__":
    main()
