"""Result files: list, downloads, ranges, archives, signed addresses, missing and damaged files."""

import contextlib
import hashlib
import io
import json
import os
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import unquote

import httpx2
import pytest

from api.cli.client import Client, ServiceError
from api.web.settings import Settings
from pipeline.core.problems.request_codes import INTERNAL_ERROR
from pipeline.core.problems.session_codes import VIDEO_TRUNCATED
from tests.api.conftest import RESULT, Live, form, problem_of, running
from tests.cases import slow_but
from tests.s3 import S3
from worker.run.reaper import Reaper
from worker.store.files.file_keys import result_key
from worker.store.model.job_records import JobProblem

# More than the buffers of a connection hold.
LARGE = os.urandom(2**20) * 64
ETAG = f'"{hashlib.sha256(RESULT).hexdigest()}"'


@pytest.fixture
def job_id(live: Live) -> str:
    identifier = live.job_id()
    live.finish(identifier)
    return identifier


@pytest.fixture
def path(job_id: str) -> str:
    return f"/v1/jobs/{job_id}/results/person-1.bvh"


def test_list(live: Live, job_id: str, path: str) -> None:
    assert live.client.get(f"/v1/jobs/{job_id}/results").json() == {
        "results": [
            {
                "name": "person-1.bvh",
                "kind": "bvh",
                "person": 1,
                "person_name": "person-1",
                "format": "bvh",
                "preset": "default",
                "download_name": "untitled_person-1.bvh",
                "media_type": "text/plain; charset=utf-8",
                "num_bytes": len(RESULT),
                "sha256": ETAG.strip('"'),
                "revision": 0,
                "url": path,
            }
        ]
    }


def test_whole_file(live: Live, path: str) -> None:
    answer = live.client.get(path)
    assert answer.status_code == 200
    assert answer.content == RESULT
    assert answer.headers["etag"] == ETAG
    assert answer.headers["accept-ranges"] == "bytes"
    assert answer.headers["content-type"] == "text/plain; charset=utf-8"
    named = "filename=\"untitled_person-1.bvh\"; filename*=utf-8''untitled_person-1.bvh"
    assert answer.headers["content-disposition"] == f"attachment; {named}"
    assert answer.headers["content-length"] == str(len(RESULT))


RANGES = [
    ("bytes=0-0", 0, 1),
    ("bytes=10-19", 10, 20),
    ("bytes=1000-", 1000, 1024),
    ("bytes=1023-1023", 1023, 1024),
    ("bytes=1000-99999", 1000, 1024),
    ("bytes=-24", 1000, 1024),
    ("bytes=-99999", 0, 1024),
    ("BYTES=0-1", 0, 2),
]


def test_ranges(live: Live, path: str) -> None:
    for wanted, start, stop in RANGES:
        answer = live.client.get(path, headers={"Range": wanted})
        assert answer.status_code == 206, wanted
        assert answer.content == RESULT[start:stop], wanted
        assert answer.headers["content-range"] == f"bytes {start}-{stop - 1}/{len(RESULT)}"
        assert answer.headers["content-length"] == str(stop - start)
        assert answer.headers["etag"] == ETAG


def test_ranges_beyond_end(live: Live, path: str) -> None:
    for wanted in ("bytes=1024-", "bytes=5000-6000", "bytes=-0"):
        answer = live.client.get(path, headers={"Range": wanted})
        problem_of(answer, 416, "range_not_satisfiable")
        assert answer.headers["content-range"] == "bytes */1024", wanted


def test_ranges_that_may_be_ignored(live: Live, path: str) -> None:
    for wanted in ("bytes=5-2", "bytes=", "bytes=-", "bytes=a-b", "lines=1-2", "bytes=0-1,5-6", "x"):
        answer = live.client.get(path, headers={"Range": wanted})
        assert (answer.status_code, answer.content) == (200, RESULT), wanted


