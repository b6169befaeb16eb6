"""Calibrations: files in any format, given to sessions by id, downloaded in others, deleted."""

import hashlib
import json
import tomllib
from collections.abc import Callable, Iterator
from typing import Any
from uuid import uuid4

import pytest

from api.web.calibrations.schemas import MEDIA_TYPES
from api.web.settings import Settings
from pipeline.calibration.program_files import PROGRAM_FORMATS
from tests.api.conftest import Live, form, problem_of, running
from tests.warm_programs import WarmPrograms

CAMERA = {
    "name": "cam_0",
    "size_px": [640, 480],
    "matrix": [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]],
    "distortion": [0.1, -0.05, 0.0, 0.0],
    "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
    "translation_m": [0.25, 1.5, 4.0],
}
ENDINGS = {"multicap": "json", "anipose": "toml", "caliscope": "toml", "opencv": "yml"}
CALIBRATION = json.dumps({"schema_version": 1, "cameras": [CAMERA, CAMERA | {"name": "cam_1"}]}).encode()


@pytest.fixture(scope="module")
def strict(make_settings: Callable[..., Settings], warm_programs: WarmPrograms) -> Iterator[Live]:
    """Running service with the real check of files."""
    command = warm_programs.command("pipeline.capture.preflight")
    with running(make_settings(preflight_command=command)) as live:
        yield live


def send(live: Live, content: bytes = CALIBRATION, name: str = "studio.json", **spec: Any) -> Any:
    parts: list[tuple[str, Any]] = [("calibration", (name, content))]
    return live.client.post("/v1/calibrations", files=[*parts, ("spec", (None, json.dumps(spec).encode()))])


def test_file_is_read_and_kept(strict: Live) -> None:
    answer = send(strict)
    assert answer.status_code == 201, answer.text
    calibration = answer.json()
    assert answer.headers["location"] == calibration["urls"]["self"]
    assert (calibration["name"], calibration["method"], calibration["state"]) == ("studio.json", "file", "ready")
    assert calibration["source"]["format"] == "Multicap JSON"
    assert calibration["cameras"][0] == CAMERA | {"lens": "standard", "position_m": [-0.25, -4.0, 1.5]}
    assert strict.client.get(calibration["urls"]["self"]).json() == calibration
    assert strict.client.get("/v1/calibrations").json()["calibrations"][0] == calibration


def test_equal_files_have_equal_digests(strict: Live) -> None:
    other = json.dumps({"schema_version": 1, "cameras": [CAMERA, CAMERA | {"name": "cam_2"}]}).encode()
    first, again, different = (send(strict, content).json() for content in (CALIBRATION, CALIBRATION, other))
    assert first["sha256"] == again["sha256"] != different["sha256"]
    assert first["sha256"] == hashlib.sha256(strict.client.get(first["urls"]["file"]).content).hexdigest()


def test_rename(strict: Live) -> None:
    path = send(strict).json()["urls"]["self"]
    before = strict.client.get(path)
    answer = strict.client.patch(path, json={"name": "Studio é"}, headers={"If-Match": before.headers["etag"]})
    assert answer.status_code == 200, answer.text
    assert answer.json() == before.json() | {"name": "Studio é"} == strict.client.get(path).json()
    stale = strict.client.patch(path, json={"name": "Hall"}, headers={"If-Match": before.headers["etag"]})
    problem_of(stale, 412, "changed_meanwhile")
    download = strict.client.get(answer.json()["urls"]["file"]).headers["content-disposition"]
    assert download == "attachment; filename*=utf-8''Studio%20%C3%A9.json"
    problem_of(strict.client.patch(path, json={"name": ""}), 422, "invalid_request")
    problem_of(strict.client.patch(f"/v1/calibrations/{uuid4()}", json={"name": "x"}), 404, "not_found")


def test_it_is_downloaded_in_other_formats(strict: Live) -> None:
    urls = send(strict, name="studio \u00e9.json").json()["urls"]
    own = strict.client.get(urls["file"])
    assert own.json()["cameras"][1]["name"] == "cam_1"
    assert own.headers["content-disposition"] == "attachment; filename*=utf-8''studio%20%C3%A9.json.json"
    toml = strict.client.get(urls["file"], params={"format": "caliscope"})
    assert toml.headers["content-type"].startswith("application/toml")
    assert tomllib.loads(toml.text)["cameras"]["0"]["matrix"] == CAMERA["matrix"]
    anipose = strict.client.get(urls["file"], params={"format": "anipose"})
    assert tomllib.loads(anipose.text)["cam_0"]["matrix"] == CAMERA["matrix"]
    assert strict.client.get(urls["file"], params={"format": "opencv"}).text.startswith("%YAML:1.0")
    problem_of(strict.client.get(urls["file"], params={"format": "pickle"}), 422, "invalid_request")


