"""Sessions: files, manifest, preflight, paging and deletion."""

import hashlib
import json
import os
import socket
import uuid
from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from api.web.settings import Settings
from pipeline.capture.preflight_record import Recording
from tests.api.conftest import Live, form, keypoint_form, problem_of, running
from worker.store.files.artifacts import read_artifact
from worker.store.files.file_keys import record_key
from worker.store.repositories.sessions import Sessions


def test_session_says_what_was_found(live: Live) -> None:
    answer = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, b'{"name": "Take \\u00e9 3"}'))])
    assert answer.status_code == 201
    session = answer.json()
    assert answer.headers["location"] == f"/v1/sessions/{session['id']}"
    assert uuid.UUID(session["id"]).version == 7
    assert session["name"] == "Take é 3"
    assert session["files"] == [
        {
            "name": name,
            "kind": kind,
            "num_bytes": len(content),
            "sha256": hashlib.sha256(content).hexdigest(),
            "is_deleted": False,
        }
        for name, kind, content in (
            ("cam_0.mp4", "video", b"video"),
            ("cam_1.mp4", "video", b"video"),
            ("calibration.toml", "calibration", b"[cam_0]"),
        )
    ]
    assert session["preflight"]["timebase"] == {"start_time_s": 0.0, "frame_rate_hz": 25.0, "num_frames": 60}
    assert session["preflight"]["cameras"][1] == {
        "name": "cam_1", "file": "cam_1.mp4", "size_px": [640, 480], "frame_rate_hz": 25.0, "num_frames": 60,
        "start_time_s": 0.0, "plays_in_browsers": True, "media_start_s": 0.08,
        "video_url": f"/v1/sessions/{session['id']}/videos/cam_1",
        "thumbnails": [{"time_s": 1.2, "url": f"/v1/sessions/{session['id']}/thumbnails/cam_1/0"}], "more_files": [],
    }  # fmt: skip
    assert session["preflight"]["findings"] == [
        {
            "code": "same_place",
            "message": "The cameras are close together.",
            "camera": None,
            "severity": "info",
            "hint": None,
            "evidence": {},
        }
    ]
    assert live.client.get(session["urls"]["self"]).json() == session


def test_session_of_keypoints(live: Live) -> None:
    manifest = ("manifest", (None, b'{"frame_rate_hz": 50.0}'))
    answer = live.client.post("/v1/sessions", files=[*keypoint_form(), manifest])
    assert answer.status_code == 201, answer.text
    kinds = {file["name"]: file["kind"] for file in answer.json()["files"]}
    assert kinds == {
        "cam_0.zip": "keypoints",
        "cam_1.zip": "keypoints",
        "calibration.toml": "calibration",
        "timestamps.csv": "timestamps",
    }


def test_problems_of_archive_point_to_it(live: Live) -> None:
    parts = [("keypoints", ("cam_0.zip", b"archive")), ("keypoints", ("cam_1.zip", b"WRONG")), form(0)[0]]
    problem = problem_of(live.client.post("/v1/sessions", files=parts), 422, "invalid_request")
    assert [(item["pointer"], item["file"]) for item in problem["errors"]] == [("/keypoints/1", "cam_1.zip")]


def test_files_are_kept_byte_for_byte_and_spool_is_empty(live: Live) -> None:
    content = os.urandom(99_999)
    answer = live.client.post("/v1/sessions", files=form(1, content))
    (video, _) = live.services.store.sessions.get(answer.json()["id"]).files
    with live.services.artifacts.open(video.key) as file:
        assert file.read() == content
    assert list(live.settings.spool_dir.iterdir()) == []


def test_preflight_record_is_kept_with_its_digest(live: Live) -> None:
    jobs = live.client.post("/v1/jobs", files=form())
    for session_id in (live.session_id(), jobs.json()["session_id"]):
        session = live.services.store.sessions.get(session_id)
        assert session.record_sha256 == hashlib.sha256(b"record").hexdigest()
        assert read_artifact(live.services.artifacts, record_key(session_id), session.record_sha256) == b"record"


