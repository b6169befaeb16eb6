"""Uploads by tus 1.0, and sessions created from them."""

import asyncio
import base64
import contextlib
import errno
import fcntl
import hashlib
import os
import socket
import sqlite3
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest
from sqlalchemy.exc import OperationalError
from starlette.requests import ClientDisconnect

from api.web.settings import Settings
from api.web.uploads.files import FolderUploads
from api.web.uploads.spool import Checksum, UploadSpool
from tests.api.conftest import Live, problem_of, raw, running
from tests.waiting import wait_for
from worker.store.files.disk import DiskSpace
from worker.store.model.session_records import Upload
from worker.store.repositories.sessions import Sessions
from worker.store.repositories.uploads import Uploads

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = TUS | {"Content-Type": "application/offset+octet-stream"}
CONTENT = os.urandom(5000)


def encoded(content: bytes) -> str:
    return base64.b64encode(content).decode()


def checksum(content: bytes, algorithm: str = "sha1") -> dict[str, str]:
    return {"Upload-Checksum": f"{algorithm} {encoded(hashlib.new(algorithm, content).digest())}"}


@dataclass
class Uploader:
    """Client of the protocol."""

    client: httpx2.Client

    def create(self, length: object, name: str = "cam_0.mp4", **more: Any) -> httpx2.Response:
        headers = TUS | {"Upload-Length": str(length), "Upload-Metadata": f"filename {encoded(name.encode())}"}
        return self.client.post("/v1/uploads", headers=headers | more.pop("headers", {}), **more)

    def begin(self, length: int, name: str = "cam_0.mp4") -> str:
        answer = self.create(length, name)
        assert answer.status_code == 201, answer.text
        return str(answer.headers["location"])

    def send(self, address: str, offset: object, content: Any, **headers: str) -> httpx2.Response:
        return self.client.patch(address, content=content, headers=PIECE | {"Upload-Offset": str(offset)} | headers)

    def offset(self, address: str) -> int:
        answer = self.client.head(address, headers=TUS)
        assert answer.status_code == 200
        assert answer.headers["cache-control"] == "no-store"
        return int(answer.headers["upload-offset"])

    def upload(self, content: bytes, name: str) -> str:
        """Send a whole file; return the id of its upload."""
        address = self.begin(len(content), name)
        assert self.send(address, 0, content).status_code == 204
        return address.rpartition("/")[2]


@pytest.fixture
def tus(live: Live) -> Uploader:
    return Uploader(live.client)


def test_pieces_become_file(live: Live, tus: Uploader) -> None:
    address = tus.begin(len(CONTENT))
    for start, stop in ((0, 1), (1, 3000), (3000, 3000), (3000, 5000)):
        answer = tus.send(address, start, CONTENT[start:stop])
        assert (answer.status_code, answer.headers["upload-offset"], answer.content) == (204, str(stop), b"")
        assert tus.offset(address) == stop
    head = live.client.head(address, headers=TUS).headers
    assert (head["upload-length"], head["upload-metadata"]) == ("5000", f"filename {encoded(b'cam_0.mp4')}")
    (kept,) = live.kept()
    assert kept.read_bytes() == CONTENT


def test_description_of_uploads(live: Live, tus: Uploader) -> None:
    answer = live.client.options("/v1/uploads")
    assert answer.status_code == 204
    assert answer.headers["tus-version"] == "1.0.0"
    assert answer.headers["tus-extension"] == "creation,creation-with-upload,termination,expiration,checksum"
    assert answer.headers["tus-max-size"] == str(live.settings.max_file_bytes)
    assert set(answer.headers["tus-checksum-algorithm"].split(",")) == {"sha1", "sha256", "md5"}


def test_first_piece_may_come_with_creation(live: Live, tus: Uploader) -> None:
    answer = tus.create(5000, content=CONTENT[:2000], headers=PIECE | checksum(CONTENT[:2000], "sha256"))
    assert (answer.status_code, answer.headers["upload-offset"]) == (201, "2000")
    assert tus.send(answer.headers["location"], 2000, CONTENT[2000:]).status_code == 204
    assert live.kept()[0].read_bytes() == CONTENT


def test_empty_file_is_finished_at_once(tus: Uploader) -> None:
    assert tus.offset(tus.begin(0)) == 0


