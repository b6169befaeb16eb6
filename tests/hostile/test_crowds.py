"""Crowds whose people look alike in every camera: bounded time and memory, a result or none, and a warning."""

import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import psutil
import pytest

from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.association.tracking.observations import Detections2D, gather
from pipeline.capture.keypoint_files.people import MAX_PEOPLE
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.people import People
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.run.engine.methods import Association
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Clock, Layout, Rig
from pipeline.validation.simulation.scenes import Scene, record
from tests.api.processes import peak_bytes
from tests.hostile.crowds import hostile_crowds

NAMES = list(hostile_crowds(1, 2, 1))
METHODS: tuple[Method, ...] = ("tracking", "clustering")
# Each crowd by one of the methods is a slow test; `make hostile` has both.
CASES = [
    pytest.param(method, name, marks=[] if number % 2 == METHODS.index(method) else pytest.mark.hostile)
    for method in METHODS
    for number, name in enumerate(NAMES)
]
MAX_FRAME_S = 60.0  # a shared machine takes 16 s for the worst crowd
MAX_RESIDENT_BYTES = 2 * 2**30


@pytest.fixture(scope="module")
def child() -> Iterator[ProcessPoolExecutor]:
    """New process, whose peak memory does not include that of other tests."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


def gathered(session: KeypointSession) -> Detections2D:
    return gather(session.cameras, session.times, session.detections)


def association_of(session: KeypointSession, method: Method) -> Association:
    setting = session.cameras, session.times, session.timebase, session.joints
    return Association(*setting, ReconstructionConfig(method))


def associated(session: KeypointSession, method: Method) -> People:
    association = association_of(session, method)
    if method == "tracking":
        return association.track(gathered(session))
    frames = range(session.timebase.num_frames)
    lengths = association.measure_bones([(frames, session.detections)])
    return association.link([association.locate_people(frames, session.detections, lengths)])


def reconstruct(method: Method, name: str, num_cameras: int, num_frames: int) -> tuple[float, int, int]:
    """Reconstruct; return seconds of computing, number of approximate frames, and peak memory in bytes."""
    session = hostile_crowds(MAX_PEOPLE, num_cameras, num_frames)[name]()
    started_s = time.process_time()
    people = associated(session, method)
    association_of(session, method).assign_identities(people)
    taken_s = time.process_time() - started_s
    return taken_s, people.num_approximate_frames, peak_bytes(psutil.Process())


@pytest.mark.parametrize(("method", "name"), CASES)
def test_frame_of_hostile_crowd_is_bounded(child: ProcessPoolExecutor, method: Method, name: str) -> None:
    num_frames = 3 if method == "tracking" else 1
    taken_s, _, peak_memory_bytes = child.submit(reconstruct, method, name, 4, num_frames).result()
    assert taken_s < 2 * num_frames * MAX_FRAME_S
    assert peak_memory_bytes < MAX_RESIDENT_BYTES


@pytest.mark.parametrize(("method", "name"), [("tracking", "cameras are the same"), ("clustering", "in one place")])
def test_frames_that_are_approximate_are_counted(child: ProcessPoolExecutor, method: Method, name: str) -> None:
    _, num_approximate, _ = child.submit(reconstruct, method, name, 4, 2).result()
    assert num_approximate > 0


@pytest.mark.parametrize(("num_cameras", "num_expected"), [(12, 0), pytest.param(31, 1, marks=pytest.mark.hostile)])
def test_many_cameras_in_hostile_crowd(child: ProcessPoolExecutor, num_cameras: int, num_expected: int) -> None:
    name = "nearly in one place"
    taken_s, num_approximate, peak_memory_bytes = child.submit(reconstruct, "tracking", name, num_cameras, 1).result()
    assert num_approximate == num_expected
    assert taken_s < MAX_FRAME_S
    assert peak_memory_bytes < MAX_RESIDENT_BYTES


def people_in_a_hall(num_people: int, num_cameras: int, num_frames: int) -> tuple[KeypointSession, np.ndarray]:
    """Simulated session of people a good metre apart, with their positions."""
    rig = Rig(Layout.RING, num_cameras, (14.0, 12.0), 4.0, (1920, 1080), 1100.0)
    cast = Cast(num_people, (20.0, 16.0), gap_m=0.4, walking=0.25)
    found = record(Scene(rig, cast, Clock(25.0), duration_s=num_frames / 25.0), seed=1)
    session = KeypointSession(found.cameras, found.times, found.timebase, found.detections, found.joints, {}, ())
    return session, found.truth_m


@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_hundred_people_in_frame(method: Method) -> None:
    session, truth_m = people_in_a_hall(100, 8, 6 if method == "tracking" else 4)
    assert max(int(np.bincount(one.frame).max()) for one in session.detections.values()) > 90
    people = associated(session, method)
    middle_m = np.nanmean(truth_m[:, 2], axis=1)
    of_frame = [one for one in people.tracks if one.start_frame <= 2 < one.start_frame + one.num_frames]
    found_m = [np.nanmean(one.xyz_m[2 - one.start_frame], axis=0) for one in of_frame]
    apart_m = np.linalg.norm(middle_m[:, None] - np.array(found_m), axis=-1)
    assert np.count_nonzero(apart_m.min(1) < 0.3) > 90


def test_progress_comes_from_within_pass_over_crowd() -> None:
    session = hostile_crowds(40, 4, 20)["elsewhere in each frame"]()
    shares: list[float] = []
    association_of(session, "tracking").track(gathered(session), shares.append)
    assert len(shares) >= 20
    assert shares == sorted(shares)


def test_effort_is_spent_once() -> None:
    limits = WorkLimits()
    while limits.allows_round(10_000):
        assert limits.is_exact
    assert not limits.is_exact
