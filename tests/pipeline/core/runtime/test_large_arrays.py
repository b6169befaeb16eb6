"""Large arrays: their place in files, and the pages that a process gives back."""

import errno
import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from pipeline.core.runtime import large_arrays
from pipeline.core.runtime.npz import decode_arrays, encode_arrays
from pipeline.core.runtime.resources import release_pages

NUM_BYTES = 2 * large_arrays.MIN_BYTES


@pytest.fixture(autouse=True)
def no_memory_for_large_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_arrays, "MAX_HELD_BYTES", 0)


def shared_bytes() -> int:
    """Memory of the process that belongs to files."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("RssFile"))
    return 1024 * int(line.split()[1])


def test_large_array_content_survives_release_of_its_pages() -> None:
    array = large_arrays.full((NUM_BYTES // 8,), 3.0)
    array[5] = np.nan
    filled = shared_bytes()
    release_pages()
    assert filled - shared_bytes() > 0.9 * NUM_BYTES
    assert np.isnan(array[5])
    assert np.nansum(array) == 3.0 * (len(array) - 1)


def test_small_array_is_in_memory() -> None:
    assert large_arrays.empty((10, 2), np.float32).base is None
    assert large_arrays.empty((NUM_BYTES,), bool).base is not None


def test_large_arrays_are_in_memory_while_it_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_arrays, "MAX_HELD_BYTES", 2 * NUM_BYTES)
    held = [large_arrays.empty((NUM_BYTES,), np.uint8)[1:] for _ in range(2)]
    assert large_arrays.empty((NUM_BYTES,), np.uint8).base is not None
    del held[0]
    assert large_arrays.empty((NUM_BYTES,), np.uint8).base is None


def test_blocks_have_every_row_once() -> None:
    rows = np.arange(1_500)
    blocks = list(large_arrays.blocks(len(rows)))
    np.testing.assert_array_equal(np.concatenate([rows[block] for block in blocks]), rows)
    assert max(block.stop - block.start for block in blocks) == 512
    assert list(large_arrays.blocks(0)) == []


def test_copied_and_concatenated_large_arrays_equal_numpy_s() -> None:
    parts: list[np.ndarray] = [np.arange(NUM_BYTES // 8, dtype=np.float32).reshape(-1, 2), np.ones((3, 2))]
    joined = large_arrays.concatenate(parts)
    np.testing.assert_array_equal(joined, np.concatenate(parts))
    assert joined.dtype == np.float64
    copied = large_arrays.copy(joined)
    copied[0] = 7.0
    assert joined[0, 1] == 1.0


def test_archive_of_large_and_small_arrays_comes_back() -> None:
    rng = np.random.default_rng(0)
    turned = np.asfortranarray(rng.normal(size=(NUM_BYTES // 16, 2)))
    arrays = {"large": rng.integers(0, 255, NUM_BYTES, np.uint8), "turned": turned, "small": np.array("text")}
    decoded = decode_arrays(encode_arrays(arrays))
    for name, array in arrays.items():
        assert decoded[name].dtype == array.dtype
        np.testing.assert_array_equal(decoded[name], array)


def test_header_of_more_than_its_entry_is_refused_before_space_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    stored = io.BytesIO()
    header = {"descr": "|u1", "fortran_order": False, "shape": (2**40,)}
    with zipfile.ZipFile(stored, "w") as archive, archive.open("large.npy", "w") as entry:
        npy.write_array_header_1_0(entry, header)
        entry.write(bytes(NUM_BYTES))
    monkeypatch.setattr(os, "posix_fallocate", lambda *_: pytest.fail("space was taken"))
    with pytest.raises(ValueError, match="large of an archive is not whole"):
        decode_arrays(stored.getvalue())


def test_full_disk_is_error_when_large_array_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", refuse)
    with pytest.raises(OSError, match="No space left on device in /"):
        large_arrays.empty((NUM_BYTES,), np.uint8)
