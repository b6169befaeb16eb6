import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.download import OnBytes, download, silent

CONTENT = np.random.default_rng(0).bytes(3_000_000)
SHA256 = hashlib.sha256(CONTENT).hexdigest()


def fetch(url: str, target: Path, max_bytes: int = len(CONTENT), on_bytes: OnBytes = silent) -> Path:
    with httpx2.Client() as client:
        return download(client, url, target, {SHA256}, max_bytes, on_bytes)


def test_file_is_downloaded_once_and_progress_told(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    told: list[tuple[int, int | None]] = []
    target = fetch(f"{file_server.url}/net", tmp_path / "new" / "net", on_bytes=lambda *args: told.append(args))
    assert target.read_bytes() == CONTENT
    assert told[-1] == (len(CONTENT), len(CONTENT))
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    fetch(f"{file_server.url}/net", target)
    assert file_server.ranges == [None]
    assert not (tmp_path / "new" / "net.part").exists()


def test_broken_connection_is_taken_up_where_it_broke(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    file_server.break_after = [1_000_000, 500_000]
    assert fetch(f"{file_server.url}/net", tmp_path / "net").read_bytes() == CONTENT
    first, second, third = file_server.ranges
    assert first is None
    # Bytes that the client had not yet written when the connection broke are asked for again.
    assert 500_000 < int(second.removeprefix("bytes=").removesuffix("-")) <= 1_000_000
    assert int(second[6:-1]) < int(third[6:-1]) <= 1_500_000


def test_interrupted_download_goes_on_in_next_run(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    file_server.break_after = [1_000_000, 0, 0]
    with pytest.raises(ModelError, match=r"net can't be downloaded.*continues from there"):
        fetch(f"{file_server.url}/net", tmp_path / "net")
    kept = (tmp_path / "net.part").stat().st_size
    assert kept > 500_000
    assert fetch(f"{file_server.url}/net", tmp_path / "net").read_bytes() == CONTENT
    assert file_server.ranges[-1] == f"bytes={kept}-"


def test_server_without_ranges_sends_everything(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    file_server.honours_range = False
    (tmp_path / "net.part").write_bytes(CONTENT[:1000])
    assert fetch(f"{file_server.url}/net", tmp_path / "net").read_bytes() == CONTENT
    assert file_server.ranges == ["bytes=1000-"]


@pytest.mark.parametrize("left", [b"the beginning of another file", CONTENT + b"too long"])
def test_remainder_that_does_not_fit_is_started_afresh(file_server: Any, tmp_path: Path, left: bytes) -> None:
    file_server.files["/net"] = CONTENT
    (tmp_path / "net.part").write_bytes(left)
    assert fetch(f"{file_server.url}/net", tmp_path / "net").read_bytes() == CONTENT
    assert file_server.ranges == [f"bytes={len(left)}-", None]


def test_whole_remainder_is_not_downloaded_again(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    (tmp_path / "net.part").write_bytes(CONTENT)
    assert fetch(f"{file_server.url}/net", tmp_path / "net").read_bytes() == CONTENT
    assert file_server.ranges == [f"bytes={len(CONTENT)}-"]


def test_wrong_checksum_is_said_and_file_removed(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = b"something else"
    with pytest.raises(ModelError, match="net has a wrong checksum and was removed"):
        fetch(f"{file_server.url}/net", tmp_path / "net")
    assert [path.name for path in tmp_path.iterdir()] == ["net.lock"]


def test_changed_file_is_downloaded_again(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    (tmp_path / "net").write_bytes(b"changed")
    assert fetch(f"{file_server.url}/net", tmp_path / "net").read_bytes() == CONTENT


def test_oversized_file_is_refused_before_it_is_received(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    told: list[int] = []
    with pytest.raises(ModelError, match=r"larger than it may be \(2000000 bytes\)"):
        fetch(f"{file_server.url}/net", tmp_path / "net", 2_000_000, lambda done, _: told.append(done))
    assert told == []
    assert [path.name for path in tmp_path.iterdir()] == ["net.lock"]


def test_no_network_is_said_without_address(closed_url: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"net can't be downloaded: no connection.*Check the network") as caught:
        fetch(f"{closed_url}/net", tmp_path / "net")
    assert "127.0.0.1" not in str(caught.value)


@pytest.mark.parametrize("url", ["ftp://example/net", "nonsense://", "http://[half/net"])
def test_address_of_no_use_is_said(url: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="net can't be downloaded"):
        fetch(url, tmp_path / "net")


def test_file_that_server_has_not_is_said(file_server: Any, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"refused net \(status 404\)"):
        fetch(f"{file_server.url}/net", tmp_path / "net")


def test_two_processes_download_once(file_server: Any, tmp_path: Path) -> None:
    file_server.files["/net"] = CONTENT
    script = (
        "import sys, httpx2\nfrom pathlib import Path\nfrom pipeline.core.runtime.packages.download import download\n"
        "url, target, sha256 = sys.argv[1:]\n"
        "with httpx2.Client() as client:\n    download(client, url, Path(target), {sha256}, 10**7)\n"
    )
    command = [sys.executable, "-c", script, f"{file_server.url}/net", str(tmp_path / "net"), SHA256]
    processes = [subprocess.Popen(command) for _ in range(2)]
    assert [process.wait(timeout=180) for process in processes] == [0, 0]
    assert (tmp_path / "net").read_bytes() == CONTENT
    assert file_server.ranges == [None]
