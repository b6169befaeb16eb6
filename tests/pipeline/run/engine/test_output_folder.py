"""The cache of outputs: whole outputs only, bounded, shared."""

import errno
import os
import stat
from pathlib import Path

import pytest

from pipeline.core.errors import PipelineError
from pipeline.run.engine.output_folder import OutputFolder, default_cache, is_usable, output_folder

KEY, OTHER = "a" * 64, "b" * 64


def age(path: Path, seconds: float) -> None:
    used_s = path.stat().st_mtime - seconds
    os.utime(path, (used_s, used_s))


def test_output_is_there_for_next_run(tmp_path: Path) -> None:
    with output_folder(tmp_path / "cache") as first:
        assert first.read(KEY) is None
        first.write(KEY, b"tracks")
    with output_folder(tmp_path / "cache") as second:
        assert second.read(KEY) == b"tracks"
    assert stat.S_IMODE((tmp_path / "cache").stat().st_mode) == 0o700


def test_without_cache_nothing_is_left() -> None:
    with output_folder(None) as outputs:
        outputs.write(KEY, b"tracks")
        folder = outputs.path
    assert not folder.exists()


@pytest.mark.parametrize("position", [0, 31, 32, 37])
def test_flipped_byte_is_noticed(tmp_path: Path, position: int) -> None:
    outputs = OutputFolder(tmp_path)
    outputs.write(KEY, b"tracks")
    content = bytearray((tmp_path / KEY).read_bytes())
    content[position] ^= 1
    (tmp_path / KEY).write_bytes(content)
    assert outputs.read(KEY) is None
    assert not outputs.copy(KEY, tmp_path / "copied")
    outputs.write(KEY, b"tracks")
    assert outputs.read(KEY) == b"tracks"


def test_file_is_stored_and_copied_like_bytes(tmp_path: Path) -> None:
    outputs = OutputFolder(tmp_path)
    (tmp_path / "tracks").write_bytes(b"tracks")
    outputs.write(KEY, tmp_path / "tracks")
    assert outputs.read(KEY) == b"tracks"
    assert outputs.copy(KEY, tmp_path / "copied")
    assert (tmp_path / "copied").read_bytes() == b"tracks"
    assert not outputs.copy(OTHER, tmp_path / "copied")


def test_cut_file_is_noticed(tmp_path: Path) -> None:
    outputs = OutputFolder(tmp_path)
    outputs.write(KEY, b"tracks")
    os.truncate(tmp_path / KEY, 35)
    assert outputs.read(KEY) is None


def test_outputs_that_were_not_used_for_longest_go_first(tmp_path: Path) -> None:
    with output_folder(tmp_path) as outputs:
        for number in range(4):
            outputs.write(f"{number}", bytes(1000))
            age(tmp_path / f"{number}", seconds=100 - number)
        assert outputs.read("0") is not None  # used now
    with output_folder(tmp_path, max_bytes=2500):
        pass
    assert {path.name for path in tmp_path.iterdir()} == {"0", "3", "lock"}


def test_file_that_killed_run_left_is_removed(tmp_path: Path) -> None:
    (tmp_path / "new-half").write_bytes(b"half")
    with output_folder(tmp_path):
        pass
    assert not (tmp_path / "new-half").exists()


def test_nothing_is_removed_while_another_run_uses_cache(tmp_path: Path) -> None:
    with output_folder(tmp_path) as outputs:
        outputs.write(KEY, bytes(1000))
        with output_folder(tmp_path, max_bytes=0):
            pass
        assert outputs.read(KEY) is not None
    with output_folder(tmp_path, max_bytes=0):
        pass
    assert not (tmp_path / KEY).exists()


def test_full_disk_leaves_no_half_output_and_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    outputs = OutputFolder(tmp_path)
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(PipelineError, match=r"the disk is full.*--cache"):
        outputs.write(KEY, b"tracks")
    assert not list(tmp_path.iterdir())


def test_cache_that_is_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cache").touch()
    with pytest.raises(PipelineError, match="file exists"), output_folder(tmp_path / "cache"):
        pass


def test_folder_can_be_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_CACHE_HOME", str(tmp_path))
    assert default_cache() == tmp_path
    monkeypatch.delenv("MULTICAP_CACHE_HOME")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache() == tmp_path / "multicap"


def test_folder_that_can_not_be_made_is_not_usable(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert not is_usable(tmp_path / "file" / "cache")
    assert is_usable(tmp_path / "new" / "cache")
    assert stat.S_IMODE((tmp_path / "new" / "cache").stat().st_mode) == 0o700
