"""Clustering by ranges of frames gives the result of the whole session, for bodies and fields."""

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.config import ReconstructionConfig
from pipeline.data.cameras import FrameTimes
from pipeline.data.detections import Detections
from pipeline.data.people import Observations, People, Track3D
from pipeline.simulation.scenes import find_scene, record
from pipeline.stages.association import link, locate_people, measure_bones
from pipeline.stages.stage import FrameCut
from pipeline.video.timeline import frames_in, span_s

CONFIG = ReconstructionConfig(method="clustering")


@pytest.fixture(scope="module")
def session() -> KeypointSession:
    """Detections of cameras with three rates and random phases, with dropped frames."""
    simulation = record(replace(find_scene("unsynchronised"), duration_s=2.0), seed=8)
    return KeypointSession(
        cameras=simulation.cameras,
        times=simulation.times,
        timebase=simulation.timebase,
        detections=simulation.detections,
        joints=simulation.joints,
        folders={},
        findings=(),
    )


def of_range(session: KeypointSession, frames: range) -> Mapping[str, Detections]:
    """Detections of a range of output frames: the range's chunk of each camera."""
    span = span_s(session.timebase, frames.start, frames.stop)
    times: Mapping[str, FrameTimes] = session.times
    return {name: one.within(frames_in(times[name], *span)) for name, one in session.detections.items()}


def clustered(session: KeypointSession, chunk_frames: int) -> People:
    whole = range(session.timebase.num_frames)
    ranges = list(FrameCut(whole, (whole,), chunk_frames))
    found = [of_range(session, frames) for frames in ranges]
    lengths = measure_bones(session, zip(ranges, found, strict=True), session.joints, CONFIG)
    poses = [
        locate_people(session, frames, one, lengths, session.joints, CONFIG)
        for frames, one in zip(ranges, found, strict=True)
    ]
    return link(session, poses, session.joints, CONFIG)


@pytest.mark.parametrize("chunk_frames", [7, pytest.param(25, marks=pytest.mark.slow)])
def test_no_cut_changes_a_byte(session: KeypointSession, chunk_frames: int) -> None:
    whole, cut = clustered(session, session.timebase.num_frames), clustered(session, chunk_frames)
    assert len(whole[0]) == len(cut[0]) >= 3
    for track, same in zip(whole[0], cut[0], strict=True):
        assert_equal(track, same)
    for seen, same_seen in zip(whole[1], cut[1], strict=True):
        assert_equal(seen, same_seen)


def assert_equal(one: Track3D | Observations, other: Track3D | Observations) -> None:
    for field in fields(one):
        np.testing.assert_array_equal(getattr(other, field.name), getattr(one, field.name))
