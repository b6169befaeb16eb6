"""Calibration from a board: recovery, ambiguities, cameras that can't be linked, the floor."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.board.calibrate_board import calibrate_board
from pipeline.calibration.board.corner_search.find_board import find_board, is_exchanged
from pipeline.calibration.board.spec import Board, parse_board
from pipeline.calibration.board.views import BoardViews, choose_views
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.core.options.job_choices import KnownPoint
from pipeline.core.runtime.record_archive import decode, encode
from pipeline.geometry.camera import center_in_world, project
from tests.cases import accuracy_but
from tests.pipeline.calibration.board.conftest import ring, views_of
from tests.pipeline.calibration.board.filmed_boards import BoardPainter, board_poses

CHARUCO = parse_board("charuco:7x5:0.1:0.075:DICT_4X4_50")
AMBIGUOUS = parse_board("chessboard:7x5:0.1")


def simulated(board: Board, num_cameras: int = 4, num_poses: int = 60, seed: int = 5) -> list[BoardViews]:
    rng = np.random.default_rng(seed)
    cameras = ring(num_cameras)
    return views_of(cameras, board, *board_poses(cameras, board, num_poses, rng), rng)


def distance_mm(found: tuple[Camera, ...], truth: tuple[Camera, ...], board: Board = CHARUCO) -> np.ndarray:
    """Distances of the cameras from the truth; an ambiguous board may lie there the other way round."""
    found_m, truth_m = (np.array([center_in_world(camera) for camera in some]) for some in (found, truth))
    turned_m = truth_m * [-1.0, -1.0, 1.0] + board.corners_m[-1] * [1.0, -1.0, 0.0]
    ways_m = (truth_m, turned_m) if board.is_ambiguous else (truth_m,)
    return min((1000 * np.linalg.norm(found_m - way_m, axis=1) for way_m in ways_m), key=np.max)


@pytest.mark.slow
def test_small_rig_is_recovered_from_short_video() -> None:
    made = calibrate_board(simulated(CHARUCO, num_cameras=3, num_poses=24), CHARUCO, None, 25.0)
    truth = ring(3)
    assert made.has_extrinsics
    # Two standard deviations, which are 16 and 18 mm.
    assert distance_mm(made.cameras, truth).max() < 36.0
    for found, given in zip(made.cameras, truth, strict=True):
        assert abs(found.matrix[0, 0] / given.matrix[0, 0] - 1) < 0.012
    assert made.reprojection_error_px < 0.3
    assert {warning.code for warning in made.warnings} == {"board_poor_coverage"}


@pytest.mark.slow
@pytest.mark.parametrize("board", [CHARUCO, AMBIGUOUS], ids=str)
def test_rig_is_recovered_with_its_floor(board: Board) -> None:
    made = calibrate_board(simulated(board), board, None, 25.0)
    truth = ring(4)
    assert made.has_extrinsics
    assert distance_mm(made.cameras, truth, board).max() < 12.0
    for found, given in zip(made.cameras, truth, strict=True):
        assert abs(found.matrix[0, 0] / given.matrix[0, 0] - 1) < 0.003
    assert made.reprojection_error_px < 0.3
    assert ("board_ambiguous" in {warning.code for warning in made.warnings}) is board.is_ambiguous
    assert [report.name for report in made.by_camera] == [camera.name for camera in truth]
    assert not {"board_floor_uncertain", "board_disagrees"} & {warning.code for warning in made.warnings}
    # One camera is the origin of the adjustment; the standard deviations of the others are those of its lens, too, with
    # the coefficients that the chosen model lacks: 12 mm, of which the errors of other seeds are 0.4 to 1.6 times.
    sigma_mm = sorted(report.position_sigma_mm for report in made.by_camera)
    assert sigma_mm[0] == 0.0
    assert 0.5 < sigma_mm[1] <= sigma_mm[-1] < 14.0
    assert set(made.pictures) == {f"coverage_{camera.name}.svg" for camera in truth}


@pytest.mark.slow
def test_places_on_floor_make_one_plane() -> None:
    cameras, rng = ring(4), np.random.default_rng(5)
    times_s, poses = board_poses(cameras, CHARUCO, 40, rng)
    # The last place is a table.
    places_m = ((-0.6, 0.3, 0.0), (0.4, -0.5, 0.0), (-0.3, 0.4, 0.72))
    lying = [Rigid3(poses[0].rotation, np.array(place_m)) for place_m in places_m for _ in range(12)]
    later_s = [times_s[-1] + 1.0 + 2.0 * place + 0.04 * k for place in range(3) for k in range(12)]
    views = views_of(cameras, CHARUCO, np.append(times_s, later_s), poses + lying, rng)
    made = calibrate_board(views, CHARUCO, None, 25.0)
    assert f"the places at 0.00 s, {later_s[0]:.2f} s, {later_s[12]:.2f} s (" in made.world
    assert distance_mm(made.cameras, cameras).max() < 12.0


@pytest.mark.slow
def test_known_points_make_world() -> None:
    cameras = ring(4)
    xyz_m = np.array([[0.4, 0.5, 0.0], [-0.6, 0.1, 0.1], [0.2, -0.5, 0.9]])
    seen_px = [(camera.name, project(camera, xyz_m)) for camera in cameras]
    points = tuple(
        KnownPoint(f"P{k}", (x_m, y_m, z_m), tuple((name, float(one[k, 0]), float(one[k, 1])) for name, one in seen_px))
        for k, (x_m, y_m, z_m) in enumerate(xyz_m.tolist())
    )
    views = simulated(CHARUCO, num_poses=24)
    made = calibrate_board(views, CHARUCO, {camera.name: camera for camera in cameras}, 25.0, known_points=points)
    assert "3 known points" in made.world
    assert distance_mm(made.cameras, cameras).max() < 10.0
    with pytest.raises(InputError, match="known_points: Photographs"):
        calibrate_board(views[:1], CHARUCO, None, 25.0, known_points=points)


@pytest.mark.slow
def test_given_intrinsics_stay() -> None:
    given = {camera.name: camera for camera in ring(4)}
    made = calibrate_board(simulated(CHARUCO, num_poses=24), CHARUCO, given, 25.0)
    for camera in made.cameras:
        np.testing.assert_array_equal(camera.matrix, given[camera.name].matrix)
    assert distance_mm(made.cameras, ring(4)).max() < 10.0
    assert all(np.isnan(report.focal_sigma_percent) for report in made.by_camera)


@pytest.mark.slow
def test_cameras_of_another_clock_are_refused_with_offset() -> None:
    views = simulated(CHARUCO)
    late = replace(views[1], time_s=read_only(views[1].time_s + 0.4))
    with pytest.raises(InputError) as raised:
        calibrate_board([views[0], late, *views[2:]], CHARUCO, None, 25.0)
    (problem,) = raised.value.problems
    assert (problem.code, problem.camera) == ("board_unsynchronised", late.camera)
    assert "-0.400 s" in (problem.hint or "")


@pytest.mark.slow
def test_camera_that_shares_no_view_is_named() -> None:
    views = simulated(CHARUCO, num_poses=24)
    alone = replace(views[2], time_s=read_only(views[2].time_s + 1000.0))
    with pytest.raises(InputError) as raised:
        calibrate_board([*views[:2], alone, views[3]], CHARUCO, None, 25.0)
    assert [(one.code, one.camera) for one in raised.value.problems] == [("board_unlinked", alone.camera)]


@pytest.mark.slow
def test_photographs_give_intrinsics_only() -> None:
    views = [
        replace(one.select(range(len(one) - 24, len(one), 2)), time_s=read_only(np.full(12, np.nan)))
        for one in simulated(CHARUCO, num_poses=24)
    ]
    made = calibrate_board(views, CHARUCO)
    assert not made.has_extrinsics
    assert {warning.code for warning in made.warnings} <= {"board_poor_coverage", "board_few_views"}
    for camera, truth in zip(made.cameras, ring(4), strict=True):
        np.testing.assert_array_equal(camera.cam_from_world.rotation, np.eye(3))
        assert abs(camera.matrix[0, 0] / truth.matrix[0, 0] - 1) < 0.03


def test_board_that_was_not_found_is_named_with_its_numbers() -> None:
    views = [one.select(range(2)) for one in simulated(AMBIGUOUS, num_poses=8)]
    with pytest.raises(InputError) as raised:
        calibrate_board(views, AMBIGUOUS, None, 25.0)
    assert [one.camera for one in raised.value.problems] == [one.camera for one in views]
    assert "5x7" in str(raised.value)


def test_board_with_columns_and_rows_exchanged_is_named() -> None:
    camera, rng = ring(4)[0], np.random.default_rng(3)
    _, poses = board_poses([camera], CHARUCO, 1, rng)
    image = BoardPainter(camera, CHARUCO).paint(poses[-1], rng)
    declared = CHARUCO.exchanged
    assert find_board(image, declared) is None
    assert is_exchanged(image, declared)
    assert not is_exchanged(image, CHARUCO)
    (views, *_) = simulated(CHARUCO, num_poses=4)
    unseen = replace(views.select([]), num_exchanged=3)
    with pytest.raises(InputError) as raised:
        calibrate_board([unseen], declared, None, 25.0)
    (problem,) = raised.value.problems
    assert (problem.code, problem.hint) == ("board_exchanged", f"State {CHARUCO}.")


def test_views_come_back_from_their_archive() -> None:
    (views, *_) = simulated(CHARUCO, num_poses=4)
    decoded = decode(BoardViews, encode(views))
    assert (decoded.camera, decoded.size_px, decoded.num_pictures) == (views.camera, views.size_px, views.num_pictures)
    np.testing.assert_array_equal(decoded.corners_px, views.corners_px)
    assert encode(decoded) == encode(views)


def test_blurred_views_are_left_out_and_others_cover_picture() -> None:
    (views, *_) = simulated(CHARUCO)
    sharpness = np.ones(len(views))
    sharpness[::3] = 5.0
    chosen = choose_views(replace(views, sharpness_px=read_only(sharpness)), 10)
    assert len(chosen) == 10
    assert not set(chosen) & set(range(0, len(views), 3))
    spread = np.nanmean(views.corners_px, axis=1)
    assert np.ptp(spread[chosen], axis=0).min() > 0.6 * np.ptp(spread, axis=0).min()


def test_board_is_found_in_picture_and_mirrored_one_is_named() -> None:
    camera = ring(4)[0]
    rng = np.random.default_rng(3)
    _, poses = board_poses([camera], CHARUCO, 1, rng)
    image = BoardPainter(camera, CHARUCO).paint(poses[-1], rng)
    found = find_board(image, CHARUCO)
    assert found is not None
    seen = np.isfinite(found.corners_px).all(-1)
    (truth,) = views_of([camera], CHARUCO, np.zeros(1), poses[-1:], rng, noise_px=0.0)
    distance_px = np.linalg.norm(found.corners_px - truth.corners_px[0], axis=-1)[seen]
    assert np.median(distance_px) < 0.2
    assert distance_px.max() < 1.0
    mirrored = find_board(np.ascontiguousarray(image[:, ::-1]), CHARUCO)
    assert mirrored is not None
    assert mirrored.is_mirrored
    assert find_board(np.full_like(image, 128), CHARUCO) is None


def rendered(
    cameras: tuple[Camera, ...], board: Board, num_poses: int, seed: int, blur_px: float, noise: float
) -> Iterator[BoardViews]:
    rng = np.random.default_rng(seed)
    times_s, poses = board_poses(cameras, board, num_poses, rng)
    for camera in cameras:
        painter = BoardPainter(camera, board, blur_px, noise)
        seen_s, corners, blur = [], [], []
        for time_s, pose in zip(times_s, poses, strict=True):
            if -pose.rotation[:, 2] @ (center_in_world(camera) - pose.translation_m) < 0.1:
                continue
            if (found := find_board(painter.paint(pose, rng), board)) is not None and not found.is_mirrored:
                seen_s.append(time_s)
                corners.append(found.corners_px)
                blur.append(found.sharpness_px)
        time_s, corners_px, sharpness_px = (read_only(np.array(values)) for values in (seen_s, corners, blur))
        yield BoardViews(camera.name, camera.size_px, time_s, corners_px, sharpness_px, len(times_s))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "num_cameras", "num_poses", "seed", "blur_px", "noise"),
    accuracy_but(
        [("charuco:7x5:0.12:0.09:DICT_4X4_50", 4, 40, 105, 1.3, 8.0)],
        [
            ("charuco:7x5:0.12:0.09:DICT_4X4_50", 4, 40, 7, 0.7, 3.0),
            ("charuco:7x5:0.12:0.09:DICT_4X4_50", 4, 40, 103, 0.7, 3.0),
            ("charuco:7x5:0.12:0.09:DICT_4X4_50", 4, 40, 105, 1.3, 8.0),
            ("chessboard:8x6:0.1", 8, 48, 7, 0.7, 3.0),
        ],
    ),
)
def test_painted_boards_calibrate_to_millimetres(
    spec: str, num_cameras: int, num_poses: int, seed: int, blur_px: float, noise: float
) -> None:
    board, cameras = parse_board(spec), ring(num_cameras)
    views = list(rendered(cameras, board, num_poses, seed, blur_px, noise))
    made = calibrate_board(views, board, None, 25.0)
    assert made.reprojection_error_px <= 0.3
    for found, truth in zip(made.cameras, cameras, strict=True):
        assert abs(found.matrix[0, 0] / truth.matrix[0, 0] - 1) <= 0.003
    # At about 3 m, in the world as it is found from the board on the floor.
    assert distance_mm(made.cameras, cameras, board).max() <= 3.0
