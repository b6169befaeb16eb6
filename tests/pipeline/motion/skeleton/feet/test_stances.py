"""Feet with heels and toes: accuracy in noise, contacts by part, and parts held in place."""

from functools import cache

import numpy as np
import pytest

from pipeline.core.data.animation import Animation, FootContact, FootPart, Side
from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.core.options.config import Feet, ReconstructionConfig, Smoothing
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.feet.holding import PARTS
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


def test_the_sole_of_a_flat_foot_is_level() -> None:
    flat = np.asarray(walk().stands.all(-1))
    for foot, side in enumerate(("Left", "Right")):
        _, world_from_foot = joint_pose(animated().motions[0], f"{side}Foot")
        tilt_deg = np.degrees(np.arcsin(world_from_foot.apply([0.0, -1.0, 0.0])[flat[:, foot], 2]))
        assert abs(np.median(tilt_deg)) < 2.0


@pytest.mark.parametrize(("side", "part"), PARTS_OF_FEET)
def test_heel_and_toe_stand_while_they_touch_the_floor(side: Side, part: FootPart) -> None:
    stands = walk().stands[:, SIDES.index(side), PARTS.index(part)]
    found = np.zeros(NUM_FRAMES, bool)
    for contact in contacts_of(animated(), side, part):
        assert contact.pinned
        found[contact.rows] = True
    assert found[stands].mean() > 0.8
    near = np.asarray(np.convolve(stands, np.ones(5), mode="same") > 0)
    assert not found[~near].any()


def test_the_heel_lands_first_and_the_toe_leaves_last() -> None:
    heels, toes = (contacts_of(animated(), "left", part) for part in PARTS)
    for heel in heels:
        (toe,) = [one for one in toes if heel.start_frame < one.rows.stop and one.start_frame < heel.rows.stop]
        assert toe.rows.stop > heel.rows.stop
        if heel.start_frame > 0:
            assert toe.start_frame > heel.start_frame


@pytest.mark.parametrize(("side", "part"), PARTS_OF_FEET)
@pytest.mark.parametrize("smoothing", ["fit", "butterworth"])
def test_a_part_that_stands_does_not_slide(side: Side, part: FootPart, smoothing: Smoothing) -> None:
    contacts = contacts_of(animated(smoothing=smoothing), side, part)
    assert contacts
    assert np.mean([one.slide_after_m for one in contacts]) < 0.003
    assert np.mean([one.slide_before_m for one in contacts]) > 0.003


def test_a_foot_whose_toes_are_rarely_seen_stands_as_a_whole() -> None:
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
