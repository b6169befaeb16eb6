"""Jobs that kill their workers again and again delay another tenant's jobs by a bounded factor.

Each turn runs three small jobs of one tenant behind four jobs of another tenant of which each chunk kills its worker
process. Their times are compared with the mean of the same three jobs alone, before and after. Broker, workers and
reaper are those of ``multicap serve``, with one worker more than there are processors. ``MULTICAP_LOAD_TURNS`` is the
number of turns, ``MULTICAP_LOAD_TAKE_S`` the length of the small jobs' takes. The report is one JSON object a turn.
"""

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.preflight import report
from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase
from pipeline.core.data.cameras import Timebase
from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.validation.simulation.scenes import find_scene, record
from tests.load.poisoned_worker import POISON
from tests.records import encode_record
from tests.waiting import wait_for
from worker.run import embedded
from worker.run.planning import plan_job
from worker.run.supervisor import Supervisor
from worker.store.database.totals import Total
from worker.store.errors import Conflict
from worker.store.files.artifacts import LocalArtifacts
from worker.store.files.file_keys import record_key
from worker.store.model.rights import Scope
from worker.store.model.session_records import InputFile
from worker.store.model.states import FINISHED, JobState
from worker.store.model.work import WorkerState
from worker.store.queue import WorkQueue
from worker.store.spec import JobSpec
from worker.store.store import JobStore

pytestmark = pytest.mark.load

ROOT = Path(__file__).parents[2]
TURNS = int(os.environ.get("MULTICAP_LOAD_TURNS", "5"))
NUM_WORKERS = (os.cpu_count() or 1) + 1
NUM_SMALL, NUM_POISON = 3, 4
TAKE_S = float(os.environ.get("MULTICAP_LOAD_TAKE_S", "6"))
# Time from the poison to the small jobs: they meet its first tries, lost leases, and later tries.
DELAYS_S = (0.0, 6.0, 12.0, 24.0, 36.0)
MAX_RATIO = 2.5
END_S = 900.0
CAMERAS = ("left", "right", "front", "back")


@dataclass(frozen=True)
class PoisonBench:
    """Running service without its API, and the take of the small jobs."""

    store: JobStore
    artifacts: LocalArtifacts
    queue: WorkQueue
    take: KeypointSession

    def add_small(self) -> list[str]:
        """Queue the small jobs, each of a session of its own: no work is found again. Returns their ids."""
        content = encode_record(self.take)
        names = [f"{camera.name}.zip" for camera in self.take.cameras]
        preflight = report(self.take, [[name] for name in names], None)
        digest = hashlib.sha256(content).hexdigest()
        records = self.store.tenant("careful")
        ids = []
        for _ in range(NUM_SMALL):
            session_id = records.sessions.reserve_id()
            self.artifacts.put_bytes(record_key(session_id), content)
            files = [InputFile(name, "keypoints", f"sessions/{session_id}/{name}", 1, "0" * 64) for name in names]
            added = records.sessions.add("take", files, preflight, session_id, record_sha256=digest)
            ids.append(records.jobs.add(session_id, JobSpec(), plan_job(added, JobSpec())).id)
        self.queue.publish()
        return ids

    def add_poison(self) -> list[str]:
        """Queue jobs of videos without a reader: the chunk of each camera kills its worker."""
        preflight = Preflight(
            cameras=tuple(PreflightCamera(name, f"{name}.mp4", (640, 480), 25.0, 500) for name in CAMERAS),
            timebase=PreflightTimebase(0.0, 25.0, 500),
            stretches=(range(500),),
        )
        records = self.store.tenant("careless")
        ids = []
        for _ in range(NUM_POISON):
            session_id = records.sessions.reserve_id()
            files = [
                InputFile(f"{name}.mp4", "video", f"sessions/{session_id}/{name}", 1, "0" * 64) for name in CAMERAS
            ]
            added = records.sessions.add(POISON, files, preflight, session_id)
            ids.append(records.jobs.add(session_id, JobSpec(), plan_job(added, JobSpec())).id)
        self.queue.publish()
        return ids

    def wait_until_idle(self) -> None:
        """Wait until all workers are ready and nothing runs."""
        wait_for(lambda: not self.store.figures().chunks, END_S)
        ready = (WorkerState.READY,) * NUM_WORKERS
        wait_for(lambda: tuple(worker.state for worker in self.store.workers.all()) == ready, END_S)

    def seconds(self, job_ids: list[str]) -> list[float]:
        """Time from the queue to the end of each job; all have succeeded."""
        wait_for(lambda: all(self.store.jobs.get(job_id).state in FINISHED for job_id in job_ids), END_S)
        jobs = [self.store.jobs.get(job_id) for job_id in job_ids]
        assert {job.state for job in jobs} == {JobState.SUCCEEDED}
        return [(job.finished_at - job.created_at).total_seconds() for job in jobs if job.finished_at is not None]

    def num_lost(self) -> float:
        """Leases that were lost so far."""
        return sum(value for (name, _), value in self.store.figures().totals.items() if name == Total.LEASES_LOST)


