"""Data folders and backups of them."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.worker.store.backups import UPLOAD, Data, opened_data
from worker.store.model.rights import Scope


@pytest.fixture
def data(tmp_path: Path) -> Iterator[Data]:
    with opened_data(tmp_path / "data") as data:
        yield data


@pytest.fixture
def busy(data: Data) -> Data:
    """A finished job, one in the middle, one that waits, half an upload and a key."""
    done, other = data.add_session(), data.add_session()
    data.add_job(done)
    data.run_all()
    data.add_job(other)
    data.run_chunk()
    data.add_job(other)
    data.add_upload(b"half", 8, UPLOAD)
    data.store.keys.add("studio", "portal", {Scope.READ})
    return data


@pytest.fixture
def archive(busy: Data, tmp_path: Path) -> Path:
    assert busy.back_up(tmp_path / "backup.tar").problems == ()
    return tmp_path / "backup.tar"