@pytest.mark.parametrize("version", [None, "0.2.2", "1.0.1", ""])
def test_other_versions_are_refused(live: Live, tus: Uploader, version: str | None) -> None:
    address = tus.begin(10)
    headers = PIECE | {"Upload-Offset": "0", "Upload-Length": "10"}
    headers = {name: value for name, value in headers.items() if name != "Tus-Resumable"}
    headers |= {} if version is None else {"Tus-Resumable": version}
    for method, path in (("POST", "/v1/uploads"), ("PATCH", address), ("DELETE", address)):
        answer = live.client.request(method, path, headers=headers)
        problem_of(answer, 412, "tus_version")
        assert answer.headers["tus-version"] == answer.headers["tus-resumable"] == "1.0.0"
    assert live.client.head(address, headers=headers).status_code == 412
    assert tus.offset(address) == 0


def test_size_at_limit_one_over_and_nonsense(live: Live, tus: Uploader) -> None:
    most = live.settings.max_file_bytes
    assert tus.create(most).status_code == 201
    answer = tus.create(most + 1)
    problem_of(answer, 413, "content_too_large")
    assert answer.headers["tus-max-size"] == str(most)
    for length in (-1, "", "x", "1e3", "9" * 5000):
        problem_of(tus.create(length), 400, "header_invalid")
    problem_of(live.client.post("/v1/uploads", headers=TUS), 400, "header_invalid")
    assert len(live.kept()) == 1


def test_no_more_is_taken_than_was_announced(live: Live, tus: Uploader) -> None:
    address = tus.begin(1000)
    problem_of(tus.send(address, 0, CONTENT), 413, "content_too_large")
    assert tus.offset(address) == 0
    problem_of(tus.send(address, 0, iter([CONTENT[:600], CONTENT[600:1001]])), 413, "content_too_large")
    assert tus.offset(address) <= 1000
    assert live.kept()[0].read_bytes() == CONTENT[: tus.offset(address)]


@pytest.mark.parametrize("offset", [0, 1, 1999, 2001, 4900])
def test_at_another_offset_nothing_is_taken(tus: Uploader, offset: int) -> None:
    address = tus.begin(5000)
    tus.send(address, 0, CONTENT[:2000])
    problem_of(tus.send(address, offset, CONTENT[:100]), 409, "offset_mismatch")
    assert tus.offset(address) == 2000


@pytest.mark.parametrize("offset", ["-1", "x", "", "0x1"])
def test_offsets_that_are_none(tus: Uploader, offset: str) -> None:
    problem_of(tus.send(tus.begin(10), offset, b"x"), 400, "header_invalid")


def test_pieces_have_type(live: Live, tus: Uploader) -> None:
    address = tus.begin(10)
    for content_type in ("application/octet-stream", "text/plain", ""):
        answer = live.client.patch(
            address, content=b"x", headers=TUS | {"Upload-Offset": "0", "Content-Type": content_type}
        )
        problem_of(answer, 415, "unsupported_media_type")
    assert tus.offset(address) == 0


@pytest.mark.parametrize("algorithm", ["sha1", "sha256", "md5"])
def test_piece_with_checksum_stays_whole_or_not_at_all(live: Live, tus: Uploader, algorithm: str) -> None:
    address = tus.begin(5000)
    assert tus.send(address, 0, CONTENT[:10], **checksum(CONTENT[:10], algorithm)).status_code == 204
    problem_of(tus.send(address, 10, CONTENT[10:], **checksum(CONTENT, algorithm)), 460, "checksum_mismatch")
    assert tus.offset(address) == 10
    assert tus.send(address, 10, CONTENT[10:], **checksum(CONTENT[10:], algorithm)).status_code == 204
    assert [path.read_bytes() for path in live.kept()] == [CONTENT]


@pytest.mark.parametrize("header", ["sha1 !", "crc99 AAAA", "", "AAAA"])
def test_checksums_that_are_none(tus: Uploader, header: str) -> None:
    problem_of(tus.send(tus.begin(10), 0, b"x", **{"Upload-Checksum": header}), 400, "checksum_invalid")


@pytest.mark.parametrize(
    "metadata",
    [
        None,
        "",
        "filename",
        "filename !!!",
        f"filename {encoded(b'../cam.mp4')}",
        f"filename {encoded(bytes([255, 254]))}",
        f"filename {encoded(b'x' * 201)}",
        f"filename {encoded(b'a')},filename {encoded(b'b')}",
        f"name {encoded(b'cam.mp4')}",
        f"filename {encoded(b'cam.mp4')},x {'A' * 5000}",
        "filename K\u00e4se",
    ],
)
def test_file_needs_name(live: Live, metadata: str | None) -> None:
    headers = httpx2.Headers(TUS | {"Upload-Length": "10"}, encoding="latin-1")
    if metadata is not None:
        headers["Upload-Metadata"] = metadata
    problem_of(live.client.post("/v1/uploads", headers=headers), 400, "metadata_invalid")
    assert live.kept() == []


