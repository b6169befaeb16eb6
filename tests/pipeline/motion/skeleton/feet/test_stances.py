"""Feet with heels and toes: accuracy in noise, contacts by part, and parts held in place."""

from functools import cache

import numpy as np
import pytest

from pipeline.core.data.animation import Animation, Floor, FootContact, FootPart, Side
from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.core.options.config import Feet, ReconstructionConfig, Smoothing
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M, SIDES, estimate_floor
from pipeline.motion.skeleton.feet.holding import PARTS, held_positions_m, stance_weight
from pipeline.motion.skeleton.feet.stances import find_contacts
from pipeline.motion.skeleton.model import joint_pose
from tests.pipeline.motion.skeleton.feet.gait import RATE_HZ, Gait, gait
from tests.pipeline.motion.skeleton.observed import observe, ring_of

NUM_FRAMES = 120
TIMEBASE = Timebase(0.0, RATE_HZ, NUM_FRAMES)
PARTS_OF_FEET = [(side, part) for side in SIDES for part in PARTS]


@cache
def walk() -> Gait:
    return gait(NUM_FRAMES)


@cache
def animated(feet: Feet = "auto", smoothing: Smoothing = "fit") -> Animation:
    track, seen = observe(ring_of(6), walk().xyz_m, noise_px=3.0)
    config = ReconstructionConfig(feet=feet, smoothing=smoothing)
    return animate([track], [seen], ring_of(6), TIMEBASE, BODY_FEET, config)


def error_m(animation: Animation, *names: str) -> np.ndarray:
    numbers = BODY_FEET.indices(names)
    return np.asarray(np.linalg.norm(animation.tracks[0].xyz_m[:, numbers] - walk().xyz_m[:, numbers], axis=-1))


def contacts_of(animation: Animation, side: Side, part: FootPart) -> list[FootContact]:
    return [one for one in animation.motions[0].contacts if (one.side, one.part) == (side, part)]


def slopes_rad(xyz_m: np.ndarray) -> np.ndarray:
    """Angle of the line from heel to toe below the horizontal, (frames, feet)."""
    line_m = np.stack(
        [
            xyz_m[:, BODY_FEET.index(f"{side}_big_toe")] - xyz_m[:, BODY_FEET.index(f"{side}_heel")]
            for side in ("left", "right")
        ],
        axis=1,
    )
    return np.asarray(-np.arctan2(line_m[..., 2], np.linalg.norm(line_m[..., :2], axis=-1)))


@pytest.mark.parametrize("feet", ["off", "auto"])
def test_heels_toes_and_pitch_are_accurate_in_noise(feet: Feet) -> None:
    animation = animated(feet)
    assert error_m(animation, "left_heel", "right_heel").mean() < 0.012
    assert error_m(animation, "left_big_toe", "right_big_toe").mean() < 0.012
    found, true = slopes_rad(animation.tracks[0].xyz_m), slopes_rad(walk().xyz_m)
    assert np.degrees(np.abs(found - true)).mean() < 3.0


def test_sole_of_flat_foot_is_level() -> None:
    flat = np.asarray(walk().stands.all(-1))
    for foot, side in enumerate(("Left", "Right")):
        _, world_from_foot = joint_pose(animated().motions[0], f"{side}Foot")
        tilt_deg = np.degrees(np.arcsin(world_from_foot.apply([0.0, -1.0, 0.0])[flat[:, foot], 2]))
        assert abs(np.median(tilt_deg)) < 2.0


@pytest.mark.parametrize(("side", "part"), PARTS_OF_FEET)
def test_heel_and_toe_stand_while_they_touch_floor(side: Side, part: FootPart) -> None:
    stands = walk().stands[:, SIDES.index(side), PARTS.index(part)]
    found = np.zeros(NUM_FRAMES, bool)
    for contact in contacts_of(animated(), side, part):
        assert contact.pinned
        found[contact.rows] = True
    assert found[stands].mean() > 0.8
    near = np.asarray(np.convolve(stands, np.ones(5), mode="same") > 0)
    assert not found[~near].any()


def test_heel_lands_first_and_toe_leaves_last() -> None:
    heels, toes = (contacts_of(animated(), "left", part) for part in PARTS)
    for heel in heels:
        (toe,) = [one for one in toes if heel.start_frame < one.rows.stop and one.start_frame < heel.rows.stop]
        assert toe.rows.stop > heel.rows.stop
        if heel.start_frame > 0:
            assert toe.start_frame > heel.start_frame