def test_all_problems_of_all_files_at_once(live: Live) -> None:
    parts = [
        ("videos", ("cam_0.mp4", b"WRONG")),
        ("videos", ("cam_1.mp4", b"video")),
        ("videos", ("cam_2.mp4", b"WRONG")),
        ("calibration", ("calibration.toml", b"")),
    ]
    problem = problem_of(live.client.post("/v1/sessions", files=parts), 422, "invalid_request")
    assert [(item["pointer"], item["code"], item["file"], item["camera"]) for item in problem["errors"]] == [
        ("/videos/0", "video_unreadable", "cam_0.mp4", "cam_0"),
        ("/videos/2", "video_unreadable", "cam_2.mp4", "cam_2"),
        ("/calibration", "calibration_empty", "calibration.toml", None),
    ]
    assert problem["errors"][0]["hint"] == "Send a video."
    assert live.kept() == []


def chapters(cameras: int) -> list[tuple[str, Any]]:
    """Parts of a session of recordings in three chapters each, as GoPro cameras name them."""
    names = [f"GX0{part}000{camera}.mp4" for camera in range(cameras) for part in (1, 2, 3)]
    return [*[("videos", (name, b"video")) for name in names], *form(0)]


@pytest.mark.parametrize(
    "name",
    [
        "../cam_0.mp4", "/etc/passwd", "a/b.mp4", "C:\\evil\\cam_0.mp4", "\\\\host\\share\\x.mp4", "a\\b.mp4",
        "..", ".", "tab\tbed.mp4", "bell\x07.mp4", "delete\x7f.mp4", "c1\x85.mp4", "turned\u202e4pm.mp4",
        "invisible\u200b.mp4", "x" * 201 + ".mp4", "é" * 101,
    ],
)  # fmt: skip
def test_hostile_file_names(live: Live, name: str) -> None:
    parts = [*form(1), ("videos", ("placeholder", b"video"))]
    request = live.client.build_request("POST", "/v1/sessions", files=parts)
    body = request.read().replace(b'"placeholder"', b'"' + name.replace('"', '\\"').encode() + b'"')
    answer = live.client.post("/v1/sessions", content=body, headers={"Content-Type": request.headers["content-type"]})
    (item,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (item["pointer"], item["code"]) == ("/videos/1", "file_name_invalid")
    assert live.kept() == []


@pytest.mark.parametrize("name", [b"\xff\xfe.mp4", b"\xed\xa0\x80.mp4", b"nul\x00.mp4", b""])
def test_file_names_that_are_no_text(live: Live, name: bytes) -> None:
    request = live.client.build_request("POST", "/v1/sessions", files=form(1))
    body = request.read().replace(b"cam_0.mp4", name)
    answer = live.client.post("/v1/sessions", content=body, headers={"Content-Type": request.headers["content-type"]})
    assert answer.status_code in {400, 422}
    assert answer.headers["content-type"] == "application/problem+json"
    assert live.kept() == []


@pytest.mark.parametrize(
    "name", ["cam 0.mp4", "Kamera ä.mp4", "撮影.mov", "-rf.mp4", "'; DROP TABLE.mp4", "x" * 196 + ".mp4"]
)
def test_unusual_names_are_kept(live: Live, name: str) -> None:
    answer = live.client.post("/v1/sessions", files=[("videos", (name, b"video")), *form(0)])
    assert answer.status_code == 201, answer.text
    assert answer.json()["files"][0]["name"] == name


@pytest.mark.parametrize(
    ("parts", "errors"),
    [
        (form(0), {("/videos", "missing_part")}),
        (form(1)[:1], {("/calibration", "missing_part")}),
        ([("x", (None, b""))], {("/x", "unknown_part"), ("/videos", "missing_part"), ("/calibration", "missing_part")}),
        ([*form(), ("spec", (None, b"{}"))], {("/spec", "unknown_part")}),
        ([*form(), ("notes", (None, b"x" * 60_000))], {("/notes", "unknown_part")}),
        ([*form(), ("photo", ("a.jpg", b"x" * 120_000))], {("/photo", "unknown_part")}),
        ([*form(), form()[0]], {("/videos/2", "duplicate_file_name")}),
        ([*form(1), ("videos", ("CAM_0.mp4", b""))], {("/videos/1", "duplicate_file_name")}),
        ([*form(1), ("videos", ("calibration.toml", b""))], {("/videos/1", "duplicate_file_name")}),
        ([*form(), ("calibration", ("other.toml", b""))], {("/calibration", "duplicate_part")}),
        ([*form(), *[("manifest", (None, b"{}"))] * 2], {("/manifest", "duplicate_part")}),
        (form(7), {("/videos/4", "too_many_videos")}),
        (chapters(5), {("/videos/4", "too_many_videos")}),
        (
            [*form(0), *[("videos", (f"{number}.mp4", b"video")) for number in range(66)]],
            {("/videos/4", "too_many_videos"), ("/videos/64", "too_many_videos")},
        ),
        (keypoint_form(5), {("/keypoints/4", "too_many_keypoints")}),
        (
            [*keypoint_form(), form()[0]],
            {("/keypoints", "part_not_allowed"), ("/timestamps", "part_not_allowed")},
        ),
        (keypoint_form()[:3], {("/calibration", "missing_part")}),
        (
            [*form(1), ("videos", ("a/b", b"")), ("y~/", (None, b""))],
            {("/videos/1", "file_name_invalid"), ("/y~0~1", "unknown_part")},
        ),
    ],
)  # fmt: skip
def test_wrong_parts(live: Live, parts: Any, errors: set[tuple[str, str]]) -> None:
    problem = problem_of(live.client.post("/v1/sessions", files=parts), 422, "invalid_request")
    assert {(item["pointer"], item["code"]) for item in problem["errors"]} == errors
    assert live.kept() == []


@pytest.mark.parametrize(
    ("manifest", "pointer"),
    [
        (b"{", "/manifest"),
        (b"[]", "/manifest"),
        (b"\xff", "/manifest"),
        (b'{"scale": 2}', "/manifest/scale"),
        (b'{"name": 3}', "/manifest/name"),
        (b'{"frame_rate_hz": 0}', "/manifest/frame_rate_hz"),
        (b'{"name": "a\\u0000b"}', "/manifest/name"),
        (b'{"name": "' + b"x" * 201 + b'"}', "/manifest/name"),
        (b'{"name": "\\ud800"}', "/manifest"),
        (b"[" * 999, "/manifest"),
    ],
)
def test_wrong_manifests(live: Live, manifest: bytes, pointer: str) -> None:
    answer = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, manifest))])
    (item,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert item["pointer"] == pointer
    assert live.kept() == []


@pytest.mark.parametrize(
    ("parts", "status"),
    [
        (form(1, b"v" * 100_000), 201),
        (form(1, b"v" * 100_001), 413),
        (form(1, b"v", b"c" * 10_000), 201),
        (form(1, b"v", b"c" * 10_001), 413),
        ([*form(2, b"v" * 100_000), ("videos", ("cam_2.mp4", b"v" * 49_993))], 201),
        ([*form(2, b"v" * 100_000), ("videos", ("cam_2.mp4", b"v" * 49_994))], 413),
        ([*form(1), ("manifest", (None, b'{"name": "x"}' + b" " * 987))], 201),
        ([*form(1), ("manifest", (None, b'{"name": "x"}' + b" " * 988))], 413),
        (form(4), 201),
        ([*form(1), *[("unknown", (None, b""))] * 40], 400),
    ],
)
def test_limits(live: Live, parts: Any, status: int) -> None:
    answer = live.client.post("/v1/sessions", files=parts)
    assert answer.status_code == status, answer.text
    if status != 201:
        assert live.kept() == []


def test_too_large_file_is_named(live: Live) -> None:
    problem = problem_of(live.client.post("/v1/sessions", files=form(1, b"v" * 100_001)), 413, "content_too_large")
    (item,) = problem["errors"]
    assert (item["pointer"], item["file"], item["code"]) == ("/videos", "cam_0.mp4", "part_too_large")


def test_announced_length_is_enough_to_refuse(live: Live) -> None:
    headers = {"Content-Type": "multipart/form-data; boundary=x", "Content-Length": "9999999999"}
    request = live.client.build_request("POST", "/v1/sessions", headers=headers)
    lines = [f"{name}: {value}" for name, value in request.headers.items()]
    head = "\r\n".join(["POST /v1/sessions HTTP/1.1", *lines, "", ""]).encode()
    with socket.create_connection(live.address[:2], timeout=180) as connection:
        connection.sendall(head)
        connection.sendall(b"x" * 70_000_000)
        assert b" 413 " in connection.recv(65536).split(b"\r\n")[0]


def test_pages(live: Live) -> None:
    made = [live.session_id() for _ in range(3)]
    first = live.client.get("/v1/sessions?limit=2").json()
    second = live.client.get(f"/v1/sessions?limit=2&cursor={first['next_cursor']}").json()
    assert [session["id"] for page in (first, second) for session in page["sessions"]] == made[::-1]
    assert second["next_cursor"] is None


def test_rename(live: Live) -> None:
    job_id = live.job_id()
    path = live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["session"]
    before = live.client.get(path)
    assert (before.json()["num_jobs"], before.json()["newest_job"]) == (1, {"id": job_id, "state": "queued"})
    assert before.json()["duration_s"] == 2.4
    answer = live.client.patch(path, json={"name": "Walk é"}, headers={"If-Match": before.headers["etag"]})
    assert answer.status_code == 200, answer.text
    assert answer.json() == before.json() | {"name": "Walk é"} == live.client.get(path).json()
    assert answer.headers["etag"] == live.client.get(path).headers["etag"] != before.headers["etag"]
    assert live.client.get(path, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    stale = live.client.patch(path, json={"name": "Run"}, headers={"If-Match": before.headers["etag"]})
    problem_of(stale, 412, "changed_meanwhile")
    assert live.client.patch(path, json={"name": "Jump"}, headers={"If-Match": "*"}).json()["name"] == "Jump"
    assert live.client.patch(path, json={"name": "Sit"}).json()["name"] == "Sit"
    assert live.client.get(f"/v1/jobs/{job_id}").json()["session_name"] == "Sit"


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({}, "missing_field"),
        ({"name": ""}, "wrong_length"),
        ({"name": "x" * 201}, "wrong_length"),
        ({"name": "turned\u202e"}, "control_characters"),
        ({"name": "walk", "id": "1"}, "unknown_field"),
    ],
)
def test_wrong_names(live: Live, body: dict[str, str], code: str) -> None:
    session_id = live.session_id()
    problem = problem_of(live.client.patch(f"/v1/sessions/{session_id}", json=body), 422, "invalid_request")
    assert [item["code"] for item in problem["errors"]] == [code]
    assert live.client.get(f"/v1/sessions/{session_id}").json()["name"] == "untitled"


