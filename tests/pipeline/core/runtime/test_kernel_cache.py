"""Completeness of the kernel cache, checked without compilation or imports."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.core.runtime import kernel_cache
from pipeline.core.runtime.packages.storage import exclusive


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(kernel_cache, "cache_folder", lambda: tmp_path)
    return tmp_path


def test_complete_after_warm_up_and_for_this_processor_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not kernel_cache.is_complete()
    kernel_cache.note_complete()
    assert kernel_cache.is_complete()
    monkeypatch.setattr(kernel_cache, "_processor", lambda: "another")
    assert not kernel_cache.is_complete()


def test_folder_that_cannot_be_written_is_never_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_cache, "cache_folder", lambda: None)
    kernel_cache.note_complete()
    assert not kernel_cache.is_complete()


def test_asking_loads_neither_numba_nor_numpy() -> None:
    program = (
        "import sys; from pipeline.core.runtime.kernel_cache import is_complete; is_complete(); print(*sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert {"numba", "numpy"}.isdisjoint(found.stdout.split())


def test_warm_up_beside_another_waits_and_has_no_work(tmp_path: Path) -> None:
    environment = os.environ | {"MULTICAP_HOME": str(tmp_path)}
    find = "from pipeline.core.runtime.kernel_cache import cache_folder; print(cache_folder())"
    found = subprocess.run([sys.executable, "-c", find], env=environment, capture_output=True, text=True, check=True)
    command = [sys.executable, "-m", "pipeline.run.warm_up", "--progress"]
    with exclusive(Path(found.stdout.strip())):
        waiting = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        assert waiting.stdout is not None
        assert waiting.stdout.readline().startswith('{"done": 0, ')
        note = "from pipeline.core.runtime.kernel_cache import note_complete; note_complete()"
        subprocess.run([sys.executable, "-c", note], env=environment, check=True)
        assert waiting.poll() is None
    assert waiting.communicate(timeout=180)[0] == ""
    assert waiting.returncode == 0
