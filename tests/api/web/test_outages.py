"""Outages as clients see them: 503 with a code and Retry-After, downloads that continue, uploads at another process."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from sqlalchemy.exc import OperationalError

from api.cli import client as own_client
from api.cli.client import Client
from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from tests.api.web.uploads.test_files import TUS, Uploader
from tests.s3 import running_s3
from tests.unreliable import Mode, UnreliableProxy, unreliable
from worker.store.tenant_records import TenantRecords

LARGE = bytes(range(256)) * 2**14  # 4 MiB


@pytest.fixture(scope="module")
def proxy() -> Iterator[UnreliableProxy]:
    with (
        running_s3() as s3,
        unreliable(int(s3.endpoint.rpartition(":")[2])) as proxy,
        pytest.MonkeyPatch.context() as patch,
    ):
        for name, value in (s3.environment | {"AWS_ENDPOINT_URL": proxy.endpoint}).items():
            patch.setenv(name, value)
        patch.setattr("worker.store.files.s3._READ_TIMEOUT", "1s")
        proxy.url = s3.new_url()  # type: ignore[attr-defined]
        yield proxy


@pytest.fixture
def on_s3(make_settings: Callable[..., Settings], proxy: UnreliableProxy) -> Iterator[Live]:
    proxy.set("forward")
    with running(make_settings(artifacts_url=proxy.url)) as live:  # type: ignore[attr-defined]
        yield live
        proxy.set("forward")


@pytest.mark.parametrize("mode", ["unavailable", "hang", "reset", "refuse"])
def test_silent_store_is_503_at_submission_and_download(on_s3: Live, proxy: UnreliableProxy, mode: Mode) -> None:
    job_id = on_s3.job_id()
    on_s3.finish(job_id)
    proxy.set(mode)
    for answer in (on_s3.post_session(), on_s3.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh")):
        problem = problem_of(answer, 503, "artifacts_unavailable")
        assert problem["retryable"]
        assert int(answer.headers["Retry-After"]) > 0
    assert on_s3.client.get(f"/v1/jobs/{job_id}").status_code == 200
    proxy.set("forward")
    assert on_s3.post_session().status_code == 201
    assert on_s3.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh").status_code == 200


def test_store_that_refuses_is_another_problem(on_s3: Live, proxy: UnreliableProxy) -> None:
    proxy.set("forbidden")
    problem_of(on_s3.post_session(), 503, "artifacts_refused")


def test_our_own_client_continues_download_where_it_broke(
    on_s3: Live, proxy: UnreliableProxy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_client, "_FIRST_PAUSE_S", 0.1)
    job_id = on_s3.job_id()
    on_s3.finish(job_id, LARGE)
    port = on_s3.address[1]
    with unreliable(port) as line:
        line.break_after = 2**20
        line.set("break_off")
        seen: list[str | None] = []

        def note(request: Any) -> None:
            if request.url.path.endswith(".bvh"):
                seen.append(request.headers.get("range"))
                if len(seen) == 3:
                    line.set("forward")

        with httpx2.Client(base_url=line.endpoint, event_hooks={"request": [note]}, trust_env=False) as http:
            job = on_s3.client.get(f"/v1/jobs/{job_id}").json()
            (path,) = Client(http).download(job, tmp_path)
    assert path.read_bytes() == LARGE
    assert seen[0] is None
    assert len(seen) == 3
    starts = [int(str(header).removeprefix("bytes=").removesuffix("-")) for header in seen[1:]]
    assert 0 < starts[0] < starts[1] < len(LARGE)


def test_our_own_client_follows_job_through_outage(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_client, "_FIRST_PAUSE_S", 0.1)
    job_id = live.job_id()
    job = live.client.get(f"/v1/jobs/{job_id}").json()
    with unreliable(live.address[1]) as line:
        seen: list[Mode] = []
        outage: list[Mode] = ["unavailable", "reset", "refuse"]

        def note(request: Any) -> None:
            seen.append(line.mode)
            if outage:
                line.set(outage.pop(0))
            else:
                line.set("forward")
                live.finish(job_id)

        with httpx2.Client(base_url=line.endpoint, event_hooks={"request": [note]}, trust_env=False) as http:
            assert Client(http).follow(job)["state"] == "succeeded"
    assert len(seen) >= 4


def test_database_that_does_not_respond_is_503(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    def away(self: object) -> Any:
        raise OperationalError("BEGIN", {}, Exception(), connection_invalidated=True)

    monkeypatch.setattr("worker.store.database.connection.Database.reading", away)
    answer = live.client.get("/v1/jobs")
    problem_of(answer, 503, "database_unavailable")
    assert int(answer.headers["Retry-After"]) > 0


def test_commit_whose_answer_is_lost_keeps_files_of_its_session(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    transaction = TenantRecords.transaction
    is_lost = True

    @contextlib.contextmanager
    def lose_the_answer(self: TenantRecords) -> Iterator[TenantRecords]:
        with transaction(self) as work:
            yield work
        if is_lost:
            raise OperationalError("COMMIT", {}, Exception(), connection_invalidated=True)

    monkeypatch.setattr(TenantRecords, "transaction", lose_the_answer)
    key = {"Idempotency-Key": "the-same"}
    problem_of(live.client.post("/v1/sessions", files=form(2), headers=key), 503, "database_unavailable")
    is_lost = False
    answer = live.client.post("/v1/sessions", files=form(2), headers=key)
    assert answer.status_code == 201, answer.text
    assert answer.headers["Idempotent-Replayed"] == "true"
    session = live.services.store.sessions.get(answer.json()["id"])
    assert all(live.services.artifacts.exists(file.key) for file in session.files)


class TestTwoProcesses:
    """Two API processes with one database, each with a folder of its own."""

    @pytest.fixture
    def others(self, live: Live, make_settings: Callable[..., Settings], tmp_path: Path) -> Iterator[Live]:
        settings = make_settings(data_dir=tmp_path / "other", database_url=live.settings.resolved_database_url)
        with running(settings) as other:
            yield other

    def test_upload_at_other_process_has_own_error_and_stays_whole(self, live: Live, others: Live) -> None:
        here, there = Uploader(live.client), Uploader(others.client)
        address = here.begin(6)
        assert here.send(address, 0, b"abc").status_code == 204
        problem_of(there.send(address, 3, b"def"), 421, "upload_elsewhere")
        answer = others.client.delete(address, headers=TUS)
        assert "sticky" in problem_of(answer, 421, "upload_elsewhere")["hint"]
        assert others.client.head(address, headers=TUS).status_code == 421
        upload_id = address.rpartition("/")[2]
        answer = others.client.post("/v1/sessions", json={"videos": [upload_id], "calibration": upload_id})
        items = problem_of(answer, 422, "invalid_request")["errors"]
        assert {item["code"] for item in items} == {"upload_elsewhere"}
        assert here.offset(address) == 3
        assert here.send(address, 3, b"def").status_code == 204
        assert (live.settings.uploads_dir / upload_id).read_bytes() == b"abcdef"
        assert not (others.settings.uploads_dir / upload_id).exists()
        spool = live.services.store.uploads.get(upload_id).spool
        assert spool == f"{socket.gethostname()}:{live.settings.uploads_dir}"
        assert live.client.delete(address, headers=TUS).status_code == 204

    def test_file_gone_at_own_process_is_not_upload_elsewhere(self, live: Live) -> None:
        address = Uploader(live.client).begin(6)
        (live.settings.uploads_dir / address.rpartition("/")[2]).unlink()
        assert live.client.head(address, headers=TUS).status_code == 404

    def test_folder_that_was_moved_or_is_shared_is_served(self, live: Live, others: Live) -> None:
        address = Uploader(live.client).begin(6)
        upload_id = address.rpartition("/")[2]
        (live.settings.uploads_dir / upload_id).rename(others.settings.uploads_dir / upload_id)
        assert Uploader(others.client).send(address, 0, b"abcdef").status_code == 204


def test_readiness_answers_while_database_hangs(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    release = threading.Event()
    monkeypatch.setattr(live.services.store, "ping", lambda: release.wait(60))
    errors = problem_of(live.client.get("/readyz"), 503, "not_ready")["errors"]
    assert "database_unavailable" in {item["code"] for item in errors}
    release.set()
