"""Edits of a session by the API: read, made, undone, applied to its runs, refused with the edit's place."""

import json
from collections import Counter
from random import Random
from typing import Any

import pytest

from pipeline.core.options.edits import PersonSpan
from tests.api.conftest import Live, problem_of

FOUND = (
    PersonSpan(1, 0, 60, ((0, 0.0, 0.0, 1.0), (59, 5.9, 0.0, 1.0))),
    PersonSpan(2, 10, 40, ((10, 0.0, 3.0, 1.0),)),
)
# Another run of the same session numbers the people otherwise, and finds them a little beside.
FOUND_AGAIN = (
    PersonSpan(1, 0, 50, ((0, 0.0, 3.1, 1.0),)),
    PersonSpan(2, 0, 60, ((0, 0.1, 0.0, 1.0), (59, 6.0, 0.0, 1.0))),
)
ANNA = {"action": "rename", "person": 1, "name": "Anna"}
PLACED_ANNA = ANNA | {"person": {"frame": 30, "place_m": [3.0, 0.0, 1.0]}}
CUT = {"action": "cut", "start_frame": 5, "stop_frame": 50}


class EditedCapture:
    """A session with a finished job."""

    def __init__(self, live: Live) -> None:
        self.live, self.job_id = live, live.job_id()
        live.finish(self.job_id, people=FOUND)
        self.session_id = self.job["session_id"]
        self.address = f"/v1/sessions/{self.session_id}/edits"

    @property
    def job(self) -> dict[str, Any]:
        return dict(self.live.client.get(f"/v1/jobs/{self.job_id}").json())

    def read(self, job_id: str | None = None) -> dict[str, Any]:
        answer = self.live.client.get(self.address, params={"job_id": job_id or self.job_id})
        assert answer.status_code == 200, answer.text
        return dict(answer.json())

    def edit(self, *edits: object, **headers: str) -> Any:
        body = {"edits": edits, "job_id": self.job_id}
        return self.live.client.put(self.address, json=body, headers=headers)

    def run_again(self, found: tuple[PersonSpan, ...] = FOUND_AGAIN, **spec: object) -> dict[str, Any]:
        answer = self.live.client.post(f"/v1/sessions/{self.session_id}/jobs", json=spec)
        assert answer.status_code == 202, answer.text
        self.live.finish(answer.json()["id"], people=found)
        return dict(self.live.client.get(answer.json()["urls"]["self"]).json())


@pytest.fixture
def capture(live: Live) -> EditedCapture:
    return EditedCapture(live)


def test_people_are_edited_and_edits_undone(capture: EditedCapture) -> None:
    assert capture.job["urls"]["edits"] == f"{capture.address}?job_id={capture.job_id}"
    before = capture.read()
    assert (before["revision"], before["edits"], before["run"]["num_frames"]) == (0, [], 60)
    assert [person["name"] for person in before["run"]["people"]] == ["person-1", "person-2"]

    answer = capture.edit(ANNA, CUT, {"action": "exchange", "person": 1, "other": 2, "start_frame": 20})
    assert (answer.status_code, answer.json()["revision"]) == (200, 1)
    job = capture.job
    assert (job["state"], job["files_state"], job["revision"], job["edits_revision"]) == ("succeeded", "updating", 1, 1)
    ahead = [stage["name"] for stage in job["stages"] if stage["state"] != "done"]
    assert ahead == ["edit", "refit", "write_people", "export"]
    capture.live.finish(capture.job_id, people=FOUND)
    assert capture.job["files_state"] == "current"
    after = capture.read()
    assert after == answer.json()
    assert after["edits"] == [
        PLACED_ANNA,
        CUT,
        {
            "action": "exchange",
            "person": {"frame": 19, "place_m": [1.9, 0.0, 1.0]},
            "other": {"frame": 20, "place_m": [0.0, 3.0, 1.0]},
            "start_frame": 20,
            "stop_frame": None,
        },
    ]
    run = after["run"]
    assert (run["start_frame"], run["stop_frame"]) == (5, 50)
    assert run["people"][0] == {
        "id": 1,
        "name": "Anna",
        "sex": None,
        "mass_kg": None,
        "pieces": [
            {"person": 1, "start_frame": 0, "stop_frame": 20},
            {"person": 2, "start_frame": 20, "stop_frame": 50},
        ],
    }
    assert [(outcome["person"], outcome["problem"]) for outcome in run["outcomes"]] == [
        (1, None),
        (None, None),
        (1, None),
    ]

    assert capture.edit().status_code == 200
    capture.live.finish(capture.job_id, people=FOUND)
    assert capture.read() == before | {"revision": 2}


