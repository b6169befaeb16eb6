"""Stored files are compared with their digests, on every artifact store, whatever happens to them on the way."""

import hashlib
import mmap
import os
import sys
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest

from tests.cases import slow_but
from tests.s3 import S3
from worker.store.errors import DamagedArtifact, NotFound
from worker.store.files.artifacts import ArtifactStore, LocalArtifacts, open_artifacts, read_artifact
from worker.store.files.checksums import Verified, file_version, read_sha256, require_file
from worker.store.files.s3 import S3Artifacts

KEY = "jobs/1/results/person-1.bvh"
# More than a block. The tests' S3 server takes seconds for files of several.
CONTENT = os.urandom(5 * 2**18)
SHA256 = hashlib.sha256(CONTENT).hexdigest()


def flipped(content: bytes) -> bytes:
    """Forty bytes in the middle are others."""
    middle = len(content) // 2
    return content[:middle] + bytes(byte ^ 255 for byte in content[middle : middle + 40]) + content[middle + 40 :]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "flipped": flipped,
    "truncated": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "longer": lambda content: content + b"\0",
    "zeros": lambda content: bytes(len(content)),
}


@pytest.fixture
def distant(s3: S3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> S3Artifacts:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    store = open_artifacts(s3.new_url(), tmp_path)
    assert isinstance(store, S3Artifacts)
    return store


@pytest.fixture(params=["folder", "s3"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> ArtifactStore:
    return LocalArtifacts(tmp_path) if request.param == "folder" else request.getfixturevalue("distant")


@pytest.fixture
def folder(tmp_path: Path) -> LocalArtifacts:
    """A folder with a file that has not changed for an hour."""
    artifacts = LocalArtifacts(tmp_path)
    artifacts.put_bytes(KEY, CONTENT)
    return artifacts


def settle() -> None:
    """Wait until the next change of a file has other times than the last one."""
    time.sleep(0.15)


def overwrite(path: Path, content: bytes) -> None:
    """Change a file in place, as a disk does."""
    with path.open("r+b") as file:
        file.truncate(len(content))
        file.write(content)


def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Digests that are computed from now on."""
    computed: list[str] = []

    def counted(*arguments: object) -> str:
        computed.append(read_sha256(*arguments))  # type: ignore[arg-type]
        return computed[-1]

    monkeypatch.setattr("worker.store.files.checksums.read_sha256", counted)
    monkeypatch.setattr("worker.store.files.s3.read_sha256", counted)
    return computed


def test_whole_file_is_read(artifacts: ArtifactStore) -> None:
    artifacts.put_bytes(KEY, CONTENT)
    assert read_artifact(artifacts, KEY, SHA256) == CONTENT
    with artifacts.open(KEY, SHA256) as file:
        assert file.read() == CONTENT
        file.seek(1000)
        assert file.read(5) == CONTENT[1000:1005]
    with artifacts.local_path(KEY, SHA256) as path:
        assert path.read_bytes() == CONTENT


# The tests' S3 server takes seconds for each file.
@pytest.mark.parametrize(
    ("artifacts", "damage"),
    slow_but(list(product(["folder"], DAMAGES)), product(["folder", "s3"], DAMAGES)),
    indirect=["artifacts"],
)
def test_damaged_file_is_never_read(artifacts: ArtifactStore, damage: str) -> None:
    artifacts.put_bytes(KEY, DAMAGES[damage](CONTENT))
    with pytest.raises(DamagedArtifact, match=KEY):
        artifacts.open(KEY, SHA256)
    with pytest.raises(DamagedArtifact), artifacts.local_path(KEY, SHA256):
        pytest.fail("the block must not run")
    with pytest.raises(DamagedArtifact):
        read_artifact(artifacts, KEY, SHA256)


def test_missing_file_is_not_found(artifacts: ArtifactStore) -> None:
    with pytest.raises(NotFound):
        artifacts.open(KEY, SHA256)
    with pytest.raises(NotFound):
        read_artifact(artifacts, KEY, SHA256)
    with pytest.raises(NotFound):
        require_file(Path("/no/such/file"), KEY, SHA256)


def test_replaced_file_is_compared_again(artifacts: ArtifactStore) -> None:
    artifacts.put_bytes(KEY, CONTENT)
    settle()
    artifacts.open(KEY, SHA256).close()
    artifacts.put_bytes(KEY, flipped(CONTENT))
    with pytest.raises(DamagedArtifact):
        artifacts.open(KEY, SHA256)
    artifacts.put_bytes(KEY, CONTENT)
    artifacts.open(KEY, SHA256).close()


def test_file_is_compared_once_while_it_does_not_change(
    artifacts: ArtifactStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    artifacts.put_bytes(KEY, CONTENT)
    settle()
    computed = count_reads(monkeypatch)
    for _ in range(3):
        artifacts.open(KEY, SHA256).close()
    assert computed == [SHA256]
    with artifacts.local_path(KEY, SHA256):
        pass
    again = len(computed)
    settle()
    for _ in range(3):
        with artifacts.local_path(KEY, SHA256):
            pass
    assert len(computed) <= again + 1  # a copy of a distant file may have been too new to be remembered


def test_changed_file_of_same_size_and_time_is_compared_again(folder: LocalArtifacts, tmp_path: Path) -> None:
    settle()
    folder.open(KEY, SHA256).close()
    before = (tmp_path / KEY).stat()
    overwrite(tmp_path / KEY, flipped(CONTENT))
    os.utime(tmp_path / KEY, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(DamagedArtifact):
        folder.open(KEY, SHA256)


def test_file_that_has_just_changed_is_not_remembered(
    folder: LocalArtifacts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = count_reads(monkeypatch)
    os.utime(tmp_path / KEY)
    folder.open(KEY, SHA256).close()
    folder.open(KEY, SHA256).close()
    assert computed == [SHA256, SHA256]


def test_no_block_is_read_of_file_that_is_damaged_meanwhile(folder: LocalArtifacts, tmp_path: Path) -> None:
    with folder.open(KEY, SHA256) as file:
        assert file.read(2**20) == CONTENT[: 2**20]
        overwrite(tmp_path / KEY, flipped(CONTENT))
        with pytest.raises(DamagedArtifact):
            file.read(2**20)


def test_bytes_stored_after_time_of_their_write_are_seen(folder: LocalArtifacts, tmp_path: Path) -> None:
    path = tmp_path / KEY
    with path.open("r+b") as writer, mmap.mmap(writer.fileno(), 0) as memory:
        memory[-1] = memory[-1]  # the page may be written now: further bytes leave its times
        settle()
        with folder.open(KEY, SHA256) as file:
            os.utime(path)
            assert file.read(2**20) == CONTENT[: 2**20]
            before = file_version(file.fileno())
            memory[-1] ^= 255
            assert file_version(file.fileno()) == before
            with pytest.raises(DamagedArtifact):
                file.read(2**20)


def test_hard_link_is_no_damage(folder: LocalArtifacts, tmp_path: Path) -> None:
    settle()
    with folder.open(KEY, SHA256) as file:
        start = file.read(2**20)
        os.link(tmp_path / KEY, tmp_path / "held")  # as backups hold files
        assert start + file.read() == CONTENT


@pytest.mark.skipif(sys.platform != "linux", reason="needs a file of the system that can't be read")
def test_disk_that_can_not_read_file_has_damaged_it(folder: LocalArtifacts, tmp_path: Path) -> None:
    (tmp_path / KEY).unlink()
    (tmp_path / KEY).symlink_to("/proc/self/mem")  # whose first byte nobody can read: EIO
    with pytest.raises(DamagedArtifact):
        folder.open(KEY, SHA256)


def test_digest_can_be_interrupted(folder: LocalArtifacts) -> None:
    class Stopped(Exception):  # noqa: N818 - the test's own
        pass

    def stop() -> None:
        raise Stopped

    settle()
    with pytest.raises(Stopped), folder.local_path(KEY, SHA256, stop):
        pass


def test_other_handles_keep_their_position(folder: LocalArtifacts, tmp_path: Path) -> None:
    with (tmp_path / KEY).open("rb", buffering=0) as file:
        file.seek(7)
        assert read_sha256(file) == hashlib.sha256(CONTENT[7:]).hexdigest()
        assert file_version(file.fileno()).num_bytes == len(CONTENT)


def test_memory_is_bounded() -> None:
    verified = Verified(max_remembered=2)
    for version in "abc":
        verified.add(version, SHA256)
    assert [verified.holds(version, SHA256) for version in "abc"] == [False, True, True]
    assert not verified.holds("c", "0" * 64)


class TestCopies:
    """Copies of distant files on this machine."""

    def copy_of(self, distant: S3Artifacts) -> Path:
        with distant.local_path(KEY, SHA256) as path:
            return path

    @pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
    def test_damaged_copy_is_fetched_again(self, distant: S3Artifacts, damage: Callable[[bytes], bytes]) -> None:
        distant.put_bytes(KEY, CONTENT)
        copy = self.copy_of(distant)
        settle()
        self.copy_of(distant)
        overwrite(copy, damage(CONTENT))
        with distant.local_path(KEY, SHA256) as path:
            assert path.read_bytes() == CONTENT

    def test_copy_that_is_in_use_is_fetched_again_too(self, distant: S3Artifacts) -> None:
        distant.put_bytes(KEY, CONTENT)
        with distant.local_path(KEY, SHA256) as used:
            overwrite(used, flipped(CONTENT))
            with distant.local_path(KEY, SHA256) as path:
                assert path.read_bytes() == CONTENT
        assert self.copy_of(distant).read_bytes() == CONTENT

    def test_copy_is_not_kept_of_file_that_is_damaged_itself(self, distant: S3Artifacts) -> None:
        distant.put_bytes(KEY, flipped(CONTENT))
        for _ in range(2):
            with pytest.raises(DamagedArtifact), distant.local_path(KEY, SHA256):
                pass
        distant.put_bytes(KEY, CONTENT)
        assert self.copy_of(distant).read_bytes() == CONTENT

    def test_copy_is_compared_once_while_it_does_not_change(
        self, distant: S3Artifacts, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        distant.put_bytes(KEY, CONTENT)
        self.copy_of(distant)
        settle()
        self.copy_of(distant)
        computed = count_reads(monkeypatch)
        for _ in range(3):
            self.copy_of(distant)
        assert computed == []
