"""Errors of wrong fields: one entry for each field, with its pointer and a sentence with all allowed values."""

import json
import re
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from api.web.errors import MAX_LISTED, MEANINGS
from api.web.http.bodies.validation import FieldPlaces
from api.web.sessions.manifest import CameraManifest, Manifest
from api.web.settings import KIB, Settings
from pipeline.core.options import rules
from pipeline.core.options.requirements import requirement
from pipeline.core.parsing import FRAME_RATE_HZ, OFFSET_S
from tests.api.conftest import Live, form, problem_of, running
from worker.store.spec import JobSpec

SPEC_FIELDS = ", ".join(JobSpec.model_fields)
PEOPLE = "people must be auto, or a whole number from 1 to 1000."
CUTOFF = "cutoff_hz must be a number above 0 and of at most 1000."
CALLBACK = (
    "callback_url must be a URL of at most 2000 characters such as https://portal.example/hooks/multicap, or null."
)
# Words that only messages of the libraries contain.
FOREIGN = re.compile(r"Input should|Extra inputs|Field required|Value error|String should|Unable to|should have at")


def wrong_fields(live: Live, spec: object) -> list[tuple[str, str, str]]:
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json=spec)
    assert not FOREIGN.search(answer.text)
    errors = problem_of(answer, 422, "invalid_request")["errors"]
    return [(item["pointer"], item["code"], item["message"]) for item in errors]


@pytest.mark.parametrize(
    ("spec", "pointer", "code", "message"),
    [
        ({"people": 0}, "/people", "invalid_value", PEOPLE),
        ({"people": "many"}, "/people", "invalid_value", PEOPLE),
        ({"people": None}, "/people", "invalid_value", PEOPLE),
        ({"people": 2.5}, "/people", "invalid_value", PEOPLE),
        ({"people": True}, "/people", "invalid_value", PEOPLE),
        ({"people": "2"}, "/people", "invalid_value", PEOPLE),
        ({"cutoff_hz": True}, "/cutoff_hz", "wrong_type", CUTOFF),
        ({"cutoff_hz": "6"}, "/cutoff_hz", "wrong_type", CUTOFF),
        (
            {"output_rate_hz": True},
            "/output_rate_hz",
            "wrong_type",
            "output_rate_hz must be a number from 1 to 240, or null.",
        ),
        (
            {"frame_range": [False, 9]},
            "/frame_range/0",
            "wrong_type",
            "frame_range[0] must be a whole number of at least 0.",
        ),
        ({"method": 3}, "/method", "value_not_allowed", "method must be one of tracking, clustering."),
        ({"cutoff_hz": "fast"}, "/cutoff_hz", "wrong_type", CUTOFF),
        (
            {"output_rate_hz": 0.5},
            "/output_rate_hz",
            "out_of_range",
            "output_rate_hz must be a number from 1 to 240, or null.",
        ),
        (
            {"frame_range": [1]},
            "/frame_range",
            "wrong_length",
            "frame_range must be a list of 2 items, each item a whole number of at least 0, or null.",
        ),
        (
            {"frame_range": [1, -1]},
            "/frame_range/1",
            "out_of_range",
            "frame_range[1] must be a whole number of at least 0.",
        ),
        (
            {"exports": ["bvh", "zip"]},
            "/exports/1",
            "value_not_allowed",
            "exports[1] must be one of bvh, glb, fbx, usd, vrma, trc, c3d, csv, npz, angles, mot, forces, osim, rerun.",
        ),
        ({"exports": ["bvh", "bvh"]}, "/exports", "export_repeated", "exports must name each format once."),
        ({"colour": 1}, "/colour", "unknown_field", f"There is no field colour here. The fields are {SPEC_FIELDS}."),
        ({"callback_url": "ftp://x"}, "/callback_url", "wrong_format", CALLBACK),
        (
            {"callback_url": "https://x:99999/"},
            "/callback_url",
            "callback_invalid",
            "The port of the address must be a number from 1 to 65535.",
        ),
        ([], "", "wrong_type", f"The body must be an object with some of the fields {SPEC_FIELDS}."),
    ],
)  # fmt: skip
def test_each_field_once_with_all_that_is_allowed(
    live: Live, spec: object, pointer: str, code: str, message: str
) -> None:
    wrong = wrong_fields(live, spec)
    assert (pointer, code, message) in wrong
    assert len({found[0] for found in wrong}) == 1


def test_parts_of_form(live: Live) -> None:
    manifest = {"cameras": [{"offset_s": "x"}, 3], "units": "inch", "name": "a\0"}
    parts = [*form(), ("manifest", (None, json.dumps(manifest))), ("spec", (None, "{"))]
    answer = live.client.post("/v1/jobs", files=parts)
    assert not FOREIGN.search(answer.text)
    assert {
        (item["pointer"], item["code"]): item["message"]
        for item in problem_of(answer, 422, "invalid_request")["errors"]
    } == {
        ("/manifest/cameras/0/name", "missing_field"): (
            "cameras[0].name is missing. It must be a text of 1 to 64 characters such as cam_1."
        ),
        ("/manifest/cameras/0/offset_s", "wrong_type"): "cameras[0].offset_s must be a number from -86400 to 86400.",
        ("/manifest/cameras/1", "wrong_type"): (
            "cameras[1] must be an object with some of the fields name, file, more_files, offset_s, offset_std_s, rate."
        ),
        ("/manifest/units", "value_not_allowed"): "units must be one of m, cm, mm, in, cmu, or null.",
        ("/manifest/name", "control_characters"): "Control characters are not allowed.",
        ("/spec", "malformed_json"): "The part spec is not JSON.",
    }


