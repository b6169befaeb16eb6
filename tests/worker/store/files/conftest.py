"""Each artifact store."""

from pathlib import Path

import pytest

from tests.s3 import S3
from worker.store.files.artifacts import ArtifactStore, open_artifacts


@pytest.fixture
def on_s3(s3: S3, monkeypatch: pytest.MonkeyPatch) -> S3:
    """With the environment that says where it is."""
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    return s3


@pytest.fixture(params=["folder", "s3"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> ArtifactStore:
    url = "" if request.param == "folder" else request.getfixturevalue("on_s3").new_url()
    return open_artifacts(url, tmp_path)
