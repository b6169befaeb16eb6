"""Forces of simulated people, whose true forces are known."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from pipeline.core.data.animation import Side
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import LaboratoryStart
from pipeline.core.data.reconstruction import Subject
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces import feet
from pipeline.motion.forces.body_mass import body_mass, mass_by_stature_kg, stature_m
from pipeline.motion.forces.feet import find_stances
from pipeline.motion.forces.joint_moments import MOMENT_NAMES, joint_moments
from pipeline.motion.forces.person_forces import PersonForces, forces_document, forces_of, touching
from pipeline.motion.forces.whole_body import body_in_motion
from pipeline.motion.gait.events import FootEvent, Swing
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.forces.physical_people import estimated, solved, truth_of
from tests.pipeline.motion.gait.walks import Act, body_only, exercise, walk
from tests.pipeline.motion.laboratory.simulated_plates import MASS_KG, plates_m, simulated

WALK, SQUAT = walk(1.2), exercise(Gesture.SQUAT)
JUMP = exercise(Gesture.COUNTERMOVEMENT_JUMP)


def errors_bw(act: Act, forces: PersonForces) -> np.ndarray:
    return (forces.total - truth_of(act).force) / GRAVITY_M_S2


def test_force_on_body_is_near_true_force() -> None:
    of_walk, of_squat = (np.sqrt((errors_bw(act, estimated(act)) ** 2).mean(0)) for act in (WALK, SQUAT))
    assert of_walk[2] < 0.06
    assert (of_walk[:2] < 0.03).all()
    assert (of_squat < 0.02).all()


def test_mass_scales_all_forces_and_widens_deviations() -> None:
    each, whole = estimated(SQUAT), estimated(SQUAT, mass_kg=80.0)
    np.testing.assert_allclose(whole.total, 80.0 * each.total)
    np.testing.assert_allclose(whole.joints.moment, 80.0 * each.joints.moment)
    np.testing.assert_allclose(whole.feet.force, 80.0 * each.feet.force)
    assert whole.weight == pytest.approx(80.0 * GRAVITY_M_S2)
    # A stated mass is 1 % off.
    np.testing.assert_allclose(whole.total_sigma, 80.0 * np.hypot(each.total_sigma, 0.01 * each.total))
    np.testing.assert_allclose(whole.joints.sigma, 80.0 * np.hypot(each.joints.sigma, 0.01 * each.joints.moment))


def test_mass_that_is_not_stated_follows_stature() -> None:
    motion = solved(SQUAT).motions[0]
    longer = replace(motion, bone_length_m=1.1 * motion.bone_length_m)
    guess, taller = (body_mass(Subject(), of) for of in (motion, longer))
    assert guess.is_estimated
    assert guess.kg == pytest.approx(18.7 * stature_m(motion) ** 2.5)
    assert taller.kg == pytest.approx(1.1**2.5 * guess.kg)
    # Means of the 4,082 men and 1,986 women of ANSUR II.
    for height_m, mean_kg in ((1.756, 85.5), (1.628, 67.8)):
        assert mass_by_stature_kg(height_m) == pytest.approx(mean_kg, rel=guess.sigma_kg / guess.kg)
    assert body_mass(Subject(mass_kg=50.0), motion)[::2] == (50.0, False)
    forces = estimated(SQUAT).in_newtons()
    weight_n = np.median(forces.total[:, 2])
    assert weight_n == pytest.approx(guess.kg * GRAVITY_M_S2, rel=0.02)
    assert np.median(forces.total_sigma[:, 2]) > 0.16 * weight_n


@pytest.mark.parametrize("act", [WALK, SQUAT, JUMP], ids=["walk", "squat", "jump"])
def test_feet_carry_the_force_on_the_body(act: Act) -> None:
    forces = estimated(act)
    stands = forces.feet.stands.any(1)
    np.testing.assert_allclose(forces.feet.force[stands].sum(1), forces.total[stands], atol=1e-6)
    assert (forces.feet.force[~forces.feet.stands] == 0.0).all()
    assert np.isnan(forces.feet.pressure_m[~forces.feet.stands]).all()
    assert (forces.feet.force[..., 2] >= 0.0).all()


def test_one_foot_carries_all_in_the_middle_of_a_swing() -> None:
    forces = estimated(WALK)
    marks = ("left_heel", "right_heel", "left_big_toe", "right_big_toe")
    heights_m = truth_of(WALK).xyz_m[:, WALK.joints.indices(marks), 2].reshape(-1, 2, 2).min(1)
    lifted = np.abs(heights_m[:, 0] - heights_m[:, 1]) > 0.04
    assert lifted.sum() > 10
    lower = heights_m[lifted].argmin(1)
    upper_force = forces.feet.force[lifted, 1 - lower, 2]
    assert (upper_force == 0.0).mean() > 0.95


def test_centre_of_pressure_is_below_standing_feet() -> None:
    forces, xyz_m = estimated(SQUAT), truth_of(SQUAT).xyz_m
    for column, side in enumerate(("left", "right")):
        heel_m, toe_m = (xyz_m[:, SQUAT.joints.index(f"{side}_{mark}"), :2] for mark in ("heel", "big_toe"))
        apart_m = np.linalg.norm(forces.feet.pressure_m[:, column, :2] - (heel_m + toe_m) / 2.0, axis=1)
        assert np.nanmax(apart_m) < 0.16


def test_force_stays_behind_the_ball_of_a_foot_that_leaves() -> None:
    forces, xyz_m = estimated(WALK), truth_of(WALK).xyz_m
    for column, side in enumerate(("left", "right")):
        heel_m, toe_m = (xyz_m[:, WALK.joints.index(f"{side}_{mark}"), :2] for mark in ("heel", "big_toe"))
        along_m = toe_m - heel_m
        place = ((forces.feet.pressure_m[:, column, :2] - heel_m) * along_m).sum(1) / (along_m**2).sum(1)
        assert 0.8 < np.nanmax(place) < 0.9
        assert np.nanmin(place) < 0.1


def test_flight_has_no_force_and_residual_is_stated() -> None:
    forces = estimated(JUMP)
    assert forces.flies.sum() > 60
    assert np.abs(forces.total[forces.flies] / GRAVITY_M_S2).max() < 0.04
    assert abs(forces.flight_residual) < 0.15
    assert np.isnan(estimated(SQUAT).flight_residual)


def test_flight_at_the_end_of_the_take_has_no_force() -> None:
    animation, stop = solved(JUMP), int(np.flatnonzero(truth_of(JUMP).flies)[12])
    motion, track = animation.motions[0], animation.tracks[0].part(slice(0, stop))
    contacts = tuple(contact for contact in motion.contacts if contact.rows.stop < stop)
    cut = replace(
        motion, root_m=motion.root_m[:stop], parent_from_joint=motion.parent_from_joint[:stop], contacts=contacts
    )
    forces = forces_of(cut, track, JUMP.joints, Subject(), animation.floor)
    assert forces is not None
    assert forces.flies[-5:].all()
    assert np.abs(forces.total[-5:]).max() < 0.04 * GRAVITY_M_S2
    assert np.isfinite(forces.flight_residual)


def test_seat_carries_what_is_behind_the_feet() -> None:
    act = exercise(Gesture.SIT)
    forces, height_m = estimated(act), truth_of(act).xyz_m[:, act.joints.index("left_hip"), 2]
    vertical = forces.feet.force[..., 2].sum(1) / GRAVITY_M_S2
    rests = (height_m < height_m.min() + 0.01) & (np.abs(np.gradient(height_m)) < 1e-3)
    assert forces.feet.seated[rests].all()
    assert not forces.feet.seated[height_m > height_m.max() - 0.05].any()
    assert not forces.feet.undetermined.any()
    # The feet keep the share that balances the body about the hips.
    assert np.median(vertical[rests]) < 0.5
    np.testing.assert_allclose(vertical[~forces.feet.seated], forces.total[~forces.feet.seated, 2] / GRAVITY_M_S2)
    assert not estimated(SQUAT).feet.seated.any()
    # The error of the share is part of the deviation.
    of_seat, of_squat = (
        np.median(of.feet.sigma[rows][..., 2] / of.feet.force[rows][..., 2])
        for of, rows in ((forces, rests), (estimated(SQUAT), slice(None)))
    )
    assert of_seat > 2.0 * of_squat


def test_forces_of_a_person_who_leans_are_undetermined() -> None:
    animation = solved(SQUAT)
    xyz_m, rows = np.array(animation.tracks[0].xyz_m), np.arange(len(animation.tracks[0].xyz_m))
    # A wall holds a body that leans by 27 degrees, from the ankles upwards.
    leans = np.interp(rows, [100, 160, 340, 400], [0.0, 1.0, 1.0, 0.0])
    above_m = np.maximum(xyz_m[..., 2] - 0.1, 0.0)
    toe, heel = (xyz_m[0, SQUAT.joints.index(f"left_{mark}"), :2] for mark in ("big_toe", "heel"))
    xyz_m[..., :2] += 0.5 * (leans[:, None] * above_m)[..., None] * (toe - heel) / np.linalg.norm(toe - heel)
    track = replace(animation.tracks[0], xyz_m=xyz_m)
    forces = forces_of(animation.motions[0], track, SQUAT.joints, Subject(), animation.floor)
    assert forces is not None
    assert forces.feet.undetermined[200:300].all()
    assert not forces.feet.undetermined[:100].any()
    assert np.isnan(forces.feet.force[forces.feet.undetermined]).all()
    assert np.isnan(forces.joints.moment[200:300, MOMENT_NAMES.index("left_knee_flexion")]).all()
    assert np.isfinite(forces.joints.moment[200:300, MOMENT_NAMES.index("left_elbow_flexion")]).all()
    assert np.isfinite(forces.total).all()


def test_heels_that_strike_late_prolong_no_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    animation, truth = solved(JUMP), truth_of(JUMP)
    landing = int(np.flatnonzero(truth.flies)[-1]) + 1
    motion = animation.motions[0]
    motion = replace(motion, contacts=tuple(of for of in motion.contacts if of.rows.stop < landing))
    heels = [Swing(side, None, FootEvent("foot_strike", side, landing + 8.0, 0.0, 1.0)) for side in get_args(Side)]
    monkeypatch.setattr(feet, "find_swings", lambda _: heels)
    stances = find_stances(motion, animation.tracks[0], JUMP.joints)
    assert stances.flies[landing - 5]
    assert not stances.flies[landing:].any()


def test_deviations_cover_landings() -> None:
    forces, flies = estimated(JUMP), truth_of(JUMP).flies
    landings = np.flatnonzero(flies[:-1] & ~flies[1:])
    rows = np.concatenate([np.arange(row, row + round(0.2 * JUMP.rate_hz)) for row in landings])
    rows = rows[~forces.flies[rows]]
    apart = np.abs(errors_bw(JUMP, forces)[rows, 2]) * GRAVITY_M_S2
    assert (apart < 1.96 * forces.total_sigma[rows, 2]).mean() > 0.8
    # A flight is known better, and so is a body at rest, whose movements have no fast parts.
    assert forces.total_sigma[forces.flies].max() < 0.04 * GRAVITY_M_S2
    assert np.median(forces.total_sigma[rows, 2]) > 5.0 * np.median(estimated(SQUAT).total_sigma[:, 2])


def test_markers_swing_with_the_body() -> None:
    animation = solved(JUMP)
    track = replace(animation.tracks[0], uncertainty_m=np.full(animation.tracks[0].xyz_m.shape[:2], 0.005))
    located = forces_of(animation.motions[0], track, JUMP.joints, Subject(), animation.floor)
    assert located is not None
    wider = np.sqrt(estimated(JUMP).total_sigma ** 2 - located.total_sigma**2) / GRAVITY_M_S2
    lands = np.flatnonzero(located.flies[:-1] & ~located.flies[1:]) + 4
    assert ((wider[lands] > 0.06) & (wider[lands] < 0.25)).all()
    assert wider[located.flies].max() < 0.04
    # It stands between two jumps.
    assert wider[~located.flies].min() < 0.02


def test_moment_of_standing_knee_is_force_times_lever() -> None:
    forces, xyz_m = estimated(SQUAT), truth_of(SQUAT).xyz_m
    # In the deepest squat, bodies are still: the moment is the weight's beyond the knee.
    row = int(xyz_m[:, SQUAT.joints.index("left_hip"), 2].argmin())
    column = MOMENT_NAMES.index("left_knee_flexion")
    knee_m = xyz_m[row, SQUAT.joints.index("left_knee")]
    ground, arm_m = forces.feet.force[row, 0], forces.feet.pressure_m[row, 0] - knee_m
    moment = -np.cross(arm_m, ground)
    # The shank and foot weigh 6 % of the body, within 0.25 m of the knee's vertical.
    assert abs(np.linalg.norm(moment) - abs(forces.joints.moment[row, column])) < 0.25
    assert forces.joints.moment[row, column] < -0.2  # muscles stretch the bent knee


def test_places_that_contradict_the_motion_widen_moments() -> None:
    forces, animation = estimated(SQUAT), solved(SQUAT)
    body = body_in_motion(animation.motions[0], animation.tracks[0], SQUAT.joints, Subject(), forces.flies)
    assert body is not None
    knee = MOMENT_NAMES.index("left_knee_flexion")
    moved = replace(forces.feet, pressure_m=forces.feet.pressure_m + np.array([0.05, 0.0, 0.0]))
    own, wider, plates = (
        np.median(joint_moments(body, of, SQUAT.joints).sigma[:, knee])
        for of in (forces.feet, moved, replace(moved, measured=np.ones_like(moved.measured)))
    )
    of_foot = np.median(forces.feet.force[:, 0, 2])
    assert 0.025 * of_foot < own < 0.08 * of_foot
    assert np.sqrt(wider**2 - own**2) == pytest.approx(0.05 * GRAVITY_M_S2, rel=0.2)
    assert plates < own


def test_swinging_leg_has_moments_of_its_own_weight_alone() -> None:
    forces = estimated(WALK)
    swings = ~forces.feet.stands[:, 0] & forces.feet.stands[:, 1]
    ankle = forces.joints.moment[swings, MOMENT_NAMES.index("left_ankle_dorsiflexion")]
    assert np.abs(ankle).max() < 0.1  # a foot of 1.4 % of the mass, 6 cm in front of the ankle


def test_people_without_heels_and_toes_have_forces() -> None:
    forces = estimated(body_only(SQUAT))
    assert np.isfinite(forces.joints.moment).all()
    assert np.median(forces.total[:, 2]) == pytest.approx(GRAVITY_M_S2, rel=0.02)


def test_person_beside_others_may_lack_heels_and_toes() -> None:
    animation, of_feet = (
        solved(SQUAT),
        [k for k, name in enumerate(SQUAT.joints.names) if "heel" in name or "toe" in name],
    )
    xyz_m = np.array(animation.tracks[0].xyz_m)
    xyz_m[:, of_feet] = np.nan
    track = replace(animation.tracks[0], xyz_m=xyz_m)
    forces = forces_of(animation.motions[0], track, SQUAT.joints, Subject(), animation.floor)
    assert forces is not None
    assert np.median(forces.total[:, 2]) == pytest.approx(GRAVITY_M_S2, rel=0.02)
    np.testing.assert_allclose(forces.feet.force.sum(1)[50:-50], forces.total[50:-50], atol=1e-6)


def test_short_track_has_no_forces() -> None:
    animation = solved(SQUAT)
    motion, track = animation.motions[0], animation.tracks[0].part(slice(0, 8))
    short = replace(motion, root_m=motion.root_m[:8], parent_from_joint=motion.parent_from_joint[:8], contacts=())
    assert forces_of(short, track, SQUAT.joints, Subject(), animation.floor) is None


def test_slow_frames_have_no_forces() -> None:
    solved_walk = solved(WALK)
    track, motion = solved_walk.tracks[0], replace(solved_walk.motions[0], frame_rate_hz=1.0)
    assert forces_of(motion, track, WALK.joints, Subject(), None) is None


def test_gap_of_all_joints_is_unknown() -> None:
    animation = solved(SQUAT)
    xyz_m = np.array(animation.tracks[0].xyz_m)
    xyz_m[100:105] = np.nan
    track = replace(animation.tracks[0], xyz_m=xyz_m)
    forces = forces_of(animation.motions[0], track, SQUAT.joints, Subject(), animation.floor)
    assert forces is not None
    assert np.isnan(forces.total[100:105]).all()
    assert np.isfinite(np.delete(forces.total, np.s_[100:105], axis=0)).all()
    on_feet = forces.feet
    for values in (on_feet.force, on_feet.pressure_m, on_feet.pressure_sigma_m, on_feet.free_moment):
        assert np.isnan(values[100:105]).all()
    assert not on_feet.stands[100:105].any()


def test_people_who_are_near_may_touch() -> None:
    track = solved(SQUAT).tracks[0]
    beside = replace(track, start_frame=10, xyz_m=track.xyz_m + np.array([0.3, 0.0, 0.0]))
    assert not touching(track, [replace(track, xyz_m=track.xyz_m + 5.0)]).any()
    found = touching(track, [beside])
    assert not found[:10].any()
    assert found[10:].any()


def test_plates_replace_the_estimate_at_their_feet() -> None:
    corners_m = plates_m(SQUAT, ((0.2, 0.0),), half_m=0.5)
    lead_s, length_s = 1.0, 4.0
    start = LaboratoryStart("trigger", lead_s, 0.001)
    laboratory = replace(simulated(SQUAT, lead_s, length_s, corners_m), start=start)
    timebase = Timebase(0.0, SQUAT.rate_hz, len(truth_of(SQUAT).xyz_m))
    forces = estimated(SQUAT, mass_kg=MASS_KG, laboratory=laboratory, timebase=timebase)
    rows = np.flatnonzero(forces.feet.measured.any(1))
    assert rows[0] == pytest.approx(lead_s * SQUAT.rate_hz, abs=2)
    assert rows[-1] == pytest.approx((lead_s + length_s) * SQUAT.rate_hz, abs=2)
    middle = rows[len(rows) // 2]
    on = forces.feet.measured[middle]
    # One plate under both feet: its force is one foot's, with its noise of 3 steps of 0.1 N.
    assert forces.feet.force[middle, on, 2].sum() == pytest.approx(MASS_KG * GRAVITY_M_S2, rel=0.15)
    assert (forces.feet.sigma[middle, on] == 0.0).all()


def test_document_has_stances_and_jumps() -> None:
    of_walk, of_jump = forces_document(estimated(WALK), 3), forces_document(estimated(JUMP), 4)
    assert of_walk["id"] == 3
    assert {stance["side"] for stance in of_walk["stances"]} == {"left", "right"}
    assert all(0.2 < stance["impulse_bw_s"] < 1.0 for stance in of_walk["stances"])
    assert all(stance["peak_bw"] > 0.9 for stance in of_walk["stances"])
    assert of_walk["jumps"] == []
    heights_m = truth_of(JUMP).heights_m
    assert len(of_jump["jumps"]) == len(heights_m)
    for jump, height_m in zip(of_jump["jumps"], heights_m, strict=True):
        assert jump["by_impulse_m"] == pytest.approx(height_m, abs=0.01)


def stepping(*stances: tuple[int, int, int]) -> PersonForces:
    """Forces of a person whose feet carry all at once: foot, first frame and end of each stance."""
    forces = estimated(WALK)
    stands, force = np.zeros_like(forces.feet.stands), np.zeros_like(forces.feet.force)
    for foot, start, stop in stances:
        stands[start:stop, foot], force[start:stop, foot, 2] = True, GRAVITY_M_S2
    return replace(forces, feet=replace(forces.feet, stands=stands, force=force))


def test_force_that_rises_within_a_frame_has_its_rate() -> None:
    document = forces_document(stepping((0, 50, 80), (1, 90, 120)), 1)
    assert [stance["loading_rate_bw_s"] for stance in document["stances"]] == [WALK.rate_hz, WALK.rate_hz]
    assert document["asymmetry_percent"] == {"impulse_bw_s": 0.0, "peak_bw": 0.0, "loading_rate_bw_s": 0.0}


def test_feet_without_force_have_no_asymmetry() -> None:
    forces = stepping((0, 50, 80), (1, 90, 120))
    document = forces_document(replace(forces, feet=replace(forces.feet, force=0.0 * forces.feet.force)), 1)
    assert set(document["asymmetry_percent"].values()) == {None}


@pytest.mark.parametrize("unknown", [49, 60, 80])
def test_stance_beside_unknown_frames_is_not_whole(unknown: int) -> None:
    forces = stepping((0, 50, 80), (1, 90, 120))
    force = forces.feet.force.copy()
    force[unknown] = np.nan
    document = forces_document(replace(forces, feet=replace(forces.feet, force=force)), 1)
    assert [stance["start_frame"] for stance in document["stances"]] == [forces.start_frame + 90]


@pytest.mark.accuracy
def test_deviations_cover_errors_of_people_seen_by_cameras() -> None:
    """Walks, jumps and squats of three people each, seen by four cameras; ``-s`` prints errors in % of body weight."""
    covers: list[np.ndarray] = []
    sizes: dict[str, list[np.ndarray]] = {}
    for seed in (2, 3, 4):
        gestures = Gesture.SQUAT, Gesture.COUNTERMOVEMENT_JUMP
        acts = {"walk": replace(walk(1.0 + 0.1 * seed, num_cameras=4), seed=seed)}
        acts |= {gesture.value: exercise(gesture, seed, num_cameras=4) for gesture in gestures}
        for name, act in acts.items():
            forces = estimated(act)
            error = errors_bw(act, forces)
            covers.append(np.abs(error) < 1.96 * forces.total_sigma / GRAVITY_M_S2)
            sizes.setdefault(name, []).append(100 * np.sqrt((error**2).mean(0)))
    for name, size in sizes.items():
        print(name, *np.mean(size, axis=0).round(2))  # noqa: T201
    cover = np.concatenate(covers).mean(0)
    print("within two deviations", *cover.round(3))  # noqa: T201
    assert (cover > 0.9).all()
    assert np.mean(sizes["walk"], axis=0)[2] < 6.0
