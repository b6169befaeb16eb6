"""Opening of live captures: keys and scopes, pages of other origins, the number of captures, silence."""

import asyncio
import json
import socket
from collections.abc import Callable, Iterator

import psutil
import pytest
import websockets
from websockets.frames import Frame, Opcode

from api.web.live import places
from api.web.live.places import LivePlaces
from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import packet, start_message
from tests.waiting import wait_for
from worker.store.model.rights import Scope


@pytest.fixture
def own(make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]) -> Iterator[Live]:
    """Running service of a test's own, with room for two captures of a tenant and three of all."""
    places = {"max_live_captures": 3, "max_tenant_live_captures": 2}
    with running(make_settings(**live_commands, **places, max_live_messages_per_s=20.0)) as live:
        yield live


@pytest.fixture
def impatient(make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]) -> Iterator[Live]:
    """Running service that is strict about silence."""
    with running(make_settings(**live_commands, live_idle_s=1.0)) as live:
        yield live


def refusal(service: Live, **options: object) -> tuple[int, str]:
    """Status and code of the answer to a WebSocket that is not opened."""
    with pytest.raises(websockets.InvalidStatus) as refused, opened(service, **options):
        pass
    response = refused.value.response
    assert response.headers["Content-Type"] == "application/problem+json"
    problem = json.loads(bytes(response.body or b""))
    assert problem["status"] == response.status_code
    assert problem["request_id"] == response.headers["X-Request-ID"]
    assert problem["instance"] == "/v1/live"
    return response.status_code, problem["code"]


def bearer(secret: str) -> dict[str, dict[str, str]]:
    return {"additional_headers": {"Authorization": f"Bearer {secret}"}}


def test_keys_and_scopes_count_as_elsewhere(own: Live) -> None:
    _, writing = own.services.store.keys.add("studio-a", "writer", frozenset({Scope.READ, Scope.WRITE}))
    _, reading = own.services.store.keys.add("studio-a", "reader", frozenset({Scope.READ}))
    assert refusal(own) == (401, "key_required")
    assert refusal(own, **bearer("mc_wrong")) == (401, "key_required")
    assert refusal(own, **bearer(reading)) == (403, "scope_missing")
    with opened(own, **bearer(writing)) as connection:
        assert LiveSocket(connection).start()["type"] == "ready"


def test_pages_of_allowed_origins_offer_their_key_as_subprotocol(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    origin = "https://stage.example"
    with running(make_settings(**live_commands, allowed_origins=frozenset({origin}))) as service:
        _, secret = service.services.store.keys.add("studio-a", "page", frozenset({Scope.WRITE}))
        _, reading = service.services.store.keys.add("studio-a", "reader", frozenset({Scope.READ}))

        def offer(key: str, origin: str = origin) -> dict[str, object]:
            return {"origin": origin, "subprotocols": ["multicap.live", f"mc.key.{key}"]}

        with opened(service, **offer(secret)) as connection:
            assert connection.subprotocol == "multicap.live"
            assert LiveSocket(connection).start()["type"] == "ready"
        assert refusal(service, **offer("mc_wrong")) == (401, "key_required")
        assert refusal(service, **offer(reading)) == (403, "scope_missing")
        assert refusal(service, **offer(secret, "https://elsewhere.example")) == (403, "origin_not_allowed")
        # A key in a header counts alone.
        both = offer(secret) | bearer("mc_wrong")
        assert refusal(service, **both) == (401, "key_required")


def test_revoked_keys_end_captures(own: Live) -> None:
    key, secret = own.services.store.keys.add("studio-a", "writer", frozenset({Scope.READ, Scope.WRITE}))
    with opened(own, **bearer(secret)) as connection:
        client = LiveSocket(connection)
        client.start()
        own.services.store.keys.revoke(key.id)
        assert client.problem()["code"] == "live_key_ended"


def test_browsers_come_with_their_cookie_from_own_page_only(own: Live) -> None:
    _, secret = own.services.store.keys.add("studio-a", "person", frozenset({Scope.READ, Scope.WRITE}))
    signed_in = own.client.post("/v1/browser-session", json={"key": secret})
    assert signed_in.is_success, signed_in.text
    cookie = {"Cookie": "; ".join(f"{name}={value}" for name, value in own.client.cookies.items())}
    origin = f"http://127.0.0.1:{own.address[1]}"
    with opened(own, additional_headers=cookie, origin=origin) as connection:
        assert LiveSocket(connection).start()["type"] == "ready"
    assert refusal(own, additional_headers=cookie) == (403, "cross_site_request")
    assert refusal(own, additional_headers=cookie, origin="https://evil.example") == (403, "origin_not_allowed")


def test_pages_of_other_origins_open_nothing_without_keys_either(own: Live) -> None:
    assert refusal(own, origin="https://evil.example") == (403, "origin_not_allowed")
    assert refusal(own, additional_headers={"Host": "evil.example"})[0] in {400, 403}


def test_captures_of_tenant_and_of_all_are_limited(own: Live) -> None:
    scopes = frozenset({Scope.READ, Scope.WRITE})
    first, second = (own.services.store.keys.add(name, name, scopes)[1] for name in ("studio-a", "studio-b"))
    with opened(own, **bearer(first)) as one, opened(own, **bearer(first)):
        LiveSocket(one).start()
        assert refusal(own, **bearer(first)) == (429, "too_many_captures")
        with opened(own, **bearer(second)):
            assert refusal(own, **bearer(second)) == (503, "captures_busy")


def test_silence_ends_capture(impatient: Live) -> None:
    with opened(impatient) as connection:
        assert LiveSocket(connection).problem()["code"] == "live_idle"
    with opened(impatient) as connection:
        client = LiveSocket(connection)
        client.start()
        assert client.problem()["code"] == "live_idle"


def test_floods_end_capture(own: Live) -> None:
    with opened(own) as connection:
        client = LiveSocket(connection)
        client.send(start_message())
        assert client.receive()["type"] == "ready"
        with pytest.raises(websockets.ConnectionClosed):  # noqa: PT012 - it may end at any message
            for number in range(1000):
                client.send(packet(time_s=number * 1e-3))
            while True:
                client.receive()
        assert connection.close_code == 1008
        assert connection.close_reason == "live_too_fast"


def test_client_faster_than_its_cameras_yields_and_loses_nothing(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    num_frames = 500  # Two cameras of 25 Hz, four times as fast: 200 frames are taken at once.
    with running(make_settings(**live_commands)) as service, opened(service) as first, opened(service) as second:
        slow, fast = LiveSocket(first), LiveSocket(second)
        slow.start()
        fast.start(format="packed")
        for number in range(num_frames):
            fast.send(packet(time_s=number * 0.04))
        slow.send(packet())
        assert slow.receive()["type"] == "instant"
        for _ in range(num_frames):
            assert isinstance(fast.receive(), bytes)
        captures = psutil.Process(service.services.live_forks.pid).children()
        assert sorted(capture.nice() for capture in captures) == [5, 19]
        end = fast.ended()[1]
        assert (end["counts"]["received"], end["dropped"]) == (num_frames, {"input": 0, "output": 0})


def test_pause_follows_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "_PAUSE", 1e9)  # the longest pause
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})

    async def run() -> None:
        turns = LivePlaces(8, 8, 8, 1)
        begun = asyncio.Event()

        async def second() -> None:
            async with turns.starting():
                begun.set()

        async with turns.starting():
            waiting = asyncio.create_task(second())
            await asyncio.sleep(0.001)
        for _ in range(3):
            await asyncio.sleep(0)
            assert not begun.is_set()
        await asyncio.wait_for(waiting, 60)

    asyncio.run(run())