def test_search(live: Live) -> None:
    ids = {}
    for name in ("Walk 1", "Run 1", "walk 2"):
        manifest = ("manifest", (None, json.dumps({"name": name}).encode()))
        ids[name] = live.client.post("/v1/sessions", files=[*form(), manifest]).json()["id"]

    def found(**parameters: Any) -> list[str]:
        answer = live.client.get("/v1/sessions", params=parameters)
        assert answer.status_code == 200, answer.text
        return [session["name"] for session in answer.json()["sessions"]]

    assert found(name="WALK") == ["walk 2", "Walk 1"]
    page = live.client.get("/v1/sessions", params={"name": "walk", "limit": 1}).json()
    assert found(name="walk", limit=1, cursor=page["next_cursor"]) == ["Walk 1"]
    job = live.client.post(f"/v1/sessions/{ids['Run 1']}/jobs", json={}).json()
    assert (found(state="queued"), found(state="failed")) == (["Run 1"], [])
    live.finish(job["id"])
    assert found(state="succeeded", name="run") == ["Run 1"]
    problem_of(live.client.get("/v1/sessions", params={"state": "lost", "name": ""}), 422, "invalid_request")


def test_delete_takes_files_and_jobs_along(live: Live) -> None:
    job_id = live.job_id()
    session_id = live.client.get(f"/v1/jobs/{job_id}").json()["session_id"]
    problem_of(live.client.delete(f"/v1/sessions/{session_id}"), 409, "conflict")
    live.finish(job_id)
    assert live.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert live.kept() == []
    problem_of(live.client.get(f"/v1/jobs/{job_id}"), 404, "not_found")


