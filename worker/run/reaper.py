"""``python -m worker.run.reaper``: repair what was lost, remove what has expired, and send webhooks.

The reaper frees the leases of workers that stopped responding, ends chunks that keep failing, and publishes a message
while work is ready: a lost message, or a broker that lost all messages, costs a few seconds. It removes expired
results, ended recordings, and the remaining files of deleted sessions. It deletes the videos of jobs that do not keep
them. It plans jobs again whose code no worker runs any more, and queues overlay videos and reports of jobs whose edits
rest.
"""

import contextlib
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial

import structlog

from pipeline.core.runtime.resources import raise_descriptor_limit
from pipeline.run.engine.code import stage_codes
from worker.run.logs import configure_logs
from worker.run.planning import plan_again, plan_visuals
from worker.run.problems import waiting_for
from worker.run.settings import WorkerSettings, read_settings, require_usable_database
from worker.run.webhooks.sender import Sender, deliver_forever
from worker.store.errors import Conflict, DamagedDatabase, NotFound
from worker.store.files.artifacts import ArtifactStore
from worker.store.files.disk import DiskSpace, keep_files_private
from worker.store.outages import Outage, find_outage
from worker.store.queue import WorkQueue
from worker.store.repositories.work.expiry import orphaned_prefixes, remove_files
from worker.store.store import JobStore

log = structlog.get_logger()

# Time between two looks for files without a row.
_ORPHANS_EVERY_S = 6 * 3600.0


class Reaper:
    """Steps that repair and remove.

    ``store``, ``artifacts``, ``disk``: where the work is, its files, and the disk that they share with the database.
    ``publish``: wakes a worker; ``False`` if the broker does not respond. ``lease_s``: see ``WorkerSettings``.
    ``visuals_rest_s``: time after the last edit of a job's people at which its visuals are rebuilt; 0: never.
    """

    def __init__(
        self,
        store: JobStore,
        artifacts: ArtifactStore,
        disk: DiskSpace,
        publish: Callable[[], bool],
        lease_s: float,
        visuals_rest_s: float = 0.0,
    ) -> None:
        self._store, self._artifacts, self._disk, self._publish = store, artifacts, disk, publish
        self._lease_s, self._visuals_rest_s = lease_s, visuals_rest_s
        # After an outage of the database, workers have the time of a lease to renew theirs.
        self._leases_kept_until_s = -math.inf
        self._is_database_away = False
        self._orphans_due_s = -math.inf
        self._is_broker_away = True  # a reaper before this one may have let jobs wait

    def reap(self) -> None:
        """Run all steps once. A step that fails, for example because the database does not respond, is logged.

        Raises ``DamagedDatabase`` if SQLite can't read its file.
        """
        # Each step runs even if another fails: on a full disk the last step makes space for the others.
        steps = self._free_leases, self._plan_again, self._queue_visuals, self._expire, self._delete_videos
        for step in (*steps, self._remove, self._look_for_orphans):
            try:
                step()
            except DamagedDatabase:
                raise
            except Exception as error:
                if find_outage(error) is Outage.DATABASE:
                    if not self._is_database_away:  # logged once
                        log.warning("reap_failed", step=step.__name__, reason=type(error).__name__)
                    self._is_database_away = True
                    return
                log.exception("reap_failed", step=step.__name__)

    def _free_leases(self) -> None:
        takes = not self._is_database_away and time.monotonic() >= self._leases_kept_until_s
        is_ready = self._store.leases.reap(self._lease_s, takes)
        if self._is_database_away:  # until now
            self._is_database_away = False
            self._leases_kept_until_s = time.monotonic() + self._lease_s
        if is_ready:
            self._wake()

    def _wake(self) -> None:
        """Wake a worker; jobs with ready chunks wait for the broker while it does not respond."""
        if not self._publish():
            self._is_broker_away = True
            self._store.waits.begin_broker_outage(waiting_for(Outage.BROKER))
        elif self._is_broker_away:
            self._store.waits.end_broker_outage()
            self._is_broker_away = False

    def _plan_again(self) -> None:
        # Asked first: after an outage of the database workers are listed again one after another.
        provider = self._store.workers.provider()
        if not self._store.plans.is_run(stage_codes(provider).values()):
            return  # workers of this version may start later
        for job_id in self._store.plans.unclaimable():
            job = self._store.jobs.get(job_id)
            session = self._store.sessions.get(job.session_id)
            stages = plan_again(session, job, provider)
            if self._store.plans.replace(job_id, stages):
                log.info("job_planned_again", job=job_id)
                self._publish()

    def _queue_visuals(self) -> None:
        if self._visuals_rest_s <= 0 or not self._disk.has_room():
            return
        for job_id in self._store.visuals.due(self._visuals_rest_s):
            job = self._store.jobs.get(job_id)
            making, stages = plan_visuals(self._store.sessions.get(job.session_id), job)
            with contextlib.suppress(Conflict, NotFound):  # it was edited or deleted since
                self._store.visuals.add(job_id, making, stages, job.revision)
                log.info("visuals_queued", job=job_id)
                self._publish()

    def _expire(self) -> None:
        for job_id in self._disk.using_reserve(self._store.removals.expire_jobs):
            log.info("job_expired", job=job_id)
        for recording_id in self._disk.using_reserve(self._store.recordings.expire):
            log.info("recording_expired", recording=recording_id)

    def _delete_videos(self) -> None:
        for session_id in self._store.sessions.with_superfluous_videos():
            with contextlib.suppress(Conflict, NotFound):  # it got a job or was deleted since
                self._disk.using_reserve(partial(self._store.sessions.delete_videos, session_id))
                log.info("videos_deleted", session=session_id)

    def _remove(self) -> None:
        self._disk.using_reserve(lambda: remove_files(self._store.removals, self._artifacts))

    def _look_for_orphans(self) -> None:
        if time.monotonic() < self._orphans_due_s:
            return
        self._orphans_due_s = time.monotonic() + _ORPHANS_EVERY_S
        if orphans := orphaned_prefixes(self._store.removals, self._artifacts):
            hint = "The database does not know them, as after a restore. `multicap doctor` lists and removes them."
            log.warning("orphaned_files", folders=len(orphans), hint=hint)


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
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    reaper = Reaper(store, artifacts, disk, queue.publish, settings.lease_s, settings.visuals_rest_s)
    exit_code = 0
    try:
        _wait_for_schema(store, settings.reap_interval_s)
        # A thread of its own, because receivers of webhooks may be slow.
        threading.Thread(target=deliver_forever, args=[store, Sender(settings.webhook_private)], daemon=True).start()
        while True:
            reaper.reap()
            time.sleep(settings.reap_interval_s)
    except KeyboardInterrupt:
        pass
    except DamagedDatabase as error:
        sys.stderr.write(f"error: {error}\n{error.instructions()}\n")
        sys.stderr.flush()
        exit_code = 1
    # End without waiting for webhooks that are being sent: they are sent again when their leases end.
    os._exit(exit_code)


def _wait_for_schema(store: JobStore, interval_s: float) -> None:
    """Wait until the database responds and an API process has made its tables: it may start later."""
    if store.ping():
        return
    log.info("waiting_for_database", hint="The API makes its tables when it starts.")
    while not store.ping():
        time.sleep(interval_s)


if __name__ == "__main__":
    main()
