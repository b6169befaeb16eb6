import hashlib
import zipfile
from pathlib import Path

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.index import fetch_package
from pipeline.motion.body import installed
from pipeline.motion.body.makehuman import members


@pytest.fixture
def package() -> Path:
    installed.install()
    return fetch_package(installed.PACKAGE)


@pytest.fixture
def made(package: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """The body's file, given in place of making it anew for ten seconds; ``install`` compares its digest as ever."""
    content = installed.path().read_bytes()
    monkeypatch.setattr(installed, "_made_from", lambda _: content)
    return content


@pytest.fixture
def fresh_home(package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Storage folder with the downloaded package of the body, and nothing else."""
    (tmp_path / "downloads").mkdir()
    (tmp_path / "downloads" / package.name).symlink_to(package)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_body_is_made_of_package_with_same_bytes(fresh_home: Path) -> None:
    assert not installed.is_installed()
    path = installed.install()
    assert path.is_relative_to(fresh_home)
    assert installed.is_installed()
    assert hashlib.sha256(path.read_bytes()).hexdigest() in installed._SHA256
    assert path.stat().st_size < 600_000


def test_data_are_free(package: Path) -> None:
    with zipfile.ZipFile(package) as wheel:
        assert b"Creative Commons CC0 1.0 Universal" in wheel.read(f"{installed._FOLDER}/LICENSE.md")
        assert {f"{installed._FOLDER}/{name}" for name in members()} <= set(wheel.namelist())


def test_body_that_is_not_there_says_how_it_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    with pytest.raises(ModelError, match=r"The human body is not installed\. Run: multicap bodies install"):
        installed.load()


@pytest.mark.slow
def test_damaged_file_is_refused_and_installed_again(made: bytes, fresh_home: Path) -> None:
    path = installed.install()
    whole = path.read_bytes()
    assert whole == made
    for damaged in (whole[:1000], whole[:-1] + b"x", b""):
        path.write_bytes(damaged)
        with pytest.raises(ModelError, match=r"The file of the human body was changed\. Run: multicap bodies install"):
            installed.load()
        assert installed.find() is None
    installed.install()
    assert path.read_bytes() == whole
    assert len(installed.load().triangles) > 20_000


@pytest.mark.slow
def test_package_with_other_data_is_refused(made: bytes, fresh_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installed, "_made_from", lambda _: made[:-1] + b"x")
    with pytest.raises(ModelError, match="not what it must be"):
        installed.install()
    assert not installed.is_installed()