def test_whole_numbers_are_numbers(live: Live) -> None:
    spec = {"cutoff_hz": 6, "output_rate_hz": 50, "frame_range": [0, 9.0], "people": 2.0}
    made = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json=spec).raise_for_status().json()
    assert {name: made["spec"][name] for name in spec} == spec
    manifest = {"frame_rate_hz": True, "cameras": [{"name": "a", "offset_s": "1", "rate": False}]}
    answer = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, json.dumps(manifest)))])
    assert {(item["pointer"], item["code"]) for item in problem_of(answer, 422, "invalid_request")["errors"]} == {
        ("/manifest/frame_rate_hz", "wrong_type"),
        ("/manifest/cameras/0/offset_s", "wrong_type"),
        ("/manifest/cameras/0/rate", "wrong_type"),
    }
    cameras = [{"name": "cam_0", "offset_s": 1, "rate": 50}]
    for sent in ({"frame_rate_hz": 50}, {"cameras": cameras}):
        answer = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, json.dumps(sent)))])
        assert answer.status_code == 201, answer.text


def test_sessions_of_uploads(live: Live) -> None:
    body = {"videos": ["cam_0.mp4"], "spec": {"people": "many"}}
    answer = live.client.post("/v1/jobs", json=body)
    assert not FOREIGN.search(answer.text)
    video, people = answer.json()["errors"]
    assert (video["pointer"], video["code"]) == ("/videos/0", "wrong_format")
    assert video["message"].startswith(
        "videos[0] must be an id (a UUID), or a URL of at most 4000 characters such as https:"
    )
    assert (people["pointer"], people["code"], people["message"]) == ("/spec/people", "invalid_value", PEOPLE)


@pytest.mark.parametrize(
    ("query", "code", "words"),
    [
        ("limit=ten", "wrong_type", "a whole number from 1 to 200"),
        ("cursor=1", "wrong_format", "an id (a UUID)"),
        ("session_id=1", "wrong_format", "an id (a UUID)"),
    ],
)
def test_wrong_parameters_are_named(live: Live, query: str, code: str, words: str) -> None:
    name = query.partition("=")[0]
    (found,) = problem_of(live.client.get(f"/v1/jobs?{query}"), 422, "invalid_request")["errors"]
    assert (found["pointer"], found["code"]) == (f"/query/{name}", code)
    assert found["message"] == f"The parameter {name} must be {words}."


