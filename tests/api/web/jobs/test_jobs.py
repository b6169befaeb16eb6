"""Jobs: creation, choices, paging, cancel, retry, attempts and deletion."""

import json
import uuid
from datetime import UTC, datetime

import pytest

from pipeline.core.errors import Problem, SessionRefused
from pipeline.core.findings import Finding
from pipeline.core.options.config import CHOICES
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import CAMERA_DISAGREES, INPUT_ERROR, MIRRORED_WORLD, NOBODY_FOUND
from pipeline.core.problems.request_codes import INTERNAL_ERROR
from pipeline.core.problems.session_codes import VIDEO_TRUNCATED
from tests.api.conftest import Live, form, problem_of
from worker.run.planning import plan_job
from worker.run.problems import job_problem
from worker.store.model.job_records import JobProblem
from worker.store.repositories.jobs import Jobs
from worker.store.spec import JobSpec


def test_job_from_its_creation_to_its_end(live: Live) -> None:
    session_id = live.session_id()
    answer = live.client.post(f"/v1/sessions/{session_id}/jobs", json={"method": "tracking"})
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}" == job["urls"]["self"]
    assert int(answer.headers["retry-after"]) >= 1
    assert uuid.UUID(job["id"]).version == 7
    assert (job["session_id"], job["state"], job["attempt"]) == (session_id, "queued", 1)
    planned = plan_job(live.services.store.sessions.get(session_id), JobSpec(method="tracking"))
    totals = {stage.name: sum(chunk.unit_count for chunk in stage.chunks) for stage in planned}
    assert {stage["name"]: stage["total"] for stage in job["stages"]} == totals
    assert (totals["look"], totals["detect"]) == (24, 120)  # 60 frames of two cameras
    assert job["created_at"].endswith("Z")
    assert abs((datetime.now(UTC) - datetime.fromisoformat(job["created_at"])).total_seconds()) < 60

    live.finish(job["id"])
    done = live.client.get(f"/v1/jobs/{job['id']}").json()
    assert (done["state"], done["progress"], done["error"]) == ("succeeded", 1.0, None)
    assert [stage["fraction"] for stage in done["stages"]] == [1] * len(totals)


def test_job_without_body_is_as_by_default(live: Live) -> None:
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs")
    defaults = json.loads(json.dumps({name: choice.default for name, choice in CHOICES.items()}))
    others = {"character": None, "apply_edits": True, "priority": "normal", "keep_videos": True, "callback_url": None}
    assert answer.json()["spec"] == defaults | others


def test_cutoff_that_frame_rate_can_not_have_is_refused_at_once(live: Live) -> None:
    session_id = live.session_id()
    half_rate_hz = live.client.get(f"/v1/sessions/{session_id}").json()["preflight"]["timebase"]["frame_rate_hz"] / 2
    spec = {"smoothing": "butterworth", "cutoff_hz": half_rate_hz}
    problem = problem_of(live.client.post(f"/v1/sessions/{session_id}/jobs", json=spec), 422, "invalid_request")
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("cutoff_range", "/cutoff_hz")]
    num_sessions = len(live.client.get("/v1/sessions").json()["sessions"])
    parts = [*form(), ("spec", (None, json.dumps(spec)))]
    problem = problem_of(live.client.post("/v1/jobs", files=parts), 422, "invalid_request")
    assert [item["pointer"] for item in problem["errors"]] == ["/spec/cutoff_hz"]
    assert len(live.client.get("/v1/sessions").json()["sessions"]) == num_sessions
    lower = {"smoothing": "butterworth", "cutoff_hz": half_rate_hz - 0.1}
    assert live.client.post(f"/v1/sessions/{session_id}/jobs", json=lower).status_code == 202


def test_formats_are_named_once_and_have_to_be_known(live: Live) -> None:
    session_id = live.session_id()
    for exports, pointer in ((["bvh", "bvh"], "/exports"), (["obj"], "/exports/0")):
        answer = live.client.post(f"/v1/sessions/{session_id}/jobs", json={"exports": exports})
        problem = problem_of(answer, 422, "invalid_request")
        assert [item["pointer"] for item in problem["errors"]] == [pointer]
    answer = live.client.post(f"/v1/sessions/{session_id}/jobs", json={"exports": []})
    assert answer.json()["spec"]["exports"] == []


def test_priority_is_one_of_three(live: Live) -> None:
    session_id = live.session_id()
    problem = problem_of(
        live.client.post(f"/v1/sessions/{session_id}/jobs", json={"priority": "urgent"}), 422, "invalid_request"
    )
    assert [item["pointer"] for item in problem["errors"]] == ["/priority"]
    assert problem["errors"][0]["message"] == "priority must be one of preview, normal, batch."
    normal = live.client.post(f"/v1/sessions/{session_id}/jobs").json()
    first = live.client.post(f"/v1/sessions/{session_id}/jobs", json={"priority": "preview"}).json()
    assert first["spec"]["priority"] == "preview"
    places = [live.client.get(f"/v1/jobs/{job['id']}").json()["queue_position"] for job in (first, normal)]
    assert places == [1, 2]


