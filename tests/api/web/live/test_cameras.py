"""Live captures whose cameras the service opens: rules of addresses, and what their process answers."""

import json
import random
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx2
import pytest

from api.web.http.websockets import SocketProblem
from api.web.live import cameras
from api.web.live.cameras import WrongSourceError, read_cameras
from api.web.live.schemas import LiveCamerasStart
from api.web.settings import Settings
from pipeline.core.problems.finding_codes import CAMERA_SOURCE
from pipeline.run.live.cameras import sources
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import CALIBRATION, CAMERA_PROGRAM
from worker.store.model.rights import Scope

# Program in the place of the one that opens cameras: it shows what it got, and the profile chooses what happens.
PROGRAM = (
    CAMERA_PROGRAM
    + """import os
if start["choices"]["profile"] == "accurate":
    answer(b"P", [{"code": "stream_refused", "message": "No stream.", "file": "x", "camera": "left", "hint": None}])
    sys.exit(2)
if start["choices"]["profile"] == "balanced":
    raise RuntimeError("a secret")
answer(b"R", {"type": "ready", "cameras": ["left", "right"], "joints": ["nose"], "bones": ["Hips"], "parents": [None],
              "rig": [], "frame_rate_hz": 12.5, "layout": "coco-17"})
answer(b"S", {"type": "notice", "message": json.dumps([start["sources"], sorted(os.environ)])})
answer(b"I", {"sequence": 0, "time_s": 0.5, "lag_s": 0.0, "people": []})
sys.stdin.buffer.read()
answer(b"E", {"received": 9, "taken": 7, "late": 0, "dropped": 2})
"""
)


def start_message(*sources: str, **changes: Any) -> dict[str, Any]:
    named = [{"camera": name, "source": source} for name, source in zip(("left", "right"), sources, strict=True)]
    return {"type": "start_cameras", "calibration": CALIBRATION, "cameras": named} | changes


def start(*sources: str, **changes: Any) -> LiveCamerasStart:
    return LiveCamerasStart.model_validate_json(json.dumps(start_message(*sources, **changes)))


def no_phone(_source: str) -> str:
    raise WrongSourceError(CAMERA_SOURCE, "There is no such recording, or it has ended.", None)


def refusals(given: LiveCamerasStart, is_private: bool) -> list[tuple[str | None, str]]:
    """Pointer and message of each problem of the cameras."""
    with pytest.raises(SocketProblem) as refused:
        read_cameras(given, ["left", "right"], is_private, no_phone)
    return [(item.pointer, item.message) for item in refused.value.errors]


def look_up(*answers: str) -> Callable[..., list[tuple[Any, ...]]]:
    return lambda *_, **__: [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (answer, 0)) for answer in answers]


def test_public_address_is_opened_as_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", look_up("10.0.0.1", "8.8.8.8"))
    first, second = read_cameras(
        start("rtsp://me:secret@cam.example:8554/a?b", "https://cam.example/v"), ["left", "right"], False, no_phone
    )
    assert (first.kind, first.address, first.host) == (
        "rtsp",
        "rtsp://me:secret@8.8.8.8:8554/a?b",
        "cam.example:8554",
    )
    assert (second.kind, second.address, second.host) == ("http", "https://8.8.8.8/v", "cam.example")
    assert first.shown == "rtsp://cam.example:8554/a"


def test_hosts_behind_one_address_are_two_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", look_up("8.8.8.8"))
    names = ["left", "right"]
    first, second = read_cameras(start("https://one.example/v", "https://two.example/v"), names, False, no_phone)
    assert (first.address, first.host, second.host) == (second.address, "one.example", "two.example")
    found = refusals(start("https://one.example/v", "https://one.example/v"), False)
    assert found == [("/cameras/1/source", sources.REPEATED_SOURCE)]


