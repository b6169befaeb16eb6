"""Zip archives of keypoints from untrusted sources."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from pipeline.capture import keypoints_zip
from pipeline.capture.keypoints_zip import unpack_keypoints
from pipeline.core.errors import InputError
from pipeline.core.runtime import zips

FRAME = "frame_000000000000_keypoints.json"


def archive(path: Path, files: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as entries:
        for name, content in files.items():
            entries.writestr(name, content)
    return path


def unpacked(tmp_path: Path, *archives: Path) -> dict[str, bytes]:
    folder = tmp_path / "unpacked"
    folder.mkdir()
    unpack_keypoints(archives, folder)
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(tmp_path: Path, *archives: Path) -> dict[str, str]:
    with pytest.raises(InputError) as raised:
        unpacked(tmp_path, *archives)
    # Nothing leaves the folder.
    assert {path.name for path in tmp_path.iterdir()} == {"unpacked", *(path.name for path in archives)}
    return {str(problem.file): problem.message for problem in raised.value.problems}


def test_files_at_top_or_in_folder_and_nothing_else(tmp_path: Path) -> None:
    first = archive(tmp_path / "cam_0.zip", {FRAME: b"{}", "notes.txt": b"no"})
    second = archive(tmp_path / "cam_1.ZIP", {"take/": b"", f"take/{FRAME}": b"[]", "picture.png": b"no"})
    assert unpacked(tmp_path, first, second) == {f"cam_0/{FRAME}": b"{}", f"cam_1/{FRAME}": b"[]"}


@pytest.mark.parametrize("name", [f"../{FRAME}", f"/etc/{FRAME}", f"..\\..\\{FRAME}", f"a/../../{FRAME}"])
def test_paths_lead_nowhere(tmp_path: Path, name: str) -> None:
    assert unpacked(tmp_path, archive(tmp_path / "cam_0.zip", {name: b"{}"})) == {f"cam_0/{FRAME}": b"{}"}
    assert {path.name for path in tmp_path.iterdir()} == {"cam_0.zip", "unpacked"}


def test_all_that_is_wrong_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zips, "MAX_ENTRIES", 3)
    text = tmp_path / "text.zip"
    text.write_bytes(b"no archive")
    cut = archive(tmp_path / "cut.zip", {FRAME: b"{}" * 1000})
    cut.write_bytes(cut.read_bytes()[:60])
    bomb = archive(tmp_path / "bomb.zip", {FRAME: b"\0" * (64 * 2**20 + 1)})
    many = archive(tmp_path / "many.zip", {f"frame_{k}_keypoints.json": b"{}" for k in range(4)})
    folders = archive(tmp_path / "folders.zip", {f"a/{FRAME}": b"{}", f"b/{FRAME}": b"{}"})
    link = tmp_path / "link.zip"
    with zipfile.ZipFile(link, "w") as entries:
        entry = zipfile.ZipInfo(FRAME)
        entry.external_attr = 0o120777 << 16
        entries.writestr(entry, "/etc/passwd")
    other = archive(tmp_path / "other.tar", {FRAME: b"{}"})
    found = refused(tmp_path, text, cut, bomb, many, folders, link, other)
    words = {
        "text.zip": "not a zip archive",
        "cut.zip": "not a zip archive",
        "bomb.zip": "too large",
        "many.zip": "at most 3",
        "folders.zip": "several folders",
        "link.zip": "is a link",
        "other.tar": "must have the name of its camera",
    }
    assert found.keys() == words.keys()
    assert all(words[name] in message for name, message in found.items())


def test_archives_that_are_too_large_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keypoints_zip, "_MAX_TOTAL_BYTES", 100)
    archives = [archive(tmp_path / f"cam_{k}.zip", {FRAME: b"x" * 60}) for k in range(2)]
    assert list(refused(tmp_path, *archives)) == ["cam_1.zip"]


def test_encrypted_archive(tmp_path: Path) -> None:
    path = archive(tmp_path / "cam_0.zip", {FRAME: b"{}"})
    content = bytearray(path.read_bytes())
    # The bit that says so, in the entry's header and in the directory.
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(content)
    assert "encrypted" in refused(tmp_path, path)["cam_0.zip"]


def test_nothing_is_unpacked_where_directory_is_wrong(tmp_path: Path) -> None:
    good = archive(tmp_path / "cam_0.zip", {FRAME: b"{}"})
    wrong = archive(tmp_path / "cam_1.zip", {f"a/{FRAME}": b"{}", f"b/{FRAME}": b"{}"})
    assert refused(tmp_path, good, wrong).keys() == {"cam_1.zip"}
    assert not [path for path in (tmp_path / "unpacked").rglob("*") if path.is_file()]


def test_directory_of_any_size_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zips, "MAX_DIRECTORY_BYTES", 2**20)
    files = {f"frame_{k:0200d}_keypoints.json": b"" for k in range(4500)}
    assert "directory" in refused(tmp_path, archive(tmp_path / "cam_0.zip", files))["cam_0.zip"]
