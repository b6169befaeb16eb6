"""Sessions with a job that blurs faces: nothing of them is shown as it was sent, to anybody."""

import hashlib

import pytest

from pipeline.core.options.job_choices import BLURRED_KIND, PROXY_KIND, blurred_name
from tests.api.conftest import Live, form, problem_of
from worker.store.files.file_keys import result_key
from worker.store.model.job_records import Result
from worker.store.repositories.work.expiry import remove_files

SENT, BLURRED = b"sent" * 100, b"blurred" * 100
BLUR = {"blur_faces": True}


def send(live: Live, *names: str) -> str:
    parts = [("videos", (name, SENT)) for name in names or ("cam_0.mp4", "cam_1.avi")]
    answer = live.client.post("/v1/sessions", files=[*parts, form(0)[0]])
    assert answer.status_code == 201, answer.text
    return str(answer.json()["urls"]["self"])


def start(live: Live, address: str, **spec: object) -> dict[str, object]:
    answer = live.client.post(f"{address}/jobs", json=spec)
    assert answer.status_code == 202, answer.text
    return dict(answer.json())


def make(live: Live, job_id: str, name: str, kind: str, content: bytes) -> None:
    """List a result file of a job, with the first chunk of it that is ready."""
    key = result_key(job_id, name, 0, kind)
    live.services.artifacts.put_bytes(key, content)
    made = Result(name, kind, None, "video/mp4", key, len(content), hashlib.sha256(content).hexdigest())
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    assert claim.job_id == job_id
    live.services.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 0, results=[made])


def cameras(live: Live, address: str, **query: str) -> list[dict[str, object]]:
    session = live.client.get(address, params=query).json()
    assert session["shows_blurred"] is True
    return list(session["preflight"]["cameras"])


def test_before_job_has_succeeded_nothing_is_shown(live: Live) -> None:
    address = send(live)
    assert live.client.get(f"{address}/videos/cam_0").content == SENT
    job = start(live, address, **BLUR)
    assert [(camera["video_url"], camera["thumbnails"]) for camera in cameras(live, address)] == [
        (None, []),
        (None, []),
    ]
    for camera in ("cam_0", "cam_1"):
        problem_of(live.client.get(f"{address}/videos/{camera}"), 409, "not_finished")
        problem_of(live.client.get(f"{address}/thumbnails/{camera}/0"), 404, "not_found")
    live.client.post(f"/v1/jobs/{job['id']}/cancel")
    # A job that ended without a result was still asked to blur.
    problem_of(live.client.get(f"{address}/videos/cam_0"), 409, "not_finished")
    assert live.client.delete(f"/v1/jobs/{job['id']}").status_code == 204
    assert live.client.get(f"{address}/videos/cam_0").content == SENT
    assert live.client.get(address).json()["shows_blurred"] is False


def test_shown_session_stays_until_blurred_job_ends(live: Live) -> None:
    """An earlier run goes on with its videos; a job that ended in any way is asked to blur."""
    address = send(live, "cam_0.mp4", "cam_1.mp4")
    live.finish(str(start(live, address)["id"]))
    job = start(live, address, **BLUR)
    assert live.client.get(f"{address}/videos/cam_0").content == SENT
    session = live.client.get(address).json()
    assert session["shows_blurred"] is False
    assert session["preflight"]["cameras"][0]["video_url"] == f"{address}/videos/cam_0"
    live.client.post(f"/v1/jobs/{job['id']}/cancel")
    problem_of(live.client.get(f"{address}/videos/cam_0"), 409, "not_finished")
    again = start(live, address, **BLUR)
    problem_of(live.client.get(f"{address}/videos/cam_0"), 409, "not_finished")
    make(live, str(again["id"]), blurred_name(0), BLURRED_KIND, BLURRED)
    assert live.client.get(f"{address}/videos/cam_0").content == BLURRED


def test_blurred_videos_take_place_of_all_others(live: Live) -> None:
    address = send(live)
    job = start(live, address, **BLUR)
    assert live.client.get(address).json()["proxies_job"] is None
    for number in range(2):
        make(live, str(job["id"]), blurred_name(number), BLURRED_KIND, BLURRED)
    start(live, address)
    for number, camera in enumerate(cameras(live, address)):
        link = f"{address}/videos/cam_{number}"
        assert (camera["video_url"], camera["media_start_s"]) == (link, 0.0)
        answer = live.client.get(link)
        assert (answer.content, answer.headers["content-type"]) == (BLURRED, "video/mp4")
        assert live.client.get(link, headers={"Range": "bytes=0-3"}).content == BLURRED[:4]


def test_proxies_that_were_made_before_are_deleted(live: Live) -> None:
    address = send(live)
    first = start(live, address)
    proxies = live.client.get(address).json()["proxies_job"]["id"]
    live.client.post(f"/v1/jobs/{first['id']}/cancel")
    make(live, proxies, "proxy-1.mp4", PROXY_KIND, SENT)
    assert live.client.get(f"{address}/videos/cam_1").content == SENT
    job = start(live, address, **BLUR)
    problem_of(live.client.get(f"/v1/jobs/{proxies}/results/proxy-1.mp4"), 404, "not_found")
    problem_of(live.client.get(f"{address}/videos/cam_1"), 409, "not_finished")
    assert live.client.delete(f"/v1/jobs/{job['id']}").status_code == 409
    remove_files(live.services.store.removals, live.services.artifacts)
    assert not [path for path in live.kept() if "proxy" in path.name]
    # Jobs that come later make no proxies either.
    start(live, address)
    assert live.client.get(address).json()["proxies_job"] is None


@pytest.mark.parametrize("scope", [{"scope": "job"}, {"scope": "video", "name": "cam_0"}])
def test_links_show_blurred_pictures_alone(live: Live, scope: dict[str, str]) -> None:
    """Also links that were made before faces were to be blurred."""
    address = send(live)
    first = start(live, address)
    made = live.client.post(f"/v1/jobs/{first['id']}/links", json=scope).json()
    query = {"link": made["url"].partition("link=")[2]}
    assert live.client.get(f"{address}/videos/cam_0", params=query).content == SENT
    live.client.post(f"/v1/jobs/{first['id']}/cancel")
    job = start(live, address, **BLUR)
    problem_of(live.client.get(f"{address}/videos/cam_0", params=query), 409, "not_finished")
    assert live.client.get(f"{address}/thumbnails/cam_0/0", params=query).status_code == 404
    proxies = live.client.get("/v1/jobs", params={"kind": "proxies"}).json()["jobs"]
    assert proxies == []
    make(live, str(job["id"]), blurred_name(0), BLURRED_KIND, BLURRED)
    assert live.client.get(f"{address}/videos/cam_0", params=query).content == BLURRED
    for path in ("/videos/cam_0%2f..%2fcam_0", "/inputs/0-cam_0.mp4", "/videos/%2e%2e%2finputs%2f0-cam_0.mp4"):
        assert SENT not in live.client.get(f"{address}{path}", params=query).content


def test_other_sessions_are_shown_as_before(live: Live) -> None:
    address, other = send(live), send(live)
    start(live, address, **BLUR)
    assert live.client.get(f"{other}/videos/cam_0").content == SENT
    assert live.client.get(other).json()["shows_blurred"] is False
