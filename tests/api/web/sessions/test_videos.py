"""Videos of sessions, for players."""

import hashlib
import os
from collections.abc import Callable

import pytest

from api.web.settings import Settings
from pipeline.core.options.job_choices import PROXY_KIND
from tests.api.conftest import Live, problem_of, running
from tests.s3 import S3
from worker.store.files.file_keys import result_key
from worker.store.model.job_records import Result

VIDEO = os.urandom(90_000)


def send(live: Live, *names: str) -> tuple[str, dict[str, str | None]]:
    """Send a session of videos; its address, and the links of its cameras."""
    parts = [("videos", (name, VIDEO)) for name in names]
    answer = live.client.post("/v1/sessions", files=[*parts, ("calibration", ("calibration.toml", b"[cam]"))])
    assert answer.status_code == 201, answer.text
    links = {camera["name"]: camera["video_url"] for camera in answer.json()["preflight"]["cameras"]}
    return answer.json()["urls"]["self"], links


def test_video_is_watched_as_it_was_sent(live: Live) -> None:
    address, links = send(live, "Küche links.mp4")
    link = links["Küche links"]
    assert link == f"{address}/videos/K%C3%BCche%20links"
    answer = live.client.get(link)
    assert (answer.status_code, answer.content) == (200, VIDEO)
    assert answer.headers["content-type"] == "video/mp4"
    assert answer.headers["accept-ranges"] == "bytes"
    assert answer.headers["etag"] == f'"{hashlib.sha256(VIDEO).hexdigest()}"'
    disposition = answer.headers["content-disposition"]
    assert disposition == "inline; filename=\"K_che links.mp4\"; filename*=utf-8''K%C3%BCche%20links.mp4"
    known = live.client.get(link, headers={"If-None-Match": answer.headers["etag"]})
    assert (known.status_code, known.content) == (304, b"")


def test_range_of_video(live: Live) -> None:
    _, links = send(live, "cam_0.mp4")
    answer = live.client.get(str(links["cam_0"]), headers={"Range": "bytes=80000-"})
    assert (answer.status_code, answer.content) == (206, VIDEO[80_000:])
    assert answer.headers["content-range"] == "bytes 80000-89999/90000"
    problem_of(live.client.get(str(links["cam_0"]), headers={"Range": "bytes=90000-"}), 416, "range_not_satisfiable")


def test_videos_that_are_not_there(live: Live) -> None:
    address, links = send(live, "cam_0.mp4", "cam_1.avi")
    assert links["cam_1"] is None
    problem_of(live.client.get(f"{address}/videos/cam_1"), 409, "not_finished")
    for camera in ("cam_2", "calibration.toml", "cam_0.mp4", "%2e%2e%2fcam_0"):
        problem_of(live.client.get(f"{address}/videos/{camera}"), 404, "not_found")
    (path,) = [one for one in live.kept() if one.name.endswith("cam_0.mp4")]
    path.unlink()
    problem_of(live.client.get(str(links["cam_0"])), 410, "expired")
    path.write_bytes(VIDEO[:-1])
    problem_of(live.client.get(str(links["cam_0"])), 500, "artifact_damaged")


def test_video_that_browsers_do_not_play_gets_proxy(live: Live) -> None:
    address, _ = send(live, "cam_0.mp4", "Cam 1.avi")
    assert live.client.get(address).json()["proxies_job"] is None
    job = live.client.post(f"{address}/jobs", json={}).json()
    again = live.client.post(f"{address}/jobs", json={}).json()
    session = live.client.get(address).json()
    proxies = live.client.get(f"/v1/jobs/{session['proxies_job']['id']}").json()
    assert (proxies["kind"], proxies["calibration_id"]) == ("proxies", None)
    assert [(stage["name"], stage["total"]) for stage in proxies["stages"]] == [("make_proxy", 60)]
    listed = [one["id"] for one in live.client.get(f"{address}/jobs").json()["jobs"]]
    assert (listed, session["num_jobs"]) == ([again["id"], job["id"]], 2)
    of_kind = live.client.get("/v1/jobs", params={"kind": "proxies"}).json()["jobs"]
    assert [one["id"] for one in of_kind] == [proxies["id"]]

    video = f"{address}/videos/Cam%201"
    problem_of(live.client.get(video), 409, "not_finished")
    for one in (job, again):
        live.client.post(f"/v1/jobs/{one['id']}/cancel")
    key = result_key(proxies["id"], "proxy-1.mp4")
    live.services.artifacts.put_bytes(key, VIDEO[:1000])
    made = Result("proxy-1.mp4", PROXY_KIND, None, "video/mp4", key, 1000, hashlib.sha256(VIDEO[:1000]).hexdigest())
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    assert (claim.stage, claim.payload["camera"]) == ("make_proxy", "Cam 1")
    live.services.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 0, results=[made])
    camera = live.client.get(address).json()["preflight"]["cameras"][1]
    assert (camera["plays_in_browsers"], camera["video_url"], camera["media_start_s"]) == (False, video, 0.0)
    answer = live.client.get(video, headers={"Range": "bytes=0-9"})
    assert (answer.status_code, answer.content, answer.headers["content-type"]) == (206, VIDEO[:10], "video/mp4")
    assert answer.headers["content-disposition"].startswith('inline; filename="Cam 1.mp4"')
    assert live.client.delete(address).status_code == 204
    assert live.kept() == []


def test_videos_in_bucket_come_through_service(
    make_settings: Callable[..., Settings], s3: S3, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    with running(make_settings(artifacts_url=s3.new_url(), signed_downloads_s=60.0)) as live:
        _, links = send(live, "cam_0.mp4")
        answer = live.client.get(str(links["cam_0"]), headers={"Range": "bytes=10-19"})
        assert (answer.status_code, answer.content) == (206, VIDEO[10:20])
