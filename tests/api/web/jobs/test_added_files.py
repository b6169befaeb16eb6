"""Files that a finished job gets: made again, added, with the visuals of a job of their own."""

import io
import zipfile
from typing import Any

import pytest

from api.cli.client import Client, ServiceError
from pipeline.core.options.edits import PersonSpan
from pipeline.core.problems.code_group import Code
from tests.api.conftest import RESULT, Live, problem_of
from worker.store.model.job_records import JobProblem
from worker.store.store import MAX_ATTEMPTS

FOUND = (PersonSpan(1, 0, 60), PersonSpan(2, 10, 40))


@pytest.fixture
def job_id(live: Live) -> str:
    job_id = live.job_id()
    live.finish(job_id, people=FOUND)
    return job_id


def ahead(job: dict[str, Any]) -> list[str]:
    return [stage["name"] for stage in job["stages"] if stage["state"] != "done"]


def test_added_formats_are_written_and_nothing_else_is_done(live: Live, job_id: str) -> None:
    answer = live.remake(job_id, exports=["glb", "bvh"], preset="blender", timeline="person")
    assert (answer.status_code, answer.headers["location"]) == (202, f"/v1/jobs/{job_id}")
    job = answer.json()
    assert (job["state"], job["files_state"], job["revision"], job["attempt"]) == ("succeeded", "updating", 1, 2)
    assert (job["spec"]["exports"], job["spec"]["preset"], job["spec"]["timeline"]) == (
        ["bvh", "glb"],
        "blender",
        "person",
    )
    assert ahead(job) == ["export"]
    live.finish(job_id, people=FOUND)
    # The next ones are added to those.
    assert live.remake(job_id, exports=["csv"]).json()["spec"]["exports"] == ["bvh", "glb", "csv"]
    live.finish(job_id, people=FOUND)


def test_added_visuals_are_due_at_once(live: Live, job_id: str) -> None:
    job = live.remake(job_id, report=True).json()
    assert (ahead(job), job["spec"]["report"], job["urls"]["visuals"]) == (["export"], True, None)
    assert live.services.store.visuals.due(3600.0) == []
    live.finish(job_id, people=FOUND)
    assert live.services.store.visuals.due(3600.0) == [job_id]
    address = live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["visuals"]
    visuals = live.client.post(address).json()
    assert ahead(visuals) == ["write_report"]
    live.client.post(visuals["urls"]["cancel"]).raise_for_status()


def test_wrong_files_are_refused(live: Live, job_id: str) -> None:
    answer = live.remake(job_id, exports=["gltf"], character="01a2285e-7ecc-72e2-9021-b1d43c75f818", method="tracking")
    errors = problem_of(answer, 422, "invalid_request")["errors"]
    assert {error["pointer"].partition("/exports")[0] for error in errors} >= {""}
    (error,) = problem_of(live.remake(job_id, method="tracking"), 422, "invalid_request")["errors"]
    assert (error["pointer"], error["code"]) == ("/method", "unknown_field")
    (error,) = problem_of(live.remake(job_id, character=job_id), 422, "invalid_request")["errors"]
    assert error["pointer"] == "/character"
    assert live.client.get(f"/v1/jobs/{job_id}").json()["revision"] == 0


def test_repeated_request_adds_files_once(live: Live, job_id: str) -> None:
    key = {"Idempotency-Key": "once"}
    answers = [live.client.post(f"/v1/jobs/{job_id}/files", json={"exports": ["csv"]}, headers=key) for _ in range(2)]
    assert [answer.json()["revision"] for answer in answers] == [1, 1]
    live.finish(job_id, people=FOUND)


def test_files_stay_until_those_of_next_revision_are_made(live: Live, job_id: str) -> None:
    def read() -> tuple[int, list[int], bytes, int]:
        job = live.client.get(f"/v1/jobs/{job_id}").json()
        listed = live.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
        content = live.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh").content
        zipped = live.client.get(f"/v1/jobs/{job_id}/results.zip").status_code
        return job["results_revision"], [one["revision"] for one in listed], content, zipped

    before = read()
    assert before == (0, [0], RESULT, 200)
    assert live.remake(job_id).status_code == 202
    assert read() == before
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    assert read() == before
    live.services.store.leases.fail(
        claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It broke.", retryable=True)
    )
    for _ in range(MAX_ATTEMPTS - 1):
        claim = live.services.store.leases.claim("test", 30.0)
        assert claim is not None
        problem = JobProblem(Code("broken"), "It broke.", retryable=True)
        live.services.store.leases.fail(claim.chunk_id, claim.lease_token, problem)
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    assert (job["state"], job["files_state"], job["error"]["code"]) == ("succeeded", "failed", "broken")
    assert read() == before

    again = live.client.post(f"/v1/jobs/{job_id}/retry").json()
    assert "export" in [stage["name"] for stage in again["stages"]]
    assert read() == before
    live.finish(job_id, b"edited", people=FOUND)
    assert read() == (1, [1], b"edited", 200)


