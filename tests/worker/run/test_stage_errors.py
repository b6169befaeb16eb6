"""Errors and warnings of stages: what a job says of them, and whether it is tried again."""

import json
from dataclasses import replace

import pytest

from pipeline.core.errors import ChildError, InputError, ModelError, Problem
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import NOBODY_FOUND
from pipeline.core.problems.session_codes import VIDEO_EMPTY, VIDEO_TRUNCATED
from pipeline.run.engine.stage import ASSOCIATE, DETECT, EXPORT, Output
from tests.worker.conftest import RESULT, RunnerBench, detect, export, fail_with
from worker.run.chunk import Work
from worker.run.planning import plan_job
from worker.store.model.states import JobState
from worker.store.spec import JobSpec


def test_bad_input_fails_at_once_with_its_words(bench: RunnerBench) -> None:
    problem = Problem(VIDEO_TRUNCATED, "Frame 7 can't be decoded.", file="left.mp4", camera="left", hint="Copy it.")
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
    problems = [Problem(VIDEO_EMPTY, "The file is empty.", file=name) for name in ("left.mp4", "right.mp4")]
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
        pytest.param(
            ChildError("A process was ended. Run: multicap models install x"), "child_failed", marks=pytest.mark.slow
        ),
    ],
)
def test_error_of_service_gives_advice_and_allows_retry(bench: RunnerBench, error: Exception, code: str) -> None:
    bench.stages[DETECT] = fail_with(error)
    job = bench.create_job()
    bench.runner().work(60.0)
    found = bench.store.jobs.get(job.id).problem
    assert found is not None
    assert (found.code, found.retryable) == (code, True)
    assert "multicap models install x" in found.detail
    bench.stages[DETECT] = detect
    bench.store.jobs.retry(job.id, plan_job(bench.session, JobSpec()))
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


def test_warnings_of_last_stage_are_in_job_and_webhook(bench: RunnerBench) -> None:
    warning = Finding(NOBODY_FOUND, "Nobody was found.")
    bench.stages[EXPORT] = lambda work: replace(export(work), warnings=(warning,))
    spec = JobSpec(callback_url="https://example.com/hook")
    job = bench.store.jobs.add(bench.session.id, spec, plan_job(bench.session, spec))
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).warnings == (warning,)
    (delivery,) = bench.store.webhooks.pending()
    assert json.loads(delivery.body)["data"]["warnings"] == [warning.to_json()]


def test_chunk_beyond_memory_limit_ends_its_job_with_reason(bench: RunnerBench) -> None:
    bench.stages[DETECT] = fail_with(MemoryError("Unable to allocate 9.74 GiB"))
    job = bench.create_job()
    bench.runner().work(60.0)
    problem = bench.store.jobs.get(job.id).problem
    assert problem is not None
    assert (problem.code, problem.stage, problem.retryable) == ("memory_limit", DETECT, False)
    assert "MULTICAP_MEMORY_BYTES" in str(problem.hint)
