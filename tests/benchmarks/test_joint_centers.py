"""Offsets of joint centres, learnt from people whose marks lie at known offsets."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17, JointOffset
from pipeline.motion.skeleton.model import INDEX, SKELETON, TRUNK
from pipeline.validation.evaluation.datasets.rendered import RenderedTruth
from tests.benchmarks.joint_centers import MarkedPerson, cross_validate, learn_offsets, marked_people

NUM_FRAMES = 20
RATE_HZ = 25.0
TRUNK_M = 0.5
TURN_DEG = 40.0
# Hips lie 2 cm outwards, 3 cm forward and 1 cm up of the true ones.
OUTWARDS_M, FORWARD_M, UP_M = 0.02, 0.03, 0.01


def motion_of(turn_deg: float) -> SkeletonMotion:
    """Somebody who stands in the T-pose, turned about the vertical."""
    lengths_m = np.full(len(SKELETON), 0.1)
    lengths_m[[INDEX[name] for name in TRUNK]] = TRUNK_M / len(TRUNK)
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (NUM_FRAMES, len(SKELETON), 1))
    turns[:, 0] = Rotation.from_euler("z", turn_deg, degrees=True).as_quat()
    return SkeletonMotion(1, "Ana", 0, RATE_HZ, lengths_m, np.zeros((NUM_FRAMES, 3)), turns, ())


def capture(start_frame: int = 0, away_m: float = 0.0) -> tuple[Reconstruction, RenderedTruth]:
    """Reconstruction of a person whose hips are marked beside the true ones, and another one who was not found."""
    body_m = np.random.default_rng(3).uniform(-0.5, 0.5, (17, 3))
    true_m = np.tile(body_m, (2, NUM_FRAMES, 1, 1)) + np.array([[[[5.0, 0.0, 0.0]]], [[[0.0, 0.0, 0.0]]]])
    marked_m = true_m[1] + np.array([away_m, 0.0, 0.0])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        offset_m = np.array([sign * OUTWARDS_M, -FORWARD_M, UP_M])
        marked_m[:, COCO_17.index(f"{side}_hip")] += Rotation.from_euler("z", TURN_DEG, degrees=True).apply(offset_m)
    marked_m[3, COCO_17.index("left_hip")] += 1.0  # a mistake
    marked_m[4, COCO_17.index("nose")] = np.nan
    ones = np.ones(marked_m.shape[:2])
    track = Track3D(1, start_frame, marked_m, ones, (ones * Source.MEASURED).astype(np.int8), ones, ones.astype(int))
    timebase = Timebase(0.0, RATE_HZ, NUM_FRAMES + start_frame)
    animation = Animation((track,), (motion_of(TURN_DEG),), None)
    reconstruction = Reconstruction((), COCO_17, timebase, (track,), (), animation)
    truth = RenderedTruth(COCO_17.names, (start_frame + np.arange(NUM_FRAMES)) / RATE_HZ, true_m)
    return reconstruction, truth


@pytest.mark.parametrize("start_frame", [0, 7])
def test_offsets_are_found_in_axes_of_body(start_frame: int) -> None:
    (person,) = marked_people(*capture(start_frame))
    assert person.trunk_m == pytest.approx(TRUNK_M)
    assert len(person.offset_m["hip"]) == 2 * NUM_FRAMES - 1  # without the mistake
    np.testing.assert_allclose(person.offset_m["hip"], [[OUTWARDS_M, FORWARD_M, UP_M]] * (2 * NUM_FRAMES - 1))
    np.testing.assert_allclose(person.offset_m["shoulder"], 0.0, atol=1e-12)
    assert len(person.offset_m["nose"]) == NUM_FRAMES - 1


def test_track_far_from_everybody_tells_nothing() -> None:
    assert marked_people(*capture(away_m=0.9)) == []


def person_with(trunk_m: float, **offset_m: tuple[float, float, float]) -> MarkedPerson:
    return MarkedPerson({kind: np.tile(offset, (9, 1)) for kind, offset in offset_m.items()}, trunk_m)


def test_offsets_scale_with_trunk_between_joints() -> None:
    # The marks of the shoulders are 4 cm higher, those of the hips 1 cm: between the joints 0.50 m are left of 0.53 m.
    marked = person_with(0.53, shoulder=(0.0, 0.0, 0.04), hip=(0.0, 0.02, 0.01))
    assert learn_offsets([marked]) == {
        "shoulder": JointOffset(up=0.08),
        "hip": JointOffset(forward=0.04, up=0.02),
    }
    assert set(learn_offsets([marked], ("hip",))) == {"hip"}


def test_each_person_is_corrected_by_others() -> None:
    people = [person_with(0.5, hip=(0.0, 0.03, 0.0))] * 2 + [person_with(0.5, hip=(0.0, -0.03, 0.0))]
    rows = cross_validate(people)
    assert [(row.person, row.kind) for row in rows] == [(0, "hip"), (1, "hip"), (2, "hip")]
    assert [row.marked_mm for row in rows] == pytest.approx([30.0, 30.0, 30.0])
    # The others of the first two disagree, those of the last one mislead.
    assert [row.corrected_mm for row in rows] == pytest.approx([30.0, 30.0, 60.0])


def test_taller_person_is_corrected_by_more() -> None:
    small, tall = person_with(0.4, hip=(0.0, 0.02, 0.0)), person_with(0.6, hip=(0.0, 0.03, 0.0))
    assert [row.corrected_mm for row in cross_validate([small, tall])] == pytest.approx([0.0, 0.0], abs=0.1)


def test_joint_of_one_person_alone_stays() -> None:
    people = [person_with(0.5, nose=(0.0, 0.03, 0.0), hip=(0.0, 0.0, 0.0)), person_with(0.5, hip=(0.0, 0.0, 0.0))]
    (nose,) = (row for row in cross_validate(people) if row.kind == "nose")
    assert nose.corrected_mm == nose.marked_mm == pytest.approx(30.0)


def test_medians_are_not_moved_by_few_marks() -> None:
    marked = person_with(0.5, hip=(0.0, 0.02, 0.0))
    marked.offset_m["hip"][:3] = 0.1
    assert learn_offsets([marked])["hip"].forward == pytest.approx(0.04)
