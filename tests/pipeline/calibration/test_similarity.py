"""Similarities of points and of rigs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.calibration.adjustment.parameters import move_camera, offsets
from pipeline.calibration.similarity import Similarity, align_world, shift_m, turn_deg, umeyama
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world
from tests.pipeline.calibration.refinement.people import ring

CAMERAS = ring(5)


def moved_world(turn: np.ndarray, growth: float, shift: np.ndarray) -> list[Camera]:
    rotation = Rotation.from_rotvec(turn).as_matrix()
    cameras = []
    for camera in CAMERAS:
        in_cam = camera.cam_from_world.rotation @ rotation.T
        center_m = growth * rotation @ center_in_world(camera) + shift
        pose = Rigid3(in_cam, -in_cam @ center_m)
        cameras.append(Camera(camera.name, camera.size_px, camera.matrix, camera.distortion, pose))
    return cameras


@settings(max_examples=10, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    growth=st.floats(0.95, 1.05),
    shift=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
)
def test_similarity_is_undone(turn: tuple[float, ...], growth: float, shift: tuple[float, ...]) -> None:
    aligned = align_world(CAMERAS, moved_world(np.array(turn), growth, np.array(shift)))
    np.testing.assert_allclose(offsets(CAMERAS, aligned), 0.0, atol=1e-5)


def test_camera_that_moved_far_does_not_move_world() -> None:
    step = np.array([0.05, -0.03, 0.02, 0.2, -0.3, 0.1, 0.0])
    refined = [move_camera(CAMERAS[0], step), *CAMERAS[1:]]
    aligned = align_world(CAMERAS, refined)
    assert max(shift_m(then, now) for then, now in zip(CAMERAS[1:], aligned[1:], strict=True)) < 0.004
    assert max(turn_deg(then, now) for then, now in zip(CAMERAS[1:], aligned[1:], strict=True)) < 0.06
    np.testing.assert_allclose(shift_m(CAMERAS[0], aligned[0]), np.linalg.norm(step[3:6]), atol=0.005)
    np.testing.assert_allclose(turn_deg(CAMERAS[0], aligned[0]), np.degrees(np.linalg.norm(step[:3])), atol=0.05)


def test_best_similarity_is_that_of_umeyama() -> None:
    rng = np.random.default_rng(2)
    points_m = rng.normal(size=(6, 3))
    similarity = Similarity(1.7, Rotation.from_rotvec([0.4, -0.9, 2.0]).as_matrix(), np.array([0.5, -2.0, 1.0]))
    goal_m = similarity.apply(points_m) + rng.normal(0.0, 0.05, (6, 3))
    best = umeyama(points_m, goal_m, has_scale=True)
    assert np.linalg.det(best.rotation) == pytest.approx(1.0)

    def error(similarity: Similarity) -> float:
        return float(((similarity.apply(points_m) - goal_m) ** 2).sum())

    for _ in range(20):
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix()
        moved_m, factor = rng.normal(0.0, 0.01, 3), 1.0 + rng.normal(0.0, 0.01)
        other = Similarity(best.scale * factor, turn @ best.rotation, best.translation_m + moved_m)
        assert error(best) < error(other)
    mirrored_m = points_m * [1.0, 1.0, -1.0]
    mirrored = umeyama(mirrored_m, goal_m, has_scale=True, is_mirrored=True)
    assert ((mirrored.apply(mirrored_m) - goal_m) ** 2).sum() == pytest.approx(error(best))
