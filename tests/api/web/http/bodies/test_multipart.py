"""Forms as multipart/form-data: limits, names, damaged and hostile bodies."""

import asyncio
import contextlib
import hashlib
import os
import random
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import ClientDisconnect, Request
from starlette.types import Message

from api.web.errors import ApiError
from api.web.http.bodies.form import Form, FormLimits, name_error
from api.web.http.bodies.multipart import receive_form
from api.web.http.bodies.validation import FieldPlaces
from api.web.sessions.schemas import SESSION_FORM
from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from worker.store.files.disk import DiskSpace

LIMITS = FormLimits(
    max_file_bytes=10_000,
    max_keypoints_bytes=10_000,
    max_session_bytes=20_000,
    max_calibration_bytes=5_000,
    max_character_bytes=5_000,
    max_json_bytes=500,
    max_cameras=3,
)
HEAD = 'Content-Disposition: form-data; name="{}"; filename="{}"\r\nContent-Type: video/mp4\r\n\r\n'
# Content with many bytes that resemble a boundary.
VIDEO = b"\r\n--x\r--x--\r\n--\r\n\r\n--xy--\r\n\0\xff" * 40
BODY = (
    b"--xyz\r\n" + HEAD.format("videos", "cam_0.mp4").encode() + VIDEO + b"\r\n"
    b"--xyz\r\n" + HEAD.format("calibration", "c.toml").encode() + b"[cam_0]\r\n"
    b'--xyz\r\nContent-Disposition: form-data; name="manifest"\r\n\r\n{"name": "x"}\r\n'
    b"--xyz--\r\n"
)  # fmt: skip


def request_of(blocks: list[bytes], hangs_up: bool = False) -> Request:
    messages: list[Message] = [{"type": "http.request", "body": block, "more_body": True} for block in blocks]
    messages.append({"type": "http.disconnect"} if hangs_up else {"type": "http.request", "body": b""})
    waiting = iter(messages)

    async def receive() -> Message:
        return next(waiting)

    headers = [(b"content-type", b"multipart/form-data; boundary=xyz")]
    return Request({"type": "http", "method": "POST", "path": "/", "headers": headers}, receive)


def received(folder: Path, blocks: list[bytes], hangs_up: bool = False) -> Form:
    places = FieldPlaces(lambda: ({}, {}))
    return asyncio.run(
        receive_form(request_of(blocks, hangs_up), folder, LIMITS, DiskSpace(folder, 0), SESSION_FORM, places)
    )


@given(cuts=st.lists(st.integers(0, len(BODY)), max_size=20).map(sorted))
def test_form_is_same_wherever_network_cuts_it(tmp_path_factory: pytest.TempPathFactory, cuts: list[int]) -> None:
    ends = [*cuts, len(BODY)]
    blocks = [BODY[start:end] for start, end in zip([0, *cuts], ends, strict=True)]
    found = received(tmp_path_factory.mktemp("spool"), blocks)
    assert found.errors == ()
    (video,) = found.videos
    assert video.path.read_bytes() == VIDEO
    assert (video.name, video.num_bytes, video.sha256) == ("cam_0.mp4", len(VIDEO), hashlib.sha256(VIDEO).hexdigest())
    (calibration,) = found.files["calibration"]
    assert calibration.path.read_bytes() == b"[cam_0]"
    assert found.documents == {"manifest": b'{"name": "x"}'}


def test_form_may_come_byte_by_byte(tmp_path: Path) -> None:
    assert received(tmp_path, [bytes([byte]) for byte in BODY]).videos[0].path.read_bytes() == VIDEO


