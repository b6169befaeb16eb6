import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.animation import Animation, FootContact, FootPart
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Doubt, Observations, Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.core.findings import Finding
from pipeline.core.joints import BODY_FEET, COCO_17, WHOLE_BODY, finger_joints
from pipeline.core.problems.finding_codes import CAMERA_BELOW_FLOOR, DISTORTION_FOLDS
from pipeline.core.problems.request_codes import CALIBRATION_UNPOSED
from pipeline.export.quality.report import (
    acceleration_m_s2,
    bone_length_std_cm,
    encode,
    estimate_stature_m,
    join_findings,
    people_findings,
    quality_report,
)
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.feet.floor import estimate_floor
from tests.pipeline.motion.skeleton.hands.people import gesturing, landmarks_of
from tests.pipeline.motion.skeleton.synthetic_tracks import SHIN_M, THIGH_M, TRUNK_M, track_of, walker, without

RATE_HZ = 30.0
NUM_BODY = len(BODY_FEET.names)


def camera(name: str, angle_deg: float, height_m: float = 1.5, distortion: tuple[float, ...] = ()) -> Camera:
    """Make a level camera that looks at the walker's start from five metres away."""
    angle = np.radians(angle_deg)
    forward = np.array([np.cos(angle), np.sin(angle), 0.0])
    rotation = np.stack([np.cross(forward, [0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], forward])
    center = np.array([1.0, 2.0, height_m]) - 5.0 * forward
    matrix = np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]])
    return Camera(name, (1280, 720), matrix, np.array(distortion), Rigid3(rotation, -rotation @ center))


CAMERAS = (camera("a", 90.0), camera("b", 210.0, distortion=(-0.2, 0.05, 0.001, 0.002)), camera("c", -30.0))


def observe(track: Track3D, cameras: tuple[Camera, ...] = CAMERAS, score: float = 0.8) -> Observations:
    """Exact observations of a track."""
    points_px = np.stack([project(one, track.xyz_m) for one in cameras], axis=1)
    return Observations(track.track_id, points_px, np.where(np.isfinite(points_px[..., 0]), score, 0.0))


def reconstruction(
    *tracks: Track3D, observations: tuple[Observations, ...] | None = None, cameras: tuple[Camera, ...] = CAMERAS
) -> Reconstruction:
    seen = tuple(observe(track, cameras) for track in tracks) if observations is None else observations
    ankles_m = [track.xyz_m[:, COCO_17.indices(("left_ankle", "right_ankle"))] for track in tracks]
    floor = estimate_floor(ankles_m, [np.isfinite(some).all(-1) for some in ankles_m], RATE_HZ)
    return Reconstruction(cameras, COCO_17, Timebase(0.0, RATE_HZ, 100), tracks, seen, Animation(tracks, (), floor))


def shifted(observations: Observations, camera_index: int, shift_px: tuple[float, float]) -> Observations:
    points_px = observations.points_px.copy()
    points_px[:, camera_index] += shift_px
    return dataclasses.replace(observations, points_px=points_px)


def test_perfect_walk_has_perfect_figures() -> None:
    report = quality_report(reconstruction(track_of(walker(40), track_id=3, start_frame=5)))
    assert report["schema_version"] == 1
    assert (report["num_frames"], report["frame_rate_hz"]) == (100, RATE_HZ)
    error = report["reprojection_error_px"]
    assert (error["median"], error["p95"]) == (0.0, 0.0)
    assert error["by_camera"] == {"a": 0.0, "b": 0.0, "c": 0.0}
    assert error["by_joint"] == dict.fromkeys(COCO_17.names, 0.0)
    assert error["num_observations"] == 40 * 3 * 17
    assert report["coverage"] == 1.0
    assert report["bone_length_std_cm"] == 0.0
    assert report["world_checks"] == []
    (person,) = report["people"]
    assert person == {
        "id": 3,
        "start_frame": 5,
        "num_frames": 40,
        "coverage": 1.0,
        "stature_m": round((SHIN_M + THIGH_M + TRUNK_M) / 0.779, 3),
        "reprojection_error_px": 0.0,
        "views_per_joint": 3.0,
        "joints_per_frame": 17.0,
        "feet": {
            "toes": "predicted",
            "num_contacts": 0,
            "num_pinned": 0,
            "slide_before_cm": None,
            "slide_after_cm": None,
            "contacts": [],
        },
        "gait": None,
        "movements": [],
        "angles": {},
        "balance": None,
        "identity": {"confidence": 1.0, "doubts": []},
    }