def test_session_and_job_in_one_call(live: Live) -> None:
    parts = [*form(), ("spec", ("", json.dumps({"method": "tracking"}))), ("manifest", (None, b'{"name": "Take 3"}'))]
    answer = live.client.post("/v1/jobs", files=parts)
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == answer.json()["urls"]["self"]
    session = live.client.get(answer.json()["urls"]["session"]).json()
    assert session["name"] == "Take 3"


def test_sync_of_job_defaults_to_that_of_its_session(live: Live) -> None:
    manifest = ("manifest", (None, json.dumps({"sync": "auto"}).encode()))
    session = live.client.post("/v1/sessions", files=[*form(), manifest]).json()
    assert session["sync"] == "auto"
    assert live.client.get(session["urls"]["self"]).json()["sync"] == "auto"
    jobs = session["urls"]["jobs"]
    for spec, sync in (({}, "auto"), ({"method": "clustering"}, "auto"), ({"sync": "declared"}, "declared")):
        job = live.client.post(jobs, json=spec).json()
        assert job["spec"]["sync"] == sync
        assert ("synchronize" in [stage["name"] for stage in job["stages"]]) == (sync == "auto")
    at_once = live.client.post("/v1/jobs", files=[*form(), manifest]).json()
    assert at_once["spec"]["sync"] == "auto"
    other = live.client.post("/v1/jobs", files=[*form(), manifest, ("spec", (None, b'{"sync": "declared"}'))]).json()
    assert other["spec"]["sync"] == "declared"
    usual = live.client.get(f"/v1/sessions/{live.session_id()}").json()
    assert usual["sync"] == "declared"
    assert live.client.post(usual["urls"]["jobs"]).json()["spec"]["sync"] == "declared"


def test_timeline_of_job_defaults_to_its_session(live: Live) -> None:
    manifest = ("manifest", (None, b'{"timeline": "person"}'))
    session = live.client.post("/v1/sessions", files=[*form(), manifest]).json()
    assert session["timeline"] == "person"
    for spec, timeline in (({}, "person"), ({"exports": ["glb"]}, "person"), ({"timeline": "take"}, "take")):
        assert live.client.post(session["urls"]["jobs"], json=spec).json()["spec"]["timeline"] == timeline
    at_once = [*form(), manifest, ("spec", (None, b'{"timeline": "take"}'))]
    assert live.client.post("/v1/jobs", files=at_once).json()["spec"]["timeline"] == "take"
    wrong = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, b'{"timeline": "people"}'))])
    (item,) = problem_of(wrong, 422, "invalid_request")["errors"]
    assert item["pointer"] == "/manifest/timeline"
    usual = live.client.get(f"/v1/sessions/{live.session_id()}").json()
    assert usual["timeline"] == "take"
    assert live.client.post(usual["urls"]["jobs"]).json()["spec"]["timeline"] == "take"


def test_one_call_names_all_problems_of_spec_manifest_and_files(live: Live) -> None:
    parts = [
        ("videos", ("cam_0.mp4", b"WRONG")),
        ("calibration", ("calibration.toml", b"")),
        ("spec", (None, b'{"method": "magic", "colour": 1}')),
        ("manifest", (None, b'{"name": ""}')),
    ]
    problem = problem_of(live.client.post("/v1/jobs", files=parts), 422, "invalid_request")
    assert {item["pointer"] for item in problem["errors"]} == {
        "/spec/method", "/spec/colour", "/manifest/name", "/videos/0", "/calibration",
    }  # fmt: skip
    assert live.kept() == []
    assert live.client.get("/v1/sessions").json()["sessions"] == []


