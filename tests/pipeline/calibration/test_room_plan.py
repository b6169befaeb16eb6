"""Plan of a rig: the stated errors are those of triangulation, and people hide people."""

from xml.etree import ElementTree

import numpy as np
import pytest

from pipeline.calibration.room_plan import plan_room, plan_svg, planned_cameras
from pipeline.geometry.camera import center_in_world, project, projection_matrices
from pipeline.geometry.triangulation import triangulate

ROOM_M = (6.0, 5.0)
RIG = planned_cameras(ROOM_M, 6, 2.5, (1920, 1080), 75.0)


def test_cameras_stand_along_walls_and_look_at_middle() -> None:
    places_m = np.array([center_in_world(camera) for camera in RIG])
    on_wall = np.isclose(np.abs(places_m[:, :2]), np.array(ROOM_M) / 2)
    assert on_wall.any(1).all()
    np.testing.assert_allclose(places_m[:, 2], 2.5)
    for camera in RIG:
        np.testing.assert_allclose(project(camera, np.array([0.0, 0.0, 1.0])), [959.5, 539.5], atol=1e-9)


def test_expected_error_is_error_of_triangulation() -> None:
    """A person alone in the middle, whom all cameras see: noise of one percent of the person's height."""
    plan = plan_room(RIG, ROOM_M, 1)
    row, column = len(plan.y_m) // 2, len(plan.x_m) // 2
    assert plan.views[row, column] == 6.0
    rng, squares = np.random.default_rng(5), []
    for height_m in (0.1, 0.5, 0.95, 1.45, 1.7):
        point_m = np.array([plan.x_m[column], plan.y_m[row], height_m])
        depths_m = np.array([camera.cam_from_world.apply(point_m)[2] for camera in RIG])
        sigma_px = 0.01 * RIG[0].matrix[1, 1] * 1.8 / depths_m
        seen_px = np.array([project(camera, point_m) for camera in RIG])[:, None]
        noisy_px = seen_px + rng.normal(size=(6, 4000, 2)) * sigma_px[:, None, None]
        found_m = triangulate(projection_matrices(RIG), noisy_px, np.ones((6, 4000)))
        squares.append(((found_m - point_m) ** 2).sum(-1).mean())
    # Triangulation weights views by angles, the plan by pixels: it is a lower bound within a few percent.
    assert 1000 * np.sqrt(np.mean(squares)) == pytest.approx(plan.error_mm[row, column], rel=0.05)


def test_people_hide_joints() -> None:
    """The mean number of views falls to the share that cylinders at random places leave free."""
    alone, crowd = plan_room(RIG, ROOM_M, 1), plan_room(RIG, ROOM_M, 6)
    row, column = len(alone.y_m) // 2, len(alone.x_m) // 2
    person_m = np.array([alone.x_m[column], alone.y_m[row]])
    rng, free = np.random.default_rng(3), []
    others_m = rng.uniform(-0.5, 0.5, (4000, 5, 2)) * ROOM_M
    for camera in RIG:
        center_m = center_in_world(camera)
        for height_m in (0.1, 0.5, 0.95, 1.45, 1.7):
            low = min((1.8 - height_m) / (center_m[2] - height_m), 1.0)
            way_m = low * (center_m[:2] - person_m)
            share = np.clip((others_m - person_m) @ way_m / (way_m @ way_m), 0.0, 1.0)
            nearest_m = person_m + share[..., None] * way_m
            free.append((np.linalg.norm(others_m - nearest_m, axis=-1) > 0.25).all(-1).mean())
    # The ends of the strips, half discs, are left out: they hold the person itself.
    assert crowd.views[row, column] == pytest.approx(6 * np.mean(free), abs=0.5)
    both = np.isfinite(crowd.error_mm)
    assert (crowd.error_mm[both] > alone.error_mm[both]).all()
    assert crowd.covered < alone.covered


def test_two_cameras_at_one_place_locate_nothing() -> None:
    plan = plan_room((RIG[0], RIG[0]), ROOM_M, 1)
    assert plan.views.max() == 2.0
    assert plan.covered == 0.0


def test_picture_has_a_cell_for_each_place_and_a_title() -> None:
    plan = plan_room(RIG, ROOM_M, 2)
    drawn = ElementTree.fromstring(plan_svg(plan, RIG, ROOM_M))  # noqa: S314 - our own text
    tag = "{http://www.w3.org/2000/svg}"
    assert len(drawn.findall(f"{tag}rect")) == plan.error_mm.size + 5
    assert len(drawn.findall(f"{tag}g/{tag}circle")) == 6
    title = drawn.find(f"{tag}title")
    assert title is not None
    assert f"{100 * plan.covered:.0f} % of the floor" in str(title.text)
