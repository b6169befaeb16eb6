"""Characters that jobs move: each job keeps a copy of its own."""

import json
from collections.abc import Callable, Iterator
from typing import Any
from uuid import uuid4

import pytest

from api.web.settings import Settings
from pipeline.core.options.edits import PersonSpan
from tests.api.conftest import Live, form, problem_of, running
from tests.pipeline.export.character.characters import bones_of, character
from worker.store.repositories.work.expiry import remove_files

ROBOT = character(bones_of("mixamo"))


@pytest.fixture(scope="module")
def moving(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings(max_character_bytes=200_000)) as live:
        yield live


def add(live: Live, **spec: Any) -> dict[str, Any]:
    parts = [("character", ("robot.glb", ROBOT)), ("spec", (None, json.dumps(spec).encode()))]
    made: dict[str, Any] = live.client.post("/v1/characters", files=parts).raise_for_status().json()
    return made


def stages(job: dict[str, Any]) -> list[str]:
    return [stage["name"] for stage in job["stages"]]


def test_finished_job_gets_copy_of_another_character(moving: Live) -> None:
    job_id = moving.job_id()
    moving.finish(job_id, people=[PersonSpan(1, 0, 60)])
    folder = moving.settings.data_dir / "artifacts" / "jobs" / job_id / "character"
    for number in (1, 2):
        made = add(moving)
        answer = moving.remake(job_id, character=made["id"])
        assert answer.status_code == 202, answer.text
        assert (answer.json()["spec"]["character"], "retarget_character" in stages(answer.json())) == (made["id"], True)
        moving.finish(job_id, people=[PersonSpan(1, 0, 60)])
        remove_files(moving.services.store.removals, moving.services.artifacts)
        assert [path.read_bytes() for path in folder.rglob("file")] == [ROBOT], number
    problem_of(moving.remake(job_id, character=str(uuid4())), 422, "invalid_request")
    assert len(list(folder.rglob("file"))) == 1


def test_job_keeps_copy_of_its_character(moving: Live) -> None:
    made = add(moving, bones={"LeftShoulder": None})
    address = f"/v1/sessions/{moving.session_id()}/jobs"
    answer = moving.client.post(address, json={"character": made["id"]})
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert job["spec"]["character"] == made["id"]
    assert "retarget_character" in stages(job)
    assert "retarget_character" not in stages(moving.client.post(address, json={}).json())
    copy = moving.settings.data_dir / "artifacts" / "jobs" / job["id"] / "character" / "file"
    assert copy.read_bytes() == ROBOT
    assert moving.client.delete(made["urls"]["self"]).status_code == 204
    stored = moving.services.store.jobs.get(job["id"]).character
    assert stored is not None
    assert (stored.character_id, stored.file.name) == (made["id"], "robot.glb")
    assert stored.corrections == {"LeftShoulder": None}
    again = moving.client.post(f"/v1/jobs/{job['id']}/cancel").json()
    again = moving.client.post(f"/v1/jobs/{job['id']}/retry").json()
    assert "retarget_character" in stages(again)
    assert copy.read_bytes() == ROBOT
    moving.client.post(f"/v1/jobs/{job['id']}/cancel").raise_for_status()
    assert moving.client.delete(f"/v1/jobs/{job['id']}").status_code == 204
    assert not copy.exists()


def test_session_with_its_job_names_character_too(moving: Live) -> None:
    made = add(moving)
    parts = [*form(), ("spec", (None, json.dumps({"character": made["id"]})))]
    answer = moving.client.post("/v1/jobs", files=parts)
    assert answer.status_code == 202, answer.text
    assert "retarget_character" in stages(answer.json())


def test_unknown_character_is_refused(moving: Live) -> None:
    unknown = {"character": str(uuid4())}
    problem = problem_of(
        moving.client.post(f"/v1/sessions/{moving.session_id()}/jobs", json=unknown), 422, "invalid_request"
    )
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("character_unknown", "/character")]
    parts = [*form(), ("spec", (None, json.dumps(unknown)))]
    problem = problem_of(moving.client.post("/v1/jobs", files=parts), 422, "invalid_request")
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("character_unknown", "/spec/character")]
    malformed = moving.client.post(f"/v1/sessions/{moving.session_id()}/jobs", json={"character": "robot"})
    assert [item["pointer"] for item in problem_of(malformed, 422, "invalid_request")["errors"]] == ["/character"]


def test_lost_file_makes_no_job(moving: Live) -> None:
    made = add(moving)
    (moving.settings.data_dir / "artifacts" / "characters" / made["id"] / "file").unlink()
    before = {path for path in moving.kept() if "jobs" in path.parts}
    answer = moving.client.post(f"/v1/sessions/{moving.session_id()}/jobs", json={"character": made["id"]})
    problem_of(answer, 410, "expired")
    assert {path for path in moving.kept() if "jobs" in path.parts} == before


def test_copies_count_for_quota(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_character_bytes=200_000, max_tenant_bytes=100_000)) as live:
        made = add(live)
        session = live.session_id()

        def used() -> int:
            return int(live.client.get("/v1/caller").json()["quotas"]["stored_bytes"]["used"])

        before = used()
        job = live.client.post(f"/v1/sessions/{session}/jobs", json={"character": made["id"]}).raise_for_status().json()
        assert used() == before + len(ROBOT)
        second = live.client.post(f"/v1/sessions/{session}/jobs", json={"character": made["id"]})
        problem_of(second, 403, "quota_exceeded")
        assert {path.parts[-3] for path in live.kept() if "jobs" in path.parts} == {job["id"]}