def test_session_goes_when_its_job_can_not_be_made(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(Jobs, "add", fail)
    problem_of(live.client.post("/v1/jobs", files=form()), 500, "internal_error")
    assert live.kept() == []
    assert live.client.get("/v1/sessions").json()["sessions"] == []


def test_pages_hold_every_job_once(live: Live) -> None:
    session_id = live.session_id()
    made = [live.client.post(f"/v1/sessions/{session_id}/jobs").json()["id"] for _ in range(5)]
    found: list[str] = []
    cursor = ""
    for _ in range(4):
        page = live.client.get(f"/v1/jobs?limit=2{cursor}").json()
        found += [job["id"] for job in page["jobs"]]
        if page["next_cursor"] is None:
            break
        cursor = f"&cursor={page['next_cursor']}"
    assert found == made[::-1]


def test_jobs_by_state(live: Live) -> None:
    first, second = live.job_id(), live.job_id()
    live.client.post(f"/v1/jobs/{first}/cancel")
    by_state = {
        state: [job["id"] for job in live.client.get(f"/v1/jobs?state={state}").json()["jobs"]]
        for state in ("queued", "canceled", "failed")
    }
    assert by_state == {"queued": [second], "canceled": [first], "failed": []}


def test_cancel_and_retry(live: Live) -> None:
    job_id = live.job_id()
    problem_of(live.client.post(f"/v1/jobs/{job_id}/retry"), 409, "conflict")
    answer = live.client.post(f"/v1/jobs/{job_id}/cancel")
    assert (answer.status_code, answer.json()["state"]) == (202, "canceled")
    problem_of(live.client.post(f"/v1/jobs/{job_id}/cancel"), 409, "conflict")
    again = live.client.post(f"/v1/jobs/{job_id}/retry")
    assert (again.status_code, again.json()["state"], again.json()["attempt"]) == (202, "queued", 2)
    assert again.headers["location"] == f"/v1/jobs/{job_id}"


def test_failed_job_says_why(live: Live) -> None:
    job_id = live.job_id()
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    problem = JobProblem(
        VIDEO_TRUNCATED, "The video ends early.", stage="detect", camera="cam_1", hint="Copy it again."
    )
    live.services.store.leases.fail(claim.chunk_id, claim.lease_token, problem)
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    assert job["state"] == "failed"
    assert job["error"] == {
        "code": "video_truncated", "detail": "The video ends early.", "stage": "detect", "camera": "cam_1",
        "hint": "Copy it again.", "retryable": False, "errors": [],
    }  # fmt: skip


def test_refused_session_has_its_errors(live: Live) -> None:
    job_id = live.job_id()
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    problems = [
        Problem(CAMERA_DISAGREES, "The camera sees people elsewhere.", camera="cam_1", hint="Calibrate it again."),
        Problem(MIRRORED_WORLD, "The world is mirrored."),
    ]
    live.services.store.leases.fail(
        claim.chunk_id, claim.lease_token, job_problem(SessionRefused(problems), "check_session")
    )
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    error = job["error"]
    assert (job["state"], job["urls"]["retry"], error["code"]) == ("failed", None, "session_refused")
    assert (error["stage"], error["retryable"], error["hint"]) == ("check_session", False, SessionRefused.advice)
    assert error["detail"] == "cam_1: The camera sees people elsewhere. The world is mirrored."
    assert error["errors"] == [
        {
            "code": "camera_disagrees",
            "message": problems[0].message,
            "file": None,
            "camera": "cam_1",
            "hint": "Calibrate it again.",
        },
        {"code": "mirrored_world", "message": problems[1].message, "file": None, "camera": None, "hint": None},
    ]
    forced = live.client.post(job["urls"]["session"] + "/jobs", json=job["spec"] | {"force": True})
    assert forced.raise_for_status().json()["spec"]["force"] is True


def test_certain_camera_errors_refuse_job_at_once(live: Live) -> None:
    """The unit is wrong whatever the people show; they tell whether the world is upside down."""
    session = live.client.post("/v1/sessions", files=form(content=b"MILES")).raise_for_status().json()
    jobs = session["urls"]["jobs"]
    (error,) = problem_of(live.client.post(jobs, json={}), 422, "invalid_request")["errors"]
    assert (error["code"], error["message"], error["hint"]) == ("world_unit", "Check it.", "Mend it.")
    assert live.client.post(jobs, json={"force": True}).status_code == 202
    (error,) = problem_of(live.client.post("/v1/jobs", files=form(content=b"MILES")), 422, "invalid_request")["errors"]
    assert error["code"] == "world_unit"
    spec = ("spec", ("", json.dumps({"force": True})))
    assert live.client.post("/v1/jobs", files=[*form(content=b"MILES"), spec]).status_code == 202


def test_attempts_say_why_each_failed(live: Live) -> None:
    job_id = live.job_id()
    claim = live.services.store.leases.claim("worker", 60.0)
    assert claim is not None
    again = JobProblem(INTERNAL_ERROR, "It failed inside.", stage="look", retryable=True)
    live.services.store.leases.fail(claim.chunk_id, claim.lease_token, again)
    claim = live.services.store.leases.claim("worker", 60.0)
    assert claim is not None
    live.services.store.leases.fail(
        claim.chunk_id, claim.lease_token, JobProblem(INPUT_ERROR, "It is broken.", camera="left")
    )
    live.client.post(f"/v1/jobs/{job_id}/retry").raise_for_status()
    url = live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["attempts"]
    first, second = live.client.get(url).raise_for_status().json()["attempts"]
    assert (first["attempt"], first["state"], first["error"]["camera"]) == (1, "failed", "left")
    assert [(one["stage"], one["chunk"], one["chunk_try"], one["reason"]["code"]) for one in first["failures"]] == [
        ("look", 0, 1, "internal_error"),
        ("look", 0, 2, "input_error"),
    ]
    assert (second["attempt"], second["state"], second["error"], second["failures"]) == (2, "queued", None, [])


def test_delete_waits_for_end(live: Live) -> None:
    job_id = live.job_id()
    problem_of(live.client.delete(f"/v1/jobs/{job_id}"), 409, "conflict")
    live.finish(job_id)
    assert any(path.name == "person-1.bvh" for path in live.kept())
    assert live.client.delete(f"/v1/jobs/{job_id}").status_code == 204
    assert not any(path.name == "person-1.bvh" for path in live.kept())
    problem_of(live.client.get(f"/v1/jobs/{job_id}"), 404, "not_found")


def test_progress_of_running_stage(live: Live) -> None:
    job_id = live.job_id()
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    live.services.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 6, 30.0)
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    assert (job["state"], job["stages"][0]["done"], job["stages"][0]["fraction"]) == ("running", 6, 0.25)