def test_later_run_applies_edits_and_tells_what_does_not_apply(capture: EditedCapture) -> None:
    gone = {"action": "remove", "person": {"frame": 12, "place_m": [9.0, 9.0, 1.0]}}
    assert capture.edit(ANNA, gone, {"action": "split", "person": 2, "frame": 30}).status_code == 200
    capture.live.finish(capture.job_id, people=FOUND)
    job = capture.run_again(method="clustering", exports=["glb"])
    assert (job["revision"], job["edits_revision"], job["spec"]["apply_edits"]) == (0, 1, True)
    run = capture.read(job["id"])["run"]
    assert [(person["id"], person["name"]) for person in run["people"]] == [
        (1, "person-1"),
        (2, "Anna"),
        (3, "person-3"),
    ]
    assert run["people"][2]["pieces"] == [{"person": 1, "start_frame": 30, "stop_frame": 50}]
    anna, told, split = run["outcomes"]
    assert (anna["person"], split["person"], anna["problem"], split["problem"]) == (2, 1, None, None)
    assert "within 0.5 m of (9.00, 9.00, 1.00) at frame 12" in told["problem"]["message"]


def test_run_of_some_frames_is_numbered_as_the_session(capture: EditedCapture) -> None:
    assert capture.edit({"action": "split", "person": 1, "frame": 30}, CUT).status_code == 200
    capture.live.finish(capture.job_id, people=FOUND)
    job = capture.run_again((PersonSpan(1, 0, 40, ((0, 2.0, 0.0, 1.0), (39, 5.9, 0.0, 1.0))),), frame_range=[20, 60])
    run = capture.read(job["id"])["run"]
    assert (run["first_frame"], run["num_frames"], run["start_frame"], run["stop_frame"]) == (20, 40, 20, 50)
    assert [person["pieces"] for person in run["people"]] == [
        [{"person": 1, "start_frame": 20, "stop_frame": 30}],
        [{"person": 1, "start_frame": 30, "stop_frame": 60}],
    ]


def test_run_can_leave_edits_out(capture: EditedCapture) -> None:
    assert capture.edit(ANNA).status_code == 200
    capture.live.finish(capture.job_id, people=FOUND)
    job = capture.run_again(FOUND, apply_edits=False)
    assert (job["edits_revision"], job["newest_edits_revision"]) == (None, 1)
    run = capture.read(job["id"])["run"]
    assert ([person["name"] for person in run["people"]], run["outcomes"]) == (["person-1", "person-2"], [])
    body = {"edits": [], "job_id": job["id"]}
    problem_of(capture.live.client.put(capture.address, json=body), 409, "conflict")
    assert capture.live.remake(job["id"], apply_edits=True).json()["edits_revision"] == 1
    capture.live.finish(job["id"], people=FOUND)
    assert capture.read(job["id"])["run"]["people"][0]["name"] == "Anna"


