"""Lags of sounds that were shifted by known times, and sounds that tell nothing."""

import numpy as np
import pytest

from pipeline.capture.synchronization.sound_offsets import (
    SPEED_OF_SOUND_M_S,
    SoundOffsets,
    find_lag,
    onset_strength,
    sound_offsets,
    synchronize_with_sound,
)
from pipeline.core.data.cameras import Camera, Synchronization
from pipeline.validation.simulation.motion.script import Gesture
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.capture.synchronization.conftest import Take, alone, cut_take, shortened


def room(seed: int, seconds: float, events: int, echo_ms: float = 60.0) -> np.ndarray:
    """Energy of each millisecond of a room in which things sound at random: sharp onsets that die away."""
    rng = np.random.default_rng(seed)
    energy = np.zeros(round(1000 * seconds))
    for start in rng.integers(0, len(energy) - 500, events):
        length = len(energy[start : start + 500])
        energy[start : start + 500] += 10 ** rng.uniform(0, 2) * np.exp(-np.arange(length) / echo_ms)
    return energy


METRONOME = np.tile(50.0 * np.exp(-np.arange(500) / 20.0), 40)


def heard(energy: np.ndarray, late_ms: int, noise: float = 0.01, seed: int = 0) -> np.ndarray:
    """Recording of a camera that starts late, with noise of its own."""
    rng = np.random.default_rng(seed)
    own = energy[late_ms:] * rng.uniform(0.5, 2.0)
    return np.asarray(own + noise * rng.chisquare(8, len(own)) / 8, np.float32)


def lag_of(first: np.ndarray, second: np.ndarray) -> tuple[float, float] | None:
    strengths = onset_strength(first), onset_strength(second)
    if strengths[0] is None or strengths[1] is None:
        return None
    found = find_lag(strengths[0], strengths[1])
    return None if found is None else (found.lag_s, found.drift)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("late_ms", [0, 137, 4211])
def test_lag_of_camera_that_starts_late(seed: int, late_ms: int) -> None:
    energy = room(seed, 20.0, 25)
    found = lag_of(heard(energy, 0, seed=1), heard(energy, late_ms, seed=2))
    assert found is not None
    # A sound at time t in the first camera is late_ms earlier in the second one.
    assert found[0] == pytest.approx(late_ms / 1000, abs=0.001)
    back = lag_of(heard(energy, late_ms, seed=2), heard(energy, 0, seed=1))
    assert back is not None
    assert back[0] == pytest.approx(-late_ms / 1000, abs=0.001)


def test_drift_of_long_take() -> None:
    energy = room(3, 300.0, 400)
    # A clock that is 100 ppm fast: its millisecond k is at k / (1 + 1e-4).
    fast = np.interp(np.arange(300_000) / 1.0001, np.arange(len(energy)), energy)
    found = lag_of(heard(energy, 0, seed=1), heard(fast, 2500, seed=2))
    assert found is not None
    middle_s = 148.7
    assert found[1] == pytest.approx(-1e-4, abs=1e-5)
    assert found[0] == pytest.approx((middle_s + 2.5) / 1.0001 - middle_s, abs=0.003)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (np.zeros(20_000), room(1, 20.0, 25)),
        (np.full(20_000, 1.0), room(1, 20.0, 25)),
        (room(1, 20.0, 25), room(2, 20.0, 25)),
        (room(1, 1.5, 25), room(1, 20.0, 25)),
        (METRONOME, METRONOME),
    ],
    ids=["silence", "hum", "other sounds", "too short", "a metronome"],
)
def test_sounds_that_tell_nothing_are_refused(first: np.ndarray, second: np.ndarray) -> None:
    assert lag_of(heard(first, 0, seed=1), heard(second, 0, seed=2)) is None


@pytest.fixture(scope="module")
def cameras() -> tuple[Camera, ...]:
    return record(find_scene("room"), 1, 4).cameras


def test_offsets_of_all_cameras(cameras: tuple[Camera, ...]) -> None:
    energy = room(5, 30.0, 40)
    late_ms = {camera.name: late for camera, late in zip(cameras, (250, 0, 1500, 700), strict=True)}
    sounds = {name: heard(energy, late, seed=late) for name, late in late_ms.items()}
    found = sound_offsets(cameras, sounds)
    names = list(late_ms)
    assert dict(found.offset_s) == pytest.approx(
        {name: (late - late_ms[names[0]]) / 1000 for name, late in late_ms.items()}, abs=0.002
    )
    assert found.sigma_s[names[0]] == 0.0
    # At least as uncertain as the way of the sound: some metres.
    assert all(0.002 < found.sigma_s[name] < 10.0 / SPEED_OF_SOUND_M_S for name in names[1:])
    assert not found.reasons


