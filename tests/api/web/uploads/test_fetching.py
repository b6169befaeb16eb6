"""Uploads that the service fetches from URLs."""

import contextlib
import json
import os
import socket
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import structlog

from api.web.settings import Settings
from api.web.uploads import fetching
from tests.api.conftest import Live, problem_of, running
from tests.api.web.uploads.test_files import TUS, Uploader
from tests.s3 import S3
from tests.waiting import wait_for
from worker.store.files.disk import DiskSpace

SECRET = "signature=s3cr3t-of-the-store"  # noqa: S105
CONTENT = b"video" + os.urandom(80_000)


@dataclass
class VideoSource:
    """Server of files by name, with ranges; a test may change what it does with a request."""

    port: int
    files: dict[str, bytes] = field(default_factory=dict)
    headers: dict[str, str] = field(default_factory=lambda: {"ETag": '"1"'})
    statuses: list[int] = field(default_factory=list)  # of the next answers; then 200 or 206
    break_after: list[int] = field(default_factory=list)  # bytes of the next bodies, which then break
    stated_bytes: int | None = None  # in place of the true length
    has_ranges: bool = True
    hold: threading.Event = field(default_factory=threading.Event)
    requests: list[dict[str, str]] = field(default_factory=list)

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.port}/take/{name}?{SECRET}"


@contextlib.contextmanager
def serving_files() -> Iterator[VideoSource]:
    class SourceHandler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            store.requests.append({name.lower(): value for name, value in self.headers.items()} | {"path": self.path})
            path, _, query = self.path.partition("?")
            content = store.files.get(path.rpartition("/")[2])
            status = store.statuses.pop(0) if store.statuses else 200
            if content is None or query != SECRET or status != 200:
                self.send_response(404 if status == 200 else status)
                self.send_header("Location", f"/elsewhere?{SECRET}")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            start = 0
            is_same = self.headers.get("If-Range") in {None, store.headers.get("ETag")}
            if store.has_ranges and is_same and (wanted := self.headers.get("Range")):
                start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            self.send_response(206 if start else 200)
            if start:
                self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
            length = len(content) - start if store.stated_bytes is None else store.stated_bytes
            for name, value in ({"Content-Length": str(length)} | store.headers).items():
                if value:
                    self.send_header(name, value)
            self.end_headers()
            end = start + store.break_after.pop(0) if store.break_after else len(content)
            self.wfile.write(content[start:end])
            self.wfile.flush()
            if not store.hold.is_set():
                store.hold.wait(60)
            if end < len(content) or store.stated_bytes is not None:
                self.connection.shutdown(socket.SHUT_RDWR)
                self.close_connection = True

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), SourceHandler) as server:
        store = VideoSource(server.server_address[1])
        store.hold.set()
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield store
        store.hold.set()
        server.shutdown()
        thread.join()


@pytest.fixture
def source() -> Iterator[VideoSource]:
    with serving_files() as found:
        found.files = {"cam_0.mp4": CONTENT, "cam_1.mp4": CONTENT[::-1]}
        yield found


@pytest.fixture(scope="module")
def fetcher(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Service that fetches from this machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fetching, "_LOOK_S", 0.05)
        patch.setattr(fetching, "_RENEW_S", 0.2)
        patch.setattr(fetching, "_FIRST_PAUSE_S", 0.02)
        patch.setattr(fetching, "_LONGEST_PAUSE_S", 0.05)
        with running(make_settings(fetch_private=True, client_idle_s=2.0, max_json_bytes=4000)) as live:
            yield live


def begin(live: Live, url: str, **more: Any) -> str:
    answer = live.client.post("/v1/uploads/from-url", json={"url": url, **more})
    assert answer.status_code == 202, answer.text
    assert SECRET not in answer.text + str(answer.headers)
    return str(answer.headers["location"])


def state_of(live: Live, address: str) -> dict[str, Any]:
    answer = live.client.get(address)
    assert answer.status_code == 200, answer.text
    assert SECRET not in answer.text
    return dict(answer.json())


