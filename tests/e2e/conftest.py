"""The real sample capture, reconstructed once for all tests that look at it."""

from pathlib import Path

import pytest

from api.commands.reconstruct import write_results
from pipeline import samples
from pipeline.config import ReconstructionConfig
from pipeline.data import Reconstruction
from pipeline.run import reconstruct
from pipeline.samples import Sample
from pipeline.session import open_session


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
