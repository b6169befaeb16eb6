"""Clustering by ranges of frames gives the result of the whole session, for bodies and fields."""

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
import pytest

from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Observations, People, Track3D
from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.methods import Association
from pipeline.run.engine.stage import FrameCut
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from pipeline.video.timeline import frames_in, span_s

CONFIG = ReconstructionConfig(method="clustering")


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    """Detections of cameras with three rates and random phases, with dropped frames."""
    return record(replace(find_scene("unsynchronised"), duration_s=2.0), seed=8)


def of_range(simulation: Simulation, frames: range) -> Mapping[str, Detections]:
    """Detections of a range of output frames: the range's chunk of each camera."""
    span = span_s(simulation.timebase, frames.start, frames.stop)
    return {
        name: bodies.within(frames_in(simulation.times[name], *span)) for name, bodies in simulation.detections.items()
    }


def clustered(simulation: Simulation, chunk_frames: int) -> People:
    association = Association(simulation.cameras, simulation.times, simulation.timebase, simulation.joints, CONFIG)
    whole = range(simulation.timebase.num_frames)
    ranges = list(FrameCut(whole, (whole,), chunk_frames))
    found = [of_range(simulation, frames) for frames in ranges]
    lengths = association.measure_bones(zip(ranges, found, strict=True))
    return association.link(
        association.locate_people(frames, bodies, lengths) for frames, bodies in zip(ranges, found, strict=True)
    )


@pytest.mark.parametrize("chunk_frames", [7, pytest.param(25, marks=pytest.mark.slow)])
def test_no_cut_changes_byte(simulation: Simulation, chunk_frames: int) -> None:
    whole, cut = clustered(simulation, simulation.timebase.num_frames), clustered(simulation, chunk_frames)
    assert len(whole[0]) == len(cut[0]) >= 3
    for track, same in zip(whole[0], cut[0], strict=True):
        assert_equal(track, same)
    for seen, same_seen in zip(whole[1], cut[1], strict=True):
        assert_equal(seen, same_seen)


def assert_equal(one: Track3D | Observations, other: Track3D | Observations) -> None:
    for field in fields(one):
        np.testing.assert_array_equal(getattr(other, field.name), getattr(one, field.name))
