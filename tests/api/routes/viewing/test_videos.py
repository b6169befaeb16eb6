"""Videos of sessions, for players."""

import hashlib
import os
from collections.abc import Callable

import pytest

from api.settings import Settings
from tests.api.conftest import Live, problem_of, running
from tests.s3 import running_s3

VIDEO = os.urandom(90_000)


def send(live: Live, *names: str) -> tuple[str, dict[str, str | None]]:
    """Send a session of videos; its address, and the links of its cameras."""
    parts = [("videos", (name, VIDEO)) for name in names]
    answer = live.client.post("/v1/sessions", files=[*parts, ("calibration", ("calibration.toml", b"[cam]"))])
    assert answer.status_code == 201, answer.text
    links = {camera["name"]: camera["video_link"] for camera in answer.json()["preflight"]["cameras"]}
    return answer.json()["links"]["self"], links


def test_a_video_is_watched_as_it_was_sent(live: Live) -> None:
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


def test_a_range_of_a_video(live: Live) -> None:
    _, links = send(live, "cam_0.mp4")
    answer = live.client.get(str(links["cam_0"]), headers={"Range": "bytes=80000-"})
    assert (answer.status_code, answer.content) == (206, VIDEO[80_000:])
    assert answer.headers["content-range"] == "bytes 80000-89999/90000"
    problem_of(live.client.get(str(links["cam_0"]), headers={"Range": "bytes=90000-"}), 416, "range_not_satisfiable")


def test_videos_that_are_not_there(live: Live) -> None:
    address, links = send(live, "cam_0.mp4", "cam_1.avi")
    assert links["cam_1"] is None
    for camera in ("cam_1", "cam_2", "calibration.toml", "cam_0.mp4", "%2e%2e%2fcam_0"):
        problem_of(live.client.get(f"{address}/videos/{camera}"), 404, "not_found")
    (path,) = [one for one in live.kept() if one.name.endswith("cam_0.mp4")]
    path.unlink()
    problem_of(live.client.get(str(links["cam_0"])), 410, "expired")
    path.write_bytes(VIDEO[:-1])
    problem_of(live.client.get(str(links["cam_0"])), 500, "artifact_damaged")


def test_videos_in_a_bucket_come_through_the_service(
    make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_s3() as server:
        for name, value in server.environment.items():
            monkeypatch.setenv(name, value)
        with running(make_settings(artifacts_url=server.new_url(), signed_downloads_s=60.0)) as live:
            _, links = send(live, "cam_0.mp4")
            answer = live.client.get(str(links["cam_0"]), headers={"Range": "bytes=10-19"})
            assert (answer.status_code, answer.content) == (206, VIDEO[10:20])
