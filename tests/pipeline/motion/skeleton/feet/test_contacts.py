"""Floor, contacts and pinning of feet, on ankles in closed form."""

import numpy as np
import pytest

from pipeline.core.data.animation import Floor, FootContact
from pipeline.core.options.config import Feet
from pipeline.motion.skeleton.feet.contacts import find_contacts
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M, estimate_floor
from pipeline.motion.skeleton.feet.holding import held_positions_m, stance_weight

RATE_HZ = 50.0
LEVEL = Floor(0.0, 0.0, 0.0)


def steps(num_steps: int = 4, stance_s: float = 0.6, swing_s: float = 0.4, length_m: float = 1.2) -> np.ndarray:
    """World positions (frames, 2, 3) of the ankles of a walker along X; the right foot is half a stride behind."""
    time_s = np.arange(round(num_steps * (stance_s + swing_s) * RATE_HZ)) / RATE_HZ
    ankles_m = np.zeros((len(time_s), 2, 3))
    for foot, delay_s in enumerate((0.0, (stance_s + swing_s) / 2)):
        number, since_s = np.divmod(time_s + delay_s, stance_s + swing_s)
        share = np.clip((since_s - stance_s) / swing_s, 0.0, 1.0)
        ankles_m[:, foot, 0] = length_m * (number + share * share * (3 - 2 * share))
        ankles_m[:, foot, 1] = 0.1 - 0.2 * foot
        ankles_m[:, foot, 2] = ANKLE_HEIGHT_M + 0.12 * np.sin(np.pi * share) ** 2
    return ankles_m


def found(ankles_m: np.ndarray, feet: Feet = "auto", floor: Floor | None = LEVEL) -> tuple[FootContact, ...]:
    return find_contacts(ankles_m, np.ones(ankles_m.shape[:2], bool), floor, RATE_HZ, feet)


def test_a_walk_s_stances_are_found_and_are_sure() -> None:
    contacts = [contact for contact in found(steps()) if contact.side == "left"]
    assert len(contacts) == 4
    for number, contact in enumerate(contacts):
        assert contact.start_frame == pytest.approx(50 * number, abs=3)
        assert contact.num_frames == pytest.approx(30, abs=4)
        assert contact.confidence > 0.9
        assert contact.pinned


def test_nothing_stands_in_the_air() -> None:
    """Feet are still at the top of a jump, and low before they land."""
    time_s = np.arange(100) / RATE_HZ
    ankles_m = np.zeros((100, 2, 3))
    ankles_m[:, :, 0] = 0.2
    flight_s = np.clip(time_s - 0.6, 0.0, 0.5)
    ankles_m[..., 2] = ANKLE_HEIGHT_M + (2.45 * flight_s - 4.9 * flight_s**2)[:, None]
    in_air = (time_s > 0.62) & (time_s < 1.08)
    for contact in found(ankles_m):
        assert not in_air[contact.rows].any()
    assert len(found(ankles_m)) == 4


def test_who_slides_all_the_time_stands_nowhere() -> None:
    ankles_m = np.zeros((100, 2, 3))
    ankles_m[..., 0] = np.arange(100)[:, None] / RATE_HZ * 0.8
    ankles_m[..., 2] = ANKLE_HEIGHT_M
    assert found(ankles_m) == ()


def test_a_foot_that_creeps_stands_in_several_places() -> None:
    ankles_m = np.zeros((200, 2, 3))
    ankles_m[:, 0, 0] = np.arange(200) / RATE_HZ * 0.05  # 20 cm in four seconds
    ankles_m[..., 2] = ANKLE_HEIGHT_M
    left = [contact for contact in found(ankles_m) if contact.side == "left"]
    assert 2 <= len(left) <= 4
    assert max(contact.slide_before_m for contact in left) < 0.04
    places_m = held_positions_m(ankles_m, left, RATE_HZ)[:, 0]
    assert np.abs(np.diff(places_m[:, 0])).max() < 0.02  # nor does it jump from one to the next


@pytest.mark.parametrize(("feet", "pinned"), [("off", False), ("always", True)])
def test_modes(feet: Feet, pinned: bool) -> None:
    contacts = found(steps(), feet)
    assert contacts
    assert all(contact.pinned is pinned for contact in contacts)


