"""Recordings: what hosts and phones see of each other, takes from their start to their files."""

import time
from typing import Any

import pytest

from api.web.recordings.intake import server_s
from tests.api.conftest import Live, problem_of
from tests.api.web.recordings.conftest import (
    JPEG,
    STARTED_LATE_S,
    OpenedRecording,
    RoomSocket,
    file_fields,
    opened_recording,
    socket_of,
    taken,
)


def clips(state: dict[str, Any], take: int = 1) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = state["recording"]["takes"][take - 1]["clips"]
    return found


def is_recording(state: dict[str, Any]) -> bool:
    takes: list[dict[str, Any]] = state["recording"]["takes"]
    return takes[-1]["state"] == "recording"


def test_recording_is_opened_with_link_and_its_code(rooms_service: Live) -> None:
    answer = rooms_service.client.post("/v1/recordings", json={"name": "Rehearsal", "expires_in_s": 600})
    assert answer.status_code == 201
    opened = answer.json()
    assert answer.headers["location"] == f"/v1/recordings/{opened['id']}"
    join = opened["join"]
    assert join["url"] == f"http://127.0.0.1:{rooms_service.address[1]}/record#join={opened['id']}.{join['secret']}"
    assert join["secret"].startswith("mcl_")
    assert join["qr_svg"].startswith('<svg xmlns="http://www.w3.org/2000/svg"')
    assert join["expires_at"] == opened["expires_at"]
    read = rooms_service.client.get(f"/v1/recordings/{opened['id']}").json()
    assert read == {name: value for name, value in opened.items() if name != "join"}
    assert read in rooms_service.client.get("/v1/recordings").json()["recordings"]
    assert rooms_service.client.delete(f"/v1/recordings/{opened['id']}").status_code == 204
    problem_of(rooms_service.client.get(f"/v1/recordings/{opened['id']}"), 404, "not_found")


def test_wrong_choices_are_named(rooms_service: Live) -> None:
    for spec, pointer in (
        ({"expires_in_s": 1e9}, "/expires_in_s"),
        ({"expires_in_s": 1}, "/expires_in_s"),
        ({"nmae": "x"}, "/nmae"),
        ({"name": ""}, "/name"),
    ):
        problem = problem_of(rooms_service.client.post("/v1/recordings", json=spec), 422, "invalid_request")
        assert [item["pointer"] for item in problem["errors"]] == [pointer]


def test_phones_record_take_together(recording: OpenedRecording) -> None:
    with recording.host() as host, recording.phone("Left") as left, recording.phone("Left") as right:
        assert (left.welcome["name"], right.welcome["name"]) == ("Left", "Left 2")
        host.state(lambda state: len(state["live"]) == 2)
        asked_s = server_s()
        host.send("start", name="Handshake", settings={"width": 1280, "height": 720, "frame_rate_hz": 30})
        starts = [phone.next("start") for phone in (left, right)]
        assert starts[0] == starts[1]
        assert starts[0]["take"] == 1
        assert starts[0]["at_server_s"] - server_s() > 1.0  # a second ahead at least
        assert starts[0]["at_server_s"] - asked_s == pytest.approx(2.0, abs=0.5)
        assert starts[0]["settings"] == {"width": 1280, "height": 720, "frame_rate_hz": 30.0}
        host.send("stop")
        stops = [phone.next("stop") for phone in (left, right)]
        assert stops[0] == stops[1]
        assert stops[0]["at_server_s"] >= starts[0]["at_server_s"]
        host.send("upload", take=1)
        assert [phone.next("upload")["take"] for phone in (left, right)] == [1, 1]
        for phone in (left, right):
            phone.record(1, starts[0]["at_server_s"])
        state = host.state(lambda state: [len(clip["files"]) for clip in clips(state)] == [1, 1])
        assert [clip["phone"] for clip in clips(state)] == [1, 2]
        (file,) = clips(state)[0]["files"]
        assert file["first_frame_s"] == pytest.approx(starts[0]["at_server_s"] + STARTED_LATE_S)
        assert state["recording"]["takes"][0]["name"] == "Handshake"
        assert "phone-id" not in str(state)
    assert [phone["name"] for phone in recording.read()["phones"]] == ["Left", "Left 2"]


