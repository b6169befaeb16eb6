"""Runner of chunks on a real store, with small stages: jobs from claim to result, leases, cancellation, shutdown."""

import threading
import time
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.options.providers import Provider
from pipeline.run.engine.stage import (
    ASSOCIATE,
    CHECK,
    DETECT,
    EXPECT,
    EXPORT,
    FIT,
    HOLD,
    IDENTIFY,
    LOOK,
    REDETECT,
    Output,
)
from tests.worker.conftest import (
    NUM_FRAMES,
    RESULT,
    RunnerBench,
    detect,
    fail_with,
    in_thread,
    run_side_by_side,
    slow_detect,
)
from worker.run import chunk
from worker.run.chunk import StoppedError, Work
from worker.run.planning import plan_job
from worker.store.model.job_records import JobRecord
from worker.store.model.states import ChunkState, JobState
from worker.store.model.work import WorkerState, WorkerStatus
from worker.store.spec import JobSpec


class Endless:
    """Stage that runs until it is stopped; ``begun`` is set when it runs."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def __call__(self, work: Work) -> Output:
        self.begun.set()
        while True:
            time.sleep(0.01)
            work.on_unit()


def begin_endless_job(bench: RunnerBench, **choices: Any) -> tuple[JobRecord, threading.Thread]:
    """Create a job whose first stage runs until it is stopped; return the job and its worker's thread."""
    endless = bench.stages[DETECT] = Endless()
    job = bench.create_job()
    thread = in_thread(bench, **choices)
    assert endless.begun.wait(120)
    return job, thread


def test_job_runs_to_its_results(bench: RunnerBench) -> None:
    job = bench.create_job()
    assert bench.runner().work(60.0) == 1 + 4 + 2 + 1 + 4 + 4
    job = bench.store.jobs.get(job.id)
    assert (job.state, job.progress, job.problem) == (JobState.SUCCEEDED, 1.0, None)
    assert [(stage.name, stage.state) for stage in job.stages] == [
        (name, ChunkState.DONE)
        for name in (
            LOOK,
            DETECT,
            CHECK,
            ASSOCIATE,
            EXPECT,
            REDETECT,
            IDENTIFY,
            FIT,
            HOLD,
            EXPORT,
        )
    ]
    assert not any(stage.reused for stage in job.stages)
    (result,) = bench.store.results.downloads(job.id)
    assert (result.name, result.kind, result.person) == ("person-1.bvh", "bvh", 1)
    assert bench.result(job.id) == RESULT


def test_without_work_nothing_is_published(bench: RunnerBench) -> None:
    assert bench.runner().work(60.0) == 0
    assert bench.published == 0


def test_worker_that_finds_work_wakes_next(bench: RunnerBench) -> None:
    published_before_the_first = []

    def first(work: Work) -> Output:
        published_before_the_first.append(bench.published)
        return detect(work)

    bench.create_job()
    bench.stages[LOOK] = first
    bench.runner().work(60.0)
    assert published_before_the_first[0] == 1


def test_after_its_time_worker_hands_over(bench: RunnerBench) -> None:
    bench.create_job()
    bench.stages[LOOK] = slow_detect
    assert bench.runner().work(0.01) == 1
    assert bench.published >= 2


def test_workers_side_by_side_leave_same(bench: RunnerBench) -> None:
    job = bench.create_job()
    bench.stages[DETECT] = slow_detect
    run_side_by_side(bench, 3)
    assert bench.result(job.id) == RESULT


