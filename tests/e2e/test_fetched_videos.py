"""Videos by URL: a real service with a worker fetches them from a server on this machine, and reconstructs them."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from api.cli.client import Client
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import file_server, serving

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("service")]

SECRET = "signature=s3cr3t-of-the-store"  # noqa: S105


@pytest.fixture
def store(sample: Sample) -> Iterator[str]:
    """Address of a server with the sample's videos."""
    with file_server(next(iter(sample.videos.values())).parent) as url:
        yield url


def test_job_of_links_gives_files_and_keeps_secrets(sample: Sample, store: str, tmp_path: Path) -> None:
    with serving(tmp_path / "data", 1, MULTICAP_FETCH_PRIVATE="true") as served:
        links = [f"{store}/{path.name}?{SECRET}" for path in list(sample.videos.values())[:2]]
        with Client(served.client) as client:
            spec = {"frame_range": [0, 10], "exports": ["bvh"], "force": True}
            job = client.submit("Take", links, sample.calibration, spec)
            job = client.follow(job, timeout_s=900)
            session = client.get(job["urls"]["session"])
        videos = [file for file in session["files"] if file["kind"] == "video"]
        assert [file["num_bytes"] for file in videos] == [
            path.stat().st_size for path in list(sample.videos.values())[:2]
        ]
    logs = [path for path in (tmp_path / "data").rglob("*.log*") if path.is_file()]
    assert logs
    assert not any(SECRET.encode() in path.read_bytes() for path in logs)