def test_hands_have_figures_of_their_own() -> None:
    """The left hand is measured in half of the frames, the right hand never."""
    track = track_of(landmarks_of(gesturing(40)))
    source = track.source.copy()
    fingers = {side: WHOLE_BODY.indices(finger_joints(side)) for side in ("left", "right")}
    source[:20, fingers["left"][:12]], source[:, fingers["right"]] = Source.PREDICTED, Source.PREDICTED
    off = shifted(observe(track), 0, (3.0, 4.0))
    score = off.score.copy()
    score[:, 1:, fingers["left"]], score[:, :, fingers["right"]] = 0.0, 0.0
    found = dataclasses.replace(
        reconstruction(
            dataclasses.replace(track, source=source), observations=(dataclasses.replace(off, score=score),)
        ),
        joints=WHOLE_BODY,
    )
    (person,) = quality_report(found)["people"]
    assert person["hands"] == {
        "left": {"measured": 0.5, "reprojection_error_px": 5.0},
        "right": {"measured": 0.0, "reprojection_error_px": None},
    }


def test_fingers_count_for_hands_alone() -> None:
    """Fingers that are far off and predicted change no figure of the body."""
    whole = track_of(landmarks_of(gesturing(40)))
    source = whole.source.copy()
    source[:, NUM_BODY:] = Source.PREDICTED
    whole = dataclasses.replace(whole, source=source)
    seen = observe(whole)
    points_px = seen.points_px.copy()
    points_px[:, :, NUM_BODY:] += 50.0
    body = dataclasses.replace(
        whole,
        **{name: getattr(whole, name)[:, :NUM_BODY] for name in ("xyz_m", "score", "source", "error_px", "views")},
    )
    with_fingers, without = (
        quality_report(dataclasses.replace(reconstruction(track, observations=(observations,)), joints=joints))
        for track, observations, joints in (
            (whole, dataclasses.replace(seen, points_px=points_px), WHOLE_BODY),
            (body, observe(body), BODY_FEET),
        )
    )
    assert with_fingers["people"][0].pop("hands")
    by_joint = with_fingers["reprojection_error_px"]["by_joint"]
    assert by_joint["left_thumb_tip"] == pytest.approx(np.hypot(50.0, 50.0), abs=0.01)
    for report in (with_fingers, without):
        del report["reprojection_error_px"]["by_joint"], report["reprojection_error_px"]["p95_by_joint"]
    assert with_fingers == without


@pytest.mark.parametrize(("part", "named"), [("foot", {}), ("heel", {"part": "heel"}), ("toe", {"part": "toe"})])
def test_contacts_of_parts_are_named(part: FootPart, named: dict[str, str]) -> None:
    contact = FootContact("left", 3, 5, 0.9, pinned=True, slide_before_m=0.01, slide_after_m=0.0, part=part)
    walked = reconstruction(track_of(walker(40)))
    motion = dataclasses.replace(gesturing(40), contacts=(contact,))
    animation = dataclasses.replace(walked.animation, motions=(motion,))
    (person,) = quality_report(dataclasses.replace(walked, animation=animation))["people"]
    assert person["feet"]["contacts"] == [
        {"foot": "left", "start_frame": 3, "num_frames": 5, "confidence": 0.9, "pinned": True, **named}
    ]


def test_doubts_about_identity_are_listed_with_their_product() -> None:
    doubts = (Doubt(12, 0.9, 2), Doubt(30, 0.8, 0))
    found = dataclasses.replace(reconstruction(track_of(walker(40))), doubts=[doubts])
    (person,) = quality_report(found)["people"]
    assert person["identity"] == {
        "confidence": 0.72,
        "doubts": [
            {"frame": 12, "confidence": 0.9, "other": 2},
            {"frame": 30, "confidence": 0.8, "other": None},
        ],
    }


def test_error_is_measured_in_pixels_as_seen_over_outliers_too() -> None:
    track = track_of(walker(40))
    off = shifted(observe(track), 1, (30.0, 40.0))
    report = quality_report(reconstruction(track, observations=(off,)))
    error = report["reprojection_error_px"]
    assert error["by_camera"] == {"a": 0.0, "b": 50.0, "c": 0.0}
    assert (error["median"], error["p95"]) == (0.0, 50.0)
    assert report["people"][0]["reprojection_error_px"] == 0.0


def test_doubtful_observations_don_t_count_and_views_show_it() -> None:
    track = track_of(walker(40))
    off = shifted(observe(track), 1, (30.0, 40.0))
    score = off.score.copy()
    score[:, 1] = 0.19
    report = quality_report(reconstruction(track, observations=(dataclasses.replace(off, score=score),)))
    assert report["reprojection_error_px"]["p95"] == 0.0
    assert report["reprojection_error_px"]["by_camera"]["b"] is None
    assert report["people"][0]["views_per_joint"] == 2.0
    score[:, 1] = 0.2
    report = quality_report(reconstruction(track, observations=(dataclasses.replace(off, score=score),)))
    assert report["reprojection_error_px"]["by_camera"]["b"] == 50.0