def test_another_job_of_session_reuses_finished_stages(bench: RunnerBench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    for name in (LOOK, DETECT, CHECK, ASSOCIATE, EXPECT, REDETECT, IDENTIFY, FIT, HOLD):
        bench.stages[name] = fail_with(AssertionError("must not run"))
    again = bench.create_job()
    bench.runner().work(60.0)
    job = bench.store.jobs.get(again.id)
    assert job.state is JobState.SUCCEEDED
    assert {stage.name: stage.reused for stage in job.stages} == {
        LOOK: True,
        DETECT: True,
        CHECK: True,
        ASSOCIATE: True,
        EXPECT: True,
        REDETECT: True,
        IDENTIFY: True,
        FIT: True,
        HOLD: True,
        EXPORT: False,
    }
    assert bench.result(again.id) == RESULT


def test_cancel_stops_running_pass(bench: RunnerBench) -> None:
    job, thread = begin_endless_job(bench)
    bench.store.jobs.cancel(job.id)
    asked_s = time.monotonic()
    thread.join(5)
    assert not thread.is_alive()
    assert time.monotonic() - asked_s < 2
    assert bench.store.jobs.get(job.id).state is JobState.CANCELED
    assert bench.stuck == []


def test_progress_is_reported_while_it_runs(bench: RunnerBench) -> None:
    halfway, go_on = threading.Event(), threading.Event()

    def slow(work: Work) -> Output:
        for _ in range(work.claim.unit_count // 2):
            work.on_unit()
        halfway.set()
        go_on.wait(120)
        return detect(work)

    bench.stages[DETECT] = slow
    job = bench.create_job()
    thread = in_thread(bench)
    assert halfway.wait(120)
    deadline_s = time.monotonic() + 120
    while (done := bench.store.jobs.get(job.id).stages[1].done) == 0 and time.monotonic() < deadline_s:
        time.sleep(0.05)
    go_on.set()
    thread.join()
    assert done == 5  # half of a chunk
    assert bench.store.jobs.get(job.id).stages[1].total == NUM_FRAMES


def test_lost_lease_stops_pass_and_new_holder_finishes(bench: RunnerBench) -> None:
    job, thread = begin_endless_job(bench, lease_s=0.3, heartbeat_s=1.5)
    bench.stages[DETECT] = detect
    time.sleep(0.5)
    assert bench.store.leases.reap(20.0)
    bench.runner().work(60.0)
    thread.join(5)
    assert not thread.is_alive()
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED
    assert bench.result(job.id) == RESULT


def test_shutdown_gives_chunk_back(bench: RunnerBench) -> None:
    job, thread = begin_endless_job(bench)
    bench.stopping = True
    thread.join(5)
    assert not thread.is_alive()
    bench.stopping = False
    bench.stages[DETECT] = detect
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT


def test_pass_that_does_not_notice_is_given_up(bench: RunnerBench) -> None:
    begun, hang = threading.Event(), threading.Event()

    def hanging(work: Work) -> Output:
        begun.set()
        hang.wait(20)
        return detect(work)

    bench.stages[DETECT] = hanging
    job = bench.create_job()
    thread = in_thread(bench)
    assert begun.wait(120)
    bench.store.jobs.cancel(job.id)
    asked_s = time.monotonic()
    while not bench.stuck and time.monotonic() < asked_s + 10:
        time.sleep(0.02)
    took_s = time.monotonic() - asked_s
    state = bench.store.jobs.get(job.id).state
    hang.set()
    thread.join()
    assert took_s < 5
    assert state is JobState.CANCELED


def test_pass_of_replaced_attempt_may_end_its_call(bench: RunnerBench) -> None:
    """Edits of people take the chunks of the edits before; the process stays for the next ones."""
    begun = threading.Event()

    def slow_to_stop(work: Work) -> Output:
        begun.set()
        try:
            while True:
                time.sleep(0.01)
                work.check()
        except StoppedError:
            time.sleep(2 * chunk.STOP_GRACE_S)
            raise

    bench.stages[DETECT] = slow_to_stop
    job = bench.create_job()
    thread = in_thread(bench)
    assert begun.wait(120)
    bench.stages[DETECT] = detect
    assert bench.store.leases.reap(0.0)
    thread.join(120)
    assert bench.stuck == []
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED


def limit_to(seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every chunk be stopped after some seconds."""
    monkeypatch.setattr(chunk, "_SHORTEST_LIMIT_S", seconds)
    monkeypatch.setattr(chunk, "_UNIT_S", 0.0)


def test_chunk_without_progress_is_stopped_twice_and_fails(
    bench: RunnerBench, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def hanging(work: Work) -> Output:
        while True:
            time.sleep(0.01)
            work.check()

    limit_to(0.6, monkeypatch)
    bench.stages[DETECT] = hanging
    job = bench.create_job()
    bench.runner(heartbeat_s=0.1).work(60.0)
    failed = bench.store.jobs.get(job.id)
    assert failed.state is JobState.FAILED
    assert failed.problem is not None
    assert (failed.problem.code, failed.problem.stage) == ("time_limit", DETECT)
    (attempt,) = bench.store.jobs.attempts(job.id)
    assert [(failure.chunk_index, failure.chunk_try) for failure in attempt.failures] == [(0, 1), (0, 2)]
    assert "in hanging" in capfd.readouterr().out  # the place where it hung


def test_chunk_hanging_in_one_call_loses_its_try_first(bench: RunnerBench, monkeypatch: pytest.MonkeyPatch) -> None:
    hang = threading.Event()

    def hanging(work: Work) -> Output:
        hang.wait(20)
        return detect(work)

    limit_to(0.6, monkeypatch)
    bench.stages[DETECT] = hanging
    job = bench.create_job()
    thread = in_thread(bench)
    started_s = time.monotonic()
    while not bench.stuck and time.monotonic() < started_s + 20:
        time.sleep(0.02)
    (attempt,) = bench.store.jobs.attempts(job.id)
    hang.set()
    bench.stopping = True
    thread.join()
    assert [failure.problem.code for failure in attempt.failures] == ["time_limit"]


def test_time_limit_grows_with_units_of_chunk() -> None:
    assert chunk.time_limit_s(10_000, 10.0) - chunk.time_limit_s(1_000, 10.0) == pytest.approx(9_000.0)
    assert chunk.time_limit_s(1_000, 20.0) - chunk.time_limit_s(1_000, 10.0) == pytest.approx(1_000.0)
    assert chunk.time_limit_s(1, 10.0) > 300.0


def test_late_result_of_lost_lease_is_not_recorded(bench: RunnerBench, tmp_path: Path) -> None:
    job = bench.create_job()
    claim = bench.store.leases.claim("a", 0.1)
    assert claim is not None
    time.sleep(0.3)
    bench.store.leases.reap(20.0)
    bench.runner().work(60.0)
    bench.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1)
    assert bench.store.outputs.find(bench.session.id, claim.output_key) != ("0" * 64, 1)
    assert bench.result(job.id) == RESULT


@pytest.mark.parametrize(("is_for_all", "passed_on"), [(True, 1), (False, 0)])
def test_message_for_work_of_others_is_passed_on_once(bench: RunnerBench, is_for_all: bool, passed_on: int) -> None:
    gpu = Provider("cuda", "1.31.1", "NVIDIA H200")
    bench.store.workers.report(WorkerStatus("gpu:1", WorkerState.READY, "A worker works", provider=gpu))
    plan = plan_job(bench.session, JobSpec(), provider=gpu.identity)
    bench.store.jobs.add(bench.session.id, JobSpec(), plan)
    assert bench.runner().work(60.0, is_for_all) == 0
    assert (bench.passed_on, bench.published) == (passed_on, 0)


def test_message_without_work_is_not_passed_on(bench: RunnerBench) -> None:
    bench.store.workers.report(
        WorkerStatus("gpu:1", WorkerState.READY, "A worker works", provider=Provider("cuda", "1.31.1"))
    )
    assert bench.runner().work(60.0) == 0
    assert bench.passed_on == 0