@pytest.mark.parametrize(
    "address",
    ["127.0.0.1", "10.1.2.3", "169.254.169.254", "192.168.0.10", "::1", "fe80::1", "fd00::1", "::ffff:10.0.0.1"],
)
def test_strangers_reach_no_internal_address(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", look_up(address))
    host = f"[{address}]" if ":" in address else address
    found = refusals(start("http://cam.example/v", f"rtsp://{host}/v"), False)
    assert found == [(f"/cameras/{place}/source", "The address is not public.") for place in (0, 1)]


@pytest.mark.parametrize("is_private", [True, False])
def test_files_and_other_schemes_are_never_opened(is_private: bool) -> None:
    for source in ("/etc/passwd", "video.mp4", "/dev/null", "file:///etc/passwd", "concat:a|b", "udp://8.8.8.8:1"):
        (found,) = refusals(start(source, "rtsp://8.8.8.8/v"), is_private)
        assert found[0] == "/cameras/0/source"
    crafted = refusals(start("http://a b/v", "http://127.0.0.1\\@8.8.8.8:99999/"), is_private)
    assert [pointer for pointer, _ in crafted] == ["/cameras/0/source", "/cameras/1/source"]


def test_all_problems_come_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "find_devices", lambda: {"/dev/video0": "Webcam"})
    given = start("/dev/video0", "ftp://a/", outputs=["vmc://127.0.0.1"]).model_copy(
        update={"cameras": start("/dev/video0", "ftp://a/").cameras[:1] * 2 + start("x", "ftp://a/").cameras[1:]}
    )
    assert refusals(given, False) == [
        ("/cameras/0/source", "The service's machine has no such camera that may be opened."),
        ("/cameras/1/camera", "The camera is stated twice."),
        ("/cameras/1/source", "The service's machine has no such camera that may be opened."),
        ("/cameras/2/source", "Streams of ftp:// are not supported."),
        ("/outputs", "The service sends people to no other program."),
    ]
    device, stream = read_cameras(start("/dev/video0", "rtsp://127.0.0.1/v"), ["left", "right"], True, no_phone)
    assert (device.kind, device.address) == ("device", "/dev/video0")
    assert (stream.address, stream.host) == ("rtsp://127.0.0.1/v", None)


