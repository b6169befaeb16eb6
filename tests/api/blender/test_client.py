"""Client of the extension against the real service, one that dies, and a hostile one."""

import contextlib
import hashlib
import json
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler
from pathlib import Path

import pytest
from scipy.spatial.transform import Rotation

from api.blender.extension import client as client_module
from api.blender.extension.answers import FileEntry, RequestError, plain, read_files, read_job
from api.blender.extension.client import BlenderClient, StoppedTaskError, is_on_this_machine, service_address
from api.blender.extension.retarget import armature_glb
from api.web.settings import Settings
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.mapping import map_bones
from tests.api.blender.conftest import WrongService, says
from tests.api.blender.test_retarget import armature_of
from tests.api.conftest import Live, running
from tests.pipeline.export.character.characters import character, odd_bones
from worker.store.model.rights import Scope

ID = "01890a5d-ac96-774b-bcce-b302099a8057"
ALIVE = says(200, b'{"status": "ok"}')


def ignore(_done: float) -> None:
    pass


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "_FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(client_module, "_SILENCE_S", 20.0)


def client_of(live: Live) -> BlenderClient:
    return BlenderClient(f"http://{live.address[0]}:{live.address[1]}")


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:8000", "http://127.0.0.1:8000"),
        ("https://mocap.example/#/jobs/1", "https://mocap.example"),
        ("https://mocap.example/studio/", "https://mocap.example/studio"),
        ("[::1]:80", "http://[::1]:80"),
    ],
)
def test_addresses_as_they_are_typed(text: str, address: str) -> None:
    assert service_address(text) == address


@pytest.mark.parametrize(
    "text",
    ["", "ftp://a", "file:///etc/passwd", "http://", "http://a b", "http://a:99999", "http://a\r\nX: y", "a@b:c"],
)
def test_other_addresses_are_refused(text: str) -> None:
    with pytest.raises(RequestError):
        service_address(text)


def test_password_in_address_is_refused() -> None:
    with pytest.raises(RequestError, match="its own field"):
        service_address("https://anna:secret@mocap.example")


def test_addresses_of_this_machine() -> None:
    addresses = (
        "http://127.0.0.1:1",
        "http://localhost",
        "http://[::1]:9",
        "http://127.evil.example",
        "http://10.0.0.1",
    )
    assert [is_on_this_machine(address) for address in addresses] == [True, True, True, False, False]


def test_connect_list_and_download(live: Live, tmp_path: Path) -> None:
    job_id = live.job_id()
    client = client_of(live)
    assert client.connect().may_write
    (capture,), cursor = client.captures()
    assert (capture.num_jobs, cursor) == (1, "")
    assert client.captures(name="no such & name") == ([], "")
    (job,) = client.jobs(capture.id)
    assert (job.id, job.state, job.is_over) == (job_id, "queued", False)
    content = bytes(range(256)) * 2000
    live.finish(job_id, content)
    assert client.job(job_id).state == "succeeded"
    file = next(file for file in client.files(job_id) if file.person)
    assert (file.name, file.person, file.num_bytes) == ("person-1.bvh", "person-1", len(content))
    seen: list[float] = []
    client.download(job_id, file, tmp_path / "0", seen.append)
    assert (tmp_path / "0").read_bytes() == content
    assert seen[-1] == len(content)


def test_service_recognises_bones_without_telling_names(live: Live) -> None:
    """By the shape of the tree, whatever stands in the list goes before; the service keeps nothing."""
    armature = armature_of(odd_bones(), Rotation.identity(), 0.01, (1.0, 2.0, 3.0), seed=1)
    expected = map_bones(decode_character("a.glb", character(odd_bones()))).bones
    client = client_of(live)
    assert client.recognised_bones(armature_glb(armature), {}) == expected
    assert client.recognised_bones(armature_glb(armature), {"Head": expected["Head"]}) == expected
    assert json.loads(live.client.get("/v1/characters").content)["characters"] == []
    with pytest.raises(RequestError, match="no bone Rüssel"):
        client.recognised_bones(armature_glb(armature), {"Head": "Rüssel"})


def test_pages_of_captures(live: Live) -> None:
    ids = [live.session_id() for _ in range(3)]
    client = client_of(live)
    first = json.loads(live.client.get("/v1/sessions?limit=2").content)
    captures, cursor = client.captures(cursor=first["next_cursor"])
    assert ([capture.id for capture in captures], cursor) == ([ids[0]], "")