def test_auto_leaves_alone_what_is_not_sure() -> None:
    """Contact of a tenth of a second."""
    brief_m = steps(stance_s=0.12, swing_s=0.6, length_m=2.0)
    auto, always = found(brief_m, "auto"), found(brief_m, "always")
    assert len(always) > 0
    assert [contact.pinned for contact in auto] == [contact.confidence >= 0.5 for contact in auto]
    assert not all(contact.pinned for contact in auto)


def test_what_nobody_saw_stands_nowhere() -> None:
    known = np.ones((200, 2), bool)
    known[:, 0] = False
    contacts = find_contacts(steps(), known, LEVEL, RATE_HZ, "auto")
    assert {contact.side for contact in contacts} == {"right"}
    assert found(steps(), floor=None) == ()


def test_the_floor_is_where_feet_rest() -> None:
    rng = np.random.default_rng(0)
    ankles_m = [steps() + rng.normal(0.0, 0.002, (200, 2, 3)) for _ in range(3)]
    for number, one in enumerate(ankles_m):
        one[..., 1] += number - 1.0
        one[..., 2] += 0.3 + 0.05 * one[..., 0] - 0.03 * one[..., 1]
    ankles_m.append(steps() * [0.0, 1.0, 1.0] + [1.0, 0.0, 0.8])  # somebody on a table
    known = [np.ones((200, 2), bool)] * 4
    floor = estimate_floor(ankles_m, known, RATE_HZ)
    assert floor is not None
    assert floor.z_m == pytest.approx(0.3, abs=0.01)
    assert floor.slope_x == pytest.approx(0.05, abs=0.01)
    assert floor.slope_y == pytest.approx(-0.03, abs=0.01)
    assert floor.tilt_deg == pytest.approx(3.34, abs=0.5)
    np.testing.assert_allclose(floor.height_m(np.array([[1.0, 1.0, 0.32]])), 0.0, atol=0.02)


def test_one_place_says_nothing_of_a_slope() -> None:
    ankles_m = np.zeros((100, 2, 3))
    ankles_m[:, 1, 1], ankles_m[..., 2] = -0.2, ANKLE_HEIGHT_M
    ankles_m[:, 1, 2] += 0.02
    floor = estimate_floor([ankles_m], [np.ones((100, 2), bool)], RATE_HZ)
    assert floor is not None
    assert floor.tilt_deg < 1.5


def test_without_feet_there_is_no_floor_and_without_rest_it_is_the_lowest() -> None:
    assert estimate_floor([], [], RATE_HZ) is None
    ankles_m = steps()
    assert estimate_floor([ankles_m], [np.zeros((200, 2), bool)], RATE_HZ) is None
    hurried_m = steps(stance_s=0.1, swing_s=0.3)
    floor = estimate_floor([hurried_m], [np.ones(hurried_m.shape[:2], bool)], RATE_HZ)
    assert floor is not None
    assert floor.z_m == pytest.approx(0.0, abs=0.03)


def test_feet_are_led_to_their_places_without_a_jump() -> None:
    rng = np.random.default_rng(4)
    drift_m = np.cumsum(rng.normal(0.0, 0.003, (200, 2, 3)), axis=0) * [1.0, 1.0, 0.0]
    ankles_m = steps() + drift_m
    contacts = found(ankles_m)
    places_m = held_positions_m(ankles_m, contacts, RATE_HZ)
    assert np.isnan(places_m[..., 2]).all()  # a standing foot may lift its heel
    for contact in filter(lambda one: one.pinned, contacts):
        foot = 0 if contact.side == "left" else 1
        np.testing.assert_allclose(np.ptp(places_m[contact.rows, foot, :2], axis=0), 0.0, atol=1e-12)
    led_m = np.where(np.isfinite(places_m), places_m, ankles_m) - ankles_m
    assert np.abs(np.diff(led_m[..., :2], axis=0)).max() < 0.02
    assert np.isnan(places_m[:, :, 0]).any()  # in mid-swing a foot is free


def test_a_foot_comes_to_stand_over_a_fifth_of_a_second() -> None:
    contact = FootContact("left", 50, 20, 0.9, pinned=True, slide_before_m=0.0, slide_after_m=0.0)
    share = stance_weight([contact], "left", 100, RATE_HZ)
    assert (share[50:70] == 1.0).all()
    assert (share[:40] == 0.0).all()
    assert (share[80:] == 0.0).all()
    assert np.abs(np.diff(share)).max() < 0.2
    assert (stance_weight([contact], "right", 100, RATE_HZ) == 0.0).all()
