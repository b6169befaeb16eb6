"""Runner of chunks on a real store, with small stages."""

import hashlib
import json
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import ChildError, InputError, ModelError
from pipeline.errors import Problem as InputProblem
from pipeline.findings import Finding
from pipeline.problem_codes.sessions import VIDEO_EMPTY, VIDEO_TRUNCATED
from pipeline.problem_codes.warnings import NOBODY_FOUND
from pipeline.stages.stage import ASSOCIATE, CHECK, DETECT, EXPORT, FIT, IDENTIFY, LOOK, Output
from tests.worker.conftest import CHUNK_FRAMES, NUM_FRAMES, RESULT, RunnerBench, associate, detect, export, fit
from worker.chunk import Work
from worker.jobs.files.artifacts import stage_key
from worker.jobs.model.jobs import JobRecord
from worker.jobs.model.states import ChunkState, JobState
from worker.jobs.repositories.work.leases import MAX_ATTEMPTS
from worker.jobs.spec import JobSpec
from worker.planning import plan_job


def fail_with(error: Exception) -> Any:
    def stage(work: Work) -> Output:
        raise error

    return stage


class Endless:
    """Stage that runs until it is stopped; ``begun`` is set when it runs."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def __call__(self, work: Work) -> Output:
        self.begun.set()
        while True:
            time.sleep(0.01)
            work.on_unit()


def slow_detect(work: Work) -> Output:
    time.sleep(0.05)
    return detect(work)


def in_thread(bench: RunnerBench, **choices: Any) -> threading.Thread:
    thread = threading.Thread(target=bench.runner(**choices).work, args=[60.0])
    thread.start()
    return thread


def begin_endless_job(bench: RunnerBench, **choices: Any) -> tuple[JobRecord, threading.Thread]:
    """Create a job whose first stage runs until it is stopped; return the job and its worker's thread."""
    endless = bench.stages[DETECT] = Endless()
    job = bench.create_job()
    thread = in_thread(bench, **choices)
    assert endless.begun.wait(120)
    return job, thread


def run_side_by_side(bench: RunnerBench, num_workers: int) -> None:
    """Run all work in threads, and what they have left in this one."""
    threads = [in_thread(bench) for _ in range(num_workers)]
    for thread in threads:
        thread.join()
    bench.runner().work(60.0)


def test_a_job_runs_to_its_results(bench: RunnerBench) -> None:
    job = bench.create_job()
    assert bench.runner().work(60.0) == 1 + 4 + 5
    job = bench.store.jobs.get(job.id)
    assert (job.state, job.progress, job.problem) == (JobState.SUCCEEDED, 1.0, None)
    assert [(stage.name, stage.state) for stage in job.stages] == [
        (name, ChunkState.DONE) for name in (LOOK, DETECT, CHECK, ASSOCIATE, IDENTIFY, FIT, EXPORT)
    ]
    assert not any(stage.reused for stage in job.stages)
    (result,) = bench.store.results.of_job(job.id)
    assert (result.name, result.kind, result.person) == ("person-1.bvh", "bvh", "person-1")
    assert bench.result(job.id) == RESULT


def test_without_work_nothing_is_published(bench: RunnerBench) -> None:
    assert bench.runner().work(60.0) == 0
    assert bench.published == 0


def test_a_worker_that_finds_work_wakes_the_next(bench: RunnerBench) -> None:
    published_before_the_first = []

    def first(work: Work) -> Output:
        published_before_the_first.append(bench.published)
        return detect(work)

    bench.create_job()
    bench.stages[LOOK] = first
    bench.runner().work(60.0)
    assert published_before_the_first[0] == 1


def test_after_its_time_a_worker_hands_over(bench: RunnerBench) -> None:
    bench.create_job()
    bench.stages[LOOK] = slow_detect
    assert bench.runner().work(0.01) == 1
    assert bench.published >= 2


def test_workers_side_by_side_leave_the_same(bench: RunnerBench) -> None:
    job = bench.create_job()
    bench.stages[DETECT] = slow_detect
    run_side_by_side(bench, 3)
    assert bench.result(job.id) == RESULT