def test_wrong_address_differs_from_wrong_key(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings()) as live:
        _, text = live.services.store.keys.add("studio", "blender", frozenset({Scope.READ}))
        client = client_of(live)
        with pytest.raises(RequestError, match="asks for a key"):
            client.connect()
        with pytest.raises(RequestError, match="does not know this key"):
            replace(client, key="mc_wrong").connect()
        with pytest.raises(RequestError, match="characters that no key has"):
            replace(client, key="mc_a\nb").connect()
        assert not replace(client, key=text).connect().may_write
        assert text not in repr(replace(client, key=text))


def test_nothing_listens_there() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(RequestError, match="Is the service running"):
            BlenderClient(f"http://127.0.0.1:{free.getsockname()[1]}").connect()


def test_another_program_answers(wrong_service: WrongService) -> None:
    wrong_service.answers["/"] = says(200, b"<html>")
    with pytest.raises(RequestError, match="not a Multicap service"):
        BlenderClient(wrong_service.address).connect()


def test_service_of_another_version_is_understood(wrong_service: WrongService) -> None:
    client = BlenderClient(wrong_service.address)
    wrong_service.answers["/healthz"] = ALIVE
    with pytest.raises(RequestError, match="another version"):
        client.connect()
    wrong_service.answers["/v1/caller"] = says(200, b'{"tenant": "a", "scopes": ["read"]}')
    wrong_service.answers["/v1/options"] = says(200, b'{"choices": [{"name": "exports"}, {"name": []}]}')
    with pytest.raises(RequestError, match="older than this extension"):
        client.connect()
    wrong_service.answers["/v1/options"] = says(200, b'{"choices": [{"name": "exports"}, {"name": "timeline"}]}')
    assert not client.connect().may_write


WRONG = [
    b"",
    b"[]",
    b"null",
    b"\xff",
    b'{"sessions": 3}',
    b'{"sessions": [null]}',
    b'{"sessions": [{"id": "../../x"}]}',
    b'{"sessions": [{"id": 7}]}',
    b'{"sessions": [], "next_cursor": {"a": 1}}',
    b'{"sessions": [], "next_cursor": "a&state=b"}',
    b"[" * 100_000,
    b'{"a": ' + b"9" * 10_000 + b"}",
    b'{"sessions": ["' + b"x" * (9 << 20) + b'"]}',
]


@pytest.mark.parametrize("body", WRONG, ids=range(len(WRONG)))
def test_wrong_lists(wrong_service: WrongService, body: bytes) -> None:
    wrong_service.answers["/v1/sessions"] = says(200, body)
    with pytest.raises(RequestError, match="not understood"):
        BlenderClient(wrong_service.address).captures()


