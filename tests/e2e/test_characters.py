"""A character of one's own in a running service and on its page: sent, corrected, moved, edited after its deletion."""

import json
from pathlib import Path

import pytest
from playwright.sync_api import Page, Response, expect

from pipeline.export.character.gltf_reader import decode_character
from pipeline.validation.simulation.scenes import record
from tests.e2e.browsing import axe_findings, opened, opened_by_a_stranger
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import files
from tests.pipeline.capture.synchronization.conftest import shortened
from tests.pipeline.export.character.characters import bones_of, character
from tests.pipeline.simulations import write_simulation

ROBOT = character(bones_of("mixamo"), unit=100.0, armature_scale=0.01)


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(shortened("walk", 2.0), 1, 4), folder)
    return folder


def test_stored_character_moves_as_everybody(served: Served, take: Path) -> None:
    parts = [
        ("character", ("robot.glb", ROBOT)),
        ("spec", (None, json.dumps({"bones": {"LeftToeBase": None}}).encode())),
    ]
    made = served.client.post("/v1/characters", files=parts).raise_for_status().json()
    spec = {"character": made["id"], "exports": ["bvh"]}
    sent = served.client.post("/v1/jobs", files=[*files(take), ("spec", (None, json.dumps(spec).encode()))])
    job_id = sent.raise_for_status().json()["id"]
    job = served.wait_for_end(job_id)
    assert job["state"] == "succeeded", job["error"]
    results = served.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
    of_character = {file["name"]: file for file in results if file["kind"] == "character"}
    assert {"person-1.character.glb", "person-1.character.bvh", "character.json"} <= of_character.keys()
    moved = served.client.get(f"/v1/jobs/{job_id}/results/person-1.character.glb").content
    read = decode_character("a.glb", moved)
    assert read.document["animations"]
    assert set(read.rig.names) >= set(bones_of("mixamo"))
    described = served.client.get(f"/v1/jobs/{job_id}/results/character.json").json()
    assert (described["file"], described["missing"]) == ("robot.glb", ["LeftToeBase"])
    served.client.delete(made["urls"]["self"]).raise_for_status()
    link = served.client.post(f"/v1/jobs/{job_id}/links", json={"scope": "job"}).raise_for_status().json()
    edits = [{"action": "rename", "person": 1, "name": "Anna"}]
    with opened(f"{served.client.base_url}#/jobs/{job_id}") as page:
        show_character(page)
        with opened_by_a_stranger(page, str(served.client.base_url).rstrip("/") + link["url"]) as other:
            show_character(other)
        # New files of the job: the character is loaded from them.
        with page.expect_response(is_part_of_character, timeout=180_000):
            served.edit(job_id, *edits)
        expect(page.locator(".look-label-person", has_text="Anna")).to_be_visible(timeout=180_000)
        expect(page.get_by_label("Loading the character")).to_be_hidden()
        expect(page.get_by_label("Bodies as")).to_have_value("character")
    job = served.wait_for_end(job_id)
    assert job["state"] == "succeeded", job["error"]
    described = served.client.get(f"/v1/jobs/{job_id}/results/character.json").json()
    assert "Anna" in [person["name"] for person in described["people"]]


def show_character(page: Page) -> None:
    """Choose the job's character in the viewer of an opened page."""
    expect(page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
    page.get_by_text("Show", exact=True).click()
    expect(page.get_by_label("Bodies as").locator("[value=character]")).to_be_attached()
    with page.expect_response(is_part_of_character):
        page.get_by_label("Bodies as").select_option("character")
    expect(page.locator(".look-status")).to_be_empty(timeout=180_000)
    expect(page.get_by_label("Bodies as")).to_have_value("character")


def is_part_of_character(answer: Response) -> bool:
    return "/person-1.character.glb?redirect=false" in answer.url and answer.status == 206


def test_form_takes_character_and_corrects_its_bones(served: Served, take: Path, tmp_path: Path) -> None:
    (tmp_path / "robot.glb").write_bytes(ROBOT)
    (tmp_path / "cube.glb").write_bytes(b"solid cube")
    manifest = ("manifest", (None, json.dumps({"name": "A walk"}).encode()))
    session = served.client.post("/v1/sessions", files=[*files(take), manifest]).raise_for_status().json()
    first = served.client.post(session["urls"]["jobs"], json={"frame_range": [0, 10]}).raise_for_status().json()
    assert served.wait_for_end(first["id"])["state"] == "succeeded"
    with opened(f"{served.client.base_url}#/captures", allowed=("422",)) as page:
        page.get_by_role("button", name="Run again: A walk").click()
        form = page.get_by_role("form", name="Run A walk again")
        form.get_by_role("radio", name="My own character").check()
        form.get_by_label("Or a file").set_input_files(tmp_path / "cube.glb")
        expect(form.get_by_role("alert")).to_contain_text("cube.glb", timeout=120_000)
        form.get_by_label("Or a file").set_input_files(tmp_path / "robot.glb")
        form.get_by_text("Bones", exact=True).click(timeout=120_000)
        expect(form.get_by_role("img", name="Front view of the character's bones")).to_be_visible()
        expect(form.get_by_role("combobox", name="LeftArm", exact=True)).to_have_value("mixamorig:LeftArm")
        assert axe_findings(page) == []
        form.get_by_role("combobox", name="LeftToeBase").select_option("")
        expect(form.get_by_text("Bones (missing: LeftToeBase)")).to_be_visible(timeout=120_000)
        with page.expect_response("**/v1/sessions/*/jobs") as answer:
            form.get_by_role("button", name="Reconstruct without uploading").click()
        job = answer.value.json()
        (sent,) = served.client.get("/v1/characters").json()["characters"]
        assert (job["spec"]["character"], job["spec"]["exports"]) == (sent["id"], ["bvh", "glb", "fbx"])
        # The next run begins with the same character; after its deletion with none.
        assert served.wait_for_end(job["id"])["state"] == "succeeded"
        page.get_by_role("button", name="Run again: A walk").click()
        expect(form.get_by_label("Stored character")).to_have_value(sent["id"])
        served.client.delete(sent["urls"]["self"]).raise_for_status()
        page.reload()
        page.get_by_role("button", name="Run again: A walk").click()
        expect(form.get_by_label("Stored character")).to_have_value("")
    described = served.client.get(f"/v1/jobs/{job['id']}/results/character.json").json()
    assert described["missing"] == ["LeftToeBase"]