def test_every_format_is_read_back(strict: Live) -> None:
    """Files for other programs, sent again, have the same cameras."""
    assert {name: known.endings[0].removeprefix(".") for name, known in PROGRAM_FORMATS.items()} | {
        "opencv": "yml"
    } == {name: ending for name, (ending, _) in MEDIA_TYPES.items()}
    calibration = send(strict).json()
    for file_format, (ending, media_type) in MEDIA_TYPES.items():
        answer = strict.client.get(calibration["urls"]["file"], params={"format": file_format})
        assert answer.headers["content-type"].startswith(media_type)
        again = send(strict, answer.content, f"rig.{ending}")
        assert again.status_code == 201, (file_format, again.text)
        for found, expected in zip(again.json()["cameras"], calibration["cameras"], strict=True):
            assert found["position_m"] == pytest.approx(expected["position_m"], abs=1e-5), file_format
            assert found["matrix"][1] == pytest.approx(expected["matrix"][1]), file_format


def test_format_that_cannot_hold_lens_or_size_is_refused(strict: Live) -> None:
    cameras = [CAMERA | {"lens": "fisheye"}, CAMERA | {"name": "cam_1", "size_px": None}]
    path = send(strict, json.dumps({"schema_version": 1, "cameras": cameras[:1]}).encode()).json()["urls"]["file"]
    problem = problem_of(strict.client.get(path, params={"format": "qca"}), 422, "invalid_request")
    assert [(error["code"], error["camera"]) for error in problem["errors"]] == [("unsupported_lens", "cam_0")]
    path = send(strict, json.dumps({"schema_version": 1, "cameras": cameras}).encode()).json()["urls"]["file"]
    problem = problem_of(strict.client.get(path, params={"format": "colmap"}), 422, "invalid_request")
    assert [(error["code"], error["camera"]) for error in problem["errors"]] == [("invalid_size", "cam_1")]
    assert strict.client.get(path).status_code == 200


def test_rig_is_planned(strict: Live) -> None:
    room = {"length_m": 8, "width_m": 6, "cameras": 6, "people": 3}
    plan = strict.client.get("/v1/calibrations/plan", params=room).json()
    assert 0.5 < plan["covered"] < 1.0
    assert len(plan["places"]) == 9
    assert plan["places"][4]["views"] > 5
    assert plan["picture"].startswith("<svg")
    calibration_id = send(strict).json()["id"]
    stand = strict.client.get("/v1/calibrations/plan", params=room | {"calibration_id": calibration_id}).json()
    # Both cameras have one place.
    assert (stand["covered"], {place["error_mm"] for place in stand["places"]}) == (0.0, {None})
    problem_of(strict.client.get("/v1/calibrations/plan", params={"length_m": 0, "cameras": 1}), 422, "invalid_request")
    unknown = room | {"calibration_id": str(uuid4())}
    problem_of(strict.client.get("/v1/calibrations/plan", params=unknown), 404, "not_found")


def test_fisheye_stays_one(strict: Live) -> None:
    fisheye = CAMERA | {"lens": "fisheye"}
    calibration = send(strict, json.dumps({"schema_version": 1, "cameras": [fisheye]}).encode()).json()
    assert calibration["cameras"][0]["lens"] == "fisheye"
    for file_format, ending in ENDINGS.items():
        answer = strict.client.get(calibration["urls"]["file"], params={"format": file_format})
        again = send(strict, answer.content, f"rig.{ending}")
        (camera,) = again.json()["cameras"]
        assert (camera["lens"], camera["distortion"]) == ("fisheye", CAMERA["distortion"])
        assert camera["position_m"] == pytest.approx(calibration["cameras"][0]["position_m"])


def test_units_count_where_format_does_not_state_them(strict: Live) -> None:
    short = {
        "name": "a",
        "width": 640,
        "height": 480,
        "K": CAMERA["matrix"],
        "R": CAMERA["rotation"],
        "t": [0, 0, 2000],
    }
    content = json.dumps({"cameras": [short]}).encode()
    cameras = send(strict, content, units="mm").json()["cameras"]
    assert cameras[0]["translation_m"] == [0.0, 0.0, 2.0]