def test_methods_by_another_name(live: Live, tus: Uploader) -> None:
    address = tus.begin(4)
    headers = PIECE | {"Upload-Offset": "0", "X-HTTP-Method-Override": "PATCH"}
    assert live.client.post(address, content=b"pose", headers=headers).status_code == 204
    assert live.client.post(address, headers=TUS | {"X-HTTP-Method-Override": "DELETE"}).status_code == 204
    assert live.kept() == []
    problem_of(live.client.post(address, headers=TUS), 405, "method_not_allowed")


def test_deleted_upload_is_gone(live: Live, tus: Uploader) -> None:
    address = tus.begin(10)
    answer = live.client.delete(address, headers=TUS)
    assert (answer.status_code, answer.headers["tus-resumable"]) == (204, "1.0.0")
    assert live.kept() == []
    problem_of(tus.send(address, 0, b"x"), 404, "not_found")
    problem_of(live.client.delete(address, headers=TUS), 404, "not_found")
    assert live.client.head(address, headers=TUS).status_code == 404


def test_time_runs_from_last_piece_and_then_it_goes(live: Live, tus: Uploader) -> None:
    answer = tus.create(10)
    address, other = answer.headers["location"], tus.begin(10)
    assert parsedate_to_datetime(answer.headers["upload-expires"]).timestamp() == pytest.approx(
        time.time() + live.settings.upload_keep_s, abs=30
    )
    database = live.settings.data_dir / "multicap.db"
    with contextlib.closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE uploads SET expires_at = expires_at - 1000")
    renewed = tus.send(address, 0, b"x").headers["upload-expires"]
    assert parsedate_to_datetime(renewed) >= parsedate_to_datetime(answer.headers["upload-expires"])
    with contextlib.closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE uploads SET expires_at = 0 WHERE id = ?", [address.rpartition("/")[2]])
    problem_of(tus.send(address, 1, b"x"), 404, "not_found")
    for path in live.kept():
        os.utime(path, (0, 0))
    live.services.uploads.sweep(live.services.store)
    assert [path.name for path in live.kept()] == [other.rpartition("/")[2]]


def wait_for_offset(tus: Uploader, address: str, offset: int) -> None:
    deadline_s = time.monotonic() + 120
    while tus.offset(address) != offset:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def piece_request(live: Live, address: str, length: int, content: bytes, **headers: str) -> bytes:
    """Request whose body may break off."""
    fields = PIECE | {"Host": "localhost", "Upload-Offset": "0", "Content-Length": str(length)} | headers
    lines = [f"PATCH {address} HTTP/1.1", *(f"{name}: {value}" for name, value in fields.items()), "", ""]
    return "\r\n".join(lines).encode() + content


@pytest.mark.parametrize(("compared", "kept"), [(None, 1234), (Checksum("sha1", b""), 0)])
def test_bytes_before_broken_connection_are_kept(tmp_path: Path, compared: Checksum | None, kept: int) -> None:
    spool = FolderUploads(tmp_path, DiskSpace(tmp_path))
    upload = Upload(spool.create(5000), "cam_0.mp4", 5000, "", datetime.now(UTC), spool.name)

    async def breaking() -> AsyncIterator[bytes]:
        yield CONTENT[:1000]
        yield CONTENT[1000:1234]
        raise ClientDisconnect

    with pytest.raises(ClientDisconnect):
        asyncio.run(spool.append(upload, 0, breaking(), compared))
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [CONTENT[:kept]]


def test_interrupted_piece_with_checksum_is_dropped(live: Live, tus: Uploader) -> None:
    address = tus.begin(5000)
    raw(live.address, piece_request(live, address, 5000, CONTENT[:1234], **checksum(CONTENT)))
    # The service may still be at the end of the broken request.
    wait_for(lambda: tus.send(address, 0, CONTENT).status_code == 204, timeout_s=120)
    assert [path.read_bytes() for path in live.kept()] == [CONTENT]


def test_reconnected_client_does_not_wait_for_its_old_request(live: Live, tus: Uploader) -> None:
    address, uploads = tus.begin(5000), live.services.uploads
    assert isinstance(uploads, UploadSpool)
    with socket.create_connection(live.address[:2], timeout=180) as stalled:
        stalled.sendall(piece_request(live, address, 5000, CONTENT[:1234]))
        deadline_s = time.monotonic() + 120
        while not uploads.has_writer(address.rpartition("/")[2]):
            assert time.monotonic() < deadline_s
        problem_of(tus.send(address, 4000, CONTENT[4000:]), 409, "offset_mismatch")
        assert stalled.recv(65536).startswith(b"HTTP/1.1 423 ")
    offset = tus.offset(address)
    assert offset in {0, 1234}  # depends on whether the service had read the piece
    assert tus.send(address, offset, CONTENT[offset:]).status_code == 204
    assert live.kept()[0].read_bytes() == CONTENT


