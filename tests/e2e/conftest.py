"""Fixtures of the end-to-end tests: the reconstructed sample capture, and a running service."""

import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from pipeline.capture.session import open_session
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.samples import Sample
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from tests.e2e.exported import capture, filmed, hands, walk  # noqa: F401 - fixtures
from tests.e2e.serving import NUM_PROCESSES, Served, serving
from tests.waiting import is_alive, wait_for

# Frames of the sample of which the quick tests need the detections.
NUM_FIRST = 20


@pytest.fixture(scope="session")
def sample() -> Sample:
    found = samples.locate()
    if found is None:
        pytest.skip("the sample capture is not installed (`multicap samples install`)")
    return found


@pytest.fixture(scope="session")
def reconstruction(sample: Sample, task_cache: Path) -> Reconstruction:
    session = open_session(list(sample.videos.values()), sample.calibration)
    return reconstruct(session, ReconstructionConfig(chunk_frames=100), cache=task_cache)


@pytest.fixture(scope="session")
def results(reconstruction: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    write_results(reconstruction, folder)
    return folder


@pytest.fixture(scope="session")
def beginning(sample: Sample, task_cache: Path) -> Reconstruction:
    """Reconstruction of the sample's first frames, from one chunk of each camera."""
    session = open_session(list(sample.videos.values()), sample.calibration)
    return reconstruct(session, ReconstructionConfig(frame_range=(0, NUM_FIRST)), cache=task_cache)


@pytest.fixture(scope="session")
def first_results(beginning: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("beginning")
    write_results(beginning, folder)
    return folder


def is_at_rest(running: Served) -> bool:
    """Return whether a service has its own processes alone."""
    try:
        words = [process.cmdline() for process in running.tree()]
    except psutil.NoSuchProcess:
        return False
    # Tests with live captures leave the server from which they are forked.
    return len(words) == NUM_PROCESSES + sum("pipeline.run.live.server" in line for line in words)


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Running service; after the tests Ctrl-C must end all of its processes."""
    if sys.platform != "linux":
        pytest.skip("only Linux ties children to their parents")
    with serving(tmp_path_factory.mktemp("data")) as running:
        yield running
        wait_for(lambda: is_at_rest(running))  # checks of files that nobody waits for any more end first
        tree = running.tree()
    assert running.process.returncode == 0
    assert not any(is_alive(one) for one in tree)
