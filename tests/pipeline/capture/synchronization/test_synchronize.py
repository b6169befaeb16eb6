"""Clocks of simulated cameras from the people whom they see."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.synchronization.motions import find_motions
from pipeline.capture.synchronization.remaining import MAX_PAIRS, remaining_offsets, strongest_pairs
from pipeline.capture.synchronization.report import error_pictures
from pipeline.capture.synchronization.synchronize import corrected_times
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.motion.script import Gesture
from pipeline.validation.simulation.scenes import find_scene
from tests.pipeline.capture.synchronization.conftest import alone, cut_take, shortened

PERIOD_S = 0.04


def test_offsets_of_three_cameras_within_quarter_of_frame() -> None:
    take = cut_take(shortened("room", 6.0), 4, (10, 0, 25))
    found = take.synchronized()
    offsets_s = [clock.offset_s for clock in found.clocks]
    assert found.is_certain
    np.testing.assert_allclose(offsets_s, take.start_s, atol=PERIOD_S / 4)
    errors_s = np.abs(np.subtract(offsets_s, offsets_s[0]) - np.subtract(take.start_s, take.start_s[0]))
    sigma_s = [clock.sigma_s for clock in found.clocks]
    assert sigma_s[0] == 0.0
    assert np.all(errors_s[1:] < 5.0 * np.array(sigma_s[1:]))
    assert max(sigma_s) < PERIOD_S / 8
    assert {clock.rate for clock in found.clocks} == {1.0}


def test_one_person_and_three_cameras_of_other_rates() -> None:
    scene = replace(shortened("unsynchronised", 8.0), cast=Cast(1, (3.0, 3.0)))
    take = cut_take(scene, 2, (0, 18, 9))
    found = take.synchronized()
    assert found.is_certain
    np.testing.assert_allclose([clock.offset_s for clock in found.clocks], take.start_s, atol=0.01)


def test_offsets_far_beyond_two_seconds_are_found_by_speeds() -> None:
    take = cut_take(shortened("room", 14.0), 1, (0, 110))
    found = take.synchronized()
    assert found.is_certain
    np.testing.assert_allclose([clock.offset_s for clock in found.clocks], take.start_s, atol=PERIOD_S / 4)


def test_corrected_times_give_true_clock() -> None:
    take = cut_take(shortened("room", 6.0), 4, (10, 0, 25))
    corrected = corrected_times(take.times, take.synchronized())
    for camera, start_s in zip(take.cameras, take.start_s, strict=True):
        own_s = take.times[camera.name].time_s
        np.testing.assert_allclose(corrected[camera.name].time_s, own_s + start_s, atol=PERIOD_S / 4)


@pytest.mark.parametrize("gesture", [Gesture.IDLE, Gesture.WAVE, Gesture.JUMP])
def test_still_and_periodic_people_are_refused(gesture: Gesture) -> None:
    found = cut_take(alone(gesture), 1, (0, 12, 20)).synchronized()
    codes = {problem.code for problem in found.refusals}
    assert not found.is_certain
    assert codes <= {"sync_no_motion", "sync_ambiguous"}
    assert "sync_ambiguous" in codes or gesture != Gesture.JUMP
    assert all(problem.camera and problem.hint for problem in found.refusals)


def test_camera_of_another_place_is_refused() -> None:
    take, other = (cut_take(shortened("room", 6.0), seed, (0, 0, 0)) for seed in (4, 5))
    stranger = take.cameras[1].name
    mixed = replace(take, detections={**take.detections, stranger: other.detections[stranger]})
    found = mixed.synchronized()
    assert not found.is_certain
    assert any(stranger in (problem.camera or "") for problem in found.refusals)


def test_nobody_is_refused() -> None:
    take = cut_take(shortened("room", 3.0), 4, (0, 0))
    none = {name: of.within(range(0)) for name, of in take.detections.items()}
    found = replace(take, detections=none).synchronized()
    assert {problem.code for problem in found.refusals} == {"sync_no_motion"}


def test_cameras_without_common_time_are_refused() -> None:
    take = cut_take(shortened("room", 8.0), 4, (0, 110, 0))
    first = take.cameras[0].name
    detections = dict(take.detections)
    for name in (first, take.cameras[2].name):
        detections[name] = detections[name].within(range(100))
    assert not replace(take, detections=detections).synchronized().is_certain


def test_remaining_offsets_name_camera_that_is_late() -> None:
    take = cut_take(shortened("room", 6.0), 4, (0, 0, 2))
    found = remaining_offsets(take.cameras, take.times, take.detections, take.joints)
    assert [one.is_wrong for one in found] == [False, False, True]
    assert found[2].frames == pytest.approx(2.0, abs=0.25)
    still = cut_take(alone(Gesture.IDLE), 1, (0, 0, 2))
    assert remaining_offsets(still.cameras, still.times, still.detections, still.joints) == ()


def test_pairs_of_many_cameras_are_few_and_link_all() -> None:
    take = cut_take(shortened("store", 4.0), 1, (0,) * 12)
    motions = find_motions(take.cameras, take.times, take.detections, take.joints)
    pairs = strongest_pairs(motions, 12)
    assert 11 <= len(pairs) <= 12 * MAX_PAIRS
    reached = {0}
    for _ in pairs:
        reached |= {camera for pair in pairs if reached & set(pair) for camera in pair}
    assert reached == set(range(12))
    # Cameras without people are linked too.
    assert strongest_pairs([], 3) == [(0, 1), (0, 2), (1, 2)]


@pytest.mark.parametrize("late", [0, 5])
def test_remaining_offsets_of_many_cameras_equal_declared_ones(late: int) -> None:
    take = cut_take(shortened("store", 6.0), 1, (0, 0, 0, 0, 0, late, 0, 0))
    found = remaining_offsets(take.cameras, take.times, take.detections, take.joints)
    assert [one.is_wrong for one in found] == [late > 0 and number == 5 for number in range(8)]
    assert found[5].frames == pytest.approx(late, abs=0.25)


def test_pictures_show_valley_at_offset() -> None:
    take = cut_take(shortened("room", 6.0), 4, (0, 10))
    found = take.synchronized()
    evidence = found.evidence[1]
    assert evidence.camera == take.cameras[1].name
    assert evidence.offsets_s[np.argmin(evidence.disagreement)] == pytest.approx(0.4, abs=0.05)
    assert max(np.abs(np.array(evidence.offsets_s) - 0.4)) <= 2.51
    pictures = error_pictures(found)
    assert list(pictures) == [f"sync_{camera.name}.svg" for camera in take.cameras]
    assert "NaN" not in "".join(pictures.values())
    assert f"found {found.clocks[1].offset_s:.4f} s" in pictures[f"sync_{take.cameras[1].name}.svg"]


@pytest.mark.slow
def test_drift_of_five_minutes_within_half_frame_at_its_end() -> None:
    stretch = (1.0, 1.0 + 1e-4, 1.0 - 1e-4, 1.0)
    take = cut_take(replace(find_scene("room"), duration_s=300.0), 0, (0, 12, 25, 5), stretch)
    found = take.synchronized()
    assert found.is_certain
    for clock, start_s, factor in zip(found.clocks, take.start_s, stretch, strict=True):
        assert clock.rate == pytest.approx(1.0 / factor, abs=1e-5)
        own_s = take.times[clock.camera].time_s[-1:]
        np.testing.assert_allclose(clock.session_s(own_s), start_s + own_s / factor, atol=PERIOD_S / 2)
