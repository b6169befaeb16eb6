"""All outputs at once: what their receivers get equals the skeletons of the capture."""

import itertools
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.outputs.fingers import FingerPoses
from pipeline.run.live.outputs.pattern import LAYOUT, pattern_instants
from pipeline.run.live.outputs.runner import LiveOutputs
from pipeline.run.live.records import LiveInstant, recorded_frames
from pipeline.run.live.settings import LiveSettings
from tests.pipeline.run.live.outputs.people import TOLERANCE_DEG, TOLERANCE_M
from tests.pipeline.run.live.outputs.receivers import NUM_PEOPLE, differences, receivers, showing

RATE_HZ = 60.0
NUM_COMPARED = 60
Instants = Iterator[LiveInstant]


def of_pattern() -> tuple[tuple[str, ...], Instants]:
    """People whose fingers move."""
    return LAYOUT.joints.names, map(pattern_instants(NUM_PEOPLE), itertools.count())


def of_keypoints() -> tuple[tuple[str, ...], Instants]:
    """People of simulated cameras, from the first instant on at which all have skeletons."""
    from api.cli.benchmark.tracking import crowd  # noqa: PLC0415 - it loads the simulation

    simulation = crowd(5, NUM_PEOPLE, 3.5, RATE_HZ)
    capture = LiveCapture(simulation.cameras, simulation.joints, LiveSettings(RATE_HZ, learn_s=1.0))
    frames = recorded_frames(simulation.cameras, simulation.times, simulation.detections)
    instants = itertools.chain.from_iterable(capture.push(*frame) for frame in frames)
    return simulation.joints.names, (
        instant for instant in instants if sum(person.skeleton is not None for person in instant.people) == NUM_PEOPLE
    )


@pytest.mark.parametrize("source", [of_keypoints, of_pattern])
def test_receivers_get_skeletons_of_capture(source: type, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pylsl", reason="pylsl is not installed (the extra `lsl`)")
    joints, instants = source()
    compared, fingers = list(itertools.islice(instants, NUM_COMPARED)), FingerPoses(joints)
    with ExitStack() as opened:
        by_name = receivers()
        addresses = [receiver.address for receiver in by_name.values()]
        outputs = opened.enter_context(LiveOutputs(addresses, allow_network=True))
        for receiver in by_name.values():  # they leave before the outputs
            opened.enter_context(receiver)
        outputs.begin(joints, RATE_HZ)
        with showing(outputs, compared[0]):
            for receiver in by_name.values():
                receiver.connect()
                receiver.read()
        for receiver in by_name.values():
            receiver.drain()
        worst = dict.fromkeys(by_name, (0.0, 0.0))
        for instant in compared:
            outputs.show(instant)
            expected = fingers.with_fingers(instant)
            for name, receiver in by_name.items():
                poses = receiver.decode(receiver.read())
                assert len(poses) == NUM_PEOPLE
                for pose, person in zip(poses, expected.people, strict=True):
                    off_mm, off_deg = differences(pose, person, joints)
                    worst[name] = max(worst[name][0], off_mm), max(worst[name][1], off_deg)
    with capsys.disabled():
        for name, (off_mm, off_deg) in worst.items():
            print(f"\n{source.__name__} {name}: {off_mm:.5f} mm, {off_deg:.5f} degrees", end="")  # noqa: T201
    assert max(off_mm for off_mm, _ in worst.values()) < 1e3 * TOLERANCE_M
    assert max(off_deg for _, off_deg in worst.values()) < TOLERANCE_DEG
