"""Feet that carry somebody, that hang, ride along, or stand on a belt; and the floor under them."""

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from pipeline.core.data.animation import Floor, FootContact
from pipeline.core.data.people import Track3D
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M, shared_floor
from pipeline.motion.skeleton.feet.stances import find_contacts
from pipeline.motion.skeleton.feet.support import FootMarks, Support, find_support
from pipeline.validation.simulation.scenes import record
from tests.acrobatics.acrobat import feet_on_floor
from tests.acrobatics.scenes import ACROBATIC_SCENES
from tests.cases import slow_but
from tests.pipeline.association.identity.test_likenesses import track
from tests.pipeline.motion.skeleton.feet.test_stances import STEPS_HZ, steps
from tests.pipeline.motion.skeleton.observed import observe

ANKLES = COCO_17.indices(("left_ankle", "right_ankle"))
# Heights of joints above the ankles of a standing person; arms hang.
HEIGHTS_M: Mapping[str, float] = {
    "hip": 0.82,
    "knee": 0.41,
    "shoulder": 1.32,
    "elbow": 1.05,
    "wrist": 0.8,
    "ankle": 0.0,
}


def body(ankles_m: np.ndarray, hips_m: np.ndarray | None = None, heights_m: Mapping[str, float] = HEIGHTS_M) -> Track3D:
    """Person over ankles, or above hips (frames, 3) that move by themselves."""
    xyz_m = np.full((len(ankles_m), 17, 3), np.nan)
    middle_m = ankles_m.mean(1) if hips_m is None else hips_m - [0.0, 0.0, heights_m["hip"]]
    for name, height_m in heights_m.items():
        for foot, side in enumerate(("left", "right")):
            xyz_m[:, COCO_17.index(f"{side}_{name}")] = middle_m + np.array([0.0, 0.1 - 0.2 * foot, height_m])
    xyz_m[:, list(ANKLES)] = ankles_m
    return track(xyz_m, noise_m=0.003)


def found(person: Track3D, rate_hz: float = STEPS_HZ) -> tuple[Support, Floor | None, tuple[FootContact, ...]]:
    ankles_m = person.xyz_m[:, list(ANKLES)]
    known = np.isfinite(ankles_m).all(-1)
    support = find_support(person, COCO_17, ankles_m, known, FootMarks.none(len(ankles_m)), rate_hz)
    floor = shared_floor([ankles_m], [known], [support.carries], rate_hz)
    on_ground_m = ankles_m - support.ground_m[:, None]
    return support, floor, find_contacts(on_ground_m, known, floor, rate_hz, "auto", support=support)


NUM_STANCES = 13  # Seven of the right foot: the walk begins and ends in one


