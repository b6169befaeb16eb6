"""Recordings in the store: their links, their end, and what other tenants reach."""

import time

import pytest

from tests.worker.store.conftest import StoreBench
from worker.store.database.quotas import Quotas
from worker.store.errors import Conflict, NotFound, PhoneRemoved
from worker.store.model.phone_records import ClipFile, RecordingLimits, TakeState, UploadingPhone
from worker.store.model.rights import Actor, Scope
from worker.store.repositories import recordings as module
from worker.store.repositories.recordings import Recordings
from worker.store.tenant_records import TenantRecords

LIMITS = RecordingLimits(phones=2, takes=2, take_s=60.0)
PHONE_IDS = ("the-secret-of-the-first-phone", "the-secret-of-the-second-phone")


def opened(jobs: StoreBench, tenant: str = "mine", lifetime_s: float = 60.0) -> tuple[TenantRecords, str, str]:
    """Records of a tenant with a recording of two phones, and the secret of its link."""
    records = jobs.store.tenant(tenant, Quotas(), Actor(None, "request"))
    recording, secret = records.recordings.add("Rehearsal", lifetime_s)
    if lifetime_s < 1.0:
        time.sleep(lifetime_s + 0.1)
    else:
        for phone_id in PHONE_IDS:
            records.recordings.join(recording.id, phone_id, "Phone", "Chrome", LIMITS)
    return records, recording.id, secret


def uploads_of(jobs: StoreBench, recording_id: str, number: int, max_bytes: int = 100) -> TenantRecords:
    return jobs.store.tenant("mine", Quotas(), Actor(), UploadingPhone(recording_id, number, 3, max_bytes))


def file_of(upload_id: str, part: int = 1) -> ClipFile:
    return ClipFile(part, upload_id, 5, 1000.5, 0.002, 2.4, {"mime_type": "video/webm"})


def test_link_of_recording_ends_with_next_one(jobs: StoreBench) -> None:
    records, recording_id, secret = opened(jobs)
    link = jobs.store.join_secrets.find(secret)
    assert link is not None
    assert (link.recording_id, link.tenant) == (recording_id, "mine")
    for wrong in ("", secret[:-1], secret + "x", secret.swapcase(), link.id, "mcl_"):
        assert jobs.store.join_secrets.find(wrong) is None
    assert jobs.store.link_secrets.find(secret) is None  # it is no link to a job
    _, other = records.recordings.renew_link(recording_id)
    assert jobs.store.join_secrets.find(secret) is None
    assert jobs.store.join_secrets.valid({link.id}) == set()
    renewed = jobs.store.join_secrets.find(other)
    assert renewed is not None
    assert jobs.store.join_secrets.valid({link.id, renewed.id}) == {renewed.id}


def test_link_of_recording_ends_with_key(jobs: StoreBench) -> None:
    _, _, before = opened(jobs)
    key, _ = jobs.store.keys.add("mine", "host", frozenset(Scope))
    assert jobs.store.join_secrets.find(before) is None  # no key made it, and now there is one
    records = jobs.store.tenant("mine", Quotas(), Actor(key.id, "request"))
    _, secret = records.recordings.add("Rehearsal", 60.0)
    assert jobs.store.join_secrets.find(secret) is not None
    jobs.store.keys.revoke(key.id)
    assert jobs.store.join_secrets.find(secret) is None


def test_recording_ended_is_removed_with_unused_uploads(jobs: StoreBench) -> None:
    records, ended_id, secret = opened(jobs, lifetime_s=0.3)
    _, kept_id, _ = opened(jobs)
    uploads_of(jobs, ended_id, 1).uploads.add("ended", "take.webm", 5, "", 60.0, "here")
    uploads_of(jobs, kept_id, 1).uploads.add("kept", "take.webm", 5, "", 60.0, "here")
    with pytest.raises(NotFound):
        records.recordings.get(ended_id)
    assert jobs.store.join_secrets.find(secret) is None
    assert [recording.id for recording in records.recordings.page()] == [kept_id]
    assert set(jobs.store.recordings.revisions([ended_id, kept_id])) == {kept_id}
    assert jobs.store.recordings.expire() == [ended_id]
    assert jobs.store.recordings.expire() == []
    assert jobs.store.uploads.known(["ended", "kept"]) == {"kept"}
    assert [phone.number for phone in records.recordings.get(kept_id).phones] == [1, 2]


def test_recording_change_increases_revision(jobs: StoreBench) -> None:
    records, recording_id, _ = opened(jobs)
    found = records.recordings
    uploads_of(jobs, recording_id, 1).uploads.add("upload", "take.webm", 5, "", 60.0, "here")
    revisions = [
        found.get(recording_id).revision,
        found.start_take(recording_id, None, {}, 1000.0, LIMITS).revision,
        found.report_clip(recording_id, 1, 1, "started", {"std_s": 0.1}).revision,
        found.stop_take(recording_id, 1010.0).revision,
        found.report_clip(recording_id, 1, 1, "stopped", {"num_frames": 9}).revision,
        found.want_upload(recording_id, 1).revision,
        found.add_file(recording_id, 1, 1, file_of("upload")).revision,
        found.rename_phone(recording_id, 1, "Door").revision,
        found.remove_phone(recording_id, 2).revision,
        found.renew_link(recording_id)[0].revision,
        found.discard_take(recording_id, 1).revision,
    ]
    assert revisions == list(range(revisions[0], revisions[0] + len(revisions)))
    take = found.get(recording_id).takes[0]
    assert (take.start_s, take.stop_s, take.state(1005.0)) == (1000.0, 1010.0, TakeState.DISCARDED)
    (clip,) = take.clips
    assert (clip.started, clip.stopped, clip.files) == ({"std_s": 0.1}, {"num_frames": 9}, (file_of("upload"),))
    assert jobs.store.uploads.known(["upload"]) == set()


