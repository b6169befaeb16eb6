"""Promises of every artifact store; another one joins by a line in ``artifacts``."""

import errno
import hashlib
import os
import stat
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.s3 import S3, running_s3
from worker.store.errors import ArtifactsUnavailable, NotFound
from worker.store.files.artifacts import ArtifactStore, LocalArtifacts, open_artifacts
from worker.store.files.file_keys import input_key, result_key, stage_key
from worker.store.files.s3 import S3Artifacts

KEY = "sessions/0190/stages/detect-0.npz"


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def set_used_s(copy: Path, time_s: float) -> None:
    """Have a copy's last use be at another time."""
    for path in (copy, copy.with_suffix(".used")):
        os.utime(path, (time_s, time_s))


def read(artifacts: ArtifactStore, key: str) -> bytes:
    with artifacts.open(key) as file:
        return file.read()


def test_bytes_come_back(artifacts: ArtifactStore) -> None:
    artifacts.put_bytes(KEY, b"\x00pose\xff")
    assert read(artifacts, KEY) == b"\x00pose\xff"
    assert artifacts.exists(KEY)
    assert artifacts.size(KEY) == 6


def test_empty_file_is_file(artifacts: ArtifactStore) -> None:
    artifacts.put_bytes(KEY, b"")
    assert artifacts.exists(KEY)
    assert (artifacts.size(KEY), read(artifacts, KEY)) == (0, b"")


def test_file_is_taken_over(artifacts: ArtifactStore, tmp_path: Path) -> None:
    path = tmp_path / "upload"
    path.write_bytes(b"video" * 100_000)
    artifacts.put_file(KEY, path)
    assert not path.exists()
    assert artifacts.size(KEY) == 500_000
    assert read(artifacts, KEY) == b"video" * 100_000


def test_missing_upload_leaves_nothing(artifacts: ArtifactStore, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        artifacts.put_file(KEY, tmp_path / "missing")
    assert not artifacts.exists(KEY)


def test_last_put_counts(artifacts: ArtifactStore, tmp_path: Path) -> None:
    artifacts.put_bytes(KEY, b"first and long")
    artifacts.put_bytes(KEY, b"second")
    assert read(artifacts, KEY) == b"second"
    path = tmp_path / "upload"
    path.write_bytes(b"third")
    artifacts.put_file(KEY, path)
    assert read(artifacts, KEY) == b"third"


def test_open_files_can_be_sought(artifacts: ArtifactStore) -> None:
    artifacts.put_bytes(KEY, b"0123456789")
    with artifacts.open(KEY) as file:
        file.seek(4)
        assert file.read(3) == b"456"


def test_local_path_holds_file(artifacts: ArtifactStore) -> None:
    artifacts.put_bytes(KEY, b"pose")
    with artifacts.local_path(KEY, sha256(b"pose")) as path:
        assert path.read_bytes() == b"pose"


@pytest.mark.parametrize("key", [KEY, "sessions/0190", "sessions/0190/stages/there/below"])
def test_missing_artifact_is_not_found(artifacts: ArtifactStore, key: str) -> None:
    artifacts.put_bytes("sessions/0190/stages/there", b"")
    for ask in (artifacts.open, artifacts.size):
        with pytest.raises(NotFound):
            ask(key)
    with pytest.raises(NotFound), artifacts.local_path(key, sha256(b"")):
        pass
    assert not artifacts.exists(key)


def test_delete_takes_one_file_and_its_copies(artifacts: ArtifactStore) -> None:
    beside = ["sessions/1/inputs/0-a.mp4.toml", "sessions/1/inputs/1-a.mp4"]
    for key in ("sessions/1/inputs/0-a.mp4", *beside):
        artifacts.put_bytes(key, b"pose")
    with artifacts.local_path("sessions/1/inputs/0-a.mp4", sha256(b"pose")) as path:
        copy = path
    for _ in range(2):
        artifacts.delete("sessions/1/inputs/0-a.mp4")
    assert not artifacts.exists("sessions/1/inputs/0-a.mp4")
    assert not copy.exists()
    assert all(artifacts.exists(key) for key in beside)


def test_delete_prefix_takes_all_below_and_nothing_beside(artifacts: ArtifactStore) -> None:
    below = ["sessions/1/inputs/0-a.mp4", "sessions/1/stages/k"]
    beside = ["sessions/10/inputs/0-a.mp4", "sessions/2/stages/k", "jobs/1/results/a.bvh"]
    for key in below + beside:
        artifacts.put_bytes(key, b"pose")
    artifacts.delete_prefix("sessions/1/")
    assert [artifacts.exists(key) for key in below] == [False, False]
    assert all(artifacts.exists(key) for key in beside)
    artifacts.delete_prefix("sessions/1/")
    artifacts.delete_prefix("sessions/never/")
    with pytest.raises(ValueError, match="slash"):
        artifacts.delete_prefix("sessions/2")


@pytest.mark.parametrize(
    "key",
    [
        "",
        "/",
        "/etc/passwd",
        "..",
        "a/../b",
        "a/..",
        ".hidden",
        "a/.b",
        "a//b",
        "a/",
        "a b",
        "a\\b",
        "a\n",
        "a\x00",
        "ä",
    ],
)
def test_other_keys_are_refused(artifacts: ArtifactStore, key: str, tmp_path: Path) -> None:
    path = tmp_path / "upload"
    path.write_bytes(b"")
    acts: list[Callable[[], object]] = [
        lambda: artifacts.put_bytes(key, b""),
        lambda: artifacts.put_file(key, path),
        lambda: artifacts.open(key),
        lambda: artifacts.size(key),
        lambda: artifacts.exists(key),
        lambda: artifacts.delete(key),
        lambda: artifacts.delete_prefix(f"{key}/"),
    ]
    for act in acts:
        with pytest.raises(ValueError, match="no key"):
            act()
    assert path.exists()


def test_many_writers_of_one_key_leave_one_whole_file(artifacts: ArtifactStore) -> None:
    contents = [bytes([k]) * 200_000 for k in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda content: artifacts.put_bytes(KEY, content), contents))
    assert read(artifacts, KEY) in contents