def walking(num_steps: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Ankles and hips of a walk over the ground."""
    ankles_m = steps(num_steps)
    hips_m = np.zeros((len(ankles_m), 3))
    hips_m[:, 0] = 1.2 * np.arange(len(ankles_m)) / STEPS_HZ + 0.3
    hips_m[:, 2] = 0.88 + 0.02 * np.sin(4 * np.pi * np.arange(len(ankles_m)) / STEPS_HZ)
    return ankles_m, hips_m


@pytest.mark.parametrize("hanging_m", [0.3, 0.05])
def test_bar_with_feet_below_it_is_no_floor(hanging_m: float) -> None:
    """Somebody stands on a bar, and then hangs from another one with the feet below the first."""
    ankles_m = np.zeros((180, 2, 3))
    ankles_m[..., 1] = [0.1, -0.1]
    ankles_m[:, :, 2] = 0.6 + ANKLE_HEIGHT_M
    stands = body(ankles_m)
    ankles_m[90:, :, 2] = hanging_m + ANKLE_HEIGHT_M
    hangs = body(ankles_m, heights_m={**HEIGHTS_M, "elbow": 1.6, "wrist": 1.9})
    xyz_m = np.concatenate([stands.xyz_m[:90], hangs.xyz_m[90:]])
    support, floor, contacts = found(track(xyz_m, noise_m=0.0))
    assert support.carries[10:25].all()
    assert floor is not None
    assert floor.z_m == 0.0
    assert not any(contact.start_frame < 90 for contact in contacts)


@pytest.mark.parametrize("height_m", [0.0, 0.6, -0.4])
def test_walk_carries_its_floor(height_m: float) -> None:
    ankles_m, hips_m = walking()
    up_m = np.array([0.0, 0.0, height_m])
    support, floor, contacts = found(body(ankles_m + up_m, hips_m + up_m))
    assert (support.ground_m == 0.0).all()
    assert floor is not None
    assert floor.z_m == pytest.approx(height_m, abs=0.02)
    assert len(contacts) == NUM_STANCES
    assert all(contact.pinned for contact in contacts[2:])


@pytest.mark.parametrize("belt_m_s", [(-0.35, 0.0), (-0.9, 0.9), (3.0, 0.0)])
def test_foot_on_belt_has_one_contact_stance(belt_m_s: tuple[float, float]) -> None:
    ankles_m, hips_m = walking()
    # A walk at the speed of the belt, against it.
    speed_m_s = float(np.hypot(*belt_m_s))
    ahead = -np.array([*belt_m_s, 0.0]) / speed_m_s
    way_m = ankles_m[..., :1] * speed_m_s / 1.2 * ahead
    ground_m = np.arange(len(ankles_m))[:, None] / STEPS_HZ * np.array([*belt_m_s, 0.0])
    on_belt_m = ankles_m * [0.0, 1.0, 1.0] + way_m + ground_m[:, None]
    support, _, contacts = found(body(on_belt_m, hips_m * [0.0, 0.0, 1.0]))
    np.testing.assert_allclose(np.diff(support.ground_m[:, :2], axis=0) * STEPS_HZ, [belt_m_s] * 299, atol=0.06)
    assert NUM_STANCES - 1 <= len(contacts) <= NUM_STANCES
    whole = [contact for contact in contacts if 0 < contact.start_frame < 260]
    assert all(contact.pinned and contact.num_frames == pytest.approx(30, abs=8) for contact in whole)
    assert max(contact.slide_before_m for contact in contacts) < 0.03


def test_person_sliding_away_is_on_no_belt() -> None:
    ankles_m = np.zeros((200, 2, 3))
    ankles_m[..., 0] = np.arange(200)[:, None] / STEPS_HZ * 0.5
    ankles_m[..., 2] = 0.065
    support, _, contacts = found(body(ankles_m))
    assert (support.ground_m == 0.0).all()
    assert contacts == ()


@pytest.mark.parametrize("turns_hz", [0.7, 1.5])
def test_pedals_are_no_belt(turns_hz: float) -> None:
    angle_rad = 2 * np.pi * turns_hz * np.arange(400)[:, None] / STEPS_HZ + np.array([0.0, np.pi])
    ankles_m = np.zeros((400, 2, 3)) + np.array([0.0, 0.1, 0.35])
    ankles_m[..., 0], ankles_m[..., 2] = 0.17 * np.cos(angle_rad), 0.35 + 0.17 * np.sin(angle_rad)
    support, _, contacts = found(body(ankles_m, np.tile([-0.2, 0.0, 1.0], (400, 1))))
    assert (support.ground_m == 0.0).all()
    assert contacts == ()


def swinging(amplitude_m: float) -> np.ndarray:
    """Ankles half a metre above the floor that go up and down with the body."""
    ankles_m = np.full((300, 2, 3), 0.55)
    ankles_m[..., 2] += amplitude_m * (1.0 - np.cos(2 * np.pi * 0.4 * np.arange(300) / STEPS_HZ))[:, None]
    return ankles_m


@pytest.mark.parametrize("wrist_m", [1.7, 0.75])
def test_people_who_pull_themselves_up_do_not_stand(wrist_m: float) -> None:
    """On a bar, and on parallel bars."""
    support, floor, contacts = found(body(swinging(0.15), heights_m={**HEIGHTS_M, "wrist": wrist_m}))
    assert not support.carries.any() or wrist_m < 1.0
    assert contacts == ()
    assert floor is not None
    assert floor.z_m == 0.0 or wrist_m < 1.0


def test_people_who_hang_still_do_not_stand() -> None:
    _, floor, contacts = found(body(swinging(0.0), heights_m={**HEIGHTS_M, "wrist": 1.75}))
    assert floor == Floor(0.0, 0.0, 0.0)
    assert contacts == ()


def test_people_who_only_lie_have_floor_of_world() -> None:
    lying_m = dict.fromkeys(HEIGHTS_M, 0.05)
    still_m = np.full((200, 2, 3), 0.06)
    assert found(body(still_m, heights_m=lying_m))[1] == Floor(0.0, 0.0, 0.0)
    assert found(body(still_m - [0.0, 0.0, 0.5], heights_m=lying_m))[1] is None  # the world's level is no floor


def test_feet_that_are_dragged_do_not_stand() -> None:
    """Feet of somebody who lies, at a pace at which the feet of upright people stand."""
    lying_m = {**dict.fromkeys(HEIGHTS_M, 0.0), "knee": -0.05}
    ankles_m = np.full((200, 2, 3), 0.05)
    angle_rad = 3.0 * np.arange(200)[:, None] / STEPS_HZ
    ankles_m[..., 0] += 0.05 * np.cos(angle_rad)
    ankles_m[..., 1] += 0.05 * np.sin(angle_rad)
    hips_m = np.tile([0.0, 0.0, 0.1], (200, 1))
    assert found(body(ankles_m, hips_m, lying_m))[2] == ()
    assert found(body(ankles_m, hips_m * 8.7))[2] != ()
    ankles_m[..., :2] = 0.05
    assert len(found(body(ankles_m, hips_m, lying_m))[2]) == 2


@cache
def acrobat(scene: str, seed: int) -> tuple[tuple[FootContact, ...], np.ndarray]:
    """Contacts of a person in a simulated scene, and where heels, toes and insteps are on the floor."""
    simulation = record(ACROBATIC_SCENES[scene], seed, 5, "feet")
    truth_m = simulation.truth_m[-1]
    person, seen = observe(simulation.cameras, truth_m[:, :17], 2.5, seed=seed)
    config = ReconstructionConfig()
    animation = animate([person], [seen], simulation.cameras, simulation.timebase, COCO_17, config)
    return animation.motions[0].contacts, feet_on_floor(truth_m, simulation.timebase.frame_rate_hz)


@pytest.mark.parametrize(
    ("scene", "num_contacts"), slow_but([("kneel", 2)], [("pull-up", 0), ("cartwheel", 4), ("kneel", 2)])
)
def test_contacts_of_acrobats_are_true(scene: str, num_contacts: int) -> None:
    contacts, on_floor = acrobat(scene, 21)
    assert BODY_FEET.names[:17] == COCO_17.names
    held = [contact for contact in contacts if contact.pinned]
    assert len(held) == num_contacts
    for contact in held:
        assert on_floor[contact.rows, int(contact.side == "right")].any(-1).mean() > 0.7
