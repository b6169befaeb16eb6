"""Session in a real store, and small stages with known results."""

import hashlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import structlog

from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase
from pipeline.core.options.edits import PeopleEdit, PersonSpan, without_names
from pipeline.core.options.job_choices import BLURRED_KIND, OVERLAY_KIND, REPORT_KIND, RERUN_KIND, blurred_name
from pipeline.run.engine.code import stage_codes
from pipeline.run.engine.stage import (
    ASSOCIATE,
    BLUR,
    CHECK,
    DETECT,
    EDIT,
    EXPECT,
    EXPORT,
    FIT,
    HEADS,
    HOLD,
    IDENTIFY,
    LOOK,
    OVERLAY,
    RECORD,
    REDETECT,
    REFIT,
    REPORT,
    WRITE,
    Output,
    ResultFile,
)
from worker.run.chunk import Work
from worker.run.planning import plan_job, plan_remake, plan_visuals
from worker.run.runner import Runner
from worker.store.files.artifacts import LocalArtifacts
from worker.store.model.job_records import JobRecord
from worker.store.model.session_records import InputFile, Session
from worker.store.model.work import Ability, Remake
from worker.store.spec import JobSpec
from worker.store.store import JobStore

NUM_FRAMES, CHUNK_FRAMES = 40, 10

RESULT = b"squares: " + b",".join(str(k * k).encode() for k in range(NUM_FRAMES))

FOUND = (PersonSpan(1, 0, NUM_FRAMES), PersonSpan(2, 10, 20))


def look(work: Work) -> Output:
    work.on_unit()
    return Output(b"size")


def detect(work: Work) -> Output:
    frames = range(work.claim.payload["start_frame"], work.claim.payload["stop_frame"])
    squares = []
    for frame in frames:
        squares.append(str(frame * frame))
        work.on_unit()
    return Output(",".join(squares).encode())


def check(work: Work) -> Output:
    return Output(b"{}")


def associate(work: Work) -> Output:
    return Output(b",".join(work.outputs(DETECT)))


def expect_bodies(work: Work) -> Output:
    return Output(b"nobody")


def redetect(work: Work) -> Output:
    return Output(work.outputs(EXPECT)[0])


def identify(work: Work) -> Output:
    return Output(work.outputs(ASSOCIATE)[0])


def fit(work: Work) -> Output:
    return Output(b"feet", interim=b"squares: " + work.outputs(IDENTIFY)[0])


def hold_feet(work: Work) -> Output:
    return Output(work.interim(FIT, slice(1))[0])


def export(work: Work) -> Output:
    path = work.scratch / "person-1.bvh"
    path.write_bytes(work.outputs(REFIT if without_names(work.claim.edits) else HOLD)[0])
    return Output(b"{}", (ResultFile(path.name, "bvh", 1, "text/plain", path),), people=FOUND)


def edit(work: Work) -> Output:
    return Output(repr(work.claim.edits).encode())


def refit(work: Work) -> Output:
    return Output(work.outputs(HOLD)[0] + work.outputs(EDIT)[0])


def draw_overlay(work: Work) -> Output:
    path = work.scratch / "overlay-left.mp4"
    path.write_bytes(b"video of " + work.outputs(REFIT if without_names(work.claim.edits) else HOLD)[0])
    return Output(b"{}", (ResultFile(path.name, OVERLAY_KIND, None, "video/mp4", path),))


def write_report(work: Work) -> Output:
    path = work.scratch / "report.html"
    path.write_bytes(b"report of " + work.outputs(REFIT if without_names(work.claim.edits) else HOLD)[0])
    return Output(b"{}", (ResultFile(path.name, REPORT_KIND, None, "text/html", path),))


def write_rerun(work: Work) -> Output:
    path = work.scratch / "take.rrd"
    path.write_bytes(b"recording of " + work.outputs(REFIT if without_names(work.claim.edits) else HOLD)[0])
    return Output(b"{}", (ResultFile(path.name, RERUN_KIND, None, "application/octet-stream", path),))


def find_heads(work: Work) -> Output:
    return Output(b"heads in " + work.outputs(HOLD)[0])


def blur_videos(work: Work) -> Output:
    path = work.scratch / blurred_name(work.claim.index)
    path.write_bytes(b"blurred by " + work.outputs(HEADS)[0])
    return Output(b"{}", (ResultFile(path.name, BLURRED_KIND, None, "video/mp4", path),))


def other(work: Work) -> Output:
    """Stage whose content no test reads."""
    return Output(b"{}", interim=b"{}")


def write(work: Work) -> Output:
    return Output(work.outputs(REFIT)[work.claim.index])