def test_upload_is_locked_while_another_process_writes(live: Live, tus: Uploader) -> None:
    address = tus.begin(4)
    with live.kept()[0].open("r+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert problem_of(tus.send(address, 0, b"pose"), 423, "upload_locked")["retryable"]
    assert tus.send(address, 0, b"pose").status_code == 204


def test_question_for_offset_during_outage_is_asked_again(
    live: Live, tus: Uploader, monkeypatch: pytest.MonkeyPatch
) -> None:
    """tus-js-client forgets an upload at 5xx and sends the file anew; at 423 it waits."""
    address = tus.begin(4)

    def away(*_: object) -> None:
        raise OperationalError("SELECT", {}, sqlite3.OperationalError("unable to open database file"))

    monkeypatch.setattr(Uploads, "get", away)
    answer = live.client.head(address, headers={"Tus-Resumable": "1.0.0"})
    assert (answer.status_code, answer.headers["Retry-After"]) == (423, "5")
    monkeypatch.undo()
    assert tus.offset(address) == 0


def test_full_disk_keeps_what_there_was_room_for(live: Live, tus: Uploader, monkeypatch: pytest.MonkeyPatch) -> None:
    address = tus.begin(5000)
    real = os.pwrite

    def nearly_full(handle: int, data: Any, offset: int) -> int:
        if offset >= 2000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(handle, data[: 2000 - offset], offset)

    monkeypatch.setattr(os, "pwrite", nearly_full)
    problem_of(tus.send(address, 0, CONTENT), 507, "storage_full")
    assert tus.offset(address) == 2000
    monkeypatch.undo()
    assert tus.send(address, 2000, CONTENT[2000:]).status_code == 204
    assert live.kept()[0].read_bytes() == CONTENT


def test_restart_keeps_uploads_and_removes_orphans(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    with running(settings) as live:
        address = Uploader(live.client).begin(5000)
        Uploader(live.client).send(address, 0, CONTENT[:3000])
    (settings.uploads_dir / f"{address.rpartition('/')[2]}.piece").write_bytes(b"not compared")
    orphan = settings.uploads_dir / "0190"
    orphan.write_bytes(b"of no row")
    os.utime(orphan, (0, 0))
    with running(settings) as live:
        tus = Uploader(live.client)
        assert tus.offset(address) == 3000
        assert tus.send(address, 3000, CONTENT[3000:]).status_code == 204
        live.services.uploads.sweep(live.services.store)
        assert [path.read_bytes() for path in live.kept()] == [CONTENT]


def test_quota(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_tenant_uploads=2, max_tenant_bytes=1000)) as live:
        tus = Uploader(live.client)
        problem_of(tus.create(1001), 403, "quota_exceeded")
        address = tus.begin(900)
        problem_of(tus.create(101), 403, "quota_exceeded")
        tus.begin(100)
        problem_of(tus.create(0), 403, "quota_exceeded")
        assert len(live.kept()) == 2
        quotas = live.client.get("/v1/caller").json()["quotas"]
        assert (quotas["uploads"], quotas["stored_bytes"]["used"]) == ({"used": 2, "limit": 2}, 1000)
        live.client.delete(address, headers=TUS)
        tus.begin(900)


class TestSessions:
    """Sessions that name uploads in place of files."""

    def body(self, tus: Uploader, videos: int = 2) -> dict[str, Any]:
        return {
            "videos": [tus.upload(b"video" + bytes([k]) * 100, f"cam_{k}.mp4") for k in range(videos)],
            "calibration": tus.upload(b"[cam_0]", "calibration.toml"),
            "manifest": {"name": "Take 1"},
        }

    def test_session_has_files_and_its_uploads_are_gone(self, live: Live, tus: Uploader) -> None:
        body = self.body(tus)
        answer = live.client.post("/v1/sessions", json=body)
        assert answer.status_code == 201, answer.text
        session = answer.json()
        assert session["name"] == "Take 1"
        expected = {f"cam_{k}.mp4": hashlib.sha256(b"video" + bytes([k]) * 100).hexdigest() for k in range(2)}
        assert {one["name"]: one["sha256"] for one in session["files"] if one["kind"] == "video"} == expected
        assert list(live.settings.uploads_dir.iterdir()) == []
        assert live.client.head(f"/v1/uploads/{body['calibration']}", headers=TUS).status_code == 404
        problem = problem_of(live.client.post("/v1/sessions", json=body), 422, "invalid_request")
        assert [item["code"] for item in problem["errors"]] == ["upload_unknown"] * 3
        live.client.delete(answer.headers["location"])
        assert live.kept() == []

    def test_job_at_once(self, live: Live, tus: Uploader) -> None:
        answer = live.client.post("/v1/jobs", json=self.body(tus) | {"spec": {"smoothing": "none"}})
        assert answer.status_code == 202, answer.text
        assert answer.json()["spec"]["smoothing"] == "none"
        assert list(live.settings.uploads_dir.iterdir()) == []

    def test_everything_wrong_is_said_and_uploads_stay(self, live: Live, tus: Uploader) -> None:
        body = self.body(tus, 1)
        unfinished = tus.begin(10, "cam_9.mp4").rpartition("/")[2]
        body["videos"] += [unfinished, "01890a5c-7c1e-7a4b-8f00-000000000000", body["videos"][0]]
        kept = {path.name for path in live.kept()}
        problem = problem_of(live.client.post("/v1/sessions", json=body), 422, "invalid_request")
        assert {(item["code"], item["pointer"]) for item in problem["errors"]} == {
            ("upload_unfinished", "/videos/1"),
            ("upload_unknown", "/videos/2"),
            ("duplicate_file_name", "/videos/3"),
        }
        assert {path.name for path in live.kept()} == kept
        body["videos"] = body["videos"][:1]
        assert live.client.post("/v1/sessions", json=body).status_code == 201

    def test_problems_of_preflight_point_to_upload(self, live: Live, tus: Uploader) -> None:
        body = self.body(tus)
        body["videos"][1] = tus.upload(b"WRONG", "broken.mp4")
        problem = problem_of(live.client.post("/v1/jobs", json=body), 422, "invalid_request")
        assert [(item["code"], item["pointer"]) for item in problem["errors"]] == [("video_unreadable", "/videos/1")]
        assert len(list(live.settings.uploads_dir.iterdir())) == 4

    def test_files_have_limits_of_their_parts(self, live: Live, tus: Uploader) -> None:
        body = self.body(tus)
        body["calibration"] = tus.upload(b"x" * (live.settings.max_calibration_bytes + 1), "large.toml")
        problem_of(live.client.post("/v1/sessions", json=body), 413, "content_too_large")
        body["calibration"] = tus.upload(b"x" * live.settings.max_calibration_bytes, "exact.toml")
        body["videos"] = [tus.upload(b"v" * 80_000, f"cam_{k}.mp4") for k in range(3)]
        assert live.client.post("/v1/sessions", json=body).status_code == 201
        body["calibration"] = tus.upload(b"x" * live.settings.max_calibration_bytes, "exact.toml")
        body["videos"] = [tus.upload(b"v" * 80_001, f"cam_{k}.mp4") for k in range(3)]
        problem_of(live.client.post("/v1/sessions", json=body), 413, "content_too_large")

    @pytest.mark.parametrize(
        ("body", "status", "code"),
        [
            (b"{", 400, "malformed_json"),
            (b"[]", 422, "invalid_request"),
            (b"{}", 422, "invalid_request"),
            (b'{"calibration": "../x"}', 422, "invalid_request"),
            (b'{"calibration": "01890a5c-7c1e-7a4b-8f00-000000000000", "spec": {}}', 422, "invalid_request"),
            (b" " * 1001, 413, "content_too_large"),
        ],
    )
    def test_bodies_that_are_none(self, live: Live, body: bytes, status: int, code: str) -> None:
        answer = live.client.post("/v1/sessions", content=body, headers={"Content-Type": "application/json"})
        problem_of(answer, status, code)

    def test_session_that_can_not_be_recorded_leaves_uploads(
        self, live: Live, tus: Uploader, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        body = self.body(tus)

        def fail(*_: object) -> None:
            raise RuntimeError

        monkeypatch.setattr(Sessions, "add", fail)
        problem_of(live.client.post("/v1/sessions", json=body), 500, "internal_error")
        monkeypatch.undo()
        assert {path.name for path in live.kept()} == {*body["videos"], body["calibration"]}
        assert live.client.post("/v1/sessions", json=body).status_code == 201


def test_blocks_are_written_on_way(live: Live, tus: Uploader, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes of a slow client are written within about a second."""
    monkeypatch.setattr("api.web.uploads.spool._BLOCK_S", 0.0)
    address = tus.begin(5000)
    with socket.create_connection(live.address[:2], timeout=180) as dripping:
        dripping.sendall(piece_request(live, address, 5000, CONTENT[:1234]))
        wait_for_offset(tus, address, 1234)
