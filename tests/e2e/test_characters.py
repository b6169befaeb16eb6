"""A character of one's own in a service that runs: sent, moved as everybody, edited after its deletion."""

import json
from pathlib import Path

import pytest

from pipeline.character.gltf_reader import decode_character
from pipeline.simulation.scenes import record
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import files
from tests.pipeline.character.characters import bones_of, character
from tests.pipeline.simulations import write_simulation
from tests.pipeline.synchronization.conftest import shortened

ROBOT = character(bones_of("mixamo"), unit=100.0, armature_scale=0.01)


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(shortened("walk", 2.0), 1, 4), folder)
    return folder


def test_a_stored_character_moves_as_everybody(served: Served, take: Path) -> None:
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
    served.client.delete(made["links"]["self"]).raise_for_status()
    edits = [{"action": "rename", "person": 1, "name": "Anna"}]
    served.client.patch(f"/v1/jobs/{job_id}/people", json={"edits": edits}).raise_for_status()
    job = served.wait_for_end(job_id)
    assert job["state"] == "succeeded", job["error"]
    described = served.client.get(f"/v1/jobs/{job_id}/results/character.json").json()
    assert "Anna" in [person["name"] for person in described["people"]]
