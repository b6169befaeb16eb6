from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.adjustment.parameters import move_camera
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_17
from pipeline.export.quality.report import estimate_stature_m, quality_report
from pipeline.export.quality.world_checks import world_checks
from tests.pipeline.export.quality.test_report import CAMERAS, camera, observe, reconstruction
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker


def codes(xyz_m: np.ndarray, cameras: tuple[Camera, ...] = CAMERAS) -> list[str]:
    track = track_of(xyz_m)
    statures_m = {track.track_id: estimate_stature_m(track, COCO_17)}
    return [check["code"] for check in world_checks(reconstruction(track, cameras=cameras), statures_m, [])]


WALK_M = walker(60)


@pytest.mark.parametrize(
    ("scale", "shift_m", "expected"),
    [
        ((1.0, 1.0, 1.0), 0.0, []),
        ((1.0, 1.0, 1.0), 0.4, ["floor_not_at_zero"]),
        ((0.1, 0.1, 0.1), 0.0, ["stature_out_of_range"]),
        ((1000.0, 1000.0, 1000.0), 0.0, ["floor_not_at_zero", "stature_out_of_range", "camera_below_floor"]),
        # The cameras stay upright: people may stand on their hands.
        ((1.0, -1.0, -1.0), 1.75, ["not_upright", "floor_not_at_zero"]),
    ],
)
def test_each_kind_of_wrong_world_is_named(scale: tuple[float, ...], shift_m: float, expected: list[str]) -> None:
    assert codes(WALK_M * scale + np.array([0.0, 0.0, shift_m])) == expected


def test_world_is_upside_down_if_people_and_cameras_are() -> None:
    turn = np.diag([1.0, -1.0, -1.0])
    turned = [camera.cam_from_world for camera in CAMERAS]
    cameras = tuple(
        replace(camera, cam_from_world=Rigid3(pose.rotation @ turn, pose.translation_m))
        for camera, pose in zip(CAMERAS, turned, strict=True)
    )
    assert "upside_down" in codes(WALK_M @ turn, cameras)


def test_people_along_another_axis_are_not_upright() -> None:
    assert "not_upright" in codes(WALK_M[..., [2, 0, 1]])


def test_nothing_is_wrong_where_nothing_is_known() -> None:
    assert codes(np.full((5, 17, 3), np.nan)) == []


def test_cameras_below_floor_are_named() -> None:
    sunk = (*CAMERAS, camera("low", 0.0, height_m=-1.0))
    track = track_of(WALK_M)
    (check,) = world_checks(reconstruction(track, cameras=sunk), {1: 1.7}, [])
    assert check["code"] == "camera_below_floor"
    assert "low" in check["message"]
    assert codes(np.full((5, 17, 3), np.nan), sunk) == ["camera_below_floor"]


def test_messages_say_who_and_how_much() -> None:
    (check,) = world_checks(reconstruction(track_of(WALK_M)), {1: 0.17}, [])
    assert check["message"].startswith("person-1 is 0.17 m tall")


def test_many_people_of_no_human_size_are_one_check() -> None:
    statures_m = dict.fromkeys(range(1, 12), 0.17) | {12: 1.7, 13: 2.5, 14: np.nan}
    (check,) = world_checks(reconstruction(track_of(WALK_M)), statures_m, [])
    assert check["code"] == "stature_out_of_range"
    assert check["message"].startswith("12 people are not 1 to 2.3 m tall: person-1 (0.17 m), person-2 (0.17 m), ")
    assert "person-10 (0.17 m) and 2 more. " in check["message"]


def test_many_cameras_below_floor_are_not_all_named() -> None:
    sunk = (*CAMERAS, *(camera(f"low-{k}", 0.0, height_m=-1.0) for k in range(12)))
    (check,) = world_checks(reconstruction(track_of(WALK_M), cameras=sunk), {1: 1.7}, [])
    assert check["message"].endswith("low-8, low-9 and 2 more.")


def test_mirrored_world_is_named() -> None:
    """People of a mirrored world raise the hand of the other side."""
    mirrored = WALK_M * np.array([-1.0, 1.0, 1.0])
    track = track_of(mirrored)
    (check,) = world_checks(reconstruction(track), {1: 1.7}, [])
    assert (check["code"], check["camera"], check["evidence"]) == ("mirrored_world", None, {"share": 1.0})


def test_units_that_fit_people_are_named() -> None:
    (check,) = world_checks(reconstruction(track_of(WALK_M)), {1: 172.0}, [])
    assert check["evidence"] == {"stature_m": 172.0, "people": [{"person": 1, "stature_m": 172.0}]}
    assert "cm" in check["hint"]


def test_camera_that_was_turned_is_named_with_its_shift() -> None:
    step = np.array([np.radians(2.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    given = (CAMERAS[0], move_camera(CAMERAS[1], step), CAMERAS[2])
    track = track_of(walker(100))
    seen = observe(track)
    noise_px = np.random.default_rng(3).normal(0.0, 1.0, seen.points_px.shape)
    take = reconstruction(track, observations=(replace(seen, points_px=seen.points_px + noise_px),), cameras=given)
    (check,) = quality_report(take)["world_checks"]
    assert (check["code"], check["camera"]) == ("camera_disagrees", "b")
    # The focal length is 900 pixels: two degrees about an axis across the view are 31.
    assert check["evidence"]["shift_px"] == pytest.approx(31.4, abs=3.0)
    assert quality_report(replace(take, cameras=CAMERAS))["world_checks"] == []
