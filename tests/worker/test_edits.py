"""Edits of people in the service: what is done stays done, results are replaced, and every edit can be undone."""

from collections.abc import Callable

import pytest

from pipeline.edits import PeopleEdit, Remove, Rename
from pipeline.stages.output import Output
from pipeline.stages.plan import DETECT, EDIT, EXPORT, FIT, IDENTIFY, PERSON_PARTS, REFIT, WRITE
from tests.worker.conftest import CHUNK_FRAMES, FOUND, RESULT, Bench
from worker.chunk import Work
from worker.jobs.errors import Conflict
from worker.jobs.files.artifacts import results_prefix
from worker.jobs.files.removals import remove_files
from worker.jobs.model import Job, JobState
from worker.planning import plan_job

ANNA, NOBODY = Rename(person=1, name="Anna"), Remove(person=2)


@pytest.fixture
def done(bench: Bench) -> Job:
    job = bench.create_job()
    bench.runner().work(60.0)
    return bench.store.jobs.get(job.id)


def edit(bench: Bench, job: Job, *edits: PeopleEdit, codes: dict[str, str] | None = None) -> Job:
    stages = plan_job(bench.session, job.spec, CHUNK_FRAMES, codes, edits=edits)
    return bench.store.jobs.edit(job.id, edits, stages, job.revision)


def expected(*edits: PeopleEdit) -> bytes:
    return RESULT + repr(edits).encode() if edits else RESULT


def test_edits_run_their_own_stages_alone(bench: Bench, done: Job) -> None:
    assert done.people == FOUND
    queued = edit(bench, done, ANNA)
    assert (queued.state, queued.attempt, queued.revision, queued.edits) == (JobState.QUEUED, 2, 1, (ANNA,))
    run: list[str] = []

    def noted(function: Callable[[Work], Output]) -> Callable[[Work], Output]:
        def run_noted(work: Work) -> Output:
            run.append(work.claim.stage)
            return function(work)

        return run_noted

    bench.stages |= {name: noted(function) for name, function in bench.stages.items()}
    bench.runner().work(60.0)
    assert run == [EDIT, *PERSON_PARTS * [REFIT], *PERSON_PARTS * [WRITE], EXPORT]
    assert bench.store.jobs.get(done.id).state is JobState.SUCCEEDED
    assert bench.result(done.id) == expected(ANNA)


def test_an_edit_is_undone(bench: Bench, done: Job) -> None:
    job = done
    for edits in ((ANNA,), (ANNA, NOBODY), (ANNA,), ()):
        edit(bench, job, *edits)
        bench.runner().work(60.0)
        job = bench.store.jobs.get(job.id)
        assert bench.result(job.id) == expected(*edits)
    assert (job.revision, job.attempt, job.edits, job.people) == (4, 5, (), FOUND)
    assert EDIT not in {stage.name for stage in job.stages}


def test_files_of_earlier_revisions_are_removed(bench: Bench, done: Job) -> None:
    edit(bench, done, ANNA)
    bench.runner().work(60.0)
    remove_files(bench.store.removals, bench.artifacts)
    folders = [bench.data_dir / "artifacts" / results_prefix(done.id, revision) for revision in (0, 1)]
    assert [folder.exists() for folder in folders] == [False, True]


def test_edits_of_another_revision_are_refused(bench: Bench, done: Job) -> None:
    edit(bench, done, ANNA)
    with pytest.raises(Conflict, match="revision 1 now"):
        edit(bench, done, NOBODY)
    with pytest.raises(Conflict, match="finished job"):
        edit(bench, bench.store.jobs.get(done.id), NOBODY)


def test_people_must_have_been_found(bench: Bench) -> None:
    job = bench.create_job()
    bench.store.jobs.cancel(job.id)
    with pytest.raises(Conflict, match="no results yet"):
        edit(bench, bench.store.jobs.get(job.id), ANNA)


def test_a_canceled_edit_can_be_made_again(bench: Bench, done: Job) -> None:
    edit(bench, done, ANNA)
    canceled = bench.store.jobs.cancel(done.id)
    assert canceled.state is JobState.CANCELED
    edit(bench, canceled)
    bench.runner().work(60.0)
    assert bench.result(done.id) == RESULT


def test_another_version_computes_what_differs(bench: Bench, done: Job) -> None:
    """After an upgrade that changed the code of `identify`, everything from there on is run again."""
    old = {stage.name: stage.code_sha256 for stage in plan_job(bench.session, done.spec, CHUNK_FRAMES, edits=(ANNA,))}
    queued = edit(bench, done, ANNA, codes=old | {IDENTIFY: "new"})
    states = {stage.name: stage.state for stage in queued.stages}
    assert (states[DETECT], states[IDENTIFY], states[FIT]) == ("done", "ready", "waiting")