def test_if_range(live: Live, path: str) -> None:
    for validator, status in ((ETAG, 206), ('"other"', 200), (f"W/{ETAG}", 200)):
        answer = live.client.get(path, headers={"Range": "bytes=0-9", "If-Range": validator})
        assert answer.status_code == status, validator


def test_if_none_match(live: Live, path: str) -> None:
    for validators in (ETAG, f'"other", {ETAG}', f"W/{ETAG}", "*"):
        answer = live.client.get(path, headers={"If-None-Match": validators})
        assert (answer.status_code, answer.content) == (304, b""), validators
        assert answer.headers["etag"] == ETAG
    for validators in ('"other"', ""):
        assert live.client.get(path, headers={"If-None-Match": validators}).status_code == 200, validators


def test_all_as_one_archive(live: Live, job_id: str) -> None:
    address = live.client.get(f"/v1/jobs/{job_id}").json()["urls"]["results_zip"]
    answer = live.client.get(address)
    assert answer.headers["Content-Type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        assert archive.testzip() is None
        packed = {name: archive.read(name) for name in archive.namelist()}
    listed = live.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
    assert [result["person"] for result in listed] == [1]
    assert packed == {
        f"person-1/{result['download_name']}": live.client.get(result["url"]).content for result in listed
    }


def test_videos_are_in_folder_of_archive_as_they_are(live: Live) -> None:
    job_id = live.job_id()
    video = bytes(1000)
    live.finish(job_id, overlays={"overlay-cam_0.mp4": video})
    (listed,) = (
        one for one in live.client.get(f"/v1/jobs/{job_id}/results").json()["results"] if one["kind"] == "overlay"
    )
    assert (listed["person"], listed["format"], listed["media_type"]) == (None, None, "video/mp4")
    sent = live.client.get(listed["url"])
    assert (sent.content, sent.headers["content-type"]) == (video, "video/mp4")
    with zipfile.ZipFile(io.BytesIO(live.client.get(f"/v1/jobs/{job_id}/results.zip").content)) as archive:
        assert archive.testzip() is None
        packed = archive.getinfo(f"overlay/{listed['download_name']}")
    assert (packed.compress_type, packed.file_size) == (zipfile.ZIP_STORED, 1000)


def test_file_of_take_has_no_person(live: Live) -> None:
    job_id = live.job_id()
    live.finish(job_id, scenes={"take.glb": b"glTF"})
    (listed,) = (
        result
        for result in live.client.get(f"/v1/jobs/{job_id}/results").json()["results"]
        if result["name"] == "take.glb"
    )
    assert (listed["kind"], listed["format"], listed["person"], listed["preset"]) == ("glb", "glb", None, None)
    assert live.client.get(listed["url"]).headers["content-type"] == "model/gltf-binary"
    with zipfile.ZipFile(io.BytesIO(live.client.get(f"/v1/jobs/{job_id}/results.zip").content)) as archive:
        assert archive.read(listed["download_name"]) == b"glTF"


@pytest.mark.parametrize(
    ("name", "kept"),
    [("take", "take"), ('Größe "2"; 撮影 / ..\\a', "größe-2-撮影-a"), ("a" * 150, "a" * 120), ("?", "take")],
)
def test_archive_bears_sessions_name(live: Live, name: str, kept: str) -> None:
    manifest = ("manifest", ("manifest.json", json.dumps({"name": name}).encode(), "application/json"))
    session = live.client.post("/v1/sessions", files=[*form(), manifest])
    assert session.status_code == 201, session.text
    job_id = live.client.post(f"/v1/sessions/{session.json()['id']}/jobs", json={}).json()["id"]
    live.finish(job_id)
    header = live.client.get(f"/v1/jobs/{job_id}/results.zip").headers["Content-Disposition"]
    assert header.isascii()
    assert header.startswith("attachment; filename=")
    assert unquote(header.rpartition("filename*=utf-8''")[2]) == f"{kept}.zip"


def test_no_archive_of_nothing(live: Live) -> None:
    job_id = live.job_id()
    problem_of(live.client.get(f"/v1/jobs/{job_id}/results.zip"), 409, "not_finished")


def test_archive_of_removed_files_is_not_begun(live: Live, job_id: str) -> None:
    live.services.artifacts.delete_prefix(f"jobs/{job_id}/")
    problem_of(live.client.get(f"/v1/jobs/{job_id}/results.zip"), 410, "expired")


def test_unknown_name(live: Live, job_id: str) -> None:
    for name in ("person-2.bvh", "%2e%2e%2fmulticap.db", "person-1.bvh%00"):
        problem_of(live.client.get(f"/v1/jobs/{job_id}/results/{name}"), 404, "not_found")


def test_unfinished_job_has_none_yet(live: Live) -> None:
    job_id = live.job_id()
    problem = problem_of(live.client.get(f"/v1/jobs/{job_id}/results"), 409, "not_finished")
    assert problem["retryable"] is True
    problem_of(live.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh"), 409, "not_finished")


@pytest.mark.parametrize("results", ["results", "results.zip", "results/person-1.bvh"])
def test_jobs_that_ended_without_results_have_none_anywhere(live: Live, results: str) -> None:
    canceled, failed = live.job_id(), live.job_id()
    live.client.post(f"/v1/jobs/{canceled}/cancel")
    problem = problem_of(live.client.get(f"/v1/jobs/{canceled}/{results}"), 409, "no_results")
    assert problem["hint"] == "Retry the job."
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    live.services.store.leases.fail(
        claim.chunk_id, claim.lease_token, JobProblem(VIDEO_TRUNCATED, "The video ends early.")
    )
    problem = problem_of(live.client.get(f"/v1/jobs/{failed}/{results}"), 409, "no_results")
    assert problem["hint"] == (
        "The job's error is video_truncated: The video ends early. Correct the input and send a new capture."
    )
    assert not problem["retryable"]
    crashed = live.job_id()
    crash = JobProblem(INTERNAL_ERROR, "It crashed.", retryable=True)
    while claim := live.services.store.leases.claim("test", 30.0):
        live.services.store.leases.fail(claim.chunk_id, claim.lease_token, crash)
    problem = problem_of(live.client.get(f"/v1/jobs/{crashed}/{results}"), 409, "no_results")
    assert problem["hint"].startswith("The job's error is internal_error: It crashed.")
    assert problem["hint"].endswith(" Retry the job.")


def test_removed_file_is_gone_and_its_key_unsaid(live: Live, path: str, job_id: str) -> None:
    live.services.artifacts.delete_prefix(f"jobs/{job_id}/")
    answer = live.client.get(path)
    problem_of(answer, 410, "expired")
    assert "results" not in answer.json()["detail"]


def test_expired_results_are_gone(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(retention_days=1e-7)) as live:
        job_id = live.job_id()
        live.finish(job_id)
        kept_until = live.client.get(f"/v1/jobs/{job_id}").json()["expires_at"]
        assert kept_until is not None
        time.sleep(0.05)
        Reaper(live.services.store, live.services.artifacts, live.services.disk, lambda: True, 20.0).reap()
        job = live.client.get(f"/v1/jobs/{job_id}").json()
        assert (job["state"], job["expires_at"]) == ("expired", kept_until)
        problem_of(live.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh"), 410, "expired")
        problem = problem_of(live.client.get(f"/v1/jobs/{job_id}/results.zip"), 410, "expired")
        assert problem["hint"].startswith("Start another job of its capture")
        problem_of(live.client.post(f"/v1/jobs/{job_id}/retry"), 409, "conflict")
        assert live.client.delete(f"/v1/jobs/{job_id}").status_code == 204


def test_signed_downloads(make_settings: Callable[..., Settings], s3: S3, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    with running(make_settings(artifacts_url=s3.new_url(), signed_downloads_s=60)) as live:
        job_id = live.job_id()
        live.finish(job_id)
        path = f"/v1/jobs/{job_id}/results/person-1.bvh"
        sent = live.client.get(path)
        assert (sent.status_code, httpx2.get(sent.headers["location"], trust_env=False).content) == (307, RESULT)
        # A page may ask the service alone.
        own = live.client.get(path, params={"redirect": "false"}, headers={"Range": "bytes=3-5"})
        assert (own.status_code, own.content) == (206, RESULT[3:6])
        # The signature is valid for GET only: the store would refuse HEAD.
        headed = live.client.head(path)
        assert (headed.status_code, headed.headers["etag"]) == (200, ETAG)
        assert headed.headers["content-length"] == str(len(RESULT))
        live.services.artifacts.delete_prefix(f"jobs/{job_id}/")
        assert (live.client.get(path).status_code, live.client.head(path).status_code) == (410, 410)


def flip(path: Path) -> None:
    """Change forty bytes in the middle, in place."""
    with path.open("r+b") as file:
        file.seek(500)
        file.write(bytes(byte ^ 255 for byte in RESULT[500:540]))


def truncate(path: Path) -> None:
    os.truncate(path, 600)


@pytest.fixture
def stored(live: Live, job_id: str) -> Path:
    """File of a result that was downloaded once, so that the service has compared its SHA-256 before."""
    live.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh").raise_for_status()
    return live.settings.data_dir / "artifacts" / result_key(job_id, "person-1.bvh")


DAMAGES = pytest.mark.parametrize("damage", [flip, truncate])


@DAMAGES
@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Range": "bytes=0-9"},
        {"Range": "bytes=510-519"},
        {"Range": "bytes=99999-"},
        {"If-None-Match": ETAG},
        {"If-None-Match": "*"},
    ],
)
def test_no_byte_of_damaged_file_is_sent(
    live: Live, path: str, stored: Path, damage: Callable[[Path], None], headers: dict[str, str]
) -> None:
    damage(stored)
    problem = problem_of(live.client.get(path, headers=headers), 500, "result_damaged")
    assert [item["file"] for item in problem["errors"]] == ["person-1.bvh"]
    assert problem["hint"].startswith("Start another job of its capture")
    assert not problem["retryable"]
    headed = live.client.head(path, headers=headers)
    assert (headed.status_code, headed.headers.get("etag")) == (500, None)
    stored.write_bytes(RESULT)
    assert live.client.get(path).content == RESULT


@DAMAGES
def test_no_archive_is_begun_with_damaged_file(
    live: Live, job_id: str, stored: Path, damage: Callable[[Path], None]
) -> None:
    damage(stored)
    problem = problem_of(live.client.get(f"/v1/jobs/{job_id}/results.zip"), 500, "result_damaged")
    assert [item["file"] for item in problem["errors"]] == ["person-1.bvh"]


@contextlib.contextmanager
def begun_download(live: Live, name: str) -> Iterator[tuple[bytes, Iterator[bytes], Path]]:
    """Begin to download a large result; first block, the other blocks, and the stored file."""
    job_id = live.job_id()
    live.finish(job_id, LARGE)
    stored = live.settings.data_dir / "artifacts" / result_key(job_id, "person-1.bvh")
    with live.client.stream("GET", f"/v1/jobs/{job_id}/{name}") as answer:
        assert answer.status_code == 200
        blocks = answer.iter_raw()
        yield next(blocks), blocks, stored


@DAMAGES
@pytest.mark.parametrize("name", ["results/person-1.bvh", "results.zip"])
def test_file_damaged_while_sent_is_not_sent_to_its_end(live: Live, name: str, damage: Callable[[Path], None]) -> None:
    with begun_download(live, name) as (first, blocks, stored):
        received = [first]
        damage(stored)
        with pytest.raises(httpx2.RemoteProtocolError):
            received.extend(blocks)
    assert sum(map(len, received)) < len(LARGE)


@pytest.mark.parametrize("name", slow_but(["results/person-1.bvh"], ["results/person-1.bvh", "results.zip"]))
def test_backup_that_is_made_meanwhile_breaks_no_download(live: Live, name: str, tmp_path: Path) -> None:
    with begun_download(live, name) as (first, blocks, stored):
        os.link(stored, live.settings.data_dir / "held")
        received = first + b"".join(blocks)
    (live.settings.data_dir / "held").unlink()
    if name == "results.zip":
        with zipfile.ZipFile(io.BytesIO(received)) as archive:
            received = archive.read("person-1/untitled_person-1.bvh")
    assert received == LARGE


@pytest.mark.slow
def test_results_of_damaged_bucket(
    make_settings: Callable[..., Settings], s3: S3, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    url = s3.new_url()
    with running(make_settings(artifacts_url=url)) as live:
        job_id = live.job_id()
        live.finish(job_id)
        path = f"/v1/jobs/{job_id}/results/person-1.bvh"
        assert live.client.get(path).content == RESULT
        live.services.artifacts.put_bytes(result_key(job_id, "person-1.bvh"), RESULT[::-1])
        for address in (path, f"/v1/jobs/{job_id}/results.zip"):
            problem_of(live.client.get(address), 500, "result_damaged")
    with running(make_settings(artifacts_url=url, signed_downloads_s=60)) as live:
        job_id = live.job_id()
        live.finish(job_id)
        live.services.artifacts.put_bytes(result_key(job_id, "person-1.bvh"), RESULT[:-1])
        path = f"/v1/jobs/{job_id}/results/person-1.bvh"
        problem_of(live.client.get(path), 500, "result_damaged")
        # The client has to compare content of the same size.
        live.services.artifacts.put_bytes(result_key(job_id, "person-1.bvh"), RESULT[::-1])
        with pytest.raises(ServiceError, match=r"person-1\.bvh is damaged"):
            Client(live.client).download(live.client.get(f"/v1/jobs/{job_id}").json(), tmp_path)
        assert list(tmp_path.iterdir()) == []


def test_our_own_client_takes_paths_as_texts(live: Live, tmp_path: Path) -> None:
    for _, (name, content) in form():
        (tmp_path / name).write_bytes(content)
    client = Client(live.client)
    videos, calibration = [str(tmp_path / f"cam_{index}.mp4") for index in range(2)], str(tmp_path / "calibration.toml")
    job = client.submit("Take", videos, calibration)
    live.finish(job["id"])
    assert client.download(client.follow(job), str(tmp_path / "new")) == [tmp_path / "new" / "person-1.bvh"]


@DAMAGES
def test_client_continues_broken_download_and_reports_damage(
    live: Live, tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    job_id = live.job_id()
    live.finish(job_id, LARGE)
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    stored = live.settings.data_dir / "artifacts" / result_key(job_id, "person-1.bvh")
    damaged = threading.Event()

    def damage_it(response: httpx2.Response) -> None:
        if response.url.path.endswith("person-1.bvh"):
            damage(stored)
            damaged.set()

    with httpx2.Client(base_url=live.client.base_url, event_hooks={"response": [damage_it]}) as http:
        for _ in range(2):
            with pytest.raises(ServiceError, match="is damaged"):
                Client(http).download(job, tmp_path)
    assert damaged.is_set()
    assert list(tmp_path.iterdir()) == []


def test_empty_file(live: Live) -> None:
    job_id = live.job_id()
    live.finish(job_id, b"")
    path = f"/v1/jobs/{job_id}/results/person-1.bvh"
    assert live.client.get(path).content == b""
    problem_of(live.client.get(path, headers={"Range": "bytes=0-"}), 416, "range_not_satisfiable")