def test_mutated_addresses_are_refused_or_public(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", look_up("127.0.0.1"))
    chance = random.Random(7)  # noqa: S311 - of a test
    letters = "rtsphttp:/@[]#?.%\\127016921685 \r\n\0é"
    for _ in range(300):
        text = list("http://user:word@127.0.0.1:80/video?a=b#c")
        for _ in range(chance.randint(1, 5)):
            text[chance.randrange(len(text))] = chance.choice(letters)
        with pytest.raises(SocketProblem):
            read_cameras(start("".join(text), "http://127.0.0.1/"), ["left", "right"], False, no_phone)


def test_names_of_all_cameras_share_one_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, limits_s = 100.0, []

    def no_answer(_host: str, _port: int, _allow_private: bool, timeout_s: float) -> str:
        nonlocal now_s
        limits_s.append(timeout_s)
        now_s += timeout_s
        raise TimeoutError

    monkeypatch.setattr(cameras, "time", SimpleNamespace(monotonic=lambda: now_s))
    monkeypatch.setattr(cameras, "resolve", no_answer)
    found = refusals(start("rtsp://one.example/", "rtsp://other.example/"), False)
    assert found == [(f"/cameras/{place}/source", "The name can't be resolved.") for place in (0, 1)]
    assert limits_s == [10.0, 0.0]


@pytest.fixture(scope="module")
def service(
    make_settings: Callable[..., Settings],
    live_commands: dict[str, tuple[str, ...]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Live]:
    """Running service with the small program."""
    path: Path = tmp_path_factory.mktemp("cameras") / "program.py"
    path.write_text(PROGRAM, encoding="utf-8")
    with running(make_settings(**live_commands, live_cameras_command=(sys.executable, "-P", str(path)))) as live:
        yield live


SOURCES = ("rtsp://127.0.0.1:1/a", "http://127.0.0.1:1/b")


def test_capture_is_passed_on_until_end(service: Live) -> None:
    with opened(service) as connection:
        client = LiveSocket(connection)
        client.send(start_message(*SOURCES))
        ready, notice, instant = client.receive(), client.receive(), client.receive()
        assert (ready["type"], ready["frame_rate_hz"], ready["limits"]) == ("ready", 12.5, {})
        sources, environment = json.loads(notice["message"])
        assert [source["address"] for source in sources] == list(SOURCES)
        assert {name for name in environment if name.startswith("MULTICAP")} <= {"MULTICAP_HOME", "MULTICAP_PROVIDER"}
        assert (instant["type"], instant["time_s"], instant["dropped"]) == ("instant", 0.5, {"input": 0, "output": 0})
        with opened(service) as second:  # processors are for one
            other = LiveSocket(second)
            other.send(start_message(*SOURCES))
            assert other.problem()["code"] == "captures_busy"
        client.send({"type": "end"})
        ended = client.receive()
        assert (ended["type"], ended["counts"]) == (
            "ended",
            {"received": 9, "taken": 7, "late": 0, "too_late": 2},
        )
    with opened(service) as connection:  # the place is free again
        client = LiveSocket(connection)
        client.send(start_message(*SOURCES))
        assert [client.receive()["type"] for _ in range(3)] == ["ready", "notice", "instant"]
        client.send({"type": "keypoints"})
        assert client.problem()["code"] == "live_message"


@pytest.mark.parametrize(("profile", "code"), [("accurate", "live_fields"), ("balanced", "live_failed")])
def test_capture_that_fails_says_why(service: Live, profile: str, code: str) -> None:
    with opened(service) as connection:
        client = LiveSocket(connection)
        client.send(start_message(*SOURCES, profile=profile))
        problem = client.problem()
        assert problem["code"] == code
        assert [error["code"] for error in problem["errors"]] == ["stream_refused"] * (code == "live_fields")


def test_keys_close_private_cameras_unless_allowed(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    for is_allowed in (None, True):
        with running(make_settings(**live_commands, live_private=is_allowed)) as live:
            address = f"http://127.0.0.1:{live.address[1]}/v1/live/devices"
            _, secret = live.services.store.keys.add("studio-a", "writer", frozenset({Scope.READ, Scope.WRITE}))
            assert httpx2.get(address, trust_env=False).status_code == 401
            bearer = {"Authorization": f"Bearer {secret}"}
            assert httpx2.get(address, headers=bearer, trust_env=False).json()["allows_private"] is (is_allowed is True)


def test_test_pattern_reaches_outputs(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        running(make_settings(**live_commands)) as live,
    ):
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60)
        address = f"vmc://127.0.0.1:{receiver.getsockname()[1]}"
        with opened(live) as connection:
            client = LiveSocket(connection)
            client.send({"type": "start_test_pattern", "outputs": [address]})
            ready = client.receive()
            assert (ready["type"], ready["cameras"], ready["frame_rate_hz"]) == ("ready", [], 60.0)
            assert b"/VMC/Ext/Bone/Pos" in receiver.recv(65_536)
            while (message := client.receive())["type"] != "status":
                assert message["people"][0]["skeleton"] is not None
            (output,) = message["outputs"]
            assert (output["address"], output["state"]) == (address, "sending")
            client.send({"type": "end"})
            while client.receive()["type"] != "ended":
                pass
        with opened(live) as connection:
            client = LiveSocket(connection)
            client.send({"type": "start_test_pattern", "outputs": ["vmc://127.0.0.1:65535?people=2", "gopher://a"]})
            problem = client.problem()
            assert problem["code"] == "live_fields"
            assert [error["message"] for error in problem["errors"]] == [
                "'vmc://127.0.0.1:65535?people=2' needs 2 ports, and 65535 is the last.",
                "'gopher://a' is no address of an output.",
            ]


def test_keys_close_outputs_of_test_pattern(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    with running(make_settings(**live_commands)) as live:
        _, secret = live.services.store.keys.add("studio-a", "writer", frozenset({Scope.READ, Scope.WRITE}))
        with opened(live, additional_headers={"Authorization": f"Bearer {secret}"}) as connection:
            client = LiveSocket(connection)
            client.send({"type": "start_test_pattern", "outputs": ["osc://127.0.0.1:9000"]})
            (error,) = client.problem()["errors"]
            assert (error["pointer"], error["message"]) == (
                "/outputs",
                "The service sends people to no other program.",
            )