def test_many_messages_at_once_are_all_read(own: Live) -> None:
    """The server parses pieces of what has come: messages, a ping between them, and one that is longer than a piece."""
    frames = [Frame(Opcode.TEXT, json.dumps(start_message()).encode())]
    frames += [Frame(Opcode.BINARY, packet(time_s=number * 0.04)) for number in range(15)]
    frames += [Frame(Opcode.PING, b"here"), Frame(Opcode.TEXT, b'{"type": "end"}' + b" " * 20_000)]
    request = (
        "GET /v1/live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    with socket.create_connection(own.address, timeout=60) as connection:
        connection.sendall(request.encode())
        assert connection.recv(10_000).startswith(b"HTTP/1.1 101")
        connection.sendall(b"".join(frame.serialize(mask=True) for frame in frames))
        answer = b""
        while b'"type":"ended"' not in answer and (content := connection.recv(2**16)):
            answer += content
    assert answer.count(b'"type":"instant"') == 15
    assert b'"type":"ended"' in answer
    assert b"\x8a\x04here" in answer  # the pong


def test_owner_of_bad_captures_waits_and_others_do_not(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    with running(make_settings(**live_commands, max_bad_live_captures_per_minute=2)) as service:
        keys = service.services.store.keys
        bad, good = (keys.add(name, name, frozenset({Scope.WRITE}))[1] for name in ("studio-a", "studio-b"))
        with opened(service, **bearer(bad)) as running_on:
            client = LiveSocket(running_on)
            client.start()
            for message in ("{", "[]"):
                with opened(service, **bearer(bad)) as connection:
                    broken = LiveSocket(connection)
                    broken.send(message)
                    assert broken.problem()["code"] == "live_message"
            wait_for(lambda: is_refused(service, bad))
            assert refusal(service, **bearer(bad)) == (429, "too_many_bad_captures")
            # Running captures go on, and other tenants begin.
            client.send(packet())
            assert len(client.ended()[0]) == 1
        with opened(service, **bearer(good)) as connection:
            assert LiveSocket(connection).start()["type"] == "ready"


def is_refused(service: Live, secret: str) -> bool:
    """Return whether a capture is refused; the end of the one before is counted a little later than the client sees."""
    try:
        with opened(service, **bearer(secret)):
            return False
    except websockets.InvalidStatus as refused:
        return 1 <= int(refused.response.headers["Retry-After"]) <= 60


def test_other_addresses_have_no_websocket(own: Live) -> None:
    address = f"ws://127.0.0.1:{own.address[1]}/v1/sessions"
    with pytest.raises(websockets.InvalidStatus), websockets.sync.client.connect(address):
        pass