@pytest.mark.parametrize(
    ("spec", "status"),
    [
        ({"frame_range": [0, 60]}, 202),
        ({"frame_range": [59, 60]}, 202),
        ({"frame_range": [0, 61]}, 422),
        ({"frame_range": [10, 10]}, 422),
        ({"frame_range": [20, 10]}, 422),
        ({"frame_range": [-1, 10]}, 422),
        ({"frame_range": [1]}, 422),
        ({"output_rate_hz": 30}, 202),
        ({"output_rate_hz": 0.5}, 422),
        ({"output_rate_hz": 241}, 422),
        ({"people": 1}, 202),
        ({"people": 0}, 422),
        ({"people": "some"}, 422),
    ],
)
def test_ranges_of_frames_and_numbers_of_people(live: Live, spec: dict[str, object], status: int) -> None:
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json=spec)
    assert answer.status_code == status, answer.text
    if status == 202:
        assert answer.json()["spec"].items() >= spec.items()
    else:
        problem = problem_of(answer, 422, "invalid_request")
        assert all(item["pointer"].startswith(f"/{next(iter(spec))}") for item in problem["errors"])


def test_urls_offer_what_makes_sense_in_each_state(live: Live) -> None:
    def offered(job_id: str) -> tuple[bool, bool]:
        urls = live.client.get(f"/v1/jobs/{job_id}").json()["urls"]
        return urls["cancel"] is not None, urls["retry"] is not None

    def fail(retryable: bool) -> str:
        job_id = live.job_id()
        claim = live.services.store.leases.claim("test", 30.0)
        assert claim is not None
        problem = JobProblem(Code("broken"), "It is broken.", retryable=retryable)
        while claim is not None:
            live.services.store.leases.fail(claim.chunk_id, claim.lease_token, problem)
            claim = live.services.store.leases.claim("test", 30.0)
        assert live.client.get(f"/v1/jobs/{job_id}").json()["state"] == "failed"
        return job_id

    done = live.job_id()
    assert offered(done) == (True, False)
    running = live.services.store.leases.claim("test", 30.0)
    assert running is not None
    assert offered(done) == (True, False)
    live.services.store.leases.release(running.chunk_id, running.lease_token)
    live.finish(done)
    assert offered(done) == (False, False)
    assert offered(fail(retryable=True)) == (False, True)
    hopeless = fail(retryable=False)
    assert offered(hopeless) == (False, False)
    # The operator allows more.
    live.client.post(f"/v1/jobs/{hopeless}/retry").raise_for_status()
    live.client.post(f"/v1/jobs/{hopeless}/cancel").raise_for_status()
    assert offered(hopeless) == (False, True)


def test_warnings_of_result_are_wherever_job_is(live: Live) -> None:
    job_id = live.job_id()
    before = live.client.get(f"/v1/jobs/{job_id}").json()
    assert [warning["message"] for warning in before["warnings"]] == ["The cameras are close together."]
    nobody = Finding(NOBODY_FOUND, "Nobody was found.")
    live.finish(job_id, warnings=[nobody])
    listed = live.client.get("/v1/jobs").json()["jobs"][0]
    with live.client.stream("GET", f"/v1/jobs/{job_id}/events") as stream:
        (data,) = [line.removeprefix("data: ") for line in stream.iter_lines() if line.startswith("data: ")]
    for job in (live.client.get(f"/v1/jobs/{job_id}").json(), listed, json.loads(data)):
        assert job["state"] == "succeeded"
        assert job["warnings"] == [*before["warnings"], nobody.to_json()]