def test_cameras_without_offset_and_why(cameras: tuple[Camera, ...]) -> None:
    energy = room(5, 30.0, 40)
    names = [camera.name for camera in cameras]
    sounds: dict[str, np.ndarray | str] = {
        names[0]: heard(energy, 0),
        names[1]: "The video has no sound.",
        names[2]: heard(energy, 400, seed=3),
        names[3]: np.zeros(30_000, np.float32),
    }
    found = sound_offsets(cameras, sounds)
    assert found.offset_s.keys() == {names[0], names[2]}
    assert "no sound" in found.reasons[names[1]]
    assert "no onsets" in found.reasons[names[3]]
    alone = sound_offsets(cameras, {names[0]: heard(energy, 0), names[1]: heard(room(6, 30.0, 40), 0)})
    assert not alone.offset_s
    assert "no other camera's" in alone.reasons[names[0]]


def test_sounds_that_contradict_each_other_are_not_used(cameras: tuple[Camera, ...]) -> None:
    one, other = room(5, 30.0, 40), room(6, 30.0, 40)
    names = [camera.name for camera in cameras]
    # The third camera's sound was edited: half of what it records is from another time.
    late = np.r_[np.zeros(2000), one][: len(one)]
    sounds = {
        names[0]: heard(one, 0),
        names[1]: heard(one + other, 0, seed=1),
        names[2]: heard(other + 0.3 * late, 0, seed=2),
    }
    found = sound_offsets(cameras, sounds)
    assert found.offset_s == {} or found.offset_s[names[1]] == pytest.approx(0.0, abs=0.002)


def sound_of(take: Take, wrong_s: float = 0.0, sigma_s: float = 0.01) -> SoundOffsets:
    """Sound that is a hundredth of a second off, or wrong for the second camera."""
    names = [camera.name for camera in take.cameras]
    errors_s = [0.0, wrong_s, 0.01][: len(names)]
    start_s = [one - take.start_s[0] for one in take.start_s]
    offsets_s = {name: start + error for name, start, error in zip(names, start_s, errors_s, strict=True)}
    return SoundOffsets(offsets_s, {name: 0.0 if name == names[0] else sigma_s for name in names})


def measured(take: Take, sound: SoundOffsets) -> Synchronization:
    starts_s = dict.fromkeys(take.times, 0.0)
    return synchronize_with_sound(take.cameras, take.times, take.detections, take.joints, starts_s, sound)


def offsets(found: Synchronization) -> list[float]:
    return [clock.offset_s for clock in found.clocks]


def test_motion_is_finer_than_sound_that_agrees() -> None:
    take = cut_take(shortened("room", 5.0), 4, (0, 12, 20))
    found = measured(take, sound_of(take, 0.02))
    assert found == take.synchronized()
    assert offsets(found) == pytest.approx(take.start_s, abs=0.005)


def test_contradiction_is_refused_with_camera_and_time() -> None:
    take = cut_take(shortened("room", 5.0), 4, (0, 12, 20))
    found = measured(take, sound_of(take, 0.7))
    (refusal,) = found.refusals
    assert (refusal.code, refusal.camera) == ("sync_contradiction", take.cameras[1].name)
    assert "0.70 s later" in refusal.message


def test_sound_decides_where_motion_repeats_itself() -> None:
    take = cut_take(alone(Gesture.JUMP, 8.0), 4, (0, 12, 20))
    assert "sync_ambiguous" in {one.code for one in take.synchronized().refusals}
    found = measured(take, sound_of(take, 0.02))
    assert found.is_certain
    assert offsets(found) == pytest.approx(take.start_s, abs=0.02)


def test_people_at_rest_are_synchronised_by_exact_sound() -> None:
    take = cut_take(alone(Gesture.IDLE, 4.0), 4, (0, 12, 20))
    found = measured(take, sound_of(take))
    assert found.is_certain
    assert found.warnings[0].code == "sync_by_sound"
    assert [clock.shift_s for clock in found.clocks] == pytest.approx([0.0, 0.48, 0.81], abs=1e-9)
    rough = measured(take, sound_of(take, sigma_s=0.05))
    assert {one.code for one in rough.refusals} == {"sync_imprecise"}
    # A camera without sound is not guessed.
    name = take.cameras[2].name
    some = sound_of(take)
    partly = SoundOffsets({k: v for k, v in some.offset_s.items() if k != name}, some.sigma_s, {name: "No sound."})
    assert not measured(take, partly).is_certain