@pytest.mark.parametrize("length", [0, 1, 40, 200, len(BODY) // 2, len(BODY) - 12, len(BODY) - 4])
def test_form_without_its_end_is_malformed(tmp_path: Path, length: int) -> None:
    with pytest.raises(ApiError) as raised:
        received(tmp_path, [BODY[:length]])
    assert (raised.value.status, raised.value.code) == (400, "malformed_multipart")


def test_client_that_hangs_up(tmp_path: Path) -> None:
    with pytest.raises(ClientDisconnect):
        received(tmp_path, [BODY[:500]], hangs_up=True)


@pytest.mark.slow
@given(name=st.text(st.characters(codec="utf-8"), min_size=1, max_size=60))
def test_names_that_pass_are_names_of_files_on_any_system(name: str) -> None:
    if name_error(name) is None:
        assert Path(name).name == name
        assert Path("/spool", name).parent == Path("/spool")
        assert name.isprintable() or " " in name.translate({ord(c): " " for c in name if not c.isprintable()})
        assert "\0" not in name


def mutations(count: int) -> Iterator[bytes]:
    """Damaged bodies: bytes changed, removed, repeated, moved."""
    chance = random.Random(20260301)  # noqa: S311
    for _ in range(count):
        body = bytearray(BODY.replace(VIDEO, VIDEO[:40]))
        for _ in range(chance.randint(1, 8)):
            start = chance.randrange(len(body))
            stop = min(len(body), start + chance.randint(1, 40))
            match chance.randrange(5):
                case 0:
                    body[start] = chance.randrange(256)
                case 1:
                    del body[start:stop]
                case 2:
                    body[start:start] = body[start:stop]
                case 3:
                    body[start:stop] = chance.randbytes(stop - start)
                case 4:
                    body[start:start] = chance.choice(
                        [b"\r\n--xyz", b"--xyz--", b"\r\n\r\n", b"\0", b'"', b"\r", b": "]
                    )
        yield bytes(body)


@pytest.mark.slow
def test_damaged_bodies_are_clients_fault_or_harmless(live: Live) -> None:
    refused = 0
    for body in mutations(1500):
        answer = live.client.post(
            "/v1/sessions", content=body, headers={"Content-Type": "multipart/form-data; boundary=xyz"}
        )
        assert answer.status_code == 201 or 400 <= answer.status_code < 500, (body, answer.text)
        if answer.status_code != 201:
            refused += 1
            problem_of(answer, answer.status_code, answer.json()["code"])
            continue
        # Damage inside the bytes of a file does not damage the form.
        assert live.client.delete(f"/v1/sessions/{answer.json()['id']}").status_code == 204
    assert refused >= 1000
    assert live.kept() == []


@pytest.mark.parametrize(
    "content_type",
    ["multipart/form-data", "multipart/form-data; boundary=", f"multipart/form-data; boundary={'x' * 300}"],
)
def test_boundaries_that_are_none(live: Live, content_type: str) -> None:
    answer = live.client.post("/v1/sessions", content=BODY, headers={"Content-Type": content_type})
    problem_of(answer, 400, "malformed_multipart")


@pytest.mark.parametrize("content_type", ["text/plain", "multipart/mixed; boundary=xyz", "", "x/y/z;;;"])
def test_other_types(live: Live, content_type: str) -> None:
    answer = live.client.post("/v1/sessions", content=BODY, headers={"Content-Type": content_type})
    problem_of(answer, 415, "unsupported_media_type")


@pytest.mark.parametrize(
    "part",
    [
        b"Content-Type: text/plain\r\n\r\nx",
        b'Content-Disposition: attachment; name="videos"; filename="a"\r\n\r\nx',
        b'Content-Disposition: form-data; filename="a"\r\n\r\nx',
        b"no header at all\r\n\r\nx",
        b"A: " + b"x" * 100_000 + b"\r\n\r\nx",
        b"".join(b"A%d: x\r\n" % number for number in range(1000)) + b"\r\nx",
    ],
)
def test_parts_that_are_none(live: Live, part: bytes) -> None:
    body = b"--xyz\r\n" + part + b"\r\n" + BODY
    headers = {"Content-Type": "multipart/form-data; boundary=xyz"}
    problem_of(live.client.post("/v1/sessions", content=body, headers=headers), 400, "malformed_multipart")


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


@pytest.mark.parametrize("chunked", [False, True])
def test_nothing_is_left_of_upload_that_breaks_off(make_settings: Callable[..., Settings], chunked: bool) -> None:
    megabyte = os.urandom(2**20)
    length = "Transfer-Encoding: chunked" if chunked else "Content-Length: 9000000"
    content_type = "Content-Type: multipart/form-data; boundary=xyz"
    head = "\r\n".join(["POST /v1/jobs HTTP/1.1", "Host: localhost", content_type, length, "", ""])
    body = b"--xyz\r\n" + HEAD.format("videos", "cam_0.mp4").encode() + megabyte * 3
    with running(make_settings(max_file_bytes=10**7, max_session_bytes=10**7)) as live:
        with socket.create_connection(live.address[:2]) as connection:
            connection.sendall(head.encode())
            connection.sendall(b"%x\r\n%b\r\n" % (len(body), body) if chunked else body)
            until(lambda: sum(path.stat().st_size for path in live.kept()) >= 2 * 2**20)
        until(lambda: not list(live.settings.spool_dir.iterdir()))
        assert live.kept() == []
        assert live.client.get("/v1/sessions").json()["sessions"] == []
        assert live.client.get("/healthz").status_code == 200


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "none", str(folder)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("a tmpfs can't be mounted here")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_full_disk_refuses_session_and_keeps_nothing(make_settings: Callable[..., Settings], tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk"):
        settings = make_settings(
            data_dir=tmp_path / "disk" / "data",
            database_url=f"sqlite:///{tmp_path / 'elsewhere.db'}",
            max_file_bytes=10**7,
            max_session_bytes=10**7,
        )
        with running(settings) as live:
            answer = live.client.post("/v1/sessions", files=form(1, os.urandom(3_000_000)))
            problem = problem_of(answer, 507, "storage_full")
            assert problem["retryable"] is True
            assert live.kept() == []
            assert list(live.settings.spool_dir.iterdir()) == []
            assert live.client.get("/v1/sessions").json()["sessions"] == []
            # The disk has space again.
            assert live.post_session(1).status_code == 201