def test_another_job_of_the_session_reuses_finished_stages(bench: RunnerBench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    for name in (LOOK, DETECT, CHECK, ASSOCIATE, IDENTIFY, FIT):
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
        IDENTIFY: True,
        FIT: True,
        EXPORT: False,
    }
    assert bench.result(again.id) == RESULT


def test_a_damaged_output_is_made_again(bench: RunnerBench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    key = bench.store.outputs.of_stage(bench.store.jobs.page()[0].id, ASSOCIATE)[0].key
    bench.artifacts.put_bytes(stage_key(bench.session.id, key), b"damaged")
    again = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(again.id) == RESULT
    assert {stage.name: stage.reused for stage in bench.store.jobs.get(again.id).stages}[ASSOCIATE] is False


def stored(bench: RunnerBench, job_id: str, stage: str, chunk: int = 0) -> Path:
    """File of a chunk's output."""
    key = bench.store.outputs.of_stage(job_id, stage)[chunk].key
    return bench.data_dir / "artifacts" / stage_key(bench.session.id, key)


def remove(path: Path) -> None:
    path.unlink()


def flip(path: Path) -> None:
    path.write_bytes(bytes(byte ^ 255 for byte in path.read_bytes()))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


DAMAGES = pytest.mark.parametrize("damage", [flip, truncate, remove])


@DAMAGES
@pytest.mark.parametrize(
    ("stage", "chunk", "reader"),
    [(DETECT, 2, ASSOCIATE), (ASSOCIATE, 0, IDENTIFY), (IDENTIFY, 0, FIT), (FIT, 0, EXPORT)],
)
def test_an_output_that_is_damaged_before_it_is_read_is_computed_again(
    bench: RunnerBench, stage: str, chunk: int, reader: str, damage: Callable[[Path], None]
) -> None:
    run = bench.stages[reader]
    damages = iter([damage])

    def damaging(work: Work) -> Output:
        for once in damages:
            once(stored(bench, work.claim.job_id, stage, chunk))
        return run(work)

    bench.stages[reader] = damaging
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED
    assert bench.result(job.id) == RESULT
    (attempt,) = bench.store.jobs.attempts(job.id)
    (failure,) = attempt.failures
    assert (failure.stage, failure.chunk_index, failure.problem.code) == (stage, chunk, "output_damaged")
    assert f"chunk {chunk} of the stage {stage}" in failure.problem.detail


def test_all_damaged_outputs_are_computed_again_at_once_and_the_others_are_kept(bench: RunnerBench) -> None:
    computed: list[int] = []

    def counted(work: Work) -> Output:
        computed.append(work.claim.index)
        return detect(work)

    def damaging(work: Work) -> Output:
        if len(computed) == 4:
            for chunk in (1, 3):
                flip(stored(bench, work.claim.job_id, DETECT, chunk))
        return associate(work)

    bench.stages |= {DETECT: counted, ASSOCIATE: damaging}
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT
    assert computed == [0, 1, 2, 3, 1, 3]
    assert bench.store.jobs.get(job.id).progress == 1.0


def test_two_stages_that_are_both_damaged_are_computed_again_in_their_order(bench: RunnerBench) -> None:
    damages = iter([ASSOCIATE, IDENTIFY])

    def damaging(work: Work) -> Output:
        for stage in damages:
            flip(stored(bench, work.claim.job_id, stage))
        return fit(work)

    bench.stages[FIT] = damaging
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT
    (attempt,) = bench.store.jobs.attempts(job.id)
    assert [failure.stage for failure in attempt.failures] == [IDENTIFY, ASSOCIATE]


def test_a_disk_that_damages_everything_ends_the_job_and_a_retry_computes_it(bench: RunnerBench) -> None:
    runs = []

    def damaging(work: Work) -> Output:
        runs.append(work.claim.index)
        flip(stored(bench, work.claim.job_id, DETECT, 1))
        return associate(work)

    bench.stages[ASSOCIATE] = damaging
    job = bench.create_job()
    bench.runner().work(60.0)
    found = bench.store.jobs.get(job.id)
    assert found.state is JobState.FAILED
    assert found.problem is not None
    assert (found.problem.code, found.problem.stage, found.problem.retryable) == ("output_damaged", DETECT, True)
    assert "chunk 1 of the stage detect" in found.problem.detail
    assert "disk" in (found.problem.hint or "")
    assert len(runs) == MAX_ATTEMPTS
    bench.stages[ASSOCIATE] = associate
    bench.store.jobs.retry(job.id, plan_job(bench.session, JobSpec(), CHUNK_FRAMES))
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT


def test_workers_side_by_side_compute_a_damaged_output_again(bench: RunnerBench) -> None:
    damaged = threading.Event()

    def damaging(work: Work) -> Output:
        if not damaged.is_set():
            damaged.set()
            for chunk in range(4):
                flip(stored(bench, work.claim.job_id, DETECT, chunk))
        return associate(work)

    bench.stages |= {DETECT: slow_detect, ASSOCIATE: damaging}
    job = bench.create_job()
    run_side_by_side(bench, 3)
    assert bench.result(job.id) == RESULT


def test_a_result_that_was_damaged_is_made_anew_by_another_job(bench: RunnerBench) -> None:
    job = bench.create_job()
    bench.runner().work(60.0)
    flip(stored(bench, job.id, FIT))
    flip(bench.data_dir / "artifacts" / bench.store.results.of_job(job.id)[0].key)
    again = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(again.id) == RESULT
    reused = {stage.name: stage.reused for stage in bench.store.jobs.get(again.id).stages}
    assert reused == {LOOK: True, DETECT: True, CHECK: True, ASSOCIATE: True, IDENTIFY: True, FIT: False, EXPORT: False}


def test_bad_input_fails_at_once_with_its_words(bench: RunnerBench) -> None:
    problem = InputProblem(
        VIDEO_TRUNCATED, "Frame 7 can't be decoded.", file="left.mp4", camera="left", hint="Copy it."
    )
    bench.stages[DETECT] = fail_with(InputError([problem]))
    job = bench.create_job()
    bench.runner().work(60.0)
    job = bench.store.jobs.get(job.id)
    assert job.state is JobState.FAILED
    assert job.problem is not None
    assert (job.problem.code, job.problem.detail) == ("video_truncated", "left.mp4: Frame 7 can't be decoded.")
    assert (job.problem.stage, job.problem.camera, job.problem.hint) == (DETECT, "left", "Copy it.")
    assert not job.problem.retryable


def test_several_problems_are_all_told(bench: RunnerBench) -> None:
    problems = [InputProblem(VIDEO_EMPTY, "The file is empty.", file=name) for name in ("left.mp4", "right.mp4")]
    bench.stages[DETECT] = fail_with(InputError(problems))
    job = bench.create_job()
    bench.runner().work(60.0)
    found = bench.store.jobs.get(job.id).problem
    assert found is not None
    assert found.code == "input_error"
    assert "left.mp4" in found.detail
    assert "right.mp4" in found.detail


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ModelError("The network x is not installed. Run: multicap models install x"), "model_error"),
        (ChildError("A process was ended. Run: multicap models install x"), "child_failed"),
    ],
)
def test_an_error_that_is_not_the_inputs_says_what_to_do_and_the_job_can_be_retried(
    bench: RunnerBench, error: Exception, code: str
) -> None:
    bench.stages[DETECT] = fail_with(error)
    job = bench.create_job()
    bench.runner().work(60.0)
    found = bench.store.jobs.get(job.id).problem
    assert found is not None
    assert (found.code, found.retryable) == (code, True)
    assert "multicap models install x" in found.detail
    bench.stages[DETECT] = detect
    bench.store.jobs.retry(job.id, plan_job(bench.session, JobSpec(), CHUNK_FRAMES))
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED


