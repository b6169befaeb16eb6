"""Part affinity fields as evidence, with fields of known content."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.clustering.instant.evidence import AffinityFields, JointPoints, ViewFields, number_limbs
from pipeline.association.clustering.skeleton import clustering_skeleton
from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import MapGrid
from pipeline.core.joints import COCO_18
from pipeline.detection.decoders.openpose import LIMBS
from pipeline.geometry.camera import project
from pipeline.geometry.fields import connectivity, quantise

SKELETON = clustering_skeleton(COCO_18)
ELBOW, WRIST = SKELETON.indices(("left_elbow", "left_wrist"))
GRID = MapGrid(offset_px=(3.5, 3.5), pitch_px=(8.0, 8.0))
ELBOW_M, WRIST_M = np.array([[0.1, 0.2, 1.2]]), np.array([[0.1, 0.4, 1.3]])


def places(joint: int, xyz_m: np.ndarray, num_cameras: int) -> JointPoints:
    return JointPoints(np.full(len(xyz_m), joint), xyz_m, np.full((len(xyz_m), num_cameras), -1))


def field_towards(camera: Camera, strength: float) -> ViewFields:
    """Fields with the projected direction from elbow to wrist in all cells."""
    begin, end = (project(camera, xyz_m)[0] for xyz_m in (ELBOW_M, WRIST_M))
    unit = (end - begin) / np.linalg.norm(end - begin)
    shape = camera.size_px[1] // 8, camera.size_px[0] // 8
    fields = np.zeros((len(LIMBS), 2, *shape))
    fields[number_limbs(SKELETON, LIMBS)[WRIST]] = strength * unit[:, None, None]
    return ViewFields(camera, quantise(fields), GRID)


def test_score_is_mean_over_views(ring: tuple[Camera, ...]) -> None:
    strengths = (0.9, 0.5, -0.3, 0.0)
    views = [field_towards(camera, strength) for camera, strength in zip(ring, strengths, strict=True)]
    evidence = AffinityFields(views, LIMBS, SKELETON, tau2=0.3)
    wanted = np.ones((1, 1), bool)
    score = evidence.connect(places(ELBOW, ELBOW_M, 4), places(WRIST, WRIST_M, 4), wanted)
    # Lenses bend the segment a little; a byte holds 1 / 127.
    np.testing.assert_allclose(score, [[np.mean(strengths)]], atol=0.01)
    assert np.isnan(evidence.connect(places(ELBOW, ELBOW_M, 4), places(WRIST, WRIST_M, 4), ~wanted)).all()


def test_view_that_does_not_show_both_ends_says_nothing(ring: tuple[Camera, ...]) -> None:
    far = replace(ring[0], matrix=ring[0].matrix + np.array([[0, 0, 5000.0], [0, 0, 0], [0, 0, 0]]))
    views = [field_towards(ring[1], 0.8), ViewFields(far, field_towards(ring[0], 1.0).fields, GRID)]
    evidence = AffinityFields(views, LIMBS, SKELETON, tau2=0.3)
    score = evidence.connect(places(ELBOW, ELBOW_M, 2), places(WRIST, WRIST_M, 2), np.ones((1, 1), bool))
    np.testing.assert_allclose(score, [[0.8]], atol=0.01)
    nobody = AffinityFields([], LIMBS, SKELETON, tau2=0.3)
    score = nobody.connect(places(ELBOW, ELBOW_M, 2), places(WRIST, WRIST_M, 2), np.ones((1, 1), bool))
    assert np.isnan(score).all()


def test_every_limb_of_skeleton_has_its_field() -> None:
    numbers = number_limbs(SKELETON, LIMBS)
    assert numbers[0] == -1  # the root hangs on nothing
    assert (numbers[1:] >= 0).all()
    for j, number in enumerate(numbers.tolist()):
        if number >= 0:
            first, second = (COCO_18.names[joint] for joint in LIMBS[number])
            assert (first, second) == (SKELETON.names[SKELETON.parents[j]], SKELETON.names[j])
    assert AffinityFields([], LIMBS, SKELETON, tau2=0.3).least[SKELETON.names.index("nose")] == pytest.approx(0.15)


def test_segment_through_half_limb_scores_half() -> None:
    fields = np.zeros((1, 2, 20, 40))
    fields[0, 0, 9:12, 5:15] = 1.0  # to the right
    begin, end = (
        np.array([[5.0, 10.0], [14.0, 10.0], [5.0, 10.0], [5.0, 10.0]]),
        np.array([[14.0, 10.0], [5.0, 10.0], [23.0, 10.0], [5.0, 19.0]]),
    )
    mean, share = connectivity(quantise(fields), np.zeros(4, int), begin, end)
    np.testing.assert_allclose(mean, [1.0, -1.0, 0.5, 0.0], atol=0.06)
    np.testing.assert_allclose(share, [1.0, 0.0, 0.5, 0.0], atol=0.11)
    off_map = np.array([[np.nan, 1.0], [-1.0, 1.0], [1.0, 20.0]])
    assert np.isnan(connectivity(quantise(fields), np.zeros(3, int), off_map, np.ones((3, 2)))[0]).all()
    assert connectivity(quantise(fields), np.zeros(1, int), np.ones((1, 2)), np.ones((1, 2)))[0] == [0.0]


def test_quantised_fields_are_within_half_step() -> None:
    values = np.linspace(-1.3, 1.3, 1001)
    back = (quantise(values).astype(float) - 128) / 127
    np.testing.assert_allclose(back, np.clip(values, -1, 1), atol=0.5 / 127 + 1e-9)