def test_ping_tells_whether_store_answers(artifacts: ArtifactStore) -> None:
    assert artifacts.ping()


@pytest.mark.slow
def test_large_file_is_whole(artifacts: ArtifactStore, tmp_path: Path) -> None:
    content = os.urandom(2**20) * 21
    path = tmp_path / "upload"
    path.write_bytes(content)
    artifacts.put_file(KEY, path)
    with artifacts.open(KEY) as file:
        file.seek(-5 * 2**20, os.SEEK_END)
        assert file.read() == content[-5 * 2**20 :]
        file.seek(3)
        assert file.read(9 * 2**20) == content[3 : 3 + 9 * 2**20]
    with artifacts.local_path(KEY, sha256(content)) as there:
        assert there.read_bytes() == content


def test_other_urls_are_refused(tmp_path: Path) -> None:
    for url in ("gs://bucket", "/var/artifacts", "s3:/bucket", "http://s3.example/bucket"):
        with pytest.raises(ValueError, match="s3://"):
            open_artifacts(url, tmp_path)


class TestS3:
    @pytest.fixture
    def store(self, on_s3: S3, tmp_path: Path) -> S3Artifacts:
        store = open_artifacts(on_s3.new_url(), tmp_path, cache_bytes=2500, cache_hours=1.0)
        assert isinstance(store, S3Artifacts)
        return store

    def copies(self, folder: Path) -> int:
        return len(list((folder / "cache").glob("*.copy")))

    def test_prefixes_keep_stores_apart(self, on_s3: S3, tmp_path: Path) -> None:
        first, second = (open_artifacts(on_s3.new_url(), tmp_path) for _ in range(2))
        first.put_bytes(KEY, b"pose")
        assert not second.exists(KEY)
        second.delete_prefix("sessions/0190/")
        assert first.exists(KEY)

    def test_file_that_is_replaced_while_it_is_read_is_never_mixture(self, store: S3Artifacts) -> None:
        store.put_bytes(KEY, b"a" * 3 * 2**20)
        with store.open(KEY) as file:
            assert file.read(10) == b"a" * 10
            store.put_bytes(KEY, b"b" * 3 * 2**20)
            file.seek(2 * 2**20)
            with pytest.raises(ArtifactsUnavailable):
                file.read(10)

    def test_hundreds_go_at_once(self, store: S3Artifacts) -> None:
        for number in range(30):
            store.put_bytes(f"sessions/1/stages/{number}", b"")
        store.delete_prefix("sessions/1/")
        assert not any(store.exists(f"sessions/1/stages/{number}") for number in range(30))

    def test_signed_addresses_need_no_key(self, store: S3Artifacts) -> None:
        store.put_bytes("jobs/1/results/person-1.bvh", b"HIERARCHY")
        address = store.signed_url("jobs/1/results/person-1.bvh", 60.0)
        assert address is not None
        assert "X-Amz-Expires=60" in address
        answer = httpx2.get(address, trust_env=False)
        assert (answer.status_code, answer.content) == (200, b"HIERARCHY")
        assert answer.headers["content-disposition"] == 'attachment; filename="person-1.bvh"'

    def test_server_that_is_away_is_error_of_its_own(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        with running_s3() as server:
            for name, value in server.environment.items():
                monkeypatch.setenv(name, value)
            store = open_artifacts(server.new_url(), tmp_path)
            store.put_bytes(KEY, b"pose")
            path = tmp_path / "upload"
            path.write_bytes(b"video")
        assert not store.ping()
        for act in (
            lambda: store.open(KEY),
            lambda: store.put_file(KEY, path),
            lambda: store.delete_prefix("sessions/0190/"),
        ):
            with pytest.raises(ArtifactsUnavailable):
                act()
        assert path.read_bytes() == b"video"

    def test_copies_are_made_once(self, store: S3Artifacts, tmp_path: Path) -> None:
        store.put_bytes(KEY, b"pose")
        with store.local_path(KEY, sha256(b"pose")) as first, store.local_path(KEY, sha256(b"pose")) as second:
            assert first == second
        with store.local_path(KEY, sha256(b"pose")) as third:
            assert (third, third.read_bytes()) == (first, b"pose")
        assert self.copies(tmp_path) == 1

    def test_unused_copies_are_removed_when_room_is_needed(self, store: S3Artifacts, tmp_path: Path) -> None:
        for name in "abcd":
            store.put_bytes(name, name.encode() * 1000)
        with store.local_path("a", sha256(b"a" * 1000)) as used:
            for age, name in ((300, "b"), (200, "c")):
                with store.local_path(name, sha256(name.encode() * 1000)) as path:
                    pass
                set_used_s(path, time.time() - age)
            assert self.copies(tmp_path) == 2  # there is room for two and a half
            with store.local_path("d", sha256(b"d" * 1000)) as path:
                assert path.read_bytes() == b"d" * 1000
                assert used.read_bytes() == b"a" * 1000
                with store.local_path(
                    "b", sha256(b"b" * 1000)
                ) as more:  # more than there is room for, but all are in use
                    assert more.read_bytes() == b"b" * 1000
                assert self.copies(tmp_path) == 3

    def test_copies_unused_for_long_are_removed(self, store: S3Artifacts, tmp_path: Path) -> None:
        for name in "abc":
            store.put_bytes(name, b"x")
        paths = []
        for name in "abc":
            with store.local_path(name, sha256(b"x")) as path:
                paths.append(path)
        old, used, _ = paths
        (tmp_path / "cache" / "0190.part").write_bytes(b"of a killed process")
        for path in (old, used):
            set_used_s(path, 0.0)
        os.utime(tmp_path / "cache" / "0190.part", (0, 0))
        with store.local_path("b", sha256(b"x")):
            store.sweep()
        assert self.copies(tmp_path) == 2
        assert not old.exists()
        assert not (tmp_path / "cache" / "0190.part").exists()

    def test_copy_that_can_not_be_made_leaves_nothing(
        self, store: S3Artifacts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        store.put_bytes(KEY, b"pose")

        def break_off(self: S3Artifacts, key: str, path: Path) -> None:
            path.write_bytes(b"po")
            raise ArtifactsUnavailable

        with monkeypatch.context() as broken:
            broken.setattr(S3Artifacts, "_download", break_off)
            with pytest.raises(ArtifactsUnavailable), store.local_path(KEY, sha256(b"pose")):
                pass
        with store.local_path(KEY, sha256(b"pose")) as path:
            assert path.read_bytes() == b"pose"
        assert not list(tmp_path.rglob("*.part"))


class TestLocal:
    def test_reader_keeps_opened_file(self, tmp_path: Path) -> None:
        artifacts = LocalArtifacts(tmp_path)
        artifacts.put_bytes(KEY, b"first")
        with artifacts.open(KEY) as file:
            artifacts.put_bytes(KEY, b"second")
            assert file.read() == b"first"

    def test_there_are_no_addresses(self, tmp_path: Path) -> None:
        assert LocalArtifacts(tmp_path).signed_url(KEY, 60.0) is None

    def test_ping_without_its_folder(self, tmp_path: Path) -> None:
        artifacts = LocalArtifacts(tmp_path / "artifacts")
        (tmp_path / "artifacts").rename(tmp_path / "moved")
        assert not artifacts.ping()

    def test_file_of_another_file_system_is_copied(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        artifacts, path = LocalArtifacts(tmp_path / "artifacts"), tmp_path / "upload"
        path.write_bytes(b"video")
        replace = Path.replace

        def only_inside(source: Path, target: Path) -> Path:
            if source == path:
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
            return replace(source, target)

        monkeypatch.setattr(Path, "replace", only_inside)
        artifacts.put_file(KEY, path)
        assert not path.exists()
        assert read(artifacts, KEY) == b"video"

    def test_full_disk_leaves_previous_file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        artifacts = LocalArtifacts(tmp_path)
        artifacts.put_bytes(KEY, b"first")

        def full(path: Path, data: bytes) -> int:
            with path.open("wb") as file:
                file.write(data[:2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(Path, "write_bytes", full)
        with pytest.raises(OSError, match="No space"):
            artifacts.put_bytes(KEY, b"second")
        monkeypatch.undo()
        assert read(artifacts, KEY) == b"first"
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == [tmp_path / KEY]

    def test_files_of_killed_process_are_removed_in_time(self, tmp_path: Path) -> None:
        LocalArtifacts(tmp_path).put_bytes(KEY, b"pose")
        old, new = tmp_path / ".incoming" / "old", tmp_path / ".incoming" / "new"
        for path in (old, new, tmp_path / KEY):
            path.write_bytes(b"pose")
        for path in (old, tmp_path / KEY):
            os.utime(path, (0, 0))
        assert LocalArtifacts(tmp_path).exists(KEY)
        assert (old.exists(), new.exists()) == (False, True)

    def test_files_are_for_their_owner_alone(self, tmp_path: Path) -> None:
        artifacts, path = LocalArtifacts(tmp_path / "artifacts"), tmp_path / "upload"
        path.write_bytes(b"video")
        artifacts.put_file("a", path)
        artifacts.put_bytes("b", b"pose")
        modes = {stat.S_IMODE((tmp_path / "artifacts" / key).stat().st_mode) for key in "ab"}
        assert modes == {0o600}


@given(name=st.text(max_size=150), number=st.integers(0, 99))
def test_any_name_makes_key(name: str, number: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    key = input_key("0190", number, name)
    assert not LocalArtifacts(tmp_path_factory.getbasetemp()).exists(key)
    assert len(key) < 150


def test_keys_of_each_kind() -> None:
    assert input_key("s", 2, "cam 1 (left).mp4") == "sessions/s/inputs/2-cam_1_left_.mp4"
    assert stage_key("s", "k") == "sessions/s/stages/k"
    assert result_key("j", "person-1.bvh") == "jobs/j/results/person-1.bvh/person-1.bvh"
    assert result_key("j", "person-1.bvh", 3) == "jobs/j/revisions/3/person-1.bvh/person-1.bvh"