def test_wrong_headers_are_named(live: Live) -> None:
    answer = live.client.post("/v1/sessions", files=form(), headers={"Idempotency-Key": "x" * 201})
    (found,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert found["code"] == "wrong_length"
    assert found["message"] == "The header idempotency-key must be a text of at most 200 characters."


def test_body_that_is_missing(live: Live) -> None:
    (found,) = problem_of(live.client.post("/v1/browser-session"), 422, "invalid_request")["errors"]
    assert found["message"] == "The body is missing. It must be an object with some of the fields key."


def test_answer_is_not_many_times_request(live: Live) -> None:
    found: list[Any] = wrong_fields(live, {f"a{number}": 1 for number in range(105)})
    assert len(found) == 81
    assert found[-1] == (None, "more_problems", "25 more problems are not listed.")


@pytest.mark.slow
def test_only_listed_errors_are_translated(
    make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small body has thousands of wrong fields; the others are counted, over all parts of a form."""
    work: Counter[str] = Counter()

    def described(*args: Any, **options: Any) -> str:
        work["described"] += 1
        return requirement(*args, **options)

    def searched(*args: Any) -> str | None:
        work["searched"] += 1
        return hint(*args)

    hint = FieldPlaces.hint
    monkeypatch.setattr(FieldPlaces, "hint", searched)
    monkeypatch.setattr(rules, "requirement", described)
    spec = json.dumps({"exports": ["x"] * 5000, **{f"a{number}": 1 for number in range(3000)}})
    manifest = json.dumps({f"a{number}": 1 for number in range(2000)})
    parts = [*form(), ("manifest", (None, manifest)), ("spec", (None, spec))]
    with running(make_settings(max_json_bytes=64 * KIB)) as live:
        problem = problem_of(live.client.post("/v1/jobs/from-files", files=parts), 422, "invalid_request")
    assert problem["detail"] == "10000 things are wrong with the request."
    assert problem["errors"][-1]["message"] == "9,920 more problems are not listed."
    assert [item["code"] for item in problem["errors"]].count("more_problems") == 1
    assert len(problem["errors"]) == MAX_LISTED + 1
    assert work["described"] > 0
    assert work["searched"] > 0
    assert work.total() <= 2 * MAX_LISTED


def test_wrong_items_of_list_that_is_too_long_are_not_looked_at(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_json_bytes=64 * KIB)) as live:
        address = f"/v1/sessions/{live.session_id()}/edits"
        too_long = problem_of(live.client.put(address, json={"edits": [[]] * 15_000}), 422, "invalid_request")
        longest = problem_of(live.client.put(address, json={"edits": [[]] * 1_000}), 422, "invalid_request")
    assert [item["pointer"] for item in too_long["errors"]] == ["/edits"]
    assert longest["detail"] == "1000 things are wrong with the request."


@pytest.mark.parametrize(
    ("body", "pointer", "hint"),
    [
        ({"callback_url": "https://x"}, "/callback_url", "callback_url belongs in spec: spec.callback_url."),
        ({"manifest": {"method": "tracking"}}, "/manifest/method", "method belongs in spec: spec.method."),
        ({"spec": {"videos": []}}, "/spec/videos", "videos belongs at the top of the body."),
        (
            {"manifest": {"offset_s": 1.0}},
            "/manifest/offset_s",
            "offset_s belongs in manifest.cameras[]: manifest.cameras[].offset_s.",
        ),
        (
            {"name": "walk"},
            "/name",
            "name belongs in manifest: manifest.name, or in manifest.cameras[]: manifest.cameras[].name.",
        ),
        ({"colour": "red"}, "/colour", None),
    ],
)
def test_misplaced_field_is_told_its_place(live: Live, body: dict[str, Any], pointer: str, hint: str | None) -> None:
    answer = live.client.post("/v1/jobs/from-uploads", json=body)
    found = {item["pointer"]: item["hint"] for item in problem_of(answer, 422, "invalid_request")["errors"]}
    assert found[pointer] == hint
    documents = [(name, (None, json.dumps(value))) for name, value in body.items()]
    answer = live.client.post("/v1/jobs/from-files", files=[*form(), *documents])
    found = {item["pointer"]: item["hint"] for item in problem_of(answer, 422, "invalid_request")["errors"]}
    assert found[pointer] == hint


def test_field_of_another_edit_is_not_sent_to_where_it_is(live: Live) -> None:
    """Actions have different fields: the place would be right if the action were."""
    sent = {"edits": [{"action": "rename", "person": 1, "name": "Anna", "other": 2}]}
    answer = live.client.put(f"/v1/sessions/{live.session_id()}/edits", json=sent)
    (found,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (found["pointer"], found["code"], found["hint"]) == ("/edits/0/other", "unknown_field", None)


def test_codes_are_in_contract(live: Live) -> None:
    spec = {
        "people": 0,
        "method": 3,
        "cutoff_hz": "a",
        "output_rate_hz": 0,
        "frame_range": [1],
        "colour": 1,
        "callback_url": "",
        "exports": ["bvh", "bvh"],
    }
    manifest = '{"cameras": [{}], "name": "a\\u0000", "metadata": {"a": NaN}}'
    found = {code for _, code, _ in wrong_fields(live, spec)}
    found |= {code for _, code, _ in wrong_fields(live, {f"a{number}": 1 for number in range(105)})}
    answer = live.client.post("/v1/jobs", files=[*form(), ("manifest", (None, manifest)), ("spec", (None, "{"))])
    found |= {item["code"] for item in problem_of(answer, 422, "invalid_request")["errors"]}
    assert found == set(MEANINGS)
    schemas = live.client.get("/openapi.json").json()["components"]["schemas"]
    published = schemas["ErrorItem"]["properties"]["code"]["description"]
    assert [code for code in MEANINGS if f"`{code}`" not in published] == []


@pytest.mark.parametrize(
    ("path", "types"),
    [
        ("/v1/sessions", ["multipart/form-data", "application/json"]),
        ("/v1/jobs", ["multipart/form-data", "application/json"]),
        ("/v1/jobs/from-files", ["multipart/form-data"]),
        ("/v1/sessions/from-uploads", ["application/json"]),
        ("/v1/calibrations/from-uploads", ["application/json"]),
        ("/v1/browser-session", ["application/json"]),
    ],
)
def test_refused_content_type_names_accepted_ones(live: Live, path: str, types: list[str]) -> None:
    answer = live.client.post(path, content=b"name: x", headers={"Content-Type": "application/yaml"})
    detail = problem_of(answer, 415, "unsupported_media_type")["detail"]
    assert {name for name in ("multipart/form-data", "application/json") if name in detail} == set(types)


def test_manifest_has_limits_of_pipeline() -> None:
    camera = CameraManifest.model_json_schema()["properties"]
    rates = [camera["rate"]["anyOf"][0], Manifest.model_json_schema()["properties"]["frame_rate_hz"]["anyOf"][0]]
    assert all((rate["minimum"], rate["maximum"]) == (FRAME_RATE_HZ.low, FRAME_RATE_HZ.high) for rate in rates)
    assert (camera["offset_s"]["minimum"], camera["offset_s"]["maximum"]) == (OFFSET_S.low, OFFSET_S.high)