def test_clock_is_told_at_once(recording: OpenedRecording) -> None:
    with recording.phone() as phone, recording.host() as host:
        for client in (phone, host):
            sent_s = server_s()
            client.send("ping", t0_s=12.5)
            pong = client.next("pong")
            assert pong["t0_s"] == 12.5
            assert sent_s <= pong["server_s"] <= server_s()


def test_hosts_see_what_phones_say_and_show(recording: OpenedRecording) -> None:
    with recording.host() as host, recording.phone("Left", mime_types=["video/webm"]) as phone:
        phone.send("status", state="ready", battery=0.5, clock={"offset_s": 1.5, "std_s": 0.002})
        state = host.state(lambda state: state["live"] and state["live"][0]["status"])
        assert state["live"][0]["is_connected"]
        assert state["live"][0]["status"]["battery"] == 0.5
        assert state["live"][0]["hello"]["mime_types"] == ["video/webm"]
        assert state["relay"] == "away"  # there is no broker here
        phone.socket.send(JPEG)
        assert host.thumbnail() == b"\x01\x00" + JPEG
        phone.socket.close()
        host.state(lambda state: not state["live"][0]["is_connected"])


def test_phone_comes_back_with_its_name_and_goes_on_with_take(recording: OpenedRecording) -> None:
    with recording.host() as host:
        with recording.phone("Left", phone_id="the-same-phone-comes-again") as phone:
            host.send("start")
            started = phone.next("start")
        with recording.phone("Other", phone_id="the-same-phone-comes-again") as phone:
            assert (phone.welcome["number"], phone.welcome["name"]) == (1, "Left")
            (take,) = phone.welcome["takes"]
            assert (take["state"], take["start_s"], take["parts"]) == ("recording", started["at_server_s"], [])
            host.send("stop")
            assert phone.next("stop")["take"] == 1


def test_phone_that_was_away_learns_all_from_welcome(recording: OpenedRecording) -> None:
    with recording.host() as host:
        with recording.phone(phone_id="the-same-phone-comes-again"):
            pass
        taken(host)
        host.send("upload", take=1)
        host.state(lambda state: state["recording"]["takes"][0]["is_upload_wanted"])
        with recording.phone(phone_id="the-same-phone-comes-again") as phone:
            (take,) = phone.welcome["takes"]
            assert (take["state"], take["is_upload_wanted"]) == ("recorded", True)
        host.send("discard", take=1)
        host.state(lambda state: state["recording"]["takes"][0]["state"] == "discarded")
        with recording.phone(phone_id="the-same-phone-comes-again") as phone:
            (take,) = phone.welcome["takes"]
            assert (take["state"], take["is_upload_wanted"]) == ("discarded", False)


def test_host_that_comes_back_sees_everything(recording: OpenedRecording) -> None:
    with recording.phone("Left") as phone:
        with recording.host() as host:
            host.send("start")
            phone.next("start")
        phone.send("status", state="recording")
        with recording.host() as host:
            state = host.state(lambda state: True)
            assert state["recording"]["takes"][0]["state"] == "recording"
            assert state["live"][0]["is_connected"]


def test_only_one_take_at_time_and_only_so_many(recording: OpenedRecording) -> None:
    with recording.host() as host:
        host.send("stop")
        assert host.next("problem")["detail"] == "No take is being recorded."
        for _ in range(4):
            host.send("start")
            host.state(lambda state: state["recording"]["takes"][-1:] and is_recording(state))
            host.send("start")
            refusal = host.next("problem")
            assert (refusal["code"], refusal["close_code"]) == ("conflict", None)
            assert refusal["detail"] == "A take is being recorded; stop it first."
            host.send("stop")
            host.state(lambda state: state["recording"]["takes"][-1]["state"] == "recorded")
        host.send("start")
        assert "4 takes at most" in host.next("problem")["detail"]