@contextlib.contextmanager
def running(data_dir: Path) -> Iterator[PoisonBench]:
    """Run broker, workers and reaper of a data folder during the block, as `multicap serve` does."""
    take = record(replace(find_scene("room"), duration_s=TAKE_S), 3, 4)
    timebase = Timebase(0.0, take.timebase.frame_rate_hz, take.timebase.num_frames)
    session = KeypointSession(take.cameras, take.times, timebase, take.detections, take.joints, {}, ())
    command = tied_to_parent([sys.executable, "-P", __file__, str(data_dir)])
    environment = {"PYTHONPATH": str(ROOT), "MULTICAP_LOG_LEVEL": "warning", "MULTICAP_NICE": "0"}
    data_dir.mkdir(exist_ok=True)
    store = JobStore(f"sqlite:///{data_dir / 'multicap.db'}")
    store.migrate()
    for tenant in ("careful", "careless"):
        store.keys.add(tenant, "load", {Scope.WRITE})
    queue = WorkQueue(embedded.DataDirectory(data_dir, data_dir / "broker" / "socket").broker_url)
    bench = PoisonBench(store, LocalArtifacts(data_dir / "artifacts"), queue, session)
    with contextlib.ExitStack() as stack:
        stack.callback(store.close)
        stack.callback(queue.close)
        process = stack.enter_context(subprocess.Popen(command, env={**os.environ, **environment}))
        stack.callback(process.terminate)
        bench.wait_until_idle()
        yield bench


def test_jobs_killing_workers_delay_others_by_bounded_factor(tmp_path: Path) -> None:
    ratios = []
    with running(tmp_path / "data") as bench:
        bench.seconds(bench.add_small())  # the workers have loaded what the jobs need
        before_s = bench.seconds(bench.add_small())
        for turn in range(TURNS):
            lost = bench.num_lost()
            poison = bench.add_poison()
            time.sleep(DELAYS_S[turn % len(DELAYS_S)])
            beside_s = bench.seconds(bench.add_small())
            lost = bench.num_lost() - lost
            for job_id in poison:
                with contextlib.suppress(Conflict):  # it has failed
                    bench.store.jobs.cancel(job_id)
            bench.wait_until_idle()
            after_s = bench.seconds(bench.add_small())
            alone_s = [fmean(pair) for pair in zip(before_s, after_s, strict=True)]
            of_turn = [beside / alone for beside, alone in zip(beside_s, alone_s, strict=True)]
            shown = {
                "delay_s": DELAYS_S[turn % len(DELAYS_S)],
                "before_s": [round(seconds, 1) for seconds in before_s],
                "beside_s": [round(seconds, 1) for seconds in beside_s],
                "after_s": [round(seconds, 1) for seconds in after_s],
                "ratios": [round(ratio, 2) for ratio in of_turn],
                "lost_leases": lost,
            }
            print(json.dumps(shown), flush=True)  # noqa: T201
            ratios += of_turn
            before_s = after_s
    assert max(ratios) <= MAX_RATIO


def serve(data_dir: Path) -> None:
    """Run the programs of the service but its API, with workers that poison kills."""
    with embedded.lock(data_dir) as directory:
        worker = embedded.worker(directory, NUM_WORKERS)
        here = [sys.executable, "-P", "-m", "tests.load.poisoned_worker", "--workers", str(NUM_WORKERS)]
        programs = [embedded.broker(directory), replace(worker, command=here), embedded.reaper(directory)]
        Supervisor(programs, directory.logs_dir, lambda sentence: print(sentence, file=sys.stderr)).run()  # noqa: T201


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
