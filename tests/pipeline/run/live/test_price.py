"""Price of feet that are held, of people who are recognised and of clothes: processor time with and without them.

Run it by ``pytest -s -m benchmark tests/pipeline/run/live/test_price.py``, three minutes. Both sides take turns, so
that other programs disturb both alike.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.session import open_session
from pipeline.core.options.config import ReconstructionConfig
from pipeline.detection.chunk import camera_images
from pipeline.detection.models import status
from pipeline.run.live.cameras.detector_pool import DetectionJob, detect_bodies
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.frames import LiveFrame
from pipeline.run.live.identities import Identities
from pipeline.run.live.settings import LiveSettings
from pipeline.run.live.skeleton import PoseFilter
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.e2e.datasets import folder_of, needs
from tests.pipeline.clothes import dress
from tests.pipeline.run.live.streams import sent_frames

pytestmark = pytest.mark.benchmark

RATE_HZ, DURATION_S, NUM_ROUNDS = 60.0, 10.0, 4
MAX_PRICE = 0.25
# Every fifth picture of a rendered clip.
EVERY, MAX_PRICE_OF_COLOURS = 5, 0.03


@pytest.fixture(scope="module")
def room() -> Simulation:
    scene = SCENES["room"]
    clock = replace(scene.clock, frame_rate_hz=RATE_HZ)
    room = record(replace(scene, cast=Cast(4, (4.0, 4.0)), clock=clock, duration_s=DURATION_S), 1, joints="feet")
    return dress(room, lambda person, time_s: person)


def instant_ms(room: Simulation) -> np.ndarray:
    """Processor time of each instant with skeletons."""
    capture, taken_ms = LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ, learn_s=2.0)), list[float]()
    for frame in sent_frames(room):
        started_s = time.thread_time()
        instants = capture.push(*frame)
        if instants and frame.time_s > 3.0:
            taken_ms.append(1e3 * (time.thread_time() - started_s))
    return np.array(taken_ms)


def without_feet(patch: pytest.MonkeyPatch) -> None:
    init = PoseFilter.__init__

    def footless(pose_filter: PoseFilter, *arguments: object) -> None:
        init(pose_filter, *arguments)  # type: ignore[arg-type]
        pose_filter._feet = []

    patch.setattr(PoseFilter, "__init__", footless)


def without_identities(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Identities, "see", lambda identities, tracked, time_s, xyz_m, colours: None)


def without_clothes(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(LiveFrame, "colours", property(lambda frame: [None] * len(frame.score)))


@pytest.mark.parametrize("without", [without_feet, without_identities, without_clothes])
def test_price(room: Simulation, without: Callable[[pytest.MonkeyPatch], None]) -> None:
    instant_ms(room)  # compiles
    with_ms, without_ms = list[np.ndarray](), list[np.ndarray]()
    for _ in range(NUM_ROUNDS):
        with_ms.append(instant_ms(room))
        with pytest.MonkeyPatch.context() as patch:
            without(patch)
            without_ms.append(instant_ms(room))
    medians = [float(np.median(np.concatenate(each))) for each in (with_ms, without_ms)]
    p99s = [float(np.percentile(np.concatenate(each), 99)) for each in (with_ms, without_ms)]
    print(  # noqa: T201
        f"\n{without.__name__}: p50 {medians[0]:.2f} ms with, {medians[1]:.2f} ms without "
        f"({100 * (medians[0] / medians[1] - 1):.0f} %); p99 {p99s[0]:.2f} and {p99s[1]:.2f} ms"
    )
    assert medians[0] <= (1 + MAX_PRICE) * medians[1]


@needs("rendered")
def test_price_of_colours_in_pictures(tmp_path: Path) -> None:
    """Detection in pictures of three people, with the colours of their clothes and without."""
    if not any(network.installed for network in status()):
        pytest.skip("the networks are not installed")
    folder = folder_of("rendered")
    session = open_session(folder / "videos", folder / "calibration.toml")
    pictures = np.array([image for _, image in camera_images(session, session.cameras[0].name, range(100))])[::EVERY]
    (tmp_path / "pictures").write_bytes(pictures.tobytes())
    choices, path = ReconstructionConfig(profile="fast", joints="body"), str(tmp_path / "pictures")
    taken_ms: dict[bool, list[float]] = {True: [], False: []}
    for number in [0, *range(len(pictures))] * NUM_ROUNDS:
        for measures_colours, taken in taken_ms.items():
            bodies = detect_bodies(DetectionJob(choices, path, pictures.shape, number, 0, 0.0, None, measures_colours))
            assert (bodies.colour is not None) == measures_colours
            taken.append(1e3 * bodies.duration_s)
    with_ms, without_ms = (float(np.median(taken_ms[each][2:])) for each in (True, False))
    price = with_ms / without_ms - 1
    print(f"\na picture: {with_ms:.2f} ms with colours, {without_ms:.2f} ms without ({100 * price:.1f} %)")  # noqa: T201
    assert price <= MAX_PRICE_OF_COLOURS
