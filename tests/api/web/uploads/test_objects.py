"""Uploads in a bucket, which two API processes continue."""

import asyncio
import hashlib
import itertools
import os
import random
import time
from collections.abc import AsyncIterator, Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import obstore
import pytest
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from api.web.errors import ApiError
from api.web.settings import Settings
from api.web.uploads import objects
from api.web.uploads.objects import SharedUploads
from api.web.uploads.spool import Checksum
from tests.api.conftest import Live, problem_of, running
from tests.api.web.uploads.test_files import TUS, Uploader, checksum
from tests.s3 import S3
from tests.waiting import wait_for
from worker.store.files.disk import DiskSpace
from worker.store.files.s3 import open_bucket
from worker.store.model.session_records import Upload

CONTENT = os.urandom(50_000)


@pytest.fixture(scope="module")
def bucket(s3: S3) -> Iterator[S3]:
    """S3 server, with the environment that says where it is."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in s3.environment.items():
            patch.setenv(name, value)
        yield s3


@pytest.fixture
def url(bucket: S3) -> str:
    return bucket.new_url()


@pytest.fixture
def uploads(url: str, tmp_path: Path) -> SharedUploads:
    return SharedUploads(url, tmp_path / "uploads", DiskSpace(tmp_path), 3600.0)


@pytest.fixture(scope="module")
def two(make_settings: Callable[..., Settings], bucket: S3) -> Iterator[tuple[Live, Live]]:
    """Two API processes with one database and one bucket, and folders of their own."""
    first = make_settings(artifacts_url=bucket.new_url(), shared_uploads=True)
    second = make_settings(
        artifacts_url=first.artifacts_url, shared_uploads=True, database_url=first.resolved_database_url
    )
    with running(first) as here, running(second) as there:
        yield here, there


def upload_of(uploads: SharedUploads, num_bytes: int = len(CONTENT)) -> Upload:
    return Upload(uploads.create(num_bytes), "cam_0.mp4", num_bytes, "", datetime.now(UTC), uploads.name)


def sent(
    uploads: SharedUploads, upload: Upload, offset: int, content: bytes, breaks: bool = False, check: str = ""
) -> int:
    async def body() -> AsyncIterator[bytes]:
        for start in range(0, len(content), 1000):
            yield content[start : start + 1000]
        if breaks:
            raise ClientDisconnect

    expected = Checksum("sha256", bytes.fromhex(check)) if check else None
    return asyncio.run(uploads.append(upload, offset, body(), expected))


def keys(url: str) -> list[str]:
    return sorted(found["path"] for some in obstore.list(open_bucket(url)) for found in some)


def test_processes_take_turns_at_upload_and_any_makes_session(two: tuple[Live, Live]) -> None:
    turns = itertools.cycle([Uploader(live.client) for live in two])
    address = next(turns).begin(len(CONTENT), "cam_0.mp4")
    offset = 0
    for size in (1, 20_000, 0, 4_999, 25_000):
        piece = CONTENT[offset : offset + size]
        answer = next(turns).send(address, offset, piece, **checksum(piece, "sha256"))
        assert (answer.status_code, answer.headers["upload-offset"]) == (204, str(offset + size))
        offset += size
        assert next(turns).offset(address) == offset
    calibration = next(turns).upload(b"[cam_0]", "calibration.toml")
    body = {"videos": [address.rpartition("/")[2]], "calibration": calibration}
    answer = two[1].client.post("/v1/sessions", json=body)
    assert answer.status_code == 201, answer.text
    (video,) = [file for file in answer.json()["files"] if file["kind"] == "video"]
    assert video["sha256"] == hashlib.sha256(CONTENT).hexdigest()
    for live in two:
        assert live.client.head(address, headers=TUS).status_code == 404
        assert [path for path in live.settings.spool_dir.rglob("*") if path.is_file()] == []
    assert [key for key in keys(two[0].settings.artifacts_url) if key.startswith("uploads/")] == []


def test_wrong_offsets_checksums_and_sizes_change_nothing(two: tuple[Live, Live]) -> None:
    here, there = (Uploader(live.client) for live in two)
    address = here.begin(10)
    assert here.send(address, 0, b"abcd").status_code == 204
    problem_of(there.send(address, 0, b"abcd"), 409, "offset_mismatch")
    problem_of(there.send(address, 4, b"efgh", **checksum(b"other")), 460, "checksum_mismatch")
    problem_of(there.send(address, 4, b"efghijk"), 413, "content_too_large")
    assert here.offset(address) == 4
    assert two[1].client.delete(address, headers=TUS).status_code == 204
    problem_of(here.send(address, 4, b"efghij"), 404, "not_found")


def test_upload_of_folder_is_elsewhere(two: tuple[Live, Live]) -> None:
    store = two[0].services.store
    store.uploads.add("0192d7a5-7c1e-7b2a-8f3e-6d5c4b3a2f10", "cam_0.mp4", 10, "", 3600.0, "host:/folder")
    address = "/v1/uploads/0192d7a5-7c1e-7b2a-8f3e-6d5c4b3a2f10"
    problem_of(Uploader(two[0].client).send(address, 0, b"abcd"), 421, "upload_elsewhere")
    store.uploads.delete("0192d7a5-7c1e-7b2a-8f3e-6d5c4b3a2f10")


def test_bytes_before_cut_are_kept_unless_they_have_checksum(uploads: SharedUploads) -> None:
    upload = upload_of(uploads)
    with pytest.raises(ClientDisconnect):
        sent(uploads, upload, 0, CONTENT[:12_345], breaks=True)
    assert uploads.offset(upload) == 12_345
    whole = hashlib.sha256(CONTENT[12_345:]).hexdigest()
    with pytest.raises(ClientDisconnect):
        sent(uploads, upload, 12_345, CONTENT[12_345:30_000], breaks=True, check=whole)
    assert uploads.offset(upload) == 12_345
    assert sent(uploads, upload, 12_345, CONTENT[12_345:], check=whole) == len(CONTENT)
    assert uploads.file(upload).read_bytes() == CONTENT


def test_two_that_send_same_at_once_disturb_nothing(uploads: SharedUploads) -> None:
    upload, chance = upload_of(uploads), random.Random(7)  # noqa: S311 - no secret
    offset = 0
    while offset < len(CONTENT):
        stale = offset  # an earlier request goes on elsewhere, with blocks of its own
        offset = sent(uploads, upload, offset, CONTENT[offset : offset + chance.randrange(1, 9000)])
        for _ in range(chance.randrange(3)):
            size = chance.randrange(1, 5000)
            stale = uploads.put(upload.id, stale, CONTENT[stale : stale + size]).end
        found = uploads.offset(upload)
        assert found == max(offset, stale)
        offset = found
    assert uploads.file(upload).read_bytes() == CONTENT


@pytest.mark.slow
def test_thousands_of_pieces_become_few_blocks(
    uploads: SharedUploads, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(objects, "_FULL_BYTES", 3000)
    monkeypatch.setattr(objects, "_MAX_SMALL_BLOCKS", 10)
    upload, offset, most = upload_of(uploads), 0, 0
    for size in itertools.cycle((1, 13, 250, 2)):
        offset = sent(uploads, upload, offset, CONTENT[offset : offset + size])
        most = max(most, len(keys(url)))
        if offset > 9000:
            break
    assert most <= 2 * (offset // 3000 + 1) + 12
    offset = sent(uploads, upload, offset, CONTENT[offset:])
    assert uploads.file(upload).read_bytes() == CONTENT


def test_slow_piece_is_stored_while_it_comes(uploads: SharedUploads, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objects, "_STORED_S", 0.0)
    monkeypatch.setattr(objects, "_MAX_SMALL_BLOCKS", 4)
    monkeypatch.setattr("api.web.uploads.spool._BLOCK_S", 0.0)
    upload, seen = upload_of(uploads), []

    async def body() -> AsyncIterator[bytes]:
        for start in range(0, len(CONTENT), 2500):
            seen.append(uploads.offset(upload))
            yield CONTENT[start : start + 2500]

    assert asyncio.run(uploads.append(upload, 0, body(), None)) == len(CONTENT)
    assert seen == list(range(0, len(CONTENT), 2500))
    assert uploads.file(upload).read_bytes() == CONTENT


def test_blocks_that_are_joined_while_they_are_read(uploads: SharedUploads, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = upload_of(uploads)
    for start in range(0, len(CONTENT), 5000):
        uploads.put(upload.id, start, CONTENT[start : start + 5000])
    monkeypatch.setattr(objects, "_MAX_SMALL_BLOCKS", 5)
    read = obstore.get_range
    joined: list[bool] = []

    def join_first(*words: object, **options: object) -> object:
        if not joined:
            joined.append(True)
            uploads.join_small(upload.id)
        return read(*words, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(obstore, "get_range", join_first)
    assert uploads.file(upload).read_bytes() == CONTENT


def test_gap_ends_upload(uploads: SharedUploads) -> None:
    upload = upload_of(uploads)
    for start, end in ((0, 100), (50, 300), (200, 250), (301, 400)):
        uploads.put(upload.id, start, CONTENT[start:end])
    assert uploads.offset(upload) == 300
    with pytest.raises(ApiError, match="at 300 bytes"):
        sent(uploads, upload, 400, b"x")
    uploads.put(upload.id, 300, CONTENT[300:301])
    assert uploads.offset(upload) == 400


def test_sweep_removes_what_is_expired_or_left(
    two: tuple[Live, Live], uploads: SharedUploads, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = two[0].services.store
    expired, used, kept = (upload_of(uploads) for _ in range(3))
    for upload in (expired, used, kept):
        sent(uploads, upload, 0, CONTENT)
    store.uploads.add(expired.id, "cam_0.mp4", len(CONTENT), "", 0.5, uploads.name)
    store.uploads.add(kept.id, "cam_0.mp4", len(CONTENT), "", 3600.0, uploads.name)
    uploads.file(used)
    wait_for(lambda: expired.id in store.uploads.expired())
    uploads.sweep(store)
    assert {key.split("/")[1] for key in keys(url)} == {used.id, kept.id}  # of no row, but new
    later = uploads.file(used).stat().st_mtime + 4000
    monkeypatch.setattr(time, "time", lambda: later)
    monkeypatch.setattr(uploads, "_keep_s", -1.0)
    uploads.sweep(store)
    assert {key.split("/")[1] for key in keys(url)} == {kept.id}
    assert not uploads._folder.joinpath(used.id).exists()
    store.uploads.delete(kept.id)


def test_unknown_upload_has_no_bytes_and_no_file(uploads: SharedUploads) -> None:
    upload = upload_of(uploads)
    assert uploads.offset(upload) == 0
    uploads.remove(upload.id)
    empty = upload_of(uploads, 0)
    assert uploads.file(empty).read_bytes() == b""


def test_shared_uploads_need_bucket(make_settings: Callable[..., Settings]) -> None:
    with pytest.raises(ValidationError, match="MULTICAP_ARTIFACTS_URL"):
        make_settings(shared_uploads=True)