def ended(live: Live, address: str) -> dict[str, Any]:
    wait_for(lambda: state_of(live, address)["state"] != "fetching", 60)
    return state_of(live, address)


def file_of(live: Live, address: str) -> Path:
    return live.settings.uploads_dir / address.rpartition("/")[2]


def failed(live: Live, address: str) -> tuple[str, str]:
    found = ended(live, address)
    assert found["state"] == "failed"
    return found["error"]["code"], found["error"]["detail"]


def database_text(live: Live) -> str:
    """Pages of the database as a backup has them, with their unused parts."""
    with (
        contextlib.closing(sqlite3.connect(live.settings.data_dir / "multicap.db")) as database,
        contextlib.closing(sqlite3.connect(":memory:")) as copy,
    ):
        database.backup(copy)
        return copy.serialize().decode("latin-1")


def test_file_at_url_becomes_upload(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    source.break_after = [30_000, 0, 0]  # connections stall until they are given up
    address = begin(fetcher, source.url("cam_0.mp4"))
    wait_for(lambda: state_of(fetcher, address)["received_bytes"] == 30_000, 60)
    found = state_of(fetcher, address)
    assert (found["filename"], found["state"], found["num_bytes"]) == ("cam_0.mp4", "fetching", len(CONTENT))
    head = fetcher.client.head(address, headers=TUS).headers
    assert (head["upload-offset"], head["upload-length"]) == ("30000", str(len(CONTENT)))
    assert SECRET in database_text(fetcher)
    source.hold.set()
    found = ended(fetcher, address)
    assert (found["state"], found["received_bytes"], found["error"]) == ("finished", len(CONTENT), None)
    assert file_of(fetcher, address).read_bytes() == CONTENT
    assert SECRET not in database_text(fetcher)
    assert {request["accept-encoding"] for request in source.requests} == {"identity"}
    assert source.requests[1]["range"] == "bytes=30000-"
    assert source.requests[1]["if-range"] == '"1"'


@pytest.mark.parametrize("has_ranges", [True, False])
def test_broken_connection_continues(fetcher: Live, source: VideoSource, has_ranges: bool) -> None:
    source.has_ranges = has_ranges
    source.break_after = [10_000, 25_000, 0, 45_000 if has_ranges else 70_000]
    source.statuses = [200, 503, 429]
    address = begin(fetcher, source.url("cam_0.mp4"), filename="left.mp4")
    assert ended(fetcher, address)["state"] == "finished"
    assert file_of(fetcher, address).read_bytes() == CONTENT


@pytest.mark.parametrize(
    ("change", "code", "detail"),
    [
        ({"statuses": [302]}, "source_not_found", "The source answers with 302."),
        ({"statuses": [403]}, "source_not_found", "The source answers with 403."),
        ({"statuses": [500] * 8}, "source_broken", "The source answers with 500."),
        ({"headers": {"Content-Length": "", "Transfer-Encoding": "chunked"}}, "source_unusable", ""),
        ({"headers": {"Content-Encoding": "gzip"}}, "source_unusable", ""),
        ({"stated_bytes": 100_001}, "content_too_large", "The file is larger than the service accepts."),
        ({"stated_bytes": len(CONTENT) + 5}, "source_changed", ""),
        ({"stated_bytes": len(CONTENT) + 5, "has_ranges": False}, "source_broken", "The connection failed."),
    ],
)
def test_fetch_ends_with_problem(
    fetcher: Live, source: VideoSource, change: dict[str, Any], code: str, detail: str
) -> None:
    for name, value in change.items():
        setattr(source, name, value)
    found = failed(fetcher, begin(fetcher, source.url("cam_0.mp4")))
    assert found[0] == code
    assert detail in found[1]
    assert SECRET not in database_text(fetcher)
    assert all(request["path"].startswith("/take/") for request in source.requests)  # no redirect


def test_length_that_is_too_short_cuts_file(fetcher: Live, source: VideoSource) -> None:
    source.stated_bytes = 1000
    address = begin(fetcher, source.url("cam_0.mp4"))
    assert ended(fetcher, address)["state"] == "finished"
    assert file_of(fetcher, address).read_bytes() == CONTENT[:1000]


def test_file_that_changes_meanwhile_is_refused(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    source.break_after = [10_000, 0, 0]
    address = begin(fetcher, source.url("cam_0.mp4"))
    wait_for(lambda: state_of(fetcher, address)["received_bytes"] == 10_000, 60)
    source.headers = {"ETag": '"2"'}
    source.hold.set()
    assert failed(fetcher, address)[0] == "source_changed"


def test_source_that_stalls_is_given_up(fetcher: Live, source: VideoSource, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetching, "_MAX_TRIES", 1)
    source.hold.clear()
    source.break_after = [10_000, 0]
    address = begin(fetcher, source.url("cam_0.mp4"))
    assert failed(fetcher, address) == ("source_broken", "The source takes too long.")


def test_deleted_upload_is_not_fetched_on(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    source.break_after = [10_000, 0, 0]
    address = begin(fetcher, source.url("cam_0.mp4"))
    wait_for(lambda: state_of(fetcher, address)["received_bytes"] == 10_000, 60)
    problem_of(Uploader(fetcher.client).send(address, 10_000, b"x"), 409, "conflict")
    assert fetcher.client.delete(address, headers=TUS).status_code == 204
    num_requests = len(source.requests)
    source.hold.set()
    time.sleep(1.0)
    assert fetcher.client.get(address).status_code == 404
    assert not file_of(fetcher, address).exists()
    assert len(source.requests) == num_requests


def test_unfinished_and_failed_fetches_are_no_files(fetcher: Live, source: VideoSource) -> None:
    source.hold.clear()
    source.files["cam_0.mp4"] = b""
    source.statuses = [404]
    address = begin(fetcher, source.url("cam_0.mp4"))
    failed(fetcher, address)
    source.break_after = [0]
    other = begin(fetcher, source.url("cam_1.mp4"))
    calibration = Uploader(fetcher.client).upload(b"[cam_0]", "calibration.toml")
    body = {"videos": [one.rpartition("/")[2] for one in (address, other)], "calibration": calibration}
    problem = problem_of(fetcher.client.post("/v1/sessions", json=body), 422, "invalid_request")
    assert [error["code"] for error in problem["errors"]] == ["source_not_found", "upload_unfinished"]


def test_quotas_count_fetched_bytes(make_settings: Callable[..., Settings], source: VideoSource) -> None:
    settings = make_settings(fetch_private=True, max_tenant_bytes=len(CONTENT) + 10, max_tenant_uploads=2)
    with running(settings) as live:
        first = ended(live, begin(live, source.url("cam_0.mp4")))
        assert first["state"] == "finished"
        assert failed(live, begin(live, source.url("cam_1.mp4")))[0] == "quota_exceeded"
        answer = live.client.post("/v1/uploads/from-url", json={"url": source.url("cam_2.mp4")})
        problem_of(answer, 403, "quota_exceeded")


def test_full_disk_ends_fetch(
    make_settings: Callable[..., Settings], source: VideoSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(make_settings(fetch_private=True)) as live:
        # Other programs fill and empty the disk meanwhile.
        monkeypatch.setattr(DiskSpace, "free_bytes", 2**30)
        monkeypatch.setattr(live.services.disk, "_headroom_bytes", 2**30 - 10 * 2**20)
        source.stated_bytes = 50 * 2**20
        object.__setattr__(live.settings, "max_file_bytes", 100 * 2**20)
        assert failed(live, begin(live, source.url("cam_0.mp4")))[0] == "storage_full"


@pytest.mark.parametrize(
    ("url", "code"),
    [
        ("http://store.example/cam_0.mp4", "source_refused"),
        ("https://127.0.0.1/cam_0.mp4", "source_refused"),
        ("https://localhost/cam_0.mp4", "source_refused"),
        ("https://[::ffff:10.0.0.1]/cam_0.mp4", "source_refused"),
        ("https://a..b/cam_0.mp4", "source_refused"),
        ("https://\u00e9[\u00ea", "source_refused"),
        ("https://store.example/", "file_name_invalid"),
        ("https://store.example/a%2Fb", "file_name_invalid"),
        ("https://user:word@store.example/cam_0.mp4", "wrong_format"),
        ("ftp://store.example/cam_0.mp4", "wrong_format"),
    ],
)
def test_refused_urls(live: Live, url: str, code: str) -> None:
    problem = problem_of(live.client.post("/v1/uploads/from-url", json={"url": url}), 422, "invalid_request")
    assert [(error["code"], error["pointer"]) for error in problem["errors"]] == [(code, "/url")]
    body = {"videos": [url], "calibration": Uploader(live.client).upload(b"[cam_0]", "calibration.toml")}
    problem = problem_of(live.client.post("/v1/sessions", json=body), 422, "invalid_request")
    assert [(error["code"], error["pointer"]) for error in problem["errors"]] == [(code, "/videos/0")]
    assert "word" not in json.dumps(problem)
    assert [path.name for path in live.kept()] == [body["calibration"]]


def test_name_of_private_address_is_refused(live: Live, source: VideoSource, monkeypatch: pytest.MonkeyPatch) -> None:
    def look_up(host: str, *_: object) -> list[str]:
        return ["127.0.0.1", "10.0.0.1"]

    monkeypatch.setattr("worker.run.webhooks.sender._look_up", look_up)
    address = begin(live, f"https://store.example:{source.port}/take/cam_0.mp4?{SECRET}")
    assert failed(live, address) == ("source_refused", "The address of the source is not public.")
    assert source.requests == []


def test_bucket_takes_fetched_bytes(
    make_settings: Callable[..., Settings], source: VideoSource, s3: S3, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    settings = make_settings(artifacts_url=s3.new_url(), shared_uploads=True, fetch_private=True)
    source.break_after = [30_000]
    with running(settings) as live:
        address = begin(live, source.url("cam_0.mp4"))
        assert ended(live, address)["received_bytes"] == len(CONTENT)
        upload = live.services.store.uploads.get(address.rpartition("/")[2])
        assert live.services.uploads.file(upload).read_bytes() == CONTENT


def test_restarted_service_continues(
    make_settings: Callable[..., Settings], source: VideoSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetching, "_LEASE_S", 1.0)
    monkeypatch.setattr(fetching, "_RENEW_S", 0.2)
    settings = make_settings(fetch_private=True, client_idle_s=2.0)
    source.hold.clear()
    source.break_after = [10_000, 0, 0]
    with running(settings) as live:
        address = begin(live, source.url("cam_0.mp4"))
        wait_for(lambda: state_of(live, address)["received_bytes"] == 10_000, 60)
    with contextlib.closing(sqlite3.connect(settings.data_dir / "multicap.db")) as database, database:
        database.execute("UPDATE uploads SET spool = 'former-host:/data/uploads'")
    source.hold.set()
    with running(settings) as live:
        assert ended(live, address)["state"] == "finished"
        assert file_of(live, address).read_bytes() == CONTENT
    assert source.requests[-1]["range"] == "bytes=10000-"


def test_secrets_are_in_no_log_and_no_metrics(fetcher: Live, source: VideoSource) -> None:
    source.statuses = [500]
    source.break_after = [5]
    with structlog.testing.capture_logs() as logged:
        ended(fetcher, begin(fetcher, source.url("cam_0.mp4")))
        failed(fetcher, begin(fetcher, source.url("gone.mp4")))
        problem_of(fetcher.client.post("/v1/jobs", json={"videos": [source.url("")]}), 422, "invalid_request")
        calibration = Uploader(fetcher.client).upload(b"[cam_0]", "calibration.toml")
        answer = fetcher.client.post("/v1/jobs", json={"videos": [source.url("cam_1.mp4")], "calibration": calibration})
        path = answer.json()["urls"]["session"]
        wait_for(lambda: fetcher.client.get(path).json()["state"] == "ready", 60)
        # The session is ready a moment before its event is logged.
        expected = {"upload_fetched", "fetch_broken", "fetch_ended", "session_completed"}
        wait_for(lambda: expected <= {entry["event"] for entry in logged}, 60)
    assert "s3cr3t" not in repr(logged) + fetcher.client.get("/metrics").text
