import errno
import os
from pathlib import Path

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, home, write_file


def test_home_is_where_environment_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "mine"))
    assert home() == tmp_path / "mine"
    monkeypatch.setenv("MULTICAP_HOME", "")
    assert home().name == "multicap"


def test_sha256(tmp_path: Path) -> None:
    file = tmp_path / "abc"
    file.write_bytes(b"abc")
    assert file_sha256(file) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_full_disk_is_said_and_leaves_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    target = tmp_path / "file"
    write_file(target, b"old")
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(ModelError, match="disk is full"):
        write_file(target, b"new")
    assert target.read_bytes() == b"old"


def test_folder_that_can_not_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(ModelError, match="MULTICAP_HOME") as caught, exclusive(tmp_path / "file" / "models" / "net"):
        pass
    assert str(tmp_path) not in str(caught.value)


def test_long_wait_for_process_is_reported(tmp_path: Path) -> None:
    target = tmp_path / "net.onnx"
    with (
        exclusive(target),
        pytest.raises(ModelError, match=r"Another process .* net\.onnx"),
        exclusive(target, timeout_s=0.05),
    ):
        pass
