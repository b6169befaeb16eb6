"""A service with a key, and the sample capture as a folder: what programs of clients are called with."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served, serving


@dataclass(frozen=True, slots=True)
class ServedCapture:
    """Service with keys, and the folder of a capture."""

    served: Served
    key: str
    take: Path

    @property
    def url(self) -> str:
        return str(self.served.client.base_url).rstrip("/")


def multicap(*arguments: str | Path) -> bytes:
    """Run a command of Multicap; return what it prints."""
    command = [sys.executable, "-P", "-m", "api.cli.main", *arguments]
    return subprocess.run(command, capture_output=True, check=True).stdout


@contextmanager
def served_capture(sample: Sample, folder: Path, /, **environment: str) -> Iterator[ServedCapture]:
    """Run a service during the block."""
    take = folder / "take"
    take.mkdir()
    for path in sample.videos.values():
        (take / path.name).symlink_to(path)
    multicap("calibration", "convert", sample.calibration, take / "calibration.toml")
    with serving(folder / "data", 1, **environment) as served:
        key = json.loads(multicap("keys", "create", "portal", "--json", "--data", folder / "data"))["key"]
        served.client.headers["Authorization"] = f"Bearer {key}"
        yield ServedCapture(served, key, take)