@pytest.mark.parametrize(("side", "part"), PARTS_OF_FEET)
@pytest.mark.parametrize("smoothing", ["fit", "butterworth"])
def test_part_that_stands_does_not_slide(side: Side, part: FootPart, smoothing: Smoothing) -> None:
    contacts = contacts_of(animated(smoothing=smoothing), side, part)
    assert contacts
    assert np.mean([one.slide_after_m for one in contacts]) < 0.003
    assert np.mean([one.slide_before_m for one in contacts]) > 0.003


def test_foot_whose_toes_are_rarely_seen_stands_as_whole() -> None:
    true_m = walk().xyz_m.copy()
    hidden = BODY_FEET.indices(("left_heel", "left_big_toe"))
    true_m[10:, hidden] = np.nan
    track, seen = observe(ring_of(6), true_m, noise_px=1.0)
    animation = animate([track], [seen], ring_of(6), TIMEBASE, BODY_FEET, ReconstructionConfig())
    parts = {side: {one.part for one in animation.motions[0].contacts if one.side == side} for side in SIDES}
    assert parts == {"left": {"foot"}, "right": {"heel", "toe"}}


def test_without_heels_and_toes_feet_stand_as_wholes() -> None:
    track, seen = observe(ring_of(6), walk().xyz_m[:, : len(COCO_17.names)], noise_px=1.0)
    animation = animate([track], [seen], ring_of(6), TIMEBASE, COCO_17, ReconstructionConfig())
    assert {one.part for one in animation.motions[0].contacts} == {"foot"}


def test_nothing_jumps_where_heels_and_toes_are_held() -> None:
    def fastest_m(animation: Animation) -> float:
        feet = BODY_FEET.indices(("left_heel", "right_heel", "left_big_toe", "right_big_toe"))
        return float(np.linalg.norm(np.diff(animation.tracks[0].xyz_m[:, feet], n=2, axis=0), axis=-1).max())

    assert fastest_m(animated()) < 1.5 * fastest_m(animated("off"))


STEPS_HZ = 50.0
LEVEL = Floor(0.0, 0.0, 0.0)


def steps(num_steps: int = 4, stance_s: float = 0.6, swing_s: float = 0.4, length_m: float = 1.2) -> np.ndarray:
    """World positions (frames, 2, 3) of the ankles of a walker along X; the right foot is half a stride behind."""
    time_s = np.arange(round(num_steps * (stance_s + swing_s) * STEPS_HZ)) / STEPS_HZ
    ankles_m = np.zeros((len(time_s), 2, 3))
    for foot, delay_s in enumerate((0.0, (stance_s + swing_s) / 2)):
        number, since_s = np.divmod(time_s + delay_s, stance_s + swing_s)
        share = np.clip((since_s - stance_s) / swing_s, 0.0, 1.0)
        ankles_m[:, foot, 0] = length_m * (number + share * share * (3 - 2 * share))
        ankles_m[:, foot, 1] = 0.1 - 0.2 * foot
        ankles_m[:, foot, 2] = ANKLE_HEIGHT_M + 0.12 * np.sin(np.pi * share) ** 2
    return ankles_m


def found(ankles_m: np.ndarray, feet: Feet = "auto", floor: Floor | None = LEVEL) -> tuple[FootContact, ...]:
    return find_contacts(ankles_m, np.ones(ankles_m.shape[:2], bool), floor, STEPS_HZ, feet)


def test_walk_s_stances_are_found_and_are_sure() -> None:
    contacts = [contact for contact in found(steps()) if contact.side == "left"]
    assert len(contacts) == 4
    for number, contact in enumerate(contacts):
        assert contact.start_frame == pytest.approx(50 * number, abs=3)
        assert contact.num_frames == pytest.approx(30, abs=4)
        assert contact.confidence > 0.9
        assert contact.pinned


def test_nothing_stands_in_air() -> None:
    """Feet are still at the top of a jump, and low before they land."""
    time_s = np.arange(100) / STEPS_HZ
    ankles_m = np.zeros((100, 2, 3))
    ankles_m[:, :, 0] = 0.2
    flight_s = np.clip(time_s - 0.6, 0.0, 0.5)
    ankles_m[..., 2] = ANKLE_HEIGHT_M + (2.45 * flight_s - 4.9 * flight_s**2)[:, None]
    in_air = (time_s > 0.62) & (time_s < 1.08)
    for contact in found(ankles_m):
        assert not in_air[contact.rows].any()
    assert len(found(ankles_m)) == 4


def test_sliding_person_stands_nowhere() -> None:
    ankles_m = np.zeros((100, 2, 3))
    ankles_m[..., 0] = np.arange(100)[:, None] / STEPS_HZ * 0.8
    ankles_m[..., 2] = ANKLE_HEIGHT_M
    assert found(ankles_m) == ()