def test_places_need_no_run(capture: EditedCapture) -> None:
    answer = capture.live.client.put(capture.address, json={"edits": [PLACED_ANNA]})
    assert (answer.status_code, answer.json()["run"], answer.json()["revision"]) == (200, None, 1)
    job = capture.job
    assert (job["files_state"], job["edits_revision"], job["newest_edits_revision"]) == ("current", 0, 1)
    answer = capture.live.client.put(capture.address, json={"edits": [PLACED_ANNA, ANNA]})
    (error,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (error["code"], error["pointer"]) == ("edit_impossible", "/edits/1/person")


def test_old_entity_tag_is_refused(capture: EditedCapture) -> None:
    client, live = capture.live.client, capture.live
    etag = client.get(capture.address).headers["etag"]
    assert client.get(capture.address, headers={"If-None-Match": etag}).status_code == 304
    assert capture.edit(ANNA, **{"If-Match": etag}).status_code == 200
    live.finish(capture.job_id, people=FOUND)
    problem_of(capture.edit(**{"If-Match": etag}), 412, "changed_meanwhile")
    assert capture.read()["edits"] == [PLACED_ANNA]


def test_edits_are_not_applied_for_unchanged_answer(capture: EditedCapture, monkeypatch: pytest.MonkeyPatch) -> None:
    etag = capture.edit(ANNA).headers["etag"]
    capture.live.finish(capture.job_id, people=FOUND)
    applied: list[object] = []
    monkeypatch.setattr("api.web.edits.apply_edits", lambda *arguments: applied.append(arguments))
    answer = capture.live.client.get(
        capture.address, params={"job_id": capture.job_id}, headers={"If-None-Match": etag}
    )
    assert answer.status_code == 304
    problem_of(capture.edit(**{"If-Match": '"old"'}), 412, "changed_meanwhile")
    assert applied == []


def test_impossible_edits_are_named(capture: EditedCapture, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*edits: object) -> tuple[str, str, str]:
        (error,) = problem_of(capture.edit(*edits), 422, "invalid_request")["errors"]
        return error["code"], error["pointer"], error["hint"]

    code, pointer, hint = refused(ANNA, {"action": "split", "person": 2, "frame": 55})
    assert (code, pointer, "11 to 49" in hint) == ("edit_impossible", "/edits/1/frame", True)
    assert refused(ANNA, ANNA | {"person": 2})[:2] == ("edit_impossible", "/edits/1/name")
    assert refused(PLACED_ANNA | {"name": "a\nb"})[:2] == ("edit_impossible", "/edits/0/name")
    monkeypatch.setattr("pipeline.core.options.edited_take.MAX_PIECES", 5)
    exchange = {"action": "exchange", "person": 1, "other": 2, "start_frame": 20, "stop_frame": 30}
    assert refused(ANNA, exchange)[:2] == ("edits_fragmented", "/edits/1")
    assert capture.read()["revision"] == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"action": "teleport", "person": 1},
        {"person": 1},
        {"action": "remove", "person": "first"},
        {"action": "remove", "person": {"frame": 1, "place_m": [1.0, 2.0]}},
        {"action": "remove", "person": {"frame": 1, "place_m": [1.0, 2.0, float("inf")]}},
        {"action": "remove", "person": 1, "really": True},
        {"action": "cut", "start_frame": 0},
        "remove",
    ],
)
def test_malformed_edits_are_refused(capture: EditedCapture, wrong: object) -> None:
    content = json.dumps({"edits": [wrong], "job_id": capture.job_id}).encode()
    answer = capture.live.client.put(capture.address, content=content, headers={"Content-Type": "application/json"})
    (error, *_) = problem_of(
        answer, answer.status_code, "invalid_request" if answer.status_code == 422 else "malformed_json"
    )["errors"]
    assert error["pointer"].startswith("/edits/0")


FRAMES = {"start_frame": 5, "stop_frame": 9}
CORRECTIONS = [
    {"action": "key", "person": 1, "joint": "left_wrist", "frame": 30, "place_m": [3.0, 0.5, 1.0]},
    {"action": "ignore_detections", "person": 1, "camera": "cam-1", "part": "left_arm", **FRAMES},
    {"action": "place_detection", "person": 1, "camera": "cam-1", "joint": "nose", "frame": 3, "place_px": [9.5, 8.0]},
    {"action": "exchange_sides", "person": 1, "part": "arms", **FRAMES},
    {"action": "contact", "person": 1, "limb": "left_foot", "stands": True, **FRAMES},
    {"action": "accept", "person": 1, "kind": "error", **FRAMES},
    {"action": "accept", "camera": "cam-1", "kind": "camera_disagrees", **FRAMES},
]