def test_phones_have_names_of_their_own_and_are_recognised(jobs: StoreBench) -> None:
    records, recording_id, _ = opened(jobs)
    assert [phone.name for phone in records.recordings.get(recording_id).phones] == ["Phone", "Phone 2"]
    before_s = time.time()
    back = records.recordings.join(recording_id, PHONE_IDS[1], "Other", "Chrome", LIMITS)
    again = records.recordings.join(recording_id, PHONE_IDS[1], "Other", "Chrome", LIMITS)
    assert back.number == again.number == 2
    assert before_s - 0.01 <= back.at_s <= again.at_s <= time.time() + 0.01
    assert records.recordings.phone_number(recording_id, PHONE_IDS[1]) == 2
    with pytest.raises(Conflict):
        records.recordings.join(recording_id, "a third phone of two", None, "Chrome", LIMITS)
    records.recordings.remove_phone(recording_id, 2)
    with pytest.raises(PhoneRemoved):
        records.recordings.join(recording_id, PHONE_IDS[1], None, "Chrome", LIMITS)
    with pytest.raises(NotFound):
        records.recordings.phone_number(recording_id, PHONE_IDS[1])
    assert records.recordings.join(recording_id, "a third phone of two", None, "Chrome", LIMITS).number == 3


def test_phone_reaches_its_own_uploads_alone(jobs: StoreBench) -> None:
    records, recording_id, _ = opened(jobs)
    first, second = (uploads_of(jobs, recording_id, number) for number in (1, 2))
    first.uploads.add("first", "take.webm", 60, "", 60.0, "here")
    assert first.uploads.get("first").num_bytes == records.uploads.get("first").num_bytes == 60
    for act in (second.uploads.get, second.uploads.delete, lambda name: second.uploads.renew(name, 60.0)):
        with pytest.raises(NotFound):
            act("first")
    with pytest.raises(NotFound):
        jobs.store.tenant("theirs").uploads.get("first")
    with pytest.raises(Conflict):
        second.uploads.add("large", "take.webm", 41, "", 60.0, "here")  # both have 100 bytes together
    second.uploads.add("small", "take.webm", 40, "", 60.0, "here")
    records.recordings.start_take(recording_id, None, {}, 1000.0, LIMITS)
    with pytest.raises(NotFound):
        records.recordings.add_file(recording_id, 1, 2, file_of("first"))


def test_take_is_used_once(jobs: StoreBench) -> None:
    records, recording_id, _ = opened(jobs)
    found = records.recordings
    for _ in range(2):
        found.start_take(recording_id, None, {}, 1000.0, LIMITS)
        found.stop_take(recording_id, 1010.0)
    found.use_take(recording_id, 1, calibration_id="calibration")
    with pytest.raises(Conflict):
        found.use_take(recording_id, 1, calibration_id="another")
    found.use_take(recording_id, 1, session_id="session", job_id="job")
    with pytest.raises(Conflict):
        found.use_take(recording_id, 1, session_id="another")
    take = found.get(recording_id).takes[0]
    assert (take.session_id, take.job_id, take.calibration_id) == ("session", "job", "calibration")
    found.discard_take(recording_id, 2)
    with pytest.raises(Conflict):
        found.use_take(recording_id, 2, session_id="session")


def test_there_are_only_so_many_recordings(jobs: StoreBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_RECORDINGS", 2)
    records, _, _ = opened(jobs)
    opened(jobs, lifetime_s=0.3)
    opened(jobs)
    with pytest.raises(Conflict):
        records.recordings.add("Third", 60.0)
    opened(jobs, "theirs")


ACTS = {
    "get": lambda found, recording_id: found.get(recording_id),
    "delete": lambda found, recording_id: found.delete(recording_id),
    "renew_link": lambda found, recording_id: found.renew_link(recording_id),
    "start_take": lambda found, recording_id: found.start_take(recording_id, None, {}, 2000.0, LIMITS),
    "stop_take": lambda found, recording_id: found.stop_take(recording_id, 2000.0),
    "want_upload": lambda found, recording_id: found.want_upload(recording_id, 1),
    "discard_take": lambda found, recording_id: found.discard_take(recording_id, 1),
    "use_take": lambda found, recording_id: found.use_take(recording_id, 1, session_id="session"),
    "rename_phone": lambda found, recording_id: found.rename_phone(recording_id, 1, "Other"),
    "remove_phone": lambda found, recording_id: found.remove_phone(recording_id, 1),
    "join": lambda found, recording_id: found.join(recording_id, "a stranger's phone id", None, "x", LIMITS),
    "report_clip": lambda found, recording_id: found.report_clip(recording_id, 1, 1, "started", {}),
    "add_file": lambda found, recording_id: found.add_file(recording_id, 1, 1, file_of("upload")),
}


@pytest.mark.parametrize("act", ACTS)
def test_recording_of_other_tenant_is_unknown(jobs: StoreBench, act: str) -> None:
    records, recording_id, _ = opened(jobs, "theirs")
    records.recordings.start_take(recording_id, None, {}, 1000.0, LIMITS)
    before = records.recordings.get(recording_id)
    with pytest.raises(NotFound):
        ACTS[act](jobs.store.tenant("mine").recordings, recording_id)
    assert records.recordings.get(recording_id) == before


def test_recordings_every_method_is_tried() -> None:
    public = {name for name in vars(Recordings) if not name.startswith("_")}
    # The first two are of a tenant; rooms, which a caller has entered, and the reaper ask for those of all.
    assert public - set(ACTS) == {"add", "page", "revisions", "expire", "phone_number"}