def test_other_errors_are_tried_again_and_tell_nothing(bench: RunnerBench, capfd: pytest.CaptureFixture[str]) -> None:
    tries = []

    def broken(work: Work) -> Output:
        tries.append(work.claim.attempt)
        raise OSError(28, "No space left on device", "/secret/path")

    bench.stages[ASSOCIATE] = broken
    job = bench.create_job()
    bench.runner().work(60.0)
    found = bench.store.jobs.get(job.id)
    assert tries == [1, 2, 3, 4, 5]
    assert found.state is JobState.FAILED
    assert found.problem is not None
    assert found.problem.retryable
    assert found.problem.stage == ASSOCIATE
    assert "secret" not in str(found.problem)
    assert "/secret/path" in "".join(capfd.readouterr())


def test_one_bad_moment_costs_nothing(bench: RunnerBench) -> None:
    failures = iter([RuntimeError("once")])

    def flaky(work: Work) -> Output:
        for error in failures:
            raise error
        return detect(work)

    bench.stages[DETECT] = flaky
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT


def test_cancel_stops_the_running_pass(bench: RunnerBench) -> None:
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


def test_a_lost_lease_stops_the_pass_and_the_new_holder_finishes(bench: RunnerBench) -> None:
    job, thread = begin_endless_job(bench, lease_s=0.3, heartbeat_s=1.5)
    bench.stages[DETECT] = detect
    time.sleep(0.5)
    assert bench.store.leases.reap(20.0)
    bench.runner().work(60.0)
    thread.join(5)
    assert not thread.is_alive()
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED
    assert bench.result(job.id) == RESULT


