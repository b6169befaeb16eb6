"""Forces of two simulated people on one floor, located together by four cameras."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.core.data.reconstruction import Subject
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces.person_forces import forces_of
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.motion.script import Gesture, Stay, Walk
from tests.pipeline.motion.forces.physical_people import truth_of
from tests.pipeline.motion.gait.walks import Act, exercise, walk
from tests.pipeline.motion.skeleton.observed import observe, ring_of

JUMP = Gesture.COUNTERMOVEMENT_JUMP
BESIDE = replace(walk(1.2, seed=5), start_m=(-2.8, -0.9), cues=(Stay(0.6), Walk((2.8, -1.5), 1.2), Stay(0.6)))
PAIRS = {
    "walk together": (walk(1.2, seed=2), BESIDE),
    "jump together": (exercise(JUMP, 2), replace(exercise(JUMP, 4), start_m=(-0.9, 0.6), facing_rad=-1.0)),
    "walk beside jumps": (
        walk(1.2, seed=3),
        replace(exercise(JUMP, 6), start_m=(0.0, 1.4), duration_s=walk(1.2).duration_s),
    ),
}


def errors_and_cover(acts: tuple[Act, Act], name: str) -> list[np.ndarray]:
    """For each person the frames that two deviations cover; prints errors in % of body weight, and of heights in cm."""
    truths, cameras = [truth_of(act) for act in acts], ring_of(4)
    num_frames = min(len(truth.xyz_m) for truth in truths)
    of_each = [
        observe(cameras, truth.xyz_m[:num_frames], noise_px=3.0, seed=10 + k)[1] for k, truth in enumerate(truths)
    ]
    points_px = np.stack([np.moveaxis(seen.points_px, 1, 0) for seen in of_each], axis=2)
    take = reconstruct(from_arrays(points_px, None, cameras, 60.0, joints=acts[0].joints.names))
    hip, covers = take.joints.index("left_hip"), []
    assert len(take.tracks) == len(acts)
    for act, truth in zip(acts, truths, strict=True):
        true_m = truth.xyz_m[:, act.joints.index("left_hip")]
        apart_m = [np.nanmedian(np.linalg.norm(of.xyz_m[:, hip] - true_m[of.frames], axis=1)) for of in take.tracks]
        track, motion = take.tracks[int(np.argmin(apart_m))], take.motions[int(np.argmin(apart_m))]
        others = [other for other in take.tracks if other is not track]
        forces = forces_of(motion, track, take.joints, Subject(), take.animation.floor, others)
        assert forces is not None
        error = (forces.total - truth.force[track.frames]) / GRAVITY_M_S2
        covers.append(np.abs(error) < 1.96 * forces.total_sigma / GRAVITY_M_S2)
        heights_m = zip(forces.jump_heights_m, truth.heights_m, strict=True)
        apart_cm = [100.0 * (by_impulse_m - true_m) for (_, by_impulse_m, _), true_m in heights_m]
        rmse = 100.0 * np.sqrt((error**2).mean(0))
        print(name, *rmse.round(1), *(100.0 * covers[-1].mean(0)).round(1), *np.round(apart_cm, 1))  # noqa: T201
        assert all(abs(height_cm) < 1.5 for height_cm in apart_cm)
        if not apart_cm:
            assert (rmse < [4.0, 4.0, 6.0]).all()
    return covers


@pytest.mark.accuracy
def test_two_people_on_one_floor_have_covered_forces() -> None:
    """``-s`` prints for each person the RMSE along X, Y, Z, what two deviations hold, and errors of heights."""
    covers = [cover for name, acts in PAIRS.items() for cover in errors_and_cover(acts, name)]
    cover = np.concatenate(covers).mean(0)
    print("within two deviations", *cover.round(3))  # noqa: T201
    # Over all takes, the public ones among them, 98 % is the goal. Simulated walks lie nearly all inside.
    assert ((cover > 0.9) & (cover < 0.99)).all()