LIGHT_STAGES: dict[str, Callable[[Work], Output]] = {
    LOOK: look,
    DETECT: detect,
    CHECK: check,
    ASSOCIATE: associate,
    EXPECT: expect_bodies,
    REDETECT: redetect,
    IDENTIFY: identify,
    FIT: fit,
    HOLD: hold_feet,
    HEADS: find_heads,
    BLUR: blur_videos,
    EDIT: edit,
    REFIT: refit,
    OVERLAY: draw_overlay,
    REPORT: write_report,
    RECORD: write_rerun,
    WRITE: write,
    EXPORT: export,
}


@dataclass
class RunnerBench:
    """Store with a session, and runners that work on it."""

    data_dir: Path
    store: JobStore
    artifacts: LocalArtifacts
    session: Session
    stages: dict[str, Callable[[Work], Output]] = field(default_factory=lambda: dict(LIGHT_STAGES))
    published: int = 0
    passed_on: int = 0
    stopping: bool = False
    has_room: bool = True
    stuck: list[str] = field(default_factory=list)

    def runner(self, lease_s: float = 20.0, heartbeat_s: float = 0.25) -> Runner:
        return Runner(
            store=self.store,
            artifacts=self.artifacts,
            publish=self._publish,
            run=lambda work: self.stages.get(work.claim.stage, other)(work),
            lease_s=lease_s,
            heartbeat_s=heartbeat_s,
            stopping=lambda: self.stopping,
            on_stuck=lambda: self.stuck.append("stuck"),
            has_room=lambda: self.has_room,
            ability=Ability(frozenset(stage_codes().values())),
            pass_on=self._pass_on,
        )

    def _publish(self) -> None:
        self.published += 1

    def _pass_on(self) -> None:
        self.passed_on += 1

    def create_job(self, retention_s: float | None = None, spec: JobSpec = JobSpec()) -> JobRecord:  # noqa: B008 - frozen
        stages = plan_job(self.session, spec)
        return self.store.jobs.add(self.session.id, spec, stages, retention_s)

    def edit(self, job_id: str, *edits: PeopleEdit, codes: dict[str, str] | None = None) -> JobRecord:
        """Edit the session, and make the files of a job again."""

        def plan(job: JobRecord) -> Remake:
            remake = plan_remake(self.session, job)
            if codes is None:
                return remake
            return replace(remake, stages=plan_job(self.session, job.spec, codes, edits=job.edits, revision=1))

        return self.store.jobs.remake(job_id, plan, edits=edits)

    def make_visuals(self, job_id: str) -> JobRecord:
        job = self.store.jobs.get(job_id)
        return self.store.visuals.add(job_id, *plan_visuals(self.session, job), job.revision)

    def result(self, job_id: str, name: str = "person-1.bvh") -> bytes:
        result = self.store.results.get(job_id, name)
        with self.artifacts.open(result.key) as file:
            content = file.read()
        assert (result.num_bytes, result.sha256) == (len(content), hashlib.sha256(content).hexdigest())
        return content


def open_bench(data_dir: Path) -> RunnerBench:
    """Create a bench with a new session in a data folder."""
    store = JobStore(f"sqlite:///{data_dir / 'multicap.db'}")
    store.migrate()
    return RunnerBench(data_dir, store, LocalArtifacts(data_dir / "artifacts"), new_session(store))


def new_session(store: JobStore) -> Session:
    """Add a session, which shares no outputs with others."""
    session_id = store.sessions.reserve_id()
    names = [("left.mp4", "video", "a"), ("rig.toml", "calibration", "c")]
    files = [
        InputFile(name, kind, f"sessions/{session_id}/inputs/{name}", 1, digit * 64) for name, kind, digit in names
    ]
    preflight = Preflight(
        cameras=(PreflightCamera("left", "left.mp4", (640, 480), 25.0, NUM_FRAMES),),
        timebase=PreflightTimebase(0.0, 25.0, NUM_FRAMES),
        stretches=(range(NUM_FRAMES),),
    )
    return store.sessions.add("take", files, preflight, session_id, chunk_frames=CHUNK_FRAMES)


@pytest.fixture(autouse=True)
def plain_log() -> Iterator[None]:
    """Log without the pictures of local variables that structlog draws by default, for a second each."""
    structlog.configure(processors=[structlog.processors.format_exc_info, structlog.processors.KeyValueRenderer()])
    yield
    structlog.reset_defaults()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[RunnerBench]:
    bench = open_bench(tmp_path)
    yield bench
    bench.store.close()


def fail_with(error: Exception) -> Any:
    def stage(work: Work) -> Output:
        raise error

    return stage


def slow_detect(work: Work) -> Output:
    time.sleep(0.05)
    return detect(work)


def in_thread(bench: RunnerBench, **choices: Any) -> threading.Thread:
    thread = threading.Thread(target=bench.runner(**choices).work, args=[60.0])
    thread.start()
    return thread


def run_side_by_side(bench: RunnerBench, num_workers: int) -> None:
    """Run all work in threads, and what they have left in this one."""
    threads = [in_thread(bench) for _ in range(num_workers)]
    for thread in threads:
        thread.join()
    bench.runner().work(60.0)
