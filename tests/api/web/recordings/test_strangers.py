"""Strangers at recordings: wrong and ended secrets, other tenants, and all that a link for phones does not open."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
import websockets

from api.web.contract.openapi import COMMITTED
from api.web.settings import Settings
from tests.api.conftest import Live, problem_of, running
from tests.api.web.recordings.conftest import TUS, OpenedRecording, RoomSocket, opened_recording, socket_of, taken
from worker.store.model.rights import Scope

CONTRACT = json.loads(COMMITTED.read_text(encoding="utf-8"))
USUAL = frozenset({Scope.READ, Scope.WRITE})


@dataclass
class GuardedRoom:
    """Service with keys of two tenants; one of them has a recording."""

    live: Live
    mine: dict[str, str]
    theirs: dict[str, str]
    reading: dict[str, str]
    recording: OpenedRecording


@pytest.fixture
def guarded(make_settings: Callable[..., Settings]) -> Iterator[GuardedRoom]:
    with running(make_settings(max_wrong_keys_per_minute=100_000, max_recording_messages_per_s=1000.0)) as live:
        keys = live.services.store.keys
        mine, theirs, reading = (
            {"Authorization": f"Bearer {keys.add(tenant, 'test', scopes)[1]}"}
            for tenant, scopes in (("mine", USUAL), ("theirs", USUAL), ("mine", frozenset({Scope.READ})))
        )
        yield GuardedRoom(live, mine, theirs, reading, opened_recording(live, mine))


def refused(recording: OpenedRecording, secret: str) -> dict[str, object]:
    """Problem that a phone with a secret gets before it said anything."""
    with socket_of(recording, subprotocols=["multicap.recording", f"mc.link.{secret}"]) as socket:
        return RoomSocket(socket).problem()


def test_wrong_and_ended_secrets_are_refused(guarded: GuardedRoom) -> None:
    recording = guarded.recording
    for wrong in ("mcl_wrong", recording.secret + "x", recording.secret.swapcase(), "mc_x"):
        problem = refused(recording, wrong)
        assert (problem["code"], problem["close_code"]) == ("link_unknown", 1008)
    other = opened_recording(guarded.live, guarded.mine)
    assert refused(recording, other.secret)["code"] == "link_unknown"
    guarded.live.client.delete(f"/v1/recordings/{other.id}", headers=guarded.mine)
    assert refused(other, other.secret)["code"] == "link_unknown"


def test_wrong_secrets_are_counted_as_wrong_keys_are(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_wrong_keys_per_minute=3)) as live:
        recording = opened_recording(live)
        codes = [refused(recording, "mcl_wrong")["code"] for _ in range(5)]
        assert codes == ["link_unknown"] * 3 + ["too_many_wrong_keys"] * 2


def test_hosts_need_key_of_tenant_that_writes(guarded: GuardedRoom) -> None:
    for headers, status, code in (
        ({}, 401, "key_required"),
        (guarded.theirs, 404, "not_found"),
        (guarded.reading, 403, "scope_missing"),
    ):
        with (
            pytest.raises(websockets.InvalidStatus) as denied,
            socket_of(guarded.recording, additional_headers=headers),
        ):
            pass
        response = denied.value.response
        assert response.status_code == status
        assert json.loads(bytes(response.body or b""))["code"] == code
    with guarded.recording.host() as host:
        assert host.state(lambda state: True)["recording"]["id"] == guarded.recording.id


def test_another_tenant_reaches_nothing_of_recording(guarded: GuardedRoom) -> None:
    client, theirs, recording = guarded.live.client, guarded.theirs, guarded.recording
    address = f"/v1/recordings/{recording.id}"
    problem_of(client.get(address, headers=theirs), 404, "not_found")
    problem_of(client.delete(address, headers=theirs), 404, "not_found")
    problem_of(client.post(f"{address}/join", headers=theirs), 404, "not_found")
    spec = {"calibration_id": recording.id}
    problem_of(client.post(f"{address}/takes/1/session", json=spec, headers=theirs), 404, "not_found")
    statures = {"stature_m": [1.8]}
    problem_of(client.post(f"{address}/takes/1/calibration", json=statures, headers=theirs), 404, "not_found")
    assert client.get("/v1/recordings", headers=theirs).json()["recordings"] == []
    assert len(client.get("/v1/recordings", headers=guarded.mine).json()["recordings"]) == 1


def test_link_opens_uploads_of_its_phone_and_nothing_else(guarded: GuardedRoom) -> None:
    live, recording = guarded.live, guarded.recording
    with recording.phone("Left") as left, recording.phone("Right") as right:
        upload_id = left.upload(b"video")
        for path, item in CONTRACT["paths"].items():
            for method in {"get", "head", "post", "patch", "put", "delete"} & item.keys():
                if path in {"/healthz", "/readyz", "/v1/browser-session"}:
                    continue
                address = re.sub(r"\{(\w+)\}", lambda found: recording.id, path)
                for headers in (left.headers, {"Authorization": left.headers["Authorization"]}):
                    answer = live.client.request(method.upper(), address, headers=TUS | headers)
                    is_upload = path.startswith("/v1/uploads") and path != "/v1/uploads/from-url"
                    assert answer.status_code in ({400, 404} if is_upload else {401}), (method, path, answer.text)
                answer = live.client.request(method.upper(), address, params={"link": recording.secret})
                assert answer.status_code in {401, 412}, (method, path)
        own = f"/v1/uploads/{upload_id}"
        for phone, status in ((left, 200), (right, 404)):
            assert live.client.head(own, headers=TUS | phone.headers).status_code == status
        problem_of(live.client.delete(own, headers=TUS | right.headers), 404, "not_found")
        wrong = TUS | left.headers | {"Multicap-Phone": "nobody-has-this-secret"}
        problem_of(live.client.delete(own, headers=wrong), 404, "not_found")
        # The host's key reaches the uploads of its phones, other keys do not.
        assert live.client.head(own, headers=TUS | guarded.mine).status_code == 200
        assert live.client.head(own, headers=TUS | guarded.theirs).status_code == 404
        assert live.client.delete(own, headers=TUS | left.headers).status_code == 204


def test_phones_do_not_meet_idempotency_keys_of_others(guarded: GuardedRoom) -> None:
    with guarded.recording.phone("Left") as left, guarded.recording.phone("Right") as right:
        key = {"Idempotency-Key": "the same key"}
        first, again, other = (phone.begin_upload(5, **key).headers["location"] for phone in (left, left, right))
        assert first == again
        assert other != first


def test_end_of_key_ends_link(guarded: GuardedRoom) -> None:
    store = guarded.live.services.store
    key, secret = store.keys.add("mine", "host", USUAL)
    recording = opened_recording(guarded.live, {"Authorization": f"Bearer {secret}"})
    with recording.host() as host, recording.phone("Left") as phone:
        store.keys.revoke(key.id)
        assert phone.problem()["code"] == "recording_link_ended"
        assert host.problem()["code"] == "recording_link_ended"
        assert phone.begin_upload(5).status_code == 401
    assert refused(recording, recording.secret)["code"] == "link_unknown"


def test_link_made_without_keys_ends_with_first_key(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings()) as live:
        recording = opened_recording(live)
        with recording.phone("Left") as phone:
            live.services.store.keys.add("default", "first", USUAL)
            assert phone.problem()["code"] == "recording_link_ended"


def test_pages_of_other_origins_open_no_socket(guarded: GuardedRoom) -> None:
    offered = [f"mc.link.{guarded.recording.secret}"]
    for headers in ({"Origin": "https://evil.example"}, {"Host": "evil.example"}):
        with (
            pytest.raises((websockets.InvalidStatus, websockets.InvalidHandshake)),
            socket_of(guarded.recording, subprotocols=offered, additional_headers=headers),
        ):
            pass


def test_no_secret_is_stored(guarded: GuardedRoom) -> None:
    with guarded.recording.host() as host, guarded.recording.phone("Left") as phone:
        phone.record(1, taken(host)["start_s"])
        host.state(lambda state: state["recording"]["takes"][0]["clips"])
        stored = b"".join(path.read_bytes() for path in guarded.live.settings.data_dir.glob("multicap.db*"))
        assert guarded.recording.id.encode() in stored
        assert guarded.recording.secret.removeprefix("mcl_").encode() not in stored
        assert phone.phone_id.encode() not in stored