def test_remade_job_is_listed_as_succeeded(live: Live, job_id: str) -> None:
    def listed(state: str) -> list[str]:
        (session,) = live.client.get("/v1/sessions").json()["sessions"]
        assert session["newest_job"] == {"id": job_id, "state": "succeeded"}
        assert len(live.client.get(f"/v1/sessions?state={state}").json()["sessions"]) == (state == "succeeded")
        return [job["id"] for job in live.client.get(f"/v1/jobs?state={state}").json()["jobs"]]

    assert live.remake(job_id).status_code == 202
    assert (listed("succeeded"), listed("queued"), listed("expired")) == ([job_id], [], [])
    canceled = live.client.post(f"/v1/jobs/{job_id}/cancel").json()
    assert (canceled["state"], canceled["files_state"], canceled["urls"]["cancel"]) == ("succeeded", "failed", None)
    assert (listed("succeeded"), listed("canceled")) == ([job_id], [])
    again = live.client.post(canceled["urls"]["retry"]).json()
    assert (again["state"], again["files_state"]) == ("succeeded", "updating")


def test_job_is_followed_until_its_files_are_current(live: Live, job_id: str) -> None:
    client = Client(live.client)
    edited = live.remake(job_id).json()
    with pytest.raises(ServiceError, match="it is updating its files and continues"):
        client.follow(edited, timeout_s=0.0)
    live.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
    with pytest.raises(ServiceError, match="The files were not made again"):
        client.follow(edited)
    live.client.post(f"/v1/jobs/{job_id}/retry").raise_for_status()
    live.finish(job_id, people=FOUND)
    assert client.follow(edited)["files_state"] == "current"


def test_downloads_name_revision_of_edits(live: Live, job_id: str) -> None:
    def names() -> list[str]:
        (listed,) = live.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
        sent = [live.client.get(path).headers["content-disposition"] for path in (listed["url"], zipped)]
        return [listed["download_name"], *(header.partition('"')[2].partition('"')[0] for header in sent)]

    zipped = f"/v1/jobs/{job_id}/results.zip"
    take = names()[0].removesuffix("_person-1.bvh")
    assert names() == [f"{take}_person-1.bvh", f"{take}_person-1.bvh", f"{take}.zip"]
    for revision in (1, 2):
        assert live.remake(job_id).status_code == 202
        live.finish(job_id, people=FOUND)
        edited = f"{take}_revision-{revision}"
        assert names() == [f"{edited}_person-1.bvh", f"{edited}_person-1.bvh", f"{edited}.zip"]


def test_visuals_are_made_on_request(live: Live) -> None:
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json={"report": True})
    job_id = str(answer.json()["id"])
    address = f"/v1/jobs/{job_id}/visuals"
    live.finish(job_id, people=FOUND, overlays={"overlay-cam_0.mp4": b"video"})
    assert live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["visuals"] is None
    problem_of(live.client.post(address), 409, "conflict")

    assert live.remake(job_id).status_code == 202
    problem_of(live.client.post(address), 409, "conflict")
    live.finish(job_id, people=FOUND)
    listed = live.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
    names = {one["name"]: (one["revision"], "revision-1" in one["download_name"]) for one in listed}
    assert names == {"overlay-cam_0.mp4": (0, False), "person-1.bvh": (1, True)}
    zipped = live.client.get(f"/v1/jobs/{job_id}/results.zip")
    assert zipped.status_code == 200
    with zipfile.ZipFile(io.BytesIO(zipped.content)) as archive:
        kept = {name.rpartition("/")[2] for name in archive.namelist()}
    assert kept == {one["download_name"] for one in listed}
    assert live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["visuals"] == address

    answer = live.client.post(address)
    assert answer.status_code == 202, answer.text
    visuals = answer.json()
    assert (visuals["kind"], visuals["state"], visuals["revision"]) == ("visuals", "queued", 1)
    assert answer.headers["location"] == f"/v1/jobs/{visuals['id']}"
    assert [stage["name"] for stage in visuals["stages"] if stage["state"] != "done"] == ["write_report"]
    assert live.client.post(address).json()["id"] == visuals["id"]
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    assert job["visuals_job"] == {"id": visuals["id"], "state": "queued"}
    assert job["urls"]["visuals"] is None
    assert [one["id"] for one in live.client.get("/v1/jobs", params={"kind": "visuals"}).json()["jobs"]] == [
        visuals["id"]
    ]
    assert visuals["id"] not in [one["id"] for one in live.client.get("/v1/jobs").json()["jobs"]]

    assert live.remake(job_id).status_code == 202
    problem_of(live.client.get(f"/v1/jobs/{visuals['id']}"), 404, "not_found")
    live.finish(job_id, people=FOUND)