def test_endless_answer_is_cut(wrong_service: WrongService) -> None:
    def endless(request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.end_headers()
        try:
            while True:
                request.wfile.write(b" " * 1_000_000)
        except OSError:
            pass

    wrong_service.answers["/v1/sessions"] = endless
    with pytest.raises(RequestError, match="not understood"):
        BlenderClient(wrong_service.address).captures()


def test_odd_names_lose_what_is_odd(wrong_service: WrongService) -> None:
    name = "\x00a\u202eb\n" + "ü" * 500
    item = {"id": ID, "name": name, "created_at": "\x1b[31m", "duration_s": float("nan"), "num_jobs": -4}
    wrong_service.answers["/v1/sessions"] = says(200, json.dumps({"sessions": [item]}).encode())
    ((capture,), _) = BlenderClient(wrong_service.address).captures()
    assert capture.name.startswith("ab üü")
    assert len(capture.name.encode()) <= 60
    assert (capture.created_at, capture.duration_s, capture.num_jobs) == ("[31m", 0.0, 0)
    assert plain(None, default="x") == "x"


@pytest.mark.parametrize("name", ["../../.bashrc", "/etc/passwd", "a\\b", "", "a..b", "x" * 200, 3, None, ".hidden"])
def test_names_that_are_paths_are_left_out(name: object) -> None:
    wrong = {"name": name, "sha256": "a" * 64, "num_bytes": 1, "person": 1, "person_name": "person-1"}
    right = wrong | {"name": "person-1.glb", "format": "glb"}
    (file,) = read_files({"results": [wrong, right]})
    assert (file.name, file.person, file.format) == ("person-1.glb", "person-1", "glb")


def test_timelines_that_are_none(wrong_service: WrongService) -> None:
    client = BlenderClient(wrong_service.address)
    assert client.timeline(ID) is None
    for rate, frames, expected in (
        (25, 60, (25.0, 60)),
        (0, 60, None),
        ("25", 60, None),
        (25.0, 1 << 60, None),
        (25.0, 2.5, None),
        (25.0, 0, None),
    ):
        body = json.dumps({"frame_rate_hz": rate, "num_frames": frames}).encode()
        wrong_service.answers["/v1/jobs/"] = says(200, body)
        assert client.timeline(ID) == expected


def test_unknown_state_is_refused() -> None:
    for state in ("paused", ["running"], None):
        with pytest.raises(RequestError):
            read_job({"id": ID, "session_id": ID, "state": state})


def file_of(content: bytes, **changes: object) -> FileEntry:
    file = FileEntry("person-1.glb", "glb", "person-1", len(content), hashlib.sha256(content).hexdigest())
    return replace(file, **changes)  # type: ignore[arg-type]


def test_file_larger_than_stated_is_refused(wrong_service: WrongService, tmp_path: Path) -> None:
    wrong_service.answers["/v1/jobs/"] = says(200, b"a" * 5000)
    with pytest.raises(RequestError, match="larger than the service said"):
        BlenderClient(wrong_service.address).download(ID, file_of(b"a" * 100), tmp_path / "0", ignore)
    assert (tmp_path / "0").stat().st_size <= 100


def test_file_other_than_listed_is_refused(wrong_service: WrongService, tmp_path: Path) -> None:
    wrong_service.answers["/v1/jobs/"] = says(200, b"b" * 100)
    with pytest.raises(RequestError, match="damaged"):
        BlenderClient(wrong_service.address).download(ID, file_of(b"a" * 100), tmp_path / "0", ignore)
    assert not (tmp_path / "0").exists()


def test_files_of_petabytes_are_not_begun(wrong_service: WrongService, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="larger than 4 GiB"):
        BlenderClient(wrong_service.address).download(ID, file_of(b"", num_bytes=1 << 50), tmp_path / "0", ignore)
    assert wrong_service.requests == []


def breaking(content: bytes, num_bytes: int) -> Callable[[BaseHTTPRequestHandler], None]:
    """Answers that break off after some bytes, from the range that is asked for."""

    def answer(request: BaseHTTPRequestHandler) -> None:
        start = int((request.headers["Range"] or "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        request.send_response(206 if start else 200)
        request.send_header("Content-Length", str(len(content) - start))
        request.end_headers()
        request.wfile.write(content[start : start + num_bytes])
        request.wfile.flush()
        request.connection.shutdown(socket.SHUT_RDWR)

    return answer


def test_downloads_go_on_where_they_broke(wrong_service: WrongService, tmp_path: Path) -> None:
    content = bytes(range(250)) * 40
    wrong_service.answers["/v1/jobs/"] = breaking(content, 1000)
    BlenderClient(wrong_service.address).download(ID, file_of(content), tmp_path / "0", ignore)
    assert (tmp_path / "0").read_bytes() == content
    ranges = [headers.get("range") for _, _, headers in wrong_service.requests]
    assert ranges == [None, *(f"bytes={start}-" for start in range(1000, 10_000, 1000))]


def test_service_that_never_sends_file_is_left(wrong_service: WrongService, tmp_path: Path) -> None:
    wrong_service.answers["/v1/jobs/"] = breaking(b"a" * 100, 0)
    with pytest.raises(RequestError, match="broke off"):
        BlenderClient(wrong_service.address).download(ID, file_of(b"a" * 100), tmp_path / "0", ignore)
    assert len(wrong_service.requests) < 10


def test_redirect_gets_no_key(wrong_service: WrongService, tmp_path: Path) -> None:
    other = WrongService()
    try:
        other.answers["/bucket"] = says(200, b"content")
        wrong_service.answers["/v1/jobs/"] = says(307, b"", Location=f"{other.address}/bucket")
        client = BlenderClient(wrong_service.address, "mc_secret")
        client.download(ID, file_of(b"content"), tmp_path / "0", ignore)
        assert (tmp_path / "0").read_bytes() == b"content"
        ((_, _, first),) = wrong_service.requests
        ((_, _, second),) = other.requests
        assert (first["authorization"], "authorization" in second) == ("Bearer mc_secret", False)
    finally:
        other.close()


@pytest.mark.parametrize("target", ["file:///etc/passwd", "ftp://x/y", "gopher://x"])
def test_redirects_lead_to_web_addresses_alone(wrong_service: WrongService, target: str, tmp_path: Path) -> None:
    wrong_service.answers["/v1/jobs/"] = says(302, b"", Location=target)
    with pytest.raises(RequestError, match="302"):
        BlenderClient(wrong_service.address).download(ID, file_of(b"content"), tmp_path / "0", ignore)


def test_redirects_in_circle_end(wrong_service: WrongService, tmp_path: Path) -> None:
    wrong_service.answers["/"] = says(302, b"", Location="/again")
    with pytest.raises(RequestError):
        BlenderClient(wrong_service.address).download(ID, file_of(b"content"), tmp_path / "0", ignore)
    assert len(wrong_service.requests) <= 5


def test_json_is_not_redirected(wrong_service: WrongService) -> None:
    wrong_service.answers["/v1/sessions"] = says(302, b"", Location="/elsewhere")
    with pytest.raises(RequestError, match="302"):
        BlenderClient(wrong_service.address).captures()
    assert len(wrong_service.requests) == 1


@pytest.fixture
def capture_files(tmp_path: Path) -> tuple[list[Path], Path]:
    videos = [tmp_path / f"cam_{number}.mp4" for number in range(2)]
    for video in videos:
        video.write_bytes(b"video" * 8000)
    calibration = tmp_path / "calibration.toml"
    calibration.write_bytes(b"[cam_0]")
    return videos, calibration


def test_send_in_pieces(live: Live, capture_files: tuple[list[Path], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "_PIECE_BYTES", 7000)
    videos, calibration = capture_files
    sent: list[float] = []
    job = client_of(live).send("Walk, take 1", videos, calibration, {"exports": ["glb"]}, sent.append)
    assert (job.capture_name, job.state) == ("Walk, take 1", "queued")
    assert sent == sorted(sent)
    assert (len(sent), sent[-1]) == (13, 80_007)
    spec = live.client.get(f"/v1/jobs/{job.id}").json()["spec"]
    assert spec["exports"] == ["glb"]
    (first, second, third) = live.client.get(f"/v1/sessions/{job.capture_id}").json()["files"]
    assert [file["name"] for file in (first, second, third)] == ["cam_0.mp4", "cam_1.mp4", "calibration.toml"]
    assert first["sha256"] == hashlib.sha256(b"video" * 8000).hexdigest()


def test_refused_captures_leave_no_uploads(live: Live, capture_files: tuple[list[Path], Path]) -> None:
    videos, calibration = capture_files
    videos[1].write_bytes(b"WRONG video")
    with pytest.raises(RequestError, match=r"cam_1\.mp4: No video\..*"):
        client_of(live).send("a", videos, calibration, {}, ignore)
    assert live.kept() == []


def test_stopped_capture_leaves_no_uploads(
    live: Live, capture_files: tuple[list[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "_PIECE_BYTES", 7000)

    def stop(sent: float) -> None:
        if sent > 50_000:
            raise StoppedTaskError

    with pytest.raises(StoppedTaskError):
        client_of(live).send("a", *capture_files, {}, stop)
    assert live.kept() == []


class ServiceGate:
    """Port before a service; each third connection is cut after 3,000 bytes."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._target, self._num_connections = target, 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"http://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Refuse connections from now on."""
        # A thread that waits for a connection keeps the port of a socket that is only closed.
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._server.accept()
                self._num_connections += 1
                limit = 3000 if self._num_connections % 3 == 0 else None
                threading.Thread(target=self._carry, args=(connection, limit), daemon=True).start()

    def _carry(self, connection: socket.socket, limit: int | None) -> None:
        with connection, socket.create_connection(self._target[:2]) as service:
            threading.Thread(target=_copy, args=(service, connection, None), daemon=True).start()
            _copy(connection, service, limit)


def _copy(source: socket.socket, target: socket.socket, limit: int | None) -> None:
    done = 0
    with contextlib.suppress(OSError):
        while (limit is None or done < limit) and (block := source.recv(1000)):
            target.sendall(block)
            done += len(block)
        for end in (source, target):
            end.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def gate(live: Live) -> Iterator[ServiceGate]:
    made = ServiceGate(live.address)
    yield made
    made.close()


def test_connections_that_break_in_piece(
    live: Live, gate: ServiceGate, capture_files: tuple[list[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "_PIECE_BYTES", 7000)
    job = BlenderClient(gate.address).send("a", *capture_files, {}, ignore)
    (first, *_) = live.client.get(f"/v1/sessions/{job.capture_id}").json()["files"]
    assert first["sha256"] == hashlib.sha256(b"video" * 8000).hexdigest()


def test_service_dies_while_files_are_sent(
    gate: ServiceGate, capture_files: tuple[list[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "_PIECE_BYTES", 7000)
    sent: list[float] = []

    def watch(done: float) -> None:
        sent.append(done)
        if done > 20_000:
            gate.close()

    with pytest.raises(RequestError, match="Is the service running"):
        BlenderClient(gate.address).send("a", *capture_files, {}, watch)
    assert max(sent) < 40_000
