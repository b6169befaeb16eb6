"""Sessions whose videos are URLs: they wait, get their files or fail, and so do their jobs."""

import errno
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from api.cli.client import Client, ServiceError
from api.web.settings import Settings
from api.web.uploads import fetching
from api.web.uploads.files import FolderUploads
from tests.api.conftest import Live, problem_of, running
from tests.api.web.uploads.test_fetching import CONTENT, SECRET, VideoSource, serving_files
from tests.api.web.uploads.test_files import TUS, Uploader
from tests.s3 import S3
from tests.waiting import wait_for

BOARD = "chessboard:9x6:0.06"


@pytest.fixture
def source() -> Iterator[VideoSource]:
    with serving_files() as found:
        found.files = {"cam_0.mp4": CONTENT, "cam_1.mp4": CONTENT[::-1]}
        yield found


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fetching, "_LOOK_S", 0.05)
        patch.setattr(fetching, "_RENEW_S", 0.2)
        patch.setattr(fetching, "_FIRST_PAUSE_S", 0.02)
        patch.setattr(fetching, "_LONGEST_PAUSE_S", 0.05)
        yield


@pytest.fixture(scope="module")
def fetcher(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Service that fetches from this machine."""
    with running(make_settings(fetch_private=True, client_idle_s=2.0, max_json_bytes=4000)) as live:
        yield live


def body_of(live: Live, source: VideoSource, *names: str, **more: Any) -> dict[str, Any]:
    calibration = Uploader(live.client).upload(b"[cam_0]", "calibration.toml")
    videos = [source.url(name) for name in names or ("cam_0.mp4", "cam_1.mp4")]
    return {"videos": videos, "calibration": calibration, **more}


def begun(live: Live, path: str, body: dict[str, Any], **options: Any) -> dict[str, Any]:
    answer = live.client.post(path, json=body, **options)
    assert answer.status_code == 202, answer.text
    assert "retry-after" in answer.headers
    assert SECRET not in answer.text
    found: dict[str, Any] = answer.json()
    assert live.client.get(answer.headers["location"]).json()["id"] == found["id"]
    return found


def resume(source: VideoSource) -> None:
    source.break_after.clear()
    source.hold.set()


def read(live: Live, path: str) -> dict[str, Any]:
    answer = live.client.get(path)
    assert answer.status_code == 200, answer.text
    assert SECRET not in answer.text
    return dict(answer.json())


def settled(live: Live, session: dict[str, Any]) -> dict[str, Any]:
    wait_for(lambda: read(live, session["urls"]["self"])["state"] != "fetching", 60)
    return read(live, session["urls"]["self"])


def chunks_of(live: Live, job: dict[str, Any]) -> int:
    return sum(stage["total"] for stage in read(live, job["urls"]["self"])["stages"])


def test_session_tells_progress_then_its_check(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    source.break_after = [30_000, 30_000, *[0] * 20]
    session = begun(fetcher, "/v1/sessions", body_of(fetcher, source, manifest={"name": "Ball", "sync": "auto"}))
    assert (session["state"], session["name"], session["sync"]) == ("fetching", "Ball", "auto")
    assert (session["files"], session["preflight"]["cameras"], session["space"]) == ([], [], None)
    told = {fetch["filename"]: (fetch["state"], fetch["received_bytes"]) for fetch in session["fetches"]}
    assert told == {"calibration.toml": ("finished", 7), "cam_0.mp4": ("fetching", 0), "cam_1.mp4": ("fetching", 0)}
    path = session["urls"]["self"]

    def received() -> dict[str, int]:
        fetches = read(fetcher, path)["fetches"]
        return {fetch["filename"]: fetch["received_bytes"] for fetch in fetches if fetch["state"] == "fetching"}

    wait_for(lambda: received() == {"cam_0.mp4": 30_000, "cam_1.mp4": 30_000}, 60)
    assert [listed["state"] for listed in read(fetcher, "/v1/sessions?name=ball")["sessions"]] == ["fetching"]
    resume(source)
    found = settled(fetcher, session)
    assert (found["state"], found["fetches"], found["errors"]) == ("ready", [], [])
    assert [file["name"] for file in found["files"]] == ["cam_0.mp4", "cam_1.mp4", "calibration.toml"]
    assert found["num_bytes"] == 2 * len(CONTENT) + 7
    assert [camera["name"] for camera in found["preflight"]["cameras"]] == ["cam_0", "cam_1"]
    assert found["sync"] == "auto"
    assert fetcher.client.get(found["preflight"]["cameras"][1]["video_url"]).content == CONTENT[::-1]
    assert fetcher.client.get(found["preflight"]["cameras"][0]["thumbnails"][0]["url"]).status_code == 200
    wait_for(
        lambda: not any(fetcher.settings.uploads_dir / fetch["id"] in fetcher.kept() for fetch in session["fetches"])
    )


def test_job_waits_for_videos_then_gets_its_stages(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    key = {"Idempotency-Key": f"wait-{source.port}"}
    body = body_of(fetcher, source, spec={"people": 2})
    job = begun(fetcher, "/v1/jobs", body, headers=key)
    assert (job["state"], job["progress"], job["stages"]) == ("queued", 0.0, [])
    assert job["waiting_for"]["code"] == "videos_fetching"
    assert fetcher.client.post("/v1/jobs", json=body, headers=key).json() == job
    session = read(fetcher, job["urls"]["session"])
    other = begun(fetcher, session["urls"]["jobs"], {"people": 1})
    assert {found["id"] for found in read(fetcher, session["urls"]["jobs"])["jobs"]} == {job["id"], other["id"]}
    problem_of(fetcher.client.put(f"{session['urls']['self']}/edits", json={"edits": []}), 409, "conflict")
    problem_of(fetcher.client.delete(session["urls"]["self"]), 409, "conflict")
    resume(source)
    settled(fetcher, session)
    for one in (job, other):
        found = read(fetcher, one["urls"]["self"])
        assert (found["state"], found["waiting_for"], found["num_frames"]) == ("queued", None, 60)
        assert found["spec"]["people"] == one["spec"]["people"]
        assert chunks_of(fetcher, one) > 0


def test_all_problems_of_sources_come_at_once(fetcher: Live, source: VideoSource) -> None:
    source.files |= {"cam_2.mp4": CONTENT}
    job = begun(fetcher, "/v1/jobs", body_of(fetcher, source, "gone.mp4", "cam_2.mp4", "lost.mp4"))
    found = settled(fetcher, read(fetcher, job["urls"]["session"]))
    wrong = [("source_not_found", "/videos/0", "gone.mp4"), ("source_not_found", "/videos/2", "lost.mp4")]
    assert [(error["code"], error["pointer"], error["file"]) for error in found["errors"]] == wrong
    assert (found["state"], found["fetches"]) == ("failed", [])
    ended = read(fetcher, job["urls"]["self"])
    assert (ended["state"], ended["error"]["code"], ended["urls"]["retry"]) == ("failed", "session_unusable", None)
    assert [error["file"] for error in ended["error"]["errors"]] == ["gone.mp4", "lost.mp4"]
    problem_of(fetcher.client.post(f"{job['urls']['self']}/retry"), 409, "conflict")
    problem_of(fetcher.client.post(found["urls"]["jobs"], json={}), 409, "conflict")
    assert fetcher.client.delete(found["urls"]["self"]).status_code == 204


def test_problems_of_check_fail_the_session(fetcher: Live, source: VideoSource) -> None:
    source.files = {"cam_0.mp4": b"WRONG" + CONTENT, "cam_1.mp4": b"WRONG" + CONTENT}
    found = settled(fetcher, begun(fetcher, "/v1/sessions", body_of(fetcher, source)))
    wrong = [("video_unreadable", "/videos/0", "cam_0"), ("video_unreadable", "/videos/1", "cam_1")]
    assert [(error["code"], error["pointer"], error["camera"]) for error in found["errors"]] == wrong


def test_job_that_does_not_fit_its_session_fails_alone(fetcher: Live, source: VideoSource) -> None:
    job = begun(fetcher, "/v1/jobs", body_of(fetcher, source, spec={"frame_range": [50, 90]}))
    session = settled(fetcher, read(fetcher, job["urls"]["session"]))
    assert session["state"] == "ready"
    ended = read(fetcher, job["urls"]["self"])
    assert (ended["state"], ended["error"]["code"]) == ("failed", "frame_range")
    assert begun(fetcher, session["urls"]["jobs"], {"frame_range": [50, 60]})["stages"] != []


def test_known_problems_are_answered_before_a_fetch(fetcher: Live, source: VideoSource) -> None:
    body: dict[str, Any] = {
        "videos": [source.url("cam_0.mp4"), source.url("CAM_0.mp4"), "http://user:word@127.0.0.1/cam_1.mp4"],
        "calibration_id": "0190c7a5-7c1e-7b2a-8f3e-6d5c4b3a2f10",
        "spec": {"people": 2, "callback_url": "https://receiver.example/ended"},
    }
    problem = problem_of(fetcher.client.post("/v1/jobs", json=body), 422, "invalid_request")
    assert [error["pointer"] for error in problem["errors"]] == ["/videos/2"]
    body["videos"][2] = source.url("")
    problem = problem_of(fetcher.client.post("/v1/jobs", json=body), 422, "invalid_request")
    assert [(error["code"], error["pointer"]) for error in problem["errors"]] == [
        ("duplicate_file_name", "/videos/1"),
        ("file_name_invalid", "/videos/2"),
        ("calibration_unknown", "/calibration_id"),
        ("webhook_secret_missing", "/spec/callback_url"),
    ]
    assert source.requests == []


def test_session_that_is_not_stored_leaves_no_upload(
    fetcher: Live, source: VideoSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, create = fetcher.services.settings.uploads_dir, FolderUploads.create
    body = body_of(fetcher, source)
    before = {path.name for path in folder.iterdir()}

    def create_first(uploads: FolderUploads, *arguments: Any) -> str:
        if {path.name for path in folder.iterdir()} != before:
            raise OSError(errno.ENOSPC, "No space left on device")
        return create(uploads, *arguments)

    monkeypatch.setattr(FolderUploads, "create", create_first)
    problem_of(fetcher.client.post("/v1/sessions", json=body), 507, "storage_full")
    assert {path.name for path in folder.iterdir()} == before
    assert source.requests == []


def test_client_submits_links(fetcher: Live, source: VideoSource, tmp_path: Path) -> None:
    calibration = tmp_path / "calibration.toml"
    calibration.write_bytes(b"[cam_0]")
    with Client.connect(f"http://127.0.0.1:{fetcher.address[1]}") as client:
        job = client.submit("Take", [source.url("cam_0.mp4"), source.url("cam_1.mp4")], calibration, {"people": 2})
        assert client.get(job["urls"]["session"])["name"] == "Take"
        assert client.get(job["urls"]["self"])["spec"]["people"] == 2
        job = client.submit("Take", [source.url("gone.mp4")], calibration)
        with pytest.raises(ServiceError, match=r"gone\.mp4: The source answers with 404") as refused:
            client.follow(job, timeout_s=60)
    assert SECRET not in str(refused.value)


def test_reserved_upload_is_in_no_other_session(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    body = body_of(fetcher, source)
    session = begun(fetcher, "/v1/sessions", body)
    problem_of(fetcher.client.post("/v1/sessions", json=body), 409, "conflict")
    resume(source)
    assert settled(fetcher, session)["state"] == "ready"


def test_deleted_session_is_not_fetched_on(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    source.break_after = [10_000, 10_000]
    job = begun(fetcher, "/v1/jobs", body_of(fetcher, source))
    wait_for(lambda: len(source.requests) == 2, 60)
    canceled = fetcher.client.post(job["urls"]["cancel"]).json()
    assert (canceled["state"], canceled["waiting_for"]) == ("canceled", None)
    (first, second, calibration) = read(fetcher, job["urls"]["session"])["fetches"]
    assert fetcher.client.delete(job["urls"]["session"]).status_code == 204
    resume(source)
    for upload in (first, second, calibration):
        assert fetcher.client.get(f"/v1/uploads/{upload['id']}").status_code == 404
    problem_of(fetcher.client.get(job["urls"]["self"]), 404, "not_found")


def test_deleted_upload_fails_the_session(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    session = begun(fetcher, "/v1/sessions", body_of(fetcher, source))
    upload_id = session["fetches"][0]["id"]
    assert fetcher.client.delete(f"/v1/uploads/{upload_id}", headers=TUS).status_code == 204
    resume(source)
    (error,) = settled(fetcher, session)["errors"]
    assert error["code"] == "upload_unknown"


def test_calibration_of_urls_is_made_when_videos_are_there(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    videos = [source.url("cam_0.mp4"), source.url("cam_1.mp4")]
    job = begun(fetcher, "/v1/calibrations", {"method": "board", "board": BOARD, "videos": videos})
    assert (job["kind"], job["stages"], job["waiting_for"]["code"]) == ("calibration", [], "videos_fetching")
    assert read(fetcher, f"/v1/calibrations/{job['id']}")["name"] == "board, 2 cameras"
    resume(source)
    found = settled(fetcher, read(fetcher, job["urls"]["session"]))
    # The program in place of the preflight refuses videos without a calibration.
    assert [error["code"] for error in found["errors"]] == ["calibration_unreadable"]
    assert read(fetcher, f"/v1/calibrations/{job['id']}")["state"] == "failed"


def test_quota_is_kept_by_waiting_sessions(make_settings: Callable[..., Settings], source: VideoSource) -> None:
    settings = make_settings(
        fetch_private=True, max_tenant_bytes=len(CONTENT) + 100, max_tenant_uploads=4, max_tenant_sessions=1
    )
    with running(settings) as live:
        session = begun(live, "/v1/sessions", body_of(live, source))
        problem_of(live.client.post("/v1/sessions", json={"videos": [source.url("a.mp4")]}), 403, "quota_exceeded")
        assert [error["code"] for error in settled(live, session)["errors"]] == ["quota_exceeded"]
        assert live.services.store.tenant("default").usage().stored_bytes == 0
        assert live.client.delete(session["urls"]["self"]).status_code == 204
        body = body_of(live, source, *[f"cam_{number}.mp4" for number in range(4)])
        problem_of(live.client.post("/v1/sessions", json=body), 403, "quota_exceeded")
        assert read(live, "/v1/sessions")["sessions"] == []


def test_restarted_service_completes_the_session(
    make_settings: Callable[..., Settings], source: VideoSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetching, "_LEASE_S", 1.0)
    settings = make_settings(fetch_private=True, client_idle_s=2.0)
    source.hold.clear()
    source.break_after = [10_000, 0, 0, 0]
    with running(settings) as live:
        job = begun(live, "/v1/jobs", body_of(live, source, "cam_0.mp4"))
        wait_for(lambda: len(source.requests) > 1, 60)
    resume(source)
    with running(settings) as live:
        assert settled(live, read(live, job["urls"]["session"]))["state"] == "ready"
        assert chunks_of(live, job) > 0
    assert source.requests[-1]["range"] == "bytes=10000-"


def test_two_processes_complete_a_session_once(
    make_settings: Callable[..., Settings], source: VideoSource, s3: S3, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    settings = make_settings(artifacts_url=s3.new_url(), shared_uploads=True, fetch_private=True)
    with running(settings) as live, running(settings.model_copy(update={"spool_dir": settings.data_dir / "b"})) as twin:
        job = begun(live, "/v1/jobs", body_of(live, source))
        assert settled(twin, read(twin, job["urls"]["session"]))["state"] == "ready"
        assert len(source.requests) == 2
        video = read(twin, job["urls"]["session"])["preflight"]["cameras"][0]["video_url"]
        assert live.client.get(video, follow_redirects=True).content == CONTENT


def test_full_disk_fails_the_session(make_settings: Callable[..., Settings], source: VideoSource) -> None:
    with running(make_settings(fetch_private=True)) as live:
        source.hold.clear()
        source.break_after = [10_000, 10_000]
        session = begun(live, "/v1/sessions", body_of(live, source))
        wait_for(lambda: len(source.requests) == 2, 60)
        live.services.disk._headroom_bytes = 2**60
        resume(source)
        assert "storage_full" in {error["code"] for error in settled(live, session)["errors"]}