def test_foot_that_creeps_stands_in_several_places() -> None:
    ankles_m = np.zeros((200, 2, 3))
    ankles_m[:, 0, 0] = np.arange(200) / STEPS_HZ * 0.05  # 20 cm in four seconds
    ankles_m[..., 2] = ANKLE_HEIGHT_M
    left = [contact for contact in found(ankles_m) if contact.side == "left"]
    assert 2 <= len(left) <= 4
    assert max(contact.slide_before_m for contact in left) < 0.04
    places_m = held_positions_m(ankles_m, left, STEPS_HZ)[:, 0]
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


def test_unseen_feet_stand_nowhere() -> None:
    known = np.ones((200, 2), bool)
    known[:, 0] = False
    contacts = find_contacts(steps(), known, LEVEL, STEPS_HZ, "auto")
    assert {contact.side for contact in contacts} == {"right"}
    assert found(steps(), floor=None) == ()


def test_floor_is_where_feet_rest() -> None:
    rng = np.random.default_rng(0)
    ankles_m = [steps() + rng.normal(0.0, 0.002, (200, 2, 3)) for _ in range(3)]
    for number, one in enumerate(ankles_m):
        one[..., 1] += number - 1.0
        one[..., 2] += 0.3 + 0.05 * one[..., 0] - 0.03 * one[..., 1]
    ankles_m.append(steps() * [0.0, 1.0, 1.0] + [1.0, 0.0, 0.8])  # somebody on a table
    known = [np.ones((200, 2), bool)] * 4
    floor = estimate_floor(ankles_m, known, STEPS_HZ)
    assert floor is not None
    assert floor.z_m == pytest.approx(0.3, abs=0.01)
    assert floor.slope_x == pytest.approx(0.05, abs=0.01)
    assert floor.slope_y == pytest.approx(-0.03, abs=0.01)
    assert floor.tilt_deg == pytest.approx(3.34, abs=0.5)
    np.testing.assert_allclose(floor.height_m(np.array([[1.0, 1.0, 0.32]])), 0.0, atol=0.02)


def test_one_place_says_nothing_of_slope() -> None:
    ankles_m = np.zeros((100, 2, 3))
    ankles_m[:, 1, 1], ankles_m[..., 2] = -0.2, ANKLE_HEIGHT_M
    ankles_m[:, 1, 2] += 0.02
    floor = estimate_floor([ankles_m], [np.ones((100, 2), bool)], STEPS_HZ)
    assert floor is not None
    assert floor.tilt_deg < 1.5


def test_floor_without_feet_is_none_without_rest_lowest() -> None:
    assert estimate_floor([], [], STEPS_HZ) is None
    ankles_m = steps()
    assert estimate_floor([ankles_m], [np.zeros((200, 2), bool)], STEPS_HZ) is None
    hurried_m = steps(stance_s=0.1, swing_s=0.3)
    floor = estimate_floor([hurried_m], [np.ones(hurried_m.shape[:2], bool)], STEPS_HZ)
    assert floor is not None
    assert floor.z_m == pytest.approx(0.0, abs=0.03)


def test_feet_are_led_to_their_places_without_jump() -> None:
    rng = np.random.default_rng(4)
    drift_m = np.cumsum(rng.normal(0.0, 0.003, (200, 2, 3)), axis=0) * [1.0, 1.0, 0.0]
    ankles_m = steps() + drift_m
    contacts = found(ankles_m)
    places_m = held_positions_m(ankles_m, contacts, STEPS_HZ)
    assert np.isnan(places_m[..., 2]).all()  # a standing foot may lift its heel
    for contact in filter(lambda one: one.pinned, contacts):
        foot = 0 if contact.side == "left" else 1
        np.testing.assert_allclose(np.ptp(places_m[contact.rows, foot, :2], axis=0), 0.0, atol=1e-12)
    led_m = np.where(np.isfinite(places_m), places_m, ankles_m) - ankles_m
    assert np.abs(np.diff(led_m[..., :2], axis=0)).max() < 0.02
    assert np.isnan(places_m[:, :, 0]).any()  # in mid-swing a foot is free


def test_foot_comes_to_stand_over_fifth_of_second() -> None:
    contact = FootContact("left", 50, 20, 0.9, pinned=True, slide_before_m=0.0, slide_after_m=0.0)
    share = stance_weight([contact], "left", 100, STEPS_HZ)
    assert (share[50:70] == 1.0).all()
    assert (share[:40] == 0.0).all()
    assert (share[80:] == 0.0).all()
    assert np.abs(np.diff(share)).max() < 0.2
    assert (stance_weight([contact], "right", 100, STEPS_HZ) == 0.0).all()