def test_dropped_joints_lower_coverage_and_joints_frame() -> None:
    whole = track_of(walker(40))
    seen = track_of(without(walker(40), "left_wrist", "nose", frames=slice(0, 20)))
    report = quality_report(reconstruction(seen, observations=(observe(whole),)))
    assert report["coverage"] == round(1 - 2 * 20 / (40 * 17), 4)
    assert report["people"][0]["joints_per_frame"] == 16.0
    # Observations of a joint without a position have no error, but they still were there.
    assert report["reprojection_error_px"]["num_observations"] == 3 * (40 * 17 - 40)
    assert report["people"][0]["views_per_joint"] == 3.0


def test_interpolated_joints_are_not_covered() -> None:
    track = track_of(walker(10))
    source = track.source.copy()
    source[:5] = Source.INTERPOLATED
    assert quality_report(reconstruction(dataclasses.replace(track, source=source)))["coverage"] == 0.5


def test_jitter_is_mean_acceleration() -> None:
    time_s = np.arange(20) / RATE_HZ
    xyz_m = np.zeros((20, 17, 3))
    # A parabola of 3 m/s2 in one joint, at rest in all others; unseen once.
    xyz_m[:, 0, 2] = 1.5 * time_s**2
    np.testing.assert_allclose(acceleration_m_s2(track_of(xyz_m), RATE_HZ)[:, 0], 3.0)
    assert quality_report(reconstruction(track_of(xyz_m)))["jitter_m_s2"] == round(3 / 17, 3)
    xyz_m[10, 0] = np.nan
    assert np.isnan(acceleration_m_s2(track_of(xyz_m), RATE_HZ)).sum() == 3


def test_bone_length_deviation_weights_tracks_by_frames() -> None:
    def stretched(num_frames: int, by_m: float) -> Track3D:
        xyz_m = np.zeros((num_frames, 17, 3))
        xyz_m[::2, COCO_17.index("left_wrist"), 0] = by_m
        return track_of(without(xyz_m, *(name for name in COCO_17.names if name not in {"left_wrist", "left_elbow"})))

    # Half the frames at 0 and half at 2 d: a standard deviation of d.
    assert bone_length_std_cm([stretched(10, 0.04)], COCO_17) == pytest.approx(2.0)
    assert bone_length_std_cm([stretched(10, 0.04), stretched(30, 0.08)], COCO_17) == pytest.approx(3.5)
    assert np.isnan(bone_length_std_cm([], COCO_17))


def test_stature_is_unknown_without_trunk() -> None:
    track = track_of(without(walker(5), "left_shoulder"))
    assert np.isnan(estimate_stature_m(track, COCO_17))
    assert quality_report(reconstruction(track))["people"][0]["stature_m"] is None


def test_nobody_is_no_error() -> None:
    report = quality_report(reconstruction())
    assert report["people"] == []
    assert report["world_checks"] == []
    assert report["coverage"] is None
    assert report["jitter_m_s2"] is None
    assert report["reprojection_error_px"]["median"] is None
    assert json.loads(encode(report)) == report


def test_short_tracks_have_no_jitter() -> None:
    report = quality_report(reconstruction(track_of(walker(1)), track_of(walker(2), track_id=2)))
    assert report["jitter_m_s2"] is None
    assert report["bone_length_std_cm"] == 0.0


def test_bytes_are_strict_and_always_same() -> None:
    report = quality_report(reconstruction(track_of(np.full((3, 17, 3), np.nan))))
    assert encode(report) == encode(report)
    assert b"NaN" not in encode(report)
    assert json.loads(encode(report)) == report


DOUBT = Finding(CAMERA_BELOW_FLOOR, "The camera is 0.40 m below z = 0.", "a")


def test_mirrored_world_is_error_wrong_floor_warning() -> None:
    mirrored = walker(60) * [-1.0, 1.0, 1.0] + [0.0, 0.0, 0.4]
    found = people_findings(quality_report(reconstruction(track_of(mirrored))))
    assert [(one.code, one.severity) for one in found] == [
        ("floor_not_at_zero", "warning"),
        ("mirrored_world", "error"),
    ]
    assert found[1].evidence == {"share": 1.0}
    assert found[1].hint is not None


def test_people_decide_where_floor_is() -> None:
    found = people_findings(quality_report(reconstruction(track_of(walker(60)))))
    assert found == []
    assert join_findings([DOUBT], found) == []


def test_findings_of_people_outweigh_errors_of_cameras() -> None:
    folds = Finding(DISTORTION_FOLDS, "The distortion folds the picture.", "a", "error")
    unposed = Finding(CALIBRATION_UNPOSED, "All cameras have the same pose.", None, "error")
    joined = join_findings([folds, unposed], [])
    assert [(finding.code, finding.severity) for finding in joined] == [
        ("distortion_folds", "warning"),
        ("calibration_unposed", "error"),
    ]
    nobody = people_findings(quality_report(reconstruction()))
    assert join_findings([folds], nobody) == [replace(folds, severity="warning"), *nobody]


def test_nobody_decides_nothing() -> None:
    found = people_findings(quality_report(reconstruction()))
    assert [(one.code, one.severity) for one in found] == [("nobody_found", "error")]
    assert join_findings([DOUBT], found) == [DOUBT, *found]
