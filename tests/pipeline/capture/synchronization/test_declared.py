"""Declared offsets with stated uncertainties: clocks within them, beyond them, and without any motion."""

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.capture.synchronization.declared import synchronize_declared
from pipeline.capture.synchronization.sound.offsets import SoundOffsets
from pipeline.core.data.cameras import FrameTimes, Synchronization
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.capture.synchronization.conftest import Take, alone, cut_take, shortened

CUT = (0, 12, 20)


def measured(take: Take, errors_s: Sequence[float], stds_s: Sequence[float | None]) -> Synchronization:
    """Clocks of a take whose starts are declared with errors."""
    names = [camera.name for camera in take.cameras]
    starts_s = {name: true_s + error_s for name, true_s, error_s in zip(names, take.start_s, errors_s, strict=True)}
    times = {name: FrameTimes(take.times[name].time_s + starts_s[name]) for name in names}
    known = {name: std_s for name, std_s in zip(names, stds_s, strict=True) if std_s is not None}
    return synchronize_declared(take.cameras, times, take.detections, take.joints, starts_s, SoundOffsets(), known)


def errors_s(take: Take, found: Synchronization) -> list[float]:
    """Errors of the measured offsets, relative to the first camera."""
    offsets_s = np.array([clock.offset_s for clock in found.clocks]) - np.array(take.start_s)
    return [float(value) for value in offsets_s - offsets_s[0]]


def test_motion_refines_declared_offsets_within_their_uncertainty() -> None:
    take = cut_take(shortened("room", 5.0), 4, CUT)
    found = measured(take, (0.0, 0.03, -0.02), (0.01, 0.01, 0.01))
    assert found.is_certain
    assert not found.warnings
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)


def test_motion_that_repeats_itself_is_decided_by_declared_offsets() -> None:
    take = cut_take(alone(Gesture.JUMP, 8.0), 4, CUT)
    assert "sync_ambiguous" in {problem.code for problem in take.synchronized().refusals}
    found = measured(take, (0.0, 0.02, 0.0), (0.01, 0.01, 0.01))
    assert found.is_certain
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.02)


@pytest.mark.parametrize("error_s", [0.3, 1.4])
def test_what_is_beyond_the_uncertainty_is_used_with_a_warning(error_s: float) -> None:
    take = cut_take(shortened("room", 5.0), 4, CUT)
    found = measured(take, (0.0, error_s, 0.0), (0.005, 0.005, 0.005))
    assert found.is_certain
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)
    (warning,) = [warning for warning in found.warnings if warning.code == "sync_beyond_declared"]
    assert warning.camera == take.cameras[1].name
    said_s = float(warning.message.partition(" s earlier")[0].rpartition(" ")[2])
    assert said_s == pytest.approx(error_s, abs=0.005)


def test_clocks_are_as_declared_where_nobody_moves() -> None:
    take = cut_take(alone(Gesture.IDLE, 4.0), 4, CUT)
    found = measured(take, (0.0, 0.001, 0.0), (0.002, 0.003, 0.004))
    assert found.is_certain
    assert [warning.code for warning in found.warnings] == ["sync_as_declared"]
    assert errors_s(take, found) == pytest.approx([0.0, 0.001, 0.0], abs=1e-9)
    assert [clock.sigma_s for clock in found.clocks] == [0.002, 0.003, 0.004]
    rough = measured(take, (0.0, 0.001, 0.0), (0.002, 0.1, 0.004))
    assert rough.refusals
    partly = measured(take, (0.0, 0.001, 0.0), (0.002, None, 0.004))
    assert partly.refusals


def test_without_uncertainties_nothing_changes() -> None:
    take = cut_take(shortened("room", 5.0), 4, CUT)
    found = measured(take, (0.0, 0.3, 0.0), (None, None, 0.01))
    assert found.is_certain
    assert not found.warnings
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)