def test_shutdown_gives_the_chunk_back(bench: RunnerBench) -> None:
    job, thread = begin_endless_job(bench)
    bench.stopping = True
    thread.join(5)
    assert not thread.is_alive()
    bench.stopping = False
    bench.stages[DETECT] = detect
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT


def test_a_pass_that_does_not_notice_is_given_up(bench: RunnerBench) -> None:
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


def test_a_late_result_of_a_lost_lease_is_not_recorded(bench: RunnerBench, tmp_path: Path) -> None:
    job = bench.create_job()
    claim = bench.store.leases.claim("a", 0.1)
    assert claim is not None
    time.sleep(0.3)
    bench.store.leases.reap(20.0)
    bench.runner().work(60.0)
    bench.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1)
    assert bench.store.outputs.find(bench.session.id, claim.output_key) != ("0" * 64, 1)
    assert bench.result(job.id) == RESULT


def test_what_the_last_stage_warns_of_is_in_the_job_and_in_its_webhook(bench: RunnerBench) -> None:
    warning = Finding(NOBODY_FOUND, "Nobody was found.")
    bench.stages[EXPORT] = lambda work: replace(export(work), warnings=(warning,))
    spec = JobSpec(callback_url="https://example.com/hook")
    job = bench.store.jobs.add(bench.session.id, spec, plan_job(bench.session, spec, CHUNK_FRAMES))
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).result_warnings == (warning,)
    (delivery,) = bench.store.webhooks.pending()
    assert json.loads(delivery.body)["data"]["warnings"] == ["Nobody was found."]


def test_a_chunk_beyond_the_memory_limit_ends_its_job_with_the_reason(bench: RunnerBench) -> None:
    bench.stages[DETECT] = fail_with(MemoryError("Unable to allocate 9.74 GiB"))
    job = bench.create_job()
    bench.runner().work(60.0)
    problem = bench.store.jobs.get(job.id).problem
    assert problem is not None
    assert (problem.code, problem.stage, problem.retryable) == ("memory_limit", DETECT, False)
    assert "MULTICAP_MEMORY_BYTES" in str(problem.hint)


def test_pieces_of_outputs_are_found_by_later_jobs_until_they_are_damaged(bench: RunnerBench) -> None:
    found: list[bytes | None] = []

    def export_with_pieces(work: Work) -> Output:
        found.append(work.piece("piece"))
        path = work.scratch / "piece"
        path.write_bytes(b"of a person")
        return replace(export(work), pieces={"piece": path})

    bench.stages[EXPORT] = export_with_pieces
    for damage in (None, None, b"of another person"):
        if damage is not None:
            bench.artifacts.put_bytes(stage_key(bench.session.id, "piece"), damage)
        bench.create_job()
        bench.runner().work(60.0)
    assert found == [None, b"of a person", None]
    assert bench.store.outputs.find(bench.session.id, "piece") == (
        hashlib.sha256(b"of a person").hexdigest(),
        len(b"of a person"),
    )