def test_start_clears_what_killed_process_was_receiving(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    (settings.spool_dir / "half").mkdir(parents=True)
    (settings.spool_dir / "half" / "cam_0.mp4").write_bytes(b"vid")
    with running(settings) as live:
        assert live.kept() == []


def test_database_that_fails_keeps_no_files(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(Sessions, "add", fail)
    problem_of(live.post_session(), 500, "internal_error")
    assert live.kept() == []


def test_manifest_may_be_file(live: Live) -> None:
    manifest = ("manifest", ("manifest.json", json.dumps({"name": "Take 4"}), "application/json"))
    assert live.client.post("/v1/sessions", files=[*form(), manifest]).json()["name"] == "Take 4"


class TestManifest:
    """Manifest of a session."""

    def send(self, live: Live, manifest: object, **options: Any) -> httpx2.Response:
        part = ("manifest", (None, json.dumps(manifest)))
        return live.client.post("/v1/sessions", files=[*options.get("files", form()), part])

    def test_metadata_comes_back(self, live: Live) -> None:
        metadata = {"scene": 12, "actors": ["\u00c5sa", None], "nested": {"a": [1.5, True]}}
        session = self.send(live, {"metadata": metadata}).json()
        assert session["metadata"] == metadata
        assert live.client.get(session["urls"]["self"]).json() == session
        assert live.client.get("/v1/sessions").json()["sessions"] == [session]
        assert live.client.get(f"/v1/sessions/{live.session_id()}").json()["metadata"] == {}

    @pytest.mark.parametrize("text", ['{"metadata": {"x": NaN}}', '{"metadata": {"x": 1e999}}', '{"metadata": []}'])
    def test_metadata_that_is_no_json(self, live: Live, text: str) -> None:
        answer = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, text))])
        problem = problem_of(answer, 422, "invalid_request")
        assert [item["pointer"] for item in problem["errors"]] == ["/manifest/metadata"]
        assert live.kept() == []

    def test_cameras_of_manifest_reach_preflight(self, live: Live) -> None:
        cameras = [{"name": "a", "file": "cam_1.mp4", "offset_s": -0.5, "rate": 50.0}, {"name": "b \u00e4"}]
        session = self.send(live, {"cameras": cameras}).raise_for_status().json()
        assert live.services.store.sessions.get(session["id"]).preflight.recordings == (
            Recording("a", "cam_1.mp4", -0.5, 50.0),
            Recording("b \u00e4", None, 0.0, None),
        )

    @pytest.mark.parametrize(
        ("camera", "pointer"),
        [
            ({"name": ""}, "/name"),
            ({"name": "a\u0000"}, "/name"),
            ({"name": "a", "offset_s": 86_401}, "/offset_s"),
            ({"name": "a", "rate": 0}, "/rate"),
            ({"name": "a", "file": 3}, "/file"),
            ({"name": "a", "fps": 25}, "/fps"),
            ({}, "/name"),
        ],
    )
    def test_cameras_that_can_not_be(self, live: Live, camera: object, pointer: str) -> None:
        problem = problem_of(self.send(live, {"cameras": [camera]}), 422, "invalid_request")
        assert [item["pointer"] for item in problem["errors"]] == [f"/manifest/cameras/0{pointer}"]

    def test_facts_of_videos_are_refused_with_keypoints(self, live: Live) -> None:
        of_videos = {"name": "cam_0", "file": "cam_0.zip", "more_files": ["b.zip"], "offset_s": 0.5, "rate": 25.0}
        cameras = [{"name": "cam_1", "file": "cam_1.zip"}, of_videos]
        problem = problem_of(self.send(live, {"cameras": cameras}, files=keypoint_form()), 422, "invalid_request")
        assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [
            ("cameras_of_keypoints", f"/manifest/cameras/1/{field}") for field in ("offset_s", "rate", "more_files")
        ]