def test_corrections_of_joints_are_kept(capture: EditedCapture) -> None:
    answer = capture.edit(*CORRECTIONS)
    assert answer.status_code == 200, answer.text
    kept = capture.read()["edits"]
    assert [edit["action"] for edit in kept] == [edit["action"] for edit in CORRECTIONS]
    assert kept[0]["place_m"] == [3.0, 0.5, 1.0]
    assert kept[0]["person"] == {"frame": 30, "place_m": [3.0, 0.0, 1.0]}


@pytest.mark.parametrize(
    ("number", "wrong"),
    [
        (0, {"place_m": [3.0, "NaN", 1.0]}),
        (0, {"place_m": [3.0, 1.0]}),
        (0, {"joint": "x" * 300}),
        (0, {"frame": -1}),
        (1, {"stop_frame": 5}),
        (1, {"start_frame": 500, "stop_frame": 600}),
        (3, {"part": "left"}),
        (4, {"limb": "head"}),
        (5, {"kind": "camera_disagrees"}),
        (5, {"camera": "cam-1"}),
        (6, {"kind": "error"}),
        (6, {"person": 1}),
    ],
)
def test_wrong_corrections_are_refused(capture: EditedCapture, number: int, wrong: dict[str, object]) -> None:
    answer = capture.edit(CORRECTIONS[number] | wrong)
    assert problem_of(answer, 422, "invalid_request")["errors"][0]["pointer"].startswith("/edits/0")


@pytest.mark.slow
def test_random_lists_are_kept_or_refused(capture: EditedCapture) -> None:
    random, statuses = Random(71), Counter[int]()  # noqa: S311 - no secret
    odd = [0, 1, 2, 99, -1, 1e9, None, "", "nose", "x" * 250, [1.0, 2.0, 3.0], {"frame": 3, "place_m": [0.3, 0.0, 1.0]}]
    known = [*CORRECTIONS, ANNA, CUT, {"action": "split", "person": 1, "frame": 20}, {"action": "remove", "person": 2}]
    for _ in range(200):
        edits = [dict(edit) for edit in random.choices(known, k=random.choice(range(5)))]
        for edit in edits:
            if random.random() < 0.2:
                edit[random.choice([*edit, "other", "stop_frame"])] = random.choice(odd)
        answer = capture.edit(*edits)
        statuses[answer.status_code] += 1
    assert set(statuses) == {200, 422}
    assert min(statuses.values()) > 40, statuses


def test_unfinished_job_has_no_people(live: Live) -> None:
    job = live.client.get(f"/v1/jobs/{live.job_id()}").json()
    address = f"/v1/sessions/{job['session_id']}/edits"
    problem_of(live.client.get(address, params={"job_id": job["id"]}), 409, "conflict")
    problem_of(live.client.put(address, json={"edits": [ANNA], "job_id": job["id"]}), 409, "conflict")
    problem_of(live.remake(job["id"]), 409, "conflict")
    assert job["urls"]["edits"] is None
    live.client.post(f"/v1/jobs/{job['id']}/cancel")


def test_job_of_another_session_is_unknown(live: Live, capture: EditedCapture) -> None:
    address = f"/v1/sessions/{live.session_id()}/edits"
    problem_of(live.client.get(address, params={"job_id": capture.job_id}), 404, "not_found")
    problem_of(live.client.put(address, json={"edits": [], "job_id": capture.job_id}), 404, "not_found")


def test_edits_are_stacked(capture: EditedCapture) -> None:
    live = capture.live
    assert capture.edit(ANNA).status_code == 200
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    assert capture.edit(ANNA, CUT).status_code == 200
    assert (capture.job["files_state"], capture.job["revision"]) == ("updating", 2)
    assert not live.services.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, 30.0)
    assert [edit["action"] for edit in capture.read()["edits"]] == ["rename", "cut"]
    live.finish(capture.job_id, people=FOUND)
    job = capture.job
    assert (job["files_state"], job["revision"], job["results_revision"]) == ("current", 2, 2)
    attempts = live.client.get(f"/v1/jobs/{capture.job_id}/attempts").json()["attempts"]
    assert [attempt["state"] for attempt in attempts] == ["succeeded", "canceled", "succeeded"]
    assert all(attempt["finished_at"] for attempt in attempts)
