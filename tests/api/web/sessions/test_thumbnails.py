"""Thumbnails of sessions: sent with the session, read like its videos, gone with it."""

import hashlib

from tests.api.conftest import Live, form, problem_of

PICTURE = b"picture of cam_1"


def thumbnails(live: Live) -> tuple[str, list[list[dict[str, object]]]]:
    """Address of a new session, and the thumbnails of its cameras."""
    answer = live.client.post("/v1/sessions", files=form(2))
    assert answer.status_code == 201, answer.text
    cameras = answer.json()["preflight"]["cameras"]
    return answer.json()["urls"]["self"], [camera["thumbnails"] for camera in cameras]


def test_pictures_of_session_are_read(live: Live) -> None:
    address, (_, (second,)) = thumbnails(live)
    assert second == {"time_s": 1.2, "url": f"{address}/thumbnails/cam_1/0"}
    answer = live.client.get(str(second["url"]))
    assert (answer.status_code, answer.content) == (200, PICTURE)
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.headers["etag"] == f'"{hashlib.sha256(PICTURE).hexdigest()}"'
    assert answer.headers["content-disposition"].startswith("inline")
    part = live.client.get(str(second["url"]), headers={"Range": "bytes=0-6"})
    assert (part.status_code, part.content) == (206, PICTURE[:7])


def test_pictures_that_are_not_there(live: Live) -> None:
    address, _ = thumbnails(live)
    for path in ("cam_1/1", "cam_2/0", "cam_1/255", "%2e%2e%2fcam_1/0"):
        problem_of(live.client.get(f"{address}/thumbnails/{path}"), 404, "not_found")
    for number in ("-1", "256", "one"):
        assert live.client.get(f"{address}/thumbnails/cam_1/{number}").status_code == 422


def test_pictures_are_deleted_with_their_session(live: Live) -> None:
    before = set(live.kept())
    address, (_, (second,)) = thumbnails(live)
    assert PICTURE in {path.read_bytes() for path in set(live.kept()) - before}
    assert live.client.delete(address).status_code == 204
    assert set(live.kept()) <= before
    problem_of(live.client.get(str(second["url"])), 404, "not_found")


def test_damaged_picture_is_not_shown(live: Live) -> None:
    before = set(live.kept())
    _, (_, (second,)) = thumbnails(live)
    (path,) = [path for path in set(live.kept()) - before if path.read_bytes() == PICTURE]
    path.write_bytes(b"another one here")
    problem_of(live.client.get(str(second["url"])), 500, "artifact_damaged")


def test_keypoints_have_no_pictures(live: Live) -> None:
    parts = [("keypoints", (f"cam_{index}.zip", b"archive")) for index in range(2)]
    parts += [("timestamps", ("timestamps.csv", b"camera,frame,time_s")), form(0)[0]]
    answer = live.client.post("/v1/sessions", files=parts)
    assert [camera["thumbnails"] for camera in answer.json()["preflight"]["cameras"]] == [[], []]
