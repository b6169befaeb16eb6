"""Acrobats: bones of constant length, planted points in place, nothing below the floor, and poses as named."""

from functools import cache

import numpy as np
import pytest
from jaxtyping import Float

from pipeline.core.joints import BODY_FEET, COCO_17, LIMBS
from pipeline.validation.simulation.motion.body import random_proportions
from pipeline.validation.simulation.motion.feet import random_foot_shape
from tests.acrobatics.acrobat import (
    Acrobat,
    acrobat_joints_at,
    feet_on_floor,
    perform_acrobatics,
)
from tests.acrobatics.anatomy import ANGLE_LIMITS_DEG, CLEARANCE_M, POINTS, points_m
from tests.acrobatics.key_poses import reference_motion, vary
from tests.acrobatics.motions import ACROBATICS
from tests.cases import slow_but

RATE_HZ = 50.0
SEED = 11


@cache
def performed(name: str) -> tuple[Acrobat, ...]:
    rng = np.random.default_rng(SEED)
    parts = ACROBATICS[name]
    return tuple(
        perform_acrobatics(part.keys, part.center_m, np.radians(part.facing_deg), part.keys[-1].time_s, rng)
        for part in parts
    )


def times_s(acrobat: Acrobat) -> Float[np.ndarray, " times"]:
    return np.arange(0.0, acrobat.motion.x[-1], 1 / RATE_HZ)


def joints_m(name: str, person: int = 0) -> Float[np.ndarray, "times 21 3"]:
    acrobat = performed(name)[person]
    return acrobat_joints_at(acrobat, times_s(acrobat), BODY_FEET)


def bend_deg(positions_m: Float[np.ndarray, "times 21 3"], *names: str) -> Float[np.ndarray, " times"]:
    above, middle, below = (positions_m[:, BODY_FEET.index(name)] for name in names)
    cos = ((above - middle) * (below - middle)).sum(-1)
    cos /= np.linalg.norm(above - middle, axis=-1) * np.linalg.norm(below - middle, axis=-1)
    return np.asarray(180.0 - np.degrees(np.arccos(np.clip(cos, -1.0, 1.0))))


@pytest.mark.parametrize("name", slow_but(["grappling"], ACROBATICS))
def test_bodies_are_plausible(name: str) -> None:
    for person, acrobat in enumerate(performed(name)):
        positions_m = joints_m(name, person)
        for above, below in LIMBS:
            bone_m = positions_m[:, BODY_FEET.index(above)] - positions_m[:, BODY_FEET.index(below)]
            np.testing.assert_allclose(np.linalg.norm(bone_m, axis=-1), np.linalg.norm(bone_m[0]), atol=1e-9)
        assert (positions_m[..., 2] > CLEARANCE_M[: len(BODY_FEET.names)] - 0.03).all()
        acceleration_m_s2 = np.linalg.norm(np.diff(positions_m, n=2, axis=0), axis=-1) * RATE_HZ**2
        assert np.percentile(acceleration_m_s2, 99) < 90.0
        limits_deg = np.array([*ANGLE_LIMITS_DEG.values()])
        angles_deg = np.degrees(acrobat.motion(times_s(acrobat))[:, 3:])
        assert ((angles_deg > limits_deg[:, 0] - 3.0) & (angles_deg < limits_deg[:, 1] + 3.0)).all()


@pytest.mark.parametrize("name", slow_but(["handstand"], ACROBATICS))
def test_planted_points_stay_in_place(name: str) -> None:
    part, acrobat = ACROBATICS[name][0], performed(name)[0]
    # The same draws as those of the performance.
    rng = np.random.default_rng(SEED)
    random_foot_shape(random_proportions(rng), rng)
    reference = reference_motion(
        vary(part.keys, rng), acrobat.body, part.center_m, np.radians(part.facing_deg), times_s(acrobat)
    )
    assert len(reference.planted) >= 2
    positions_m = points_m(acrobat.body, *np.split(acrobat.motion(times_s(acrobat)), [3], axis=1))
    for run in reference.planted:
        # The movement is soft where a point lands and leaves.
        inside = (times_s(acrobat) > run.start_s + 0.1) & (times_s(acrobat) < run.stop_s - 0.1)
        point_m = positions_m[inside, POINTS.index(run.point)]
        assert np.linalg.norm(point_m - run.place_m, axis=-1).max(initial=0.0) < 0.02
        assert len(point_m) == 0 or np.ptp(point_m, axis=0).max() < 0.01


def test_poses_are_those_of_motions() -> None:
    up = np.array([0.0, 0.0, 1.0])

    def trunk(name: str) -> Float[np.ndarray, "times 3"]:
        positions_m = joints_m(name)
        shoulders_m, hips_m = (
            positions_m[:, BODY_FEET.indices((f"left_{kind}", f"right_{kind}"))].mean(1) for kind in ("shoulder", "hip")
        )
        return (shoulders_m - hips_m) / np.linalg.norm(shoulders_m - hips_m, axis=-1, keepdims=True)

    assert (np.abs(trunk("lying") @ up) < 0.3).all()
    assert (np.abs(trunk("crawl") @ up) < 0.5).all()
    for name in ("cartwheel", "handstand", "roll"):
        assert (trunk(name) @ up).min() < -0.7
        assert (trunk(name) @ up).max() > 0.9
    kneeling = bend_deg(joints_m("kneel"), "left_hip", "left_knee", "left_ankle")
    assert 160.0 < kneeling.max() < 168.0
    pulling = joints_m("pull-up")
    assert pulling[..., 2].min() > 0.1
    hips_m = pulling[:, BODY_FEET.index("left_hip"), 2]
    assert np.ptp(hips_m) > 0.25
    assert np.ptp(pulling[:, BODY_FEET.index("left_wrist")], axis=0).max() < 0.01


def test_two_who_grapple_are_close() -> None:
    apart_m = np.linalg.norm(joints_m("grappling")[:, :, None] - joints_m("grappling", 1)[:, None], axis=-1)
    assert np.median(apart_m.min((1, 2))) < 0.2
    assert apart_m.min() > 0.005


def test_contacts_of_feet_are_known() -> None:
    standing = feet_on_floor(joints_m("handstand"), RATE_HZ)
    inverted = joints_m("handstand")[:, BODY_FEET.index("left_ankle"), 2] > 1.2
    assert standing[:10, :, :2].all()
    assert not standing[:10, :, 2].any()
    assert inverted.sum() > 20
    assert not standing[inverted].any()
    assert not feet_on_floor(joints_m("pull-up"), RATE_HZ).any()
    # A kneeling person's feet lie on their insteps.
    heel, _, instep = np.moveaxis(feet_on_floor(joints_m("kneel"), RATE_HZ), -1, 0)
    assert instep.mean() > 0.9
    assert not heel.any()


def test_seeds_vary_bodies_and_motions() -> None:
    keys = ACROBATICS["kneel"][0].keys
    first, second = (
        acrobat_joints_at(
            perform_acrobatics(keys, (0.0, 0.0), 0.0, 0.5, np.random.default_rng(seed)), np.zeros(1), COCO_17
        )
        for seed in (1, 2)
    )
    assert np.linalg.norm(first - second, axis=-1).max() > 0.05