def test_phones_are_renamed_and_removed(recording: OpenedRecording) -> None:
    with recording.host() as host, recording.phone("Left") as left, recording.phone("Right") as right:
        host.send("rename", phone=1, name="Door")
        assert left.next("rename")["name"] == "Door"
        host.send("rename", phone=1, name="Right")
        assert host.next("problem")["code"] == "conflict"
        right.send("rename", name="Window")
        host.state(lambda state: [phone["name"] for phone in state["recording"]["phones"]] == ["Door", "Window"])
        assert right.next("rename")["name"] == "Window"
        host.send("remove", phone=2)
        assert right.ended() == "removed"
        refused = right.begin_upload(5)
        problem_of(refused, 404, "not_found")
        host.send("remove", phone=9)
        assert host.next("problem")["code"] == "not_found"
    with recording.phone("Window", phone_id="another-phone-with-that-name") as other:
        assert other.welcome["name"] == "Window 2"


def test_removed_phone_does_not_come_back(recording: OpenedRecording) -> None:
    identity = "a-phone-that-is-removed"
    with recording.host() as host, recording.phone(phone_id=identity) as phone:
        host.send("remove", phone=1)
        assert phone.ended() == "removed"
    with socket_of(recording, subprotocols=[f"mc.link.{recording.secret}"]) as connection:
        again = RoomSocket(connection)
        again.send("hello", phone_id=identity)
        assert again.ended() == "removed"


def test_end_of_recording_ends_its_connections(rooms_service: Live) -> None:
    recording = opened_recording(rooms_service)
    with recording.host() as host, recording.phone() as phone:
        rooms_service.client.delete(f"/v1/recordings/{recording.id}")
        assert phone.ended() == "recording"
        assert host.ended() == "recording"


def test_another_link_ends_one_before(recording: OpenedRecording) -> None:
    with recording.phone("Left", phone_id="a-phone-with-the-old-link") as phone:
        renewed = recording.live.client.post(f"/v1/recordings/{recording.id}/join")
        assert renewed.status_code == 201
        problem = phone.problem()
        assert (problem["code"], problem["close_code"]) == ("recording_link_ended", 1008)
        assert phone.begin_upload(5).status_code == 401
        recording.secret = renewed.json()["join"]["secret"]
    with recording.phone(phone_id="a-phone-with-the-old-link") as phone:
        assert phone.welcome["name"] == "Left"
        assert phone.begin_upload(5).status_code == 201


def test_same_phone_has_one_connection(recording: OpenedRecording) -> None:
    identity = "a-phone-with-two-tabs-open"
    with recording.phone(phone_id=identity) as first, recording.phone(phone_id=identity) as second:
        assert first.ended() == "replaced"
        second.send("ping", t0_s=0.0)
        assert second.next("pong")


def test_files_come_from_uploads_of_phone_alone(recording: OpenedRecording) -> None:
    with recording.host() as host, recording.phone() as left, recording.phone() as right:
        take = taken(host)
        upload_id = left.upload(b"video")
        right.send("file", **file_fields(1, upload_id, take["start_s"]))
        assert right.next("problem")["code"] == "not_found"
        left.send("file", **file_fields(7, upload_id, take["start_s"]))
        assert left.next("problem")["detail"] == "The recording has no such take."
        left.send("file", **file_fields(1, upload_id, take["start_s"]))
        host.state(clips)
        # An upload that is told twice, as after a lost connection, is one file.
        left.send("file", **file_fields(1, upload_id, take["start_s"]))
        left.send("file", **file_fields(1, left.upload(b"more"), take["start_s"]), part=2)
        state = host.state(lambda state: len(clips(state)[0]["files"]) == 2)
        assert [file["part"] for file in clips(state)[0]["files"]] == [1, 2]
        host.send("discard", take=1)
        assert left.next("delete")["take"] == 1
        answer = recording.live.client.head(f"/v1/uploads/{upload_id}", headers={"Tus-Resumable": "1.0.0"})
        assert answer.status_code == 404


def test_take_without_stop_ends_by_itself(rooms_service: Live) -> None:
    store = rooms_service.services.store
    recording = opened_recording(rooms_service)
    with recording.host() as host, recording.phone() as phone:
        host.send("start")
        start = phone.next("start")
        assert start["latest_stop_s"] - start["at_server_s"] == pytest.approx(3600.0)
    found = store.recordings.get(recording.id).takes[0]
    assert found.state(time.time()) == "recording"
    assert found.state(start["latest_stop_s"]) == "recorded"