def test_axis_that_points_up_is_asked_for_and_turned(strict: Live) -> None:
    """Cameras that stand upright in a world whose y points down."""
    upright = CAMERA | {
        "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "translation_m": [0.0, 1.5, 4.0],
    }
    cameras = [upright, upright | {"name": "cam_1", "translation_m": [3.0, 1.5, 4.0]}]
    content = json.dumps({"schema_version": 1, "cameras": cameras}).encode()
    (warning,) = send(strict, content).json()["warnings"]
    assert "the calibration's up axis may be -Y" in warning["message"]
    assert "`up`" in warning["hint"]
    turned = send(strict, content, up="-y").json()
    assert (turned["warnings"], turned["source"]["axes"]) == ([], "-Y up, as stated: turned to Z up")
    assert [camera["position_m"] for camera in turned["cameras"]] == [[0.0, -4.0, 1.5], [-3.0, -4.0, 1.5]]
    problem = problem_of(send(strict, content, up="w"), 422, "invalid_request")
    assert [error["pointer"] for error in problem["errors"]] == ["/spec/up"]


def test_all_problems_of_file_are_named(strict: Live) -> None:
    content = CALIBRATION.replace(b'"matrix": [[500.0', b'"matrix": [[-500.0')
    problem = problem_of(send(strict, content), 422, "invalid_request")
    assert [(one["camera"], one["field"], one["pointer"], one["file"]) for one in problem["errors"]] == [
        ("cam_0", "matrix", "/calibration", "studio.json"),
        ("cam_1", "matrix", "/calibration", "studio.json"),
    ]


@pytest.mark.parametrize(
    ("spec", "pointers"),
    [
        ({"method": "board"}, {"/videos", "/spec/board", "/calibration"}),
        ({"method": "file", "board": "chessboard:9x6:0.06"}, {"/spec/board"}),
        ({"method": "guess"}, {"/spec/method"}),
        ({"board": "paper"}, {"/spec/board"}),
    ],
)
def test_each_method_says_what_it_needs(strict: Live, spec: dict[str, Any], pointers: set[str]) -> None:
    problem = problem_of(send(strict, **spec), 422, "invalid_request")
    assert {one["pointer"] for one in problem["errors"]} == pointers


def test_session_names_calibration(live: Live) -> None:
    calibration_id = live.services.store.calibrations.add("Studio", {}, "{}").id
    parts = [*form()[:2], ("calibration_id", (None, calibration_id.encode()))]
    session = live.client.post("/v1/sessions", files=parts)
    assert session.status_code == 201, session.text
    kinds = {file["kind"]: file["name"] for file in session.json()["files"]}
    assert kinds["calibration"] == f"calibration-{calibration_id}.json"
    job = live.client.post("/v1/jobs", files=parts)
    assert job.status_code == 202, job.text
    assert job.json()["kind"] == "reconstruction"


def test_session_has_one_calibration(live: Live) -> None:
    calibration_id = live.services.store.calibrations.add("Studio", {}, "{}").id
    both = [*form(), ("calibration_id", (None, calibration_id.encode()))]
    problem = problem_of(live.client.post("/v1/sessions", files=both), 422, "invalid_request")
    assert [one["pointer"] for one in problem["errors"]] == ["/calibration_id"]
    unknown = [*form()[:2], ("calibration_id", (None, str(uuid4()).encode()))]
    problem = problem_of(live.client.post("/v1/sessions", files=unknown), 422, "invalid_request")
    assert [one["code"] for one in problem["errors"]] == ["calibration_unknown"]
    wrong = [*form()[:2], ("calibration_id", (None, b"\xff"))]
    problem = problem_of(live.client.post("/v1/sessions", files=wrong), 422, "invalid_request")
    assert [one["code"] for one in problem["errors"]] == ["wrong_format"]


def test_deleted_calibration_is_gone_and_its_sessions_stay(live: Live) -> None:
    calibration_id = live.services.store.calibrations.add("Studio", {}, "{}").id
    parts = [*form()[:2], ("calibration_id", (None, calibration_id.encode()))]
    session = live.client.post("/v1/sessions", files=parts).json()
    address = f"/v1/calibrations/{calibration_id}"
    assert live.client.delete(address).status_code == 204
    problem_of(live.client.get(address), 404, "not_found")
    problem_of(live.client.delete(address), 404, "not_found")
    assert live.client.get(session["urls"]["self"]).status_code == 200


def test_calibrations_come_in_pages(live: Live) -> None:
    ids = [live.services.store.calibrations.add(f"{k}", {}, '{"cameras": []}').id for k in range(3)]
    first = live.client.get("/v1/calibrations", params={"limit": 2}).json()
    second = live.client.get("/v1/calibrations", params={"cursor": first["next_cursor"]}).json()
    assert [one["id"] for one in (*first["calibrations"], *second["calibrations"])][:3] == ids[::-1]
