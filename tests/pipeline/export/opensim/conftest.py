"""Fitted people who move, and their archives for OpenSim."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import BODY_FEET
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.file_formats import is_installed
from pipeline.export.opensim.model_files import OpenSimPerson, write_opensim_files
from pipeline.motion.skeleton.animate import animate
from tests.pipeline.motion.angles.simulated_people import NOISE_PX, RATE_HZ, performed
from tests.pipeline.motion.skeleton.observed import observe, ring_of

needs_opensim = pytest.mark.skipif(
    not is_installed("osim"), reason="OpenSim's package or its generic model is not installed: multicap opensim install"
)


def take_of(
    motion: str, duration_s: float | None, seed: int = 7, size: float = 1.0, gaps: Sequence[tuple[slice, str]] = ()
) -> Reconstruction:
    """Take of a simulated person, seen by six cameras with 3 px of noise.

    ``size`` is that of the person, beside the simulated one. ``gaps`` are rows in which joints are hidden from all
    cameras, those whose name begins with a word.
    """
    joints_m, _ = performed(motion, seed, duration_s)
    joints_m = size * joints_m
    for rows, word in gaps:
        joints_m[rows, [name.startswith(word) for name in BODY_FEET.names]] = np.nan
    cameras = ring_of(6)
    track, seen = observe(cameras, joints_m, noise_px=NOISE_PX, seed=seed)
    timebase = Timebase(0.0, RATE_HZ, len(joints_m))
    animation = animate([track], [seen], cameras, timebase, BODY_FEET, ReconstructionConfig())
    return Reconstruction(cameras, BODY_FEET, timebase, [track], [seen], animation)


def archived(take: Reconstruction, folder: Path) -> tuple[OpenSimPerson, Path]:
    """Archive of the only person, unpacked."""
    (written,) = write_opensim_files(take, slice(None), folder)
    assert written.path is not None
    with zipfile.ZipFile(written.path) as archive:
        archive.extractall(folder)
    return written.person, folder / f"person-{written.person.id}"


@pytest.fixture(scope="session")
def walk() -> Reconstruction:
    return take_of("walk", 1.0)


@pytest.fixture(scope="session")
def walk_archive(walk: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> tuple[OpenSimPerson, Path]:
    return archived(walk, tmp_path_factory.mktemp("walk"))
