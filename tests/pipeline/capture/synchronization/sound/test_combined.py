"""Sound and motion together: what one does not tell, the other does, and contradictions."""

import pytest

from pipeline.capture.synchronization.sound.combined import synchronize_with_sound
from pipeline.capture.synchronization.sound.offsets import SoundOffsets
from pipeline.core.data.cameras import Synchronization
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.capture.synchronization.conftest import Take, alone, cut_take, shortened


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


def test_motion_is_finer_than_the_sound_that_agrees() -> None:
    take = cut_take(shortened("room", 5.0), 4, (0, 12, 20))
    found = measured(take, sound_of(take, 0.02))
    assert found == take.synchronized()
    assert offsets(found) == pytest.approx(take.start_s, abs=0.005)


def test_a_contradiction_is_refused_with_the_camera_and_the_time() -> None:
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


def test_people_at_rest_are_synchronised_by_sound_alone_if_it_is_exact() -> None:
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
