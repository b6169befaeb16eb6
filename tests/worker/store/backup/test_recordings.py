"""Recordings by phones in backups: rooms, phones, takes, clips and their uploads, and the rights of links."""

from dataclasses import dataclass
from pathlib import Path

import pytest
import uuid_utils

from tests.worker.store.backups import Data, opened_data, restored
from worker.store.database.quotas import Quotas
from worker.store.errors import NotFound, PhoneRemoved
from worker.store.model.phone_records import ClipFile, RecordingLimits, TakeState, UploadingPhone
from worker.store.model.rights import Actor
from worker.store.store import JobStore
from worker.store.tenant_records import TenantRecords

LIMITS = RecordingLimits(phones=3, takes=4, take_s=60.0)
PHONE_IDS = ("the-secret-of-the-first-phone", "the-secret-of-the-second-phone", "the-secret-of-the-third-phone")
START_S = 1_790_000_000.0


@dataclass(frozen=True)
class FilmedRoom:
    """Recording in the middle: a take that became a session, one whose clips come, and one that is recorded."""

    id: str
    secret: str
    whole: str  # Id of an upload
    half: str


def uploads_of(store: JobStore, recording_id: str, number: int) -> TenantRecords:
    return store.tenant("mine", Quotas(), Actor(), UploadingPhone(recording_id, number, 5, 1000))


def add_upload(data: Data, recording_id: str, phone: int, content: bytes, num_bytes: int) -> str:
    upload_id = str(uuid_utils.uuid7())
    uploads_of(data.store, recording_id, phone).uploads.add(upload_id, "a.webm", num_bytes, "", 3600.0, "host:/uploads")
    (data.folder / "uploads").mkdir(exist_ok=True)
    (data.folder / "uploads" / upload_id).write_bytes(content)
    return upload_id


@pytest.fixture
def room(data: Data) -> FilmedRoom:
    recordings = data.store.tenant("mine", Quotas(), Actor()).recordings
    recording, secret = recordings.add("Rehearsal", 3600.0)
    for phone_id in PHONE_IDS:
        recordings.join(recording.id, phone_id, "Phone", "Chrome on Android", LIMITS)
    recordings.remove_phone(recording.id, 3)
    settings = {"width": 1280, "height": 720, "frame_rate_hz": 30.0}
    for number in (1, 2, 3):
        recordings.start_take(recording.id, None, settings, START_S + 100 * number, LIMITS)
        recordings.report_clip(
            recording.id, number, 1, "started", {"first_frame_s": START_S + 100 * number, "std_s": 0.004}
        )
        if number < 3:
            recordings.stop_take(recording.id, START_S + 100 * number + 10)
    recordings.use_take(recording.id, 1, session_id=data.add_session())
    recordings.want_upload(recording.id, 2)
    recordings.report_clip(recording.id, 2, 1, "stopped", {"num_frames": 300})
    whole = add_upload(data, recording.id, 1, b"whole", 5)
    half = add_upload(data, recording.id, 2, b"ha", 4)
    facts = {"mime_type": "video/webm", "lost": [{"from_s": START_S + 201, "to_s": START_S + 202}]}
    recordings.add_file(recording.id, 2, 1, ClipFile(2, whole, 5, START_S + 202.5, 0.004, 7.5, facts))
    return FilmedRoom(recording.id, secret, whole, half)


def test_restored_recordings_are_unchanged_and_continue(data: Data, room: FilmedRoom, tmp_path: Path) -> None:
    before = data.store.recordings.get(room.id)
    assert data.back_up(tmp_path / "backup.tar").problems == ()
    restored(tmp_path / "backup.tar", tmp_path / "there")
    with opened_data(tmp_path / "there") as there:
        recordings = there.store.tenant("mine", Quotas(), Actor()).recordings
        assert recordings.get(room.id) == before
        assert [take.state(START_S + 305) for take in before.takes] == [
            *(TakeState.USED, TakeState.RECORDED, TakeState.RECORDING)
        ]
        assert there.tree() == data.tree()
        # The link and the secrets of phones open what they opened, and nothing else.
        link = there.store.join_secrets.find(room.secret)
        assert link is not None
        assert (link.recording_id, link.tenant) == (room.id, "mine")
        assert [recordings.phone_number(room.id, phone_id) for phone_id in PHONE_IDS[:2]] == [1, 2]
        with pytest.raises(PhoneRemoved):
            recordings.join(room.id, PHONE_IDS[2], None, "Chrome on Android", LIMITS)
        assert uploads_of(there.store, room.id, 2).uploads.get(room.half).num_bytes == 4
        with pytest.raises(NotFound):
            uploads_of(there.store, room.id, 1).uploads.get(room.half)
        with pytest.raises(NotFound):
            there.store.tenant("other", Quotas(), Actor()).recordings.get(room.id)
        # Revisions count on from there.
        assert recordings.stop_take(room.id, START_S + 310).revision == before.revision + 1
        recordings.add_file(room.id, 2, 2, ClipFile(1, room.half, 4, START_S + 200.0, 0.02, 10.0, {}))
        recordings.delete(room.id)
        assert there.store.uploads.known([room.whole, room.half]) == set()
        assert len(there.store.sessions.page()) == 1


def test_upload_that_backup_lacks_is_note(data: Data, room: FilmedRoom, tmp_path: Path) -> None:
    (data.folder / "uploads" / room.whole).unlink()
    report = data.back_up(tmp_path / "backup.tar")
    assert [(problem.path, problem.needed) for problem in report.problems] == [(f"uploads/{room.whole}", False)]
    assert report.manifest.rows.uploads == 2