@pytest.mark.parametrize(
    ("limits", "codes"),
    [
        ({"max_duration_s": 2.4, "max_pixels": 640 * 480}, []),  # 60 frames at 25 Hz
        ({"max_duration_s": 2.39}, ["session_too_long"]),
        ({"max_pixels": 640 * 480 - 1}, ["frames_too_large", "frames_too_large"]),
        ({"max_duration_s": 1.0, "max_pixels": 1}, ["session_too_long", "frames_too_large", "frames_too_large"]),
    ],
)
def test_duration_and_pixels_at_their_limits_and_beyond(
    make_settings: Callable[..., Settings], limits: dict[str, float], codes: list[str]
) -> None:
    with running(make_settings(**limits)) as live:
        answer = live.post_session()
        if not codes:
            assert answer.status_code == 201
            return
        problem = problem_of(answer, 422, "invalid_request")
        assert [item["code"] for item in problem["errors"]] == codes
        assert live.kept() == []


def test_problems_of_manifest_point_to_its_entries(live: Live) -> None:
    videos = [("videos", (f"cam_{index}.mp4", content)) for index, content in enumerate((b"APART", b"TWICE", b"APART"))]
    cameras = [{"name": name} for name in ("cam_1", "cam_0", "cam_1")]
    manifest = ("manifest", (None, json.dumps({"cameras": cameras})))
    answer = live.client.post("/v1/sessions", files=[*videos, form(0)[0], manifest])
    assert [(item["code"], item["camera"], item["pointer"]) for item in answer.json()["errors"]] == [
        ("no_overlap", "cam_0", "/manifest/cameras/1"),
        ("duplicate_recording", "cam_1", "/manifest/cameras/2"),
        ("no_overlap", "cam_2", None),  # not in the manifest
    ]


def test_parts_of_recording_are_one_camera(live: Live) -> None:
    """At most four cameras are taken: by the names of chapters, and as stated."""
    assert live.client.post("/v1/sessions", files=chapters(4)).status_code == 201
    videos = [("videos", (f"C{number:04}.mp4", b"video")) for number in range(6)]
    answer = live.client.post("/v1/sessions", files=[*videos, *form(0)])
    assert problem_of(answer, 422, "invalid_request")["errors"][0]["code"] == "too_many_videos"
    cameras = [
        {"name": name, "file": f"C{first:04}.mp4", "more_files": [f"C{first + 1:04}.mp4", f"C{first + 2:04}.mp4"]}
        for name, first in (("left", 0), ("right", 3))
    ]
    manifest = ("manifest", (None, json.dumps({"cameras": cameras}).encode()))
    assert live.client.post("/v1/sessions", files=[*videos, manifest, *form(0)]).status_code == 201
