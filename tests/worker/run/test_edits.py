"""Edits of people in the service: what is done stays done, results are replaced, and every edit can be undone."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from pipeline.core.errors import PipelineError
from pipeline.core.findings import Finding
from pipeline.core.options.edits import PeopleEdit, Remove, Rename
from pipeline.core.problems.finding_codes import NOBODY_FOUND
from pipeline.run.engine.stage import DETECT, EDIT, EXPORT, FIT, IDENTIFY, REFIT, WRITE, Output, ResultFile
from tests.cases import slow_but
from tests.worker.conftest import FOUND, RESULT, RunnerBench
from worker.run.chunk import StoppedError, Work
from worker.run.planning import plan_again, plan_job, plan_remake
from worker.store.errors import Conflict, EditedMeanwhile
from worker.store.files.file_keys import results_prefix
from worker.store.model.job_records import JobRecord
from worker.store.model.session_records import SessionEdits
from worker.store.model.states import FilesState, JobState
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import JobSpec

FIRST, NOBODY, ANNA = Remove(person=1), Remove(person=2), Rename(person=1, name="Anna")


@pytest.fixture
def done(bench: RunnerBench) -> JobRecord:
    job = bench.create_job()
    bench.runner().work(60.0)
    return bench.store.jobs.get(job.id)


def expected(*edits: PeopleEdit) -> bytes:
    return RESULT + repr(edits).encode() if edits else RESULT


def test_edits_run_their_own_stages_alone(bench: RunnerBench, done: JobRecord) -> None:
    assert bench.store.edits.people(done.id) == FOUND
    queued = bench.edit(done.id, FIRST)
    assert (queued.state, queued.files_state) == (JobState.SUCCEEDED, FilesState.UPDATING)
    assert (queued.attempt_state, queued.attempt, queued.revision, queued.edits) == (JobState.QUEUED, 2, 1, (FIRST,))
    run: list[str] = []

    def noted(function: Callable[[Work], Output]) -> Callable[[Work], Output]:
        def run_noted(work: Work) -> Output:
            run.append(work.claim.stage)
            return function(work)

        return run_noted

    bench.stages |= {name: noted(function) for name, function in bench.stages.items()}
    bench.runner().work(60.0)
    assert run == [EDIT, REFIT, WRITE, EXPORT]
    assert bench.store.jobs.get(done.id).files_state is FilesState.CURRENT
    assert bench.result(done.id) == expected(FIRST)


def test_rename_stores_files_that_hold_name_alone(bench: RunnerBench) -> None:
    export, run = bench.stages[EXPORT], []

    def export_with_name(work: Work) -> Output:
        run.append(work.claim.stage)
        path = work.scratch / "person-1.glb"
        path.write_bytes(repr(work.claim.edits).encode())
        made = export(work)
        return replace(made, files=(*made.files, ResultFile(path.name, "glb", 1, "model/gltf-binary", path)))

    def stored() -> dict[str, tuple[str, int]]:
        """Key and time of the last change of each file."""
        files = {file.name: file.key for file in bench.store.results.all(job.id)}
        return {name: (key, (bench.data_dir / "artifacts" / key).stat().st_mtime_ns) for name, key in files.items()}

    bench.stages[EXPORT] = export_with_name
    job = bench.create_job()
    bench.runner().work(60.0)
    before = stored()
    renamed = bench.edit(job.id, ANNA)
    assert [stage.name for stage in renamed.stages if stage.state != "done"] == [EXPORT]
    bench.runner().work(60.0)
    remove_files(bench.store.removals, bench.artifacts)
    after = stored()
    assert run == [EXPORT, EXPORT]
    assert after["person-1.bvh"] == before["person-1.bvh"]
    assert after["person-1.glb"] != before["person-1.glb"]
    assert not bench.artifacts.exists(before["person-1.glb"][0])
    assert {file.revision for file in bench.store.results.all(job.id)} == {1}

    # A file that is damaged is stored again; one that no revision lists is removed.
    bench.artifacts.put_bytes(after["person-1.bvh"][0], b"damaged")
    bench.edit(job.id, ANNA, replace(ANNA, person=2))
    bench.runner().work(60.0)
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.result(job.id) == RESULT
    assert stored()["person-1.bvh"][0] != after["person-1.bvh"][0]
    assert not bench.artifacts.exists(after["person-1.bvh"][0])


def test_edit_is_undone(bench: RunnerBench, done: JobRecord) -> None:
    job = done
    for edits in ((FIRST,), (FIRST, NOBODY), (FIRST,), ()):
        bench.edit(job.id, *edits)
        bench.runner().work(60.0)
        job = bench.store.jobs.get(job.id)
        assert bench.result(job.id) == expected(*edits)
    assert (job.revision, job.edits_revision, job.attempt, job.edits) == (4, 4, 5, ())
    assert bench.store.edits.people(job.id) == FOUND
    assert EDIT not in {stage.name for stage in job.stages}


def test_files_of_earlier_revisions_are_removed(bench: RunnerBench, done: JobRecord) -> None:
    bench.edit(done.id, FIRST)
    bench.runner().work(60.0)
    remove_files(bench.store.removals, bench.artifacts)
    folders = [bench.data_dir / "artifacts" / results_prefix(done.id, revision) for revision in (0, 1)]
    # Folders stay, empty, until the job is deleted.
    assert [[path.name for path in folder.rglob("*") if path.is_file()] for folder in folders] == [[], ["person-1.bvh"]]


def test_edits_of_another_revision_are_refused(bench: RunnerBench, done: JobRecord) -> None:
    bench.edit(done.id, FIRST)
    with pytest.raises(EditedMeanwhile, match="revision 1 now"):
        bench.store.edits.replace(bench.session.id, (NOBODY,), 0)
    assert bench.store.edits.get(bench.session.id) == SessionEdits(1, (FIRST,))


def test_later_jobs_apply_edits_of_session(bench: RunnerBench, done: JobRecord) -> None:
    bench.edit(done.id, FIRST)
    bench.runner().work(60.0)
    edits = bench.store.edits.get(bench.session.id)
    spec = JobSpec(method="clustering")
    stages = plan_job(bench.session, spec, edits=edits.edits)
    later = bench.store.jobs.add(bench.session.id, spec, stages, edits=edits)
    bench.runner().work(60.0)
    later = bench.store.jobs.get(later.id)
    assert (later.revision, later.edits_revision, later.newest_edits_revision) == (0, 1, 1)
    assert bench.result(later.id) == expected(FIRST)
    without = bench.create_job(spec=JobSpec(apply_edits=False))
    bench.runner().work(60.0)
    assert bench.result(without.id) == RESULT
    without = bench.store.jobs.get(without.id)
    assert (without.edits_revision, without.newest_edits_revision) == (None, 1)
    with pytest.raises(Conflict, match="leaves the edits"):
        bench.edit(without.id, NOBODY)
    assert bench.store.edits.get(bench.session.id).revision == 1


def test_files_follow_edits_that_another_job_got(bench: RunnerBench, done: JobRecord) -> None:
    other = bench.create_job()
    bench.runner().work(60.0)
    bench.edit(other.id, FIRST)
    bench.runner().work(60.0)
    behind = bench.store.jobs.get(done.id)
    assert (behind.edits_revision, behind.newest_edits_revision, bench.result(done.id)) == (0, 1, RESULT)
    bench.store.jobs.remake(done.id, partial(plan_remake, bench.session))
    bench.runner().work(60.0)
    assert bench.store.jobs.get(done.id).edits_revision == 1
    assert bench.result(done.id) == expected(FIRST)


def test_newest_of_stacked_edits_wins(bench: RunnerBench, done: JobRecord) -> None:
    queued = bench.edit(done.id, FIRST)
    newest = bench.edit(queued.id, FIRST, NOBODY)
    bench.runner().work(60.0)
    job = bench.store.jobs.get(done.id)
    assert (job.files_state, job.revision, job.results_revision) == (FilesState.CURRENT, newest.revision, 2)
    assert bench.result(done.id) == expected(FIRST, NOBODY)
    states = [attempt.state for attempt in bench.store.jobs.attempts(done.id)]
    assert states == [JobState.SUCCEEDED, JobState.CANCELED, JobState.SUCCEEDED]


@pytest.mark.parametrize("stage", slow_but([EXPORT], [EDIT, REFIT, WRITE, EXPORT]))
def test_work_for_older_list_is_given_up(bench: RunnerBench, done: JobRecord, stage: str) -> None:
    """A chunk that ends after a newer edit changes nothing, and a unit of work later it stops."""
    function, stopped = bench.stages[stage], []

    def edited_meanwhile(work: Work) -> Output:
        bench.stages[stage] = function
        bench.edit(done.id, NOBODY)
        output = function(work)
        if stage == EDIT:
            wait_until_stopped(work)
        return output

    def wait_until_stopped(work: Work) -> None:
        try:
            for _ in range(600):
                work.on_unit()
                time.sleep(0.05)
        except StoppedError:
            stopped.append(work.claim.stage)
            raise

    bench.stages[stage] = edited_meanwhile
    bench.edit(done.id, FIRST)
    bench.runner().work(60.0)
    job = bench.store.jobs.get(done.id)
    assert (job.files_state, job.results_revision, job.edits) == (FilesState.CURRENT, 2, (NOBODY,))
    assert bench.result(done.id) == expected(NOBODY)
    assert stopped == ([EDIT] if stage == EDIT else [])
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.result(done.id) == expected(NOBODY)


@pytest.mark.parametrize("end", slow_but(["canceled"], ["canceled", "failed"]))
def test_files_stay_if_edit_comes_to_nothing(bench: RunnerBench, done: JobRecord, end: str) -> None:
    def broken(_: Work) -> Output:
        raise PipelineError("It is broken.")

    whole = bench.stages[EXPORT]
    bench.stages[EXPORT] = broken
    queued = bench.edit(done.id, FIRST)
    assert (queued.results_revision, bench.result(done.id)) == (0, RESULT)
    if end == "canceled":
        bench.store.jobs.cancel(done.id)
    else:
        bench.runner().work(60.0)
    job = bench.store.jobs.get(done.id)
    assert (job.state, job.files_state, job.results_revision) == (JobState.SUCCEEDED, FilesState.FAILED, 0)
    assert job.attempt_state == end
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.result(done.id) == RESULT

    bench.stages[EXPORT] = whole
    bench.store.jobs.retry(done.id, plan_again(bench.session, job))
    assert bench.result(done.id) == RESULT
    bench.runner().work(60.0)
    assert bench.result(done.id) == expected(FIRST)


@pytest.mark.slow
def test_edits_go_before_other_work_of_tenant(bench: RunnerBench, done: JobRecord) -> None:
    running, queued = bench.create_job(), bench.create_job()
    claim = bench.store.leases.claim("worker", 30.0)
    assert claim is not None
    assert claim.job_id == running.id
    edited = bench.edit(done.id, FIRST)
    assert edited.queue_position == 1
    assert bench.store.jobs.get(queued.id).queue_position == 2
    claim = bench.store.leases.claim("worker", 30.0)
    assert claim is not None
    assert claim.job_id == done.id


@pytest.mark.slow
def test_edits_take_no_share_of_other_tenants(bench: RunnerBench, done: JobRecord) -> None:
    """The tenant with fewer running chunks is next, whatever the other one edits."""
    store = bench.store
    session = store.tenant("other").sessions.add(
        "theirs", bench.session.files, bench.session.preflight, store.sessions.reserve_id()
    )
    theirs = store.tenant("other").jobs.add(session.id, done.spec, plan_job(session, done.spec))
    bench.edit(done.id, FIRST)
    again = bench.create_job()
    taken = []
    for _ in range(2):
        claim = store.leases.claim("worker", 30.0)
        assert claim is not None
        taken.append(claim.job_id)
    assert sorted(taken) == sorted([done.id, theirs.id])
    assert store.jobs.get(again.id).attempt_state is JobState.QUEUED


def test_warnings_of_last_revision_stay_until_next_succeeds(bench: RunnerBench) -> None:
    export, doubt = bench.stages[EXPORT], Finding(NOBODY_FOUND, "Nobody was found.")
    bench.stages[EXPORT] = lambda work: replace(export(work), warnings=() if work.claim.edits else (doubt,))
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.edit(job.id, FIRST).warnings == (doubt,)
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).warnings == ()


def test_people_must_have_been_found(bench: RunnerBench) -> None:
    job = bench.create_job()
    bench.store.jobs.cancel(job.id)
    with pytest.raises(Conflict, match="no people yet"):
        bench.edit(job.id, FIRST)


@pytest.mark.slow
def test_canceled_edit_can_be_made_again(bench: RunnerBench, done: JobRecord) -> None:
    bench.edit(done.id, FIRST)
    canceled = bench.store.jobs.cancel(done.id)
    assert canceled.files_state is FilesState.FAILED
    bench.edit(canceled.id)
    bench.runner().work(60.0)
    assert bench.result(done.id) == RESULT


def test_another_version_computes_differing_stages(bench: RunnerBench, done: JobRecord) -> None:
    """After an upgrade that changed the code of `identify`, everything from there on is run again."""
    old = {stage.name: stage.code_sha256 for stage in plan_job(bench.session, done.spec, edits=(FIRST,))}
    queued = bench.edit(done.id, FIRST, codes=old | {IDENTIFY: "new"})
    states = {stage.name: stage.state for stage in queued.stages}
    assert (states[DETECT], states[IDENTIFY], states[FIT]) == ("done", "ready", "waiting")
