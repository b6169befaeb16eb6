"""The real sample capture, reconstructed once for all tests that look at it."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx2
import psutil
import pytest

from api.commands.reconstruct import write_results
from api.commands.serve import READY
from pipeline import samples
from pipeline.config import ReconstructionConfig
from pipeline.data import Reconstruction
from pipeline.run import reconstruct
from pipeline.samples import Sample
from pipeline.session import open_session
from tests.e2e.serving import COMMAND, NUM_PROCESSES, Served, is_alive


@pytest.fixture(scope="session")
def sample() -> Sample:
    found = samples.locate()
    if found is None:
        pytest.skip("the sample capture is not installed (`multicap samples install`)")
    return found


@pytest.fixture(scope="session")
def reconstruction(sample: Sample) -> Reconstruction:
    session = open_session(list(sample.videos.values()), sample.calibration)
    return reconstruct(session, ReconstructionConfig(chunk_frames=100))


@pytest.fixture(scope="session")
def results(reconstruction: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    write_results(reconstruction, folder)
    return folder


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The service, and in the end that Ctrl-C leaves no process of it."""
    if sys.platform != "linux":
        pytest.skip("only Linux ties children to their parents")
    data_dir = tmp_path_factory.mktemp("data")
    command = [*COMMAND, "--port", "0", "--data", str(data_dir)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        tree: list[psutil.Process] = []
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith(READY)
            with httpx2.Client(base_url=line.removeprefix(READY).strip(), timeout=60.0, trust_env=False) as client:
                running = Served(process, data_dir, client)
                yield running
                tree = running.tree()
        finally:
            process.send_signal(signal.SIGINT)
            status = process.wait(30)
    assert status == 0
    assert len(tree) == NUM_PROCESSES
    assert not any(is_alive(one) for one in tree)
