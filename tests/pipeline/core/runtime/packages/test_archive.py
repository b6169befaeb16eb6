import io
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.archive import read_member

Make = Callable[[Path, dict[str, bytes]], Path]


def _zip(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def _tar(path: Path, members: dict[str, bytes]) -> Path:
    with tarfile.open(path, "w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return path


@pytest.mark.parametrize("make", [_zip, _tar])
def test_one_member_is_read(make: Make, tmp_path: Path) -> None:
    archive = make(tmp_path / "package", {"a/setup.py": b"raise SystemExit", "a/weights": b"\x01\x02"})
    assert read_member(archive, "a/weights", max_bytes=2) == b"\x01\x02"
    assert [path.name for path in tmp_path.iterdir()] == ["package"]


def test_archive_in_memory_is_read(tmp_path: Path) -> None:
    inner = _zip(tmp_path / "inner", {"weights": b"abc"}).read_bytes()
    outer = _zip(tmp_path / "outer", {"inner.bin": inner})
    assert read_member(io.BytesIO(read_member(outer, "inner.bin", 1000)), "weights", 3) == b"abc"


@pytest.mark.parametrize("make", [_zip, _tar])
def test_missing_member_is_said(make: Make, tmp_path: Path) -> None:
    archive = make(tmp_path / "package", {"a/other": b""})
    with pytest.raises(ModelError, match="holds no a/weights"):
        read_member(archive, "a/weights", max_bytes=10)


@pytest.mark.parametrize("make", [_zip, _tar])
def test_bomb_is_refused_before_it_is_unpacked(make: Make, tmp_path: Path) -> None:
    archive = make(tmp_path / "package", {"weights": bytes(5_000_000)})
    assert archive.stat().st_size < 10_000
    with pytest.raises(ModelError, match=r"larger \(5000000 bytes\) than it may be \(1000\)"):
        read_member(archive, "weights", max_bytes=1000)


def test_member_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    archive = _zip(tmp_path / "package", {"weights": bytes(5000)})
    directory = bytearray(archive.read_bytes())
    entry = directory.rindex(b"PK\x01\x02")
    directory[entry + 24 : entry + 28] = (100).to_bytes(4, "little")
    archive.write_bytes(directory)
    with pytest.raises(ModelError, match="damaged"):
        read_member(archive, "weights", max_bytes=1000)


def test_tar_that_never_ends_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.core.runtime.packages.archive._MAX_TAR_BYTES", 1_000_000)
    archive = _tar(tmp_path / "package", {"filler": bytes(2_000_000), "weights": b"abc"})
    with pytest.raises(ModelError, match="what lies before it"):
        read_member(archive, "weights", max_bytes=10)


@pytest.mark.parametrize("make", [_zip, _tar])
def test_truncated_archive_is_said(make: Make, tmp_path: Path) -> None:
    archive = make(tmp_path / "package", {"weights": bytes(range(256)) * 50})
    archive.write_bytes(archive.read_bytes()[:100])
    with pytest.raises(ModelError, match="damaged"):
        read_member(archive, "weights", max_bytes=100_000)


def test_no_archive_is_reported(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("<html>log in first</html>")
    with pytest.raises(ModelError, match="damaged"):
        read_member(tmp_path / "page.html", "weights", max_bytes=10)
