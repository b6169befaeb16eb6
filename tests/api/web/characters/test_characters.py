"""Characters: sent as GLB, VRM or FBX, their bones recognised and corrected, downloaded, deleted."""

import hashlib
import json
from collections.abc import Callable, Iterator
from typing import Any
from uuid import uuid4

import pytest

from api.web.settings import Settings
from api.web.uploads.routes import VERSION
from pipeline.export.character.gltf_reader import decode_character
from tests.api.conftest import Live, problem_of, running
from tests.pipeline.export.character.characters import bones_of, character, glb, odd_bones, vrm
from tests.pipeline.export.character.fbx.fbx_characters import fbx_of

MIXAMO = character(bones_of("mixamo"), unit=100.0, armature_scale=0.01)


@pytest.fixture(scope="module")
def strict(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Running service that takes characters of some size."""
    with running(make_settings(max_character_bytes=200_000)) as live:
        yield live


def send(
    live: Live, content: bytes = MIXAMO, name: str = "robot.glb", spec: dict[str, Any] | None = None, **options: Any
) -> Any:
    parts: list[tuple[str, Any]] = [("character", (name, content))]
    if spec is not None:
        parts.append(("spec", (None, json.dumps(spec).encode())))
    return live.client.post("/v1/characters", files=parts, **options)


def bones(answer: dict[str, Any]) -> dict[str, str | None]:
    return {joint["joint"]: joint["bone"] for joint in answer["joints"]}


def test_file_is_read_and_kept(strict: Live) -> None:
    answer = send(strict)
    assert answer.status_code == 201, answer.text
    made = answer.json()
    assert answer.headers["location"] == made["urls"]["self"]
    facts = {key: made[key] for key in ("name", "file", "format", "method", "num_bytes", "num_bones")}
    assert facts == {
        "name": "robot.glb",
        "file": "robot.glb",
        "format": "GLB",
        "method": "names",
        "num_bytes": len(MIXAMO),
        "num_bones": 52,
    }
    assert 165.0 < made["stature"] < 180.0  # The file is in centimetres.
    by_joint = {joint["joint"]: joint for joint in made["joints"]}
    assert by_joint["LeftArm"] == {
        "joint": "LeftArm",
        "bone": "mixamorig:LeftArm",
        "recognised_by": "names",
        "is_required": True,
    }
    assert by_joint["Hips"]["recognised_by"] == "shape"
    assert (made["corrections"], made["at_rest"]) == ({}, [])
    places = {bone["bone"]: bone for bone in made["skeleton"]}
    assert places["mixamorig:LeftForeArm"]["parent"] == "mixamorig:LeftArm"
    assert places["mixamorig:Head"]["position"][2] > places["mixamorig:Hips"]["position"][2] > 50.0
    assert strict.client.get(made["urls"]["self"]).json() == made


def test_fbx_is_read_in_metres(strict: Live) -> None:
    content = fbx_of(decode_character("a.glb", MIXAMO))
    made = send(strict, content, "robot.fbx").json()
    assert (made["format"], made["method"], made["num_bones"]) == ("FBX", "names", 52)
    assert 1.65 < made["stature"] < 1.8
    assert bones(made) == bones(send(strict).json())
    answer = strict.client.get(made["urls"]["file"])
    assert (answer.content, answer.headers["content-type"]) == (content, "application/octet-stream")


def test_lists_are_paged_and_have_no_bones(strict: Live) -> None:
    made = [send(strict).json() for _ in range(2)]
    first = strict.client.get("/v1/characters", params={"limit": 1}).json()
    (newest,) = first["characters"]
    assert newest == {key: made[1][key] for key in newest}
    assert "joints" not in newest
    second = strict.client.get("/v1/characters", params={"limit": 1, "cursor": first["next_cursor"]}).json()
    assert [listed["id"] for listed in second["characters"]] == [made[0]["id"]]


@pytest.mark.parametrize("version", ["0.x", "1.0"])
def test_table_of_vrm_counts(strict: Live, version: str) -> None:
    made = send(strict, vrm(version), "robot.vrm").json()
    assert (made["format"], made["method"]) == (f"VRM {version}", "vrm")
    ways = {joint["joint"]: joint["recognised_by"] for joint in made["joints"]}
    assert (ways["LeftArm"], ways["LeftHandThumb1"]) == ("vrm", None)
    assert bones(made)["LeftHandThumb1"] is None
    assert made["at_rest"]


def test_shape_counts_where_names_tell_nothing(strict: Live) -> None:
    made = send(strict, character(odd_bones())).json()
    assert made["method"] == "shape"
    assert bones(made)["LeftArm"].startswith("Knochen ")  # type: ignore[union-attr]


def test_bones_are_stated_with_file(strict: Live) -> None:
    made = send(strict, spec={"name": "Robot", "bones": {"LeftShoulder": None, "Hips": "mixamorig:Spine"}}).json()
    assert (made["name"], made["method"]) == ("Robot", "table")
    assert bones(made)["LeftShoulder"] is None
    assert bones(made)["Hips"] == "mixamorig:Spine"
    ways = {joint["joint"]: joint["recognised_by"] for joint in made["joints"]}
    assert (ways["Hips"], ways["LeftShoulder"], ways["LeftArm"]) == ("table", None, "names")
    assert "mixamorig:LeftShoulder" in made["at_rest"]


def test_bones_are_corrected_and_corrections_taken_back(strict: Live) -> None:
    made = send(strict).json()
    path, tag = made["urls"]["self"], strict.client.get(made["urls"]["self"]).headers["etag"]
    answer = strict.client.patch(path, json={"bones": {"LeftShoulder": None}}, headers={"If-Match": tag})
    assert answer.status_code == 200, answer.text
    corrected = answer.json()
    assert corrected == strict.client.get(path).json()
    assert (corrected["corrections"], corrected["method"]) == ({"LeftShoulder": None}, "table")
    assert "mixamorig:LeftShoulder" in corrected["at_rest"]
    stale = strict.client.patch(path, json={"bones": {}}, headers={"If-Match": tag})
    problem_of(stale, 412, "changed_meanwhile")
    assert strict.client.patch(path, json={"bones": {}}).json() == made


def test_wrong_corrections_are_named(strict: Live) -> None:
    path = send(strict).json()["urls"]["self"]
    before = strict.client.get(path).json()
    wrong = {"LeftArm": "no such bone", "RightArm": "nor this"}
    problem = problem_of(strict.client.patch(path, json={"bones": wrong}), 422, "invalid_request")
    found = [(item["code"], item["pointer"]) for item in problem["errors"]]
    assert found == [("bones_invalid", "/bones")] * 2
    problem = problem_of(send(strict, spec={"bones": {"Tail": "x"}}), 422, "invalid_request")
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("bones_invalid", "/spec/bones")]
    upside_down = {"LeftArm": "mixamorig:LeftHand", "LeftHand": "mixamorig:LeftArm"}
    problem = problem_of(strict.client.patch(path, json={"bones": upside_down}), 422, "invalid_request")
    assert {item["code"] for item in problem["errors"]} == {"character_bones"}
    assert strict.client.get(path).json() == before


def test_rename(strict: Live) -> None:
    made = send(strict).json()
    path = made["urls"]["self"]
    assert strict.client.patch(path, json={"name": "Roboter é"}).json() == made | {"name": "Roboter é"}
    assert strict.client.patch(path, json={}).json() == made | {"name": "Roboter é"}
    problem_of(strict.client.patch(path, json={"name": ""}), 422, "invalid_request")
    problem_of(strict.client.patch(path, json={"size": 1}), 422, "invalid_request")
    problem_of(strict.client.patch(f"/v1/characters/{uuid4()}", json={"name": "x"}), 404, "not_found")


def test_file_is_downloaded_as_it_was_sent(strict: Live) -> None:
    made = send(strict, name="robot é.glb").json()
    answer = strict.client.get(made["urls"]["file"])
    assert answer.content == MIXAMO
    assert answer.headers["etag"] == f'"{made["sha256"]}"' == f'"{hashlib.sha256(MIXAMO).hexdigest()}"'
    assert answer.headers["content-type"] == "model/gltf-binary"
    assert "robot%20%C3%A9.glb" in answer.headers["content-disposition"]
    part = strict.client.get(made["urls"]["file"], headers={"Range": "bytes=0-3"})
    assert (part.status_code, part.content) == (206, b"glTF")


def test_deletion_takes_file_along(strict: Live) -> None:
    made = send(strict).json()
    stored = strict.settings.data_dir / "artifacts" / "characters" / made["id"] / "file"
    assert stored.read_bytes() == MIXAMO
    assert strict.client.delete(made["urls"]["self"]).status_code == 204
    assert not stored.exists()
    for path in made["urls"].values():
        problem_of(strict.client.get(path), 404, "not_found")
    problem_of(strict.client.delete(made["urls"]["self"]), 404, "not_found")


def test_upload_is_used_once(strict: Live) -> None:
    headers = {"Tus-Resumable": VERSION, "Upload-Length": str(len(MIXAMO)), "Upload-Metadata": "filename cm9ib3QuZ2xi"}
    place = strict.client.post("/v1/uploads", headers=headers).headers["location"]
    body = {"character": place.rpartition("/")[2], "name": "Robot"}
    problem = problem_of(strict.client.post("/v1/characters", json=body), 422, "invalid_request")
    assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("upload_unfinished", "/character")]
    piece = {"Tus-Resumable": VERSION, "Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    assert strict.client.patch(place, content=MIXAMO, headers=piece).status_code == 204
    wrong = strict.client.post("/v1/characters/from-uploads", json=body | {"bones": {"LeftArm": "x"}})
    assert [item["pointer"] for item in problem_of(wrong, 422, "invalid_request")["errors"]] == ["/bones"]
    made = strict.client.post("/v1/characters/from-uploads", json=body)
    assert made.status_code == 201, made.text
    assert (made.json()["name"], made.json()["file"]) == ("Robot", "robot.glb")
    again = problem_of(strict.client.post("/v1/characters", json=body), 422, "invalid_request")
    assert [item["code"] for item in again["errors"]] == ["upload_unknown"]


def test_repeated_request_makes_one_character(strict: Live) -> None:
    headers = {"Idempotency-Key": str(uuid4())}
    first, again = (send(strict, headers=headers) for _ in range(2))
    assert first.json() == again.json()
    assert again.headers["idempotent-replayed"] == "true"


def test_file_without_character_is_refused(strict: Live) -> None:
    def codes(answer: Any) -> list[tuple[str, str]]:
        return [(item["code"], item["pointer"]) for item in problem_of(answer, 422, "invalid_request")["errors"]]

    assert codes(send(strict, b"solid cube")) == [("character_format", "/character")]
    assert codes(send(strict, b"; FBX 6.1.0 project file")) == [("character_format", "/character")]
    assert codes(send(strict, b"Kaydara FBX Binary  ")) == [("character_unreadable", "/character")]
    assert codes(send(strict, MIXAMO[:2000])) == [("character_unreadable", "/character")]
    table = glb({"asset": {"version": "2.0"}, "nodes": [{"name": "Table"}]}, b"")
    assert codes(send(strict, table)) == [("character_bones", "/character")]
    missing = strict.client.post("/v1/characters", files=[("spec", (None, b"{}"))])
    assert codes(missing) == [("missing_part", "/character")]
    twice = strict.client.post("/v1/characters", files=[("character", ("a.glb", MIXAMO))] * 2)
    assert codes(twice) == [("duplicate_part", "/character")]
    large = send(strict, bytes(200_001))
    assert [item["code"] for item in problem_of(large, 413, "content_too_large")["errors"]] == ["part_too_large"]
    assert all("/characters/" in str(path) for path in strict.kept() if "artifacts" in path.parts)


def test_lost_or_damaged_file_is_named(strict: Live) -> None:
    made = send(strict).json()
    stored = strict.settings.data_dir / "artifacts" / "characters" / made["id"] / "file"
    stored.write_bytes(MIXAMO[:-1] + b"x")
    problem_of(strict.client.patch(made["urls"]["self"], json={"bones": {}}), 500, "artifact_damaged")
    stored.unlink()
    problem_of(strict.client.get(made["urls"]["file"]), 410, "expired")
    problem_of(strict.client.patch(made["urls"]["self"], json={"bones": {}}), 410, "expired")


@pytest.mark.slow
def test_quota_of_bytes_counts_characters(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_character_bytes=200_000, max_tenant_bytes=100_000)) as live:
        made = send(live).json()
        used = live.client.get("/v1/caller").json()["quotas"]["stored_bytes"]["used"]
        assert len(MIXAMO) < used < 2 * len(MIXAMO)
        send(live)
        problem_of(send(live), 403, "quota_exceeded")
        assert live.client.delete(made["urls"]["self"]).status_code == 204
        assert send(live).status_code == 201
