"""People of a job by the API: read, edited, undone, refused with the edit's place."""

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

FOUND = (
    PersonSpan(1, 0, 60, ((0, 0.0, 0.0, 1.0), (59, 2.0, 0.0, 1.0))),
    PersonSpan(2, 10, 40, ((10, 0.0, 2.0, 1.0),)),
)
ANNA = {"action": "rename", "person": 1, "name": "Anna"}
CUT = {"action": "cut", "start_frame": 5, "stop_frame": 50}


@pytest.fixture
def job_id(live: Live) -> str:
    job_id = live.job_id()
    live.finish(job_id, people=FOUND)
    return job_id


def people(live: Live, job_id: str) -> dict[str, Any]:
    answer = live.client.get(f"/v1/jobs/{job_id}/people")
    assert answer.status_code == 200, answer.text
    document: dict[str, Any] = answer.json()
    return document


def edit(live: Live, job_id: str, *edits: object, **headers: str) -> Any:
    return live.client.put(f"/v1/jobs/{job_id}/people", json={"edits": edits}, headers=headers)


def test_people_are_edited_and_edits_undone(live: Live, job_id: str) -> None:
    assert live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["people"] == f"/v1/jobs/{job_id}/people"
    before = people(live, job_id)
    assert (before["revision"], before["edits"], before["num_frames"]) == (0, [], 60)
    assert [person["name"] for person in before["people"]] == ["person-1", "person-2"]

    answer = edit(live, job_id, ANNA, CUT, {"action": "exchange", "person": 1, "other": 2, "start_frame": 20})
    assert (answer.status_code, answer.headers["location"]) == (202, f"/v1/jobs/{job_id}")
    job = answer.json()
    assert (job["state"], job["files_state"], job["revision"], job["attempt"]) == ("succeeded", "updating", 1, 2)
    ahead = [stage["name"] for stage in job["stages"] if stage["state"] != "done"]
    assert ahead == ["edit", "refit", "write_people", "export"]
    live.finish(job_id, people=FOUND)
    assert live.client.get(f"/v1/jobs/{job_id}").json()["files_state"] == "current"
    after = people(live, job_id)
    assert (after["start_frame"], after["stop_frame"]) == (5, 50)
    assert after["edits"][2] == {
        "action": "exchange", "person": 1, "other": 2, "start_frame": 20, "stop_frame": None,
    }  # fmt: skip
    assert after["people"][0] == {
        "id": 1,
        "name": "Anna",
        "pieces": [
            {"person": 1, "start_frame": 0, "stop_frame": 20},
            {"person": 2, "start_frame": 20, "stop_frame": 50},
        ],
    }

    assert edit(live, job_id).status_code == 202
    live.finish(job_id, people=FOUND)
    assert people(live, job_id) == before | {"revision": 2}


def test_old_entity_tag_is_refused(live: Live, job_id: str) -> None:
    etag = live.client.get(f"/v1/jobs/{job_id}/people").headers["etag"]
    assert live.client.get(f"/v1/jobs/{job_id}/people", headers={"If-None-Match": etag}).status_code == 304
    assert edit(live, job_id, ANNA, **{"If-Match": etag}).status_code == 202
    live.finish(job_id, people=FOUND)
    problem_of(edit(live, job_id, **{"If-Match": etag}), 412, "changed_meanwhile")
    assert people(live, job_id)["edits"] == [ANNA]


