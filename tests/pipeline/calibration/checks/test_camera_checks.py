"""Checks of a calibration alone: each fault is named with its camera, and good rigs have none."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.checks.camera_checks import check_cameras, growing_radius, picture_radii
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.vertical import AXES, turn_upright
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world, look_at
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.pipeline.calibration.readers.rigs import RIG, fisheye

OPPOSITE = {axis: axis[1:] if axis.startswith("-") else f"-{axis}" for axis in AXES}
RING = build_cameras(Rig(Layout.RING, 4, (4.0, 3.0), 2.2), np.random.default_rng(1))


def moved(
    camera: Camera, center_m: Sequence[float] | np.ndarray, target_m: Sequence[float] = (0.0, 0.0, 1.0)
) -> Camera:
    return replace(camera, cam_from_world=look_at(np.array(center_m, float), np.array(target_m, float)))


def changed(camera: Camera, row: int, column: int, value: float) -> Camera:
    matrix = camera.matrix.copy()
    matrix[row, column] = value
    return replace(camera, matrix=matrix)


def distorted(camera: Camera, *coefficients: float) -> Camera:
    return replace(camera, distortion=np.array(coefficients))


def in_other_world(cameras: Sequence[Camera], turn: Rotation, scale: float = 1.0) -> tuple[Camera, ...]:
    def place(camera: Camera) -> Camera:
        rotation = camera.cam_from_world.rotation @ turn.as_matrix().T
        return replace(camera, cam_from_world=Rigid3(rotation, scale * camera.cam_from_world.translation_m))

    return tuple(map(place, cameras))


def codes(cameras: Sequence[Camera]) -> list[tuple[str, str | None, str]]:
    return [(one.code, one.camera, one.severity) for one in check_cameras(cameras)]


@pytest.mark.parametrize(
    "rig",
    [
        RING,
        RIG,
        (fisheye("left", 0.3), fisheye("right", -0.8)),
        build_cameras(Rig(Layout.CEILING, 10, (8.0, 5.0), 3.5), np.random.default_rng(2)),
        build_cameras(Rig(Layout.DOME, 8, (3.0, 3.0), 0.5), np.random.default_rng(3)),
        tuple(replace(camera, size_px=UNKNOWN_SIZE) for camera in RING),
    ],
    ids=["ring", "pair", "fisheye", "ceiling", "dome", "unknown sizes"],
)
def test_good_rig_has_no_finding(rig: Sequence[Camera]) -> None:
    assert codes(rig) == []


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda c: moved(c, (4.0, 0.0, -0.5)), ("camera_below_floor", "warning")),
        (lambda c: moved(c, center_in_world(RING[1]) + 0.002), ("same_place", "warning")),
        (lambda c: replace(c, cam_from_world=RING[1].cam_from_world), ("same_place", "error")),
        (lambda c: moved(c, (4.0, 0.0, 6.0), (4.5, 0.0, 13.0)), ("no_common_view", "warning")),
        (lambda c: changed(changed(c, 0, 0, 80.0), 1, 1, 80.0), ("focal_length", "warning")),
        (lambda c: changed(changed(c, 0, 0, 40_000.0), 1, 1, 40_000.0), ("focal_length", "warning")),
        (lambda c: changed(c, 1, 1, 1.1 * c.matrix[0, 0]), ("pixels_not_square", "warning")),
        (lambda c: changed(c, 0, 2, 40.0), ("principal_point", "warning")),
        (lambda c: distorted(c, -0.55, 0.0, 0.0, 0.0), ("distortion_folds", "warning")),
        (lambda c: distorted(c, -2.0, 0.0, 0.0, 0.0), ("distortion_folds", "error")),
        (lambda c: replace(distorted(c, -0.4, 0.0, 0.0, 0.0), lens="fisheye"), ("distortion_folds", "warning")),
    ],
)
def test_fault_of_one_camera_is_named(fault: Callable[[Camera], Camera], expected: tuple[str, str]) -> None:
    faulty = fault(RING[3])
    assert codes((*RING[:3], faulty)) == [(expected[0], faulty.name, expected[1])]


@pytest.mark.parametrize(
    ("rig", "expected", "evidence"),
    [
        (in_other_world(RING, Rotation.from_euler("x", np.pi)), ("upside_down", "error"), 180.0),
        (in_other_world(RING, Rotation.from_euler("x", np.pi / 2)), ("not_upright", "warning"), 90.0),
        (in_other_world(RING, Rotation.identity(), 1000.0), ("world_unit", "error"), 8000.0),
        (in_other_world(RING, Rotation.identity(), 0.001), ("world_unit", "error"), 0.008),
        # Centimetres, or cameras around a stadium and a valley: the people decide.
        (in_other_world(RING, Rotation.identity(), 100.0), ("world_unit", "warning"), 800.0),
    ],
)
def test_wrong_world_is_one_finding(rig: Sequence[Camera], expected: tuple[str, str], evidence: float) -> None:
    found = [one for one in check_cameras(rig) if one.code != "same_place"]
    (finding,) = found
    assert (finding.code, finding.severity, finding.camera) == (*expected, None)
    assert next(iter(finding.evidence.values())) == pytest.approx(evidence, rel=0.05)


@pytest.mark.parametrize(("scale", "unit"), [(1000.0, "mm"), (100.0, "cm")])
def test_hint_names_unit(scale: float, unit: str) -> None:
    (finding,) = check_cameras(in_other_world(RING, Rotation.identity(), scale))
    assert finding.hint == f"The lengths look like {unit}: state the unit (`--units {unit}`, `units`)."


@pytest.mark.parametrize("axis", ["z", "-z", "y", "x"])
def test_cameras_looking_down_bound_vertical(axis: str) -> None:
    """They stand in a circle, turned to its middle, so that their up directions cancel out."""
    down = [
        replace(camera, cam_from_world=Rigid3(turn.as_matrix() @ np.diag([1.0, -1.0, -1.0]), np.array([x, y, 4.0])))
        for camera, (x, y), angle in zip(RING, ((0, 2), (2, 0), (0, -2), (-2, 0)), (0, 90, 180, 270), strict=True)
        for turn in [Rotation.from_euler("z", angle, degrees=True)]
    ]
    turn = Rotation.from_matrix(turn_upright(AXES[axis]).T)
    (finding,) = [finding for finding in check_cameras(in_other_world(down, turn)) if finding.code == "up_axis_unknown"]
    axes = finding.evidence["up_axes"]
    assert (axes[0], OPPOSITE[axis] in axes) == (axis, False)
    assert finding.severity == ("warning" if axis == "-z" else "info")
    assert f"--up={axes[1] if axis == 'z' else axis}" in str(finding)


def test_cameras_on_their_sides_tell_only_what_may_be_up() -> None:
    rolled = [
        replace(camera, cam_from_world=Rigid3(turn @ pose.rotation, turn @ pose.translation_m))
        for camera, angle in zip(RING, (0, 90, 180, 270), strict=True)
        for turn, pose in [(Rotation.from_euler("z", angle, degrees=True).as_matrix(), camera.cam_from_world)]
    ]
    (finding,) = check_cameras(rolled)
    assert (finding.code, finding.severity, finding.evidence) == ("up_axis_unknown", "info", {"up_axes": ["z", "-z"]})


def test_cameras_without_poses_are_one_finding() -> None:
    still = Rigid3(np.eye(3), np.zeros(3))
    assert codes([replace(camera, cam_from_world=still) for camera in RING]) == [("calibration_unposed", None, "error")]


def test_single_camera_is_not_enough() -> None:
    assert codes(RING[:1]) == [("too_few_cameras", None, "error")]


def test_narrow_views_that_cross_are_found() -> None:
    """Two lenses of five degrees see the same cubic metre ten metres away."""
    narrow = [changed(changed(camera, 0, 0, 15_000.0), 1, 1, 15_000.0) for camera in RING[:2]]
    far = [moved(distorted(camera), center) for camera, center in zip(narrow, ((10, 0, 2), (0, 10, 2)), strict=True)]
    assert codes(far) == []
    aside = [far[0], moved(far[1], (0, 10, 2), (0.0, 0.0, 6.0))]
    assert {(finding[0], finding[2]) for finding in codes(aside)} == {("no_common_view", "error")}


def test_long_lenses_side_by_side_share_view_far_away() -> None:
    """Views of two degrees, three metres apart: they overlap beyond 86 m."""
    narrow = [changed(changed(camera, 0, 0, 36_600.0), 1, 1, 36_600.0) for camera in RING[:2]]
    places = ((10.0, 0.0, 2.0), (10.0, 3.0, 2.0))
    beside = [
        moved(distorted(camera), place, (-90.0, place[1], 1.0)) for camera, place in zip(narrow, places, strict=True)
    ]
    assert "no_common_view" not in {finding[0] for finding in codes(beside)}


def test_folding_radius_of_one_coefficient() -> None:
    """r (1 + k1 r^2) grows up to r = 1 / sqrt(-3 k1), to two thirds of it on the picture (closed form)."""
    camera = distorted(RING[0], -0.75, 0.0, 0.0, 0.0)
    on_picture, ideal = growing_radius(camera)
    assert ideal == pytest.approx(2 / 3, rel=2e-3)
    assert on_picture == pytest.approx(4 / 9, rel=1e-5)
    corner, inner = picture_radii(camera)
    assert inner < on_picture < corner
    (finding,) = [one for one in check_cameras((camera, *RING[1:])) if one.code == "distortion_folds"]
    assert finding.evidence == {"share": pytest.approx(4 / 9 / corner, rel=1e-5)}
