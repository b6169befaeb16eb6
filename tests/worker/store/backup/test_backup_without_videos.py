"""Backups before and after the deletion of a session's videos."""

from pathlib import Path

from tests.worker.store.backups import opened_data, restored
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import JobSpec


def videos(folder: Path) -> list[Path]:
    return [path for path in (folder / "artifacts").rglob("*.mp4") if path.is_file()]


def test_backup_after_deletion_lacks_nothing(tmp_path: Path) -> None:
    with opened_data(tmp_path / "data") as data:
        session_id = data.add_session()
        data.add_job(session_id)
        data.run_all()
        assert len(videos(data.folder)) == 2
        data.store.sessions.delete_videos(session_id)
        remove_files(data.store.removals, data.artifacts)
        assert data.back_up(tmp_path / "backup.tar").problems == ()
    assert restored(tmp_path / "backup.tar", tmp_path / "again").problems == ()
    with opened_data(tmp_path / "again") as again:
        session = again.store.sessions.get(session_id)
        assert (session.videos_deleted_at is None, videos(again.folder)) == (False, [])
        (job,) = again.store.jobs.page()
        with again.artifacts.open(again.store.results.get(job.id, "person-1.bvh").key) as file:
            assert file.read() == b"HIERARCHY"
        again.store.sessions.delete_videos(session_id)


def test_backup_before_deletion_has_videos(
    tmp_path: Path,
) -> None:
    with opened_data(tmp_path / "data") as data:
        kept, other = data.add_session(), data.add_session()
        for session_id, spec in ((kept, JobSpec()), (other, JobSpec(keep_videos=False))):
            data.add_job(session_id, spec)
            data.run_all()
        assert data.back_up(tmp_path / "backup.tar").problems == ()
        for session_id in (kept, other):
            data.store.sessions.delete_videos(session_id)
    restored(tmp_path / "backup.tar", tmp_path / "again")
    with opened_data(tmp_path / "again") as again:
        assert len(videos(again.folder)) == 4
        assert again.store.sessions.with_superfluous_videos() == [other]