def test_edits_are_not_applied_for_unchanged_answer(live: Live, job_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert edit(live, job_id, ANNA).status_code == 202
    live.finish(job_id, people=FOUND)
    etag = live.client.get(f"/v1/jobs/{job_id}/people").headers["etag"]
    applied: list[object] = []
    monkeypatch.setattr("api.web.people.apply_edits", lambda *arguments: applied.append(arguments))
    assert live.client.get(f"/v1/jobs/{job_id}/people", headers={"If-None-Match": etag}).status_code == 304
    problem_of(edit(live, job_id, **{"If-Match": '"old"'}), 412, "changed_meanwhile")
    assert applied == []


def test_fragmented_edits_are_refused(live: Live, job_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.core.options.edited_take.MAX_PIECES", 5)
    exchange = {"action": "exchange", "person": 1, "other": 2, "start_frame": 20, "stop_frame": 30}
    (error,) = problem_of(edit(live, job_id, ANNA, exchange), 422, "invalid_request")["errors"]
    assert (error["code"], error["pointer"]) == ("edits_fragmented", "/edits/1")


def test_impossible_edits_are_named(live: Live, job_id: str) -> None:
    answer = edit(live, job_id, ANNA, {"action": "split", "person": 2, "frame": 55})
    (error,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (error["code"], error["pointer"]) == ("edit_impossible", "/edits/1/frame")
    assert "11 to 49" in error["hint"]
    assert people(live, job_id)["revision"] == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"action": "teleport", "person": 1},
        {"person": 1},
        {"action": "remove", "person": "first"},
        {"action": "remove", "person": 1, "really": True},
        {"action": "cut", "start_frame": 0},
        "remove",
    ],
)
def test_malformed_edits_are_refused(live: Live, job_id: str, wrong: object) -> None:
    (error, *_) = problem_of(edit(live, job_id, wrong), 422, "invalid_request")["errors"]
    assert error["pointer"].startswith("/edits/0")


def test_unfinished_job_has_no_people(live: Live) -> None:
    job_id = live.job_id()
    problem_of(live.client.get(f"/v1/jobs/{job_id}/people"), 409, "conflict")
    problem_of(edit(live, job_id, ANNA), 409, "conflict")
    live.client.post(f"/v1/jobs/{job_id}/cancel")


def test_edits_are_stacked(live: Live, job_id: str) -> None:
    assert edit(live, job_id, ANNA).status_code == 202
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    answer = edit(live, job_id, ANNA, CUT)
    assert (answer.status_code, answer.json()["files_state"], answer.json()["revision"]) == (202, "updating", 2)
    assert not live.services.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, 30.0)
    assert [one["action"] for one in people(live, job_id)["edits"]] == ["rename", "cut"]
    live.finish(job_id, people=FOUND)
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    assert (job["files_state"], job["revision"], job["results_revision"]) == ("current", 2, 2)
    attempts = live.client.get(f"/v1/jobs/{job_id}/attempts").json()["attempts"]
    assert [attempt["state"] for attempt in attempts] == ["succeeded", "canceled", "succeeded"]
    assert all(attempt["finished_at"] for attempt in attempts)


def test_files_stay_until_those_of_next_revision_are_made(live: Live, job_id: str) -> None:
    def read() -> tuple[int, list[int], bytes, int]:
        job = live.client.get(f"/v1/jobs/{job_id}").json()
        listed = live.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
        content = live.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh").content
        zipped = live.client.get(f"/v1/jobs/{job_id}/results.zip").status_code
        return job["results_revision"], [one["revision"] for one in listed], content, zipped

    before = read()
    assert before == (0, [0], RESULT, 200)
    assert edit(live, job_id, ANNA).status_code == 202
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


def test_edited_job_is_listed_as_succeeded(live: Live, job_id: str) -> None:
    def listed(state: str) -> list[str]:
        (session,) = live.client.get("/v1/sessions").json()["sessions"]
        assert session["newest_job"] == {"id": job_id, "state": "succeeded"}
        assert len(live.client.get(f"/v1/sessions?state={state}").json()["sessions"]) == (state == "succeeded")
        return [job["id"] for job in live.client.get(f"/v1/jobs?state={state}").json()["jobs"]]

    assert edit(live, job_id, ANNA).status_code == 202
    assert (listed("succeeded"), listed("queued"), listed("expired")) == ([job_id], [], [])
    canceled = live.client.post(f"/v1/jobs/{job_id}/cancel").json()
    assert (canceled["state"], canceled["files_state"], canceled["urls"]["cancel"]) == ("succeeded", "failed", None)
    assert (listed("succeeded"), listed("canceled")) == ([job_id], [])
    again = live.client.post(canceled["urls"]["retry"]).json()
    assert (again["state"], again["files_state"]) == ("succeeded", "updating")


def test_job_is_followed_until_its_files_are_current(live: Live, job_id: str) -> None:
    client = Client(live.client)
    edited = edit(live, job_id, ANNA).json()
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
        assert edit(live, job_id, ANNA).status_code == 202
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

    assert edit(live, job_id, ANNA).status_code == 202
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

    assert edit(live, job_id).status_code == 202
    problem_of(live.client.get(f"/v1/jobs/{visuals['id']}"), 404, "not_found")
    live.finish(job_id, people=FOUND)
