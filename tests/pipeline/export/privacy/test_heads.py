"""Regions of heads: of tracked people through the lens, and of all bodies that were detected."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.detections import Detections, HeadRegions, MapGrid, PafFields, SeenHeads
from pipeline.core.joints import COCO_17, COCO_18
from pipeline.export.privacy.heads import (
    FACE,
    HOLD_S,
    NEAR_S,
    head_ellipses,
    head_path,
    head_regions,
    seen_heads,
    sphere_ellipse,
)
from pipeline.geometry.camera import project
from tests.pipeline.export.test_overlay import CAMERA
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

RATE_HZ, NUM_FRAMES = 25.0, 50
TIMEBASE = Timebase(0.0, RATE_HZ, NUM_FRAMES)
TIME_S = np.arange(NUM_FRAMES) / RATE_HZ
NOBODY = SeenHeads(np.empty(0, int), np.empty((0, 4)))
HEAD = COCO_17.indices(FACE)


def walk_m() -> np.ndarray:
    """Walk from left to right in front of the camera."""
    return (
        walker(NUM_FRAMES, RATE_HZ)
        - np.array([1.0, 2.0, 0.0])
        + np.linspace(-1, 1, NUM_FRAMES)[:, None, None] * [1, 0, 0]
    )


def is_inside(points_px: np.ndarray, ellipse_px: np.ndarray) -> np.ndarray:
    away = (points_px[:, None] - ellipse_px[None, :, :2]) / ellipse_px[None, :, 2:]
    return ((away**2).sum(-1) <= 1).any(1)


def regions_of(xyz_m: np.ndarray, seen: SeenHeads = NOBODY, start_frame: int = 0) -> HeadRegions:
    path = head_path(replace(track_of(xyz_m, 1), start_frame=start_frame), COCO_17, TIMEBASE)
    assert path is not None
    return head_regions(CAMERA, range(NUM_FRAMES), TIME_S, [path], seen)


def covered(regions: HeadRegions, xyz_m: np.ndarray) -> np.ndarray:
    """Frames in which all true joints of the head are inside a region."""
    return np.array(
        [
            is_inside(project(CAMERA, xyz_m[frame, HEAD]), regions.in_frame(frame, CAMERA.size_px)).all()
            for frame in range(NUM_FRAMES)
        ]
    )


def without_joints(xyz_m: np.ndarray, frames: slice, *names: str) -> np.ndarray:
    joints_m = xyz_m.copy()
    joints_m[frames, [[COCO_17.index(name)] for name in names]] = np.nan
    return joints_m


def test_head_is_inside_in_every_frame() -> None:
    assert covered(regions_of(walk_m()), walk_m()).all()


@pytest.mark.parametrize(
    "missing",
    [
        FACE,
        ("left_ear", "right_ear"),
        (*FACE, "left_shoulder", "right_shoulder"),
        ("nose", "left_eye", "right_eye", "left_ear"),
        COCO_17.names,
    ],
)
def test_head_whose_joints_are_unknown_for_while_is_inside(missing: tuple[str, ...]) -> None:
    truth_m = walk_m()
    assert covered(regions_of(without_joints(truth_m, slice(15, 35), *missing)), truth_m).all()


def test_less_knowledge_makes_larger_regions() -> None:
    truth_m = walk_m()
    radii = [
        float(np.median(regions_of(without_joints(truth_m, slice(None), *missing)).ellipse_px[:, 2]))
        for missing in ((), ("left_ear",), FACE, (*FACE, "left_shoulder", "right_shoulder"))
    ]
    assert radii == sorted(radii)
    assert radii[-1] > 2 * radii[0]


def test_joint_that_is_uncertain_makes_larger_region() -> None:
    certain = track_of(walk_m(), 1)
    unsure = replace(certain, uncertainty_m=np.full(certain.score.shape, 0.05))
    radii = [path.radius_m for track in (certain, unsure) if (path := head_path(track, COCO_17, TIMEBASE))]
    np.testing.assert_allclose(radii[1] - radii[0], 0.1)


def test_people_are_expected_before_and_after_their_track() -> None:
    truth_m = walk_m()
    held = covered(regions_of(truth_m[20:30], start_frame=20), truth_m)
    # Somebody who walks at 1 m/s is inside for the half second before and after.
    assert held[8:42].all()
    assert not held[0]
    short = head_path(replace(track_of(truth_m[:5], 1), start_frame=0), COCO_17, TIMEBASE)
    assert short is not None
    assert short.at(TIME_S[4] + HOLD_S - 0.01) is not None
    assert short.at(TIME_S[4] + HOLD_S + 0.01) is None


def test_track_without_any_place_has_no_head() -> None:
    assert head_path(track_of(np.full((5, 17, 3), np.nan), 1), COCO_17, TIMEBASE) is None


def test_sphere_is_inside_its_ellipse_through_lens() -> None:
    wide = replace(
        CAMERA, matrix=np.diag([0.5, 0.5, 1.0]) @ CAMERA.matrix, distortion=np.array([-0.25, 0.06, 0.0, 0.0])
    )
    directions = np.random.default_rng(2).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for center_m in ([0.0, 0.0, 1.7], [2.0, -1.0, 1.9], [-1.5, -2.8, 0.4]):
        ellipse_px = sphere_ellipse(wide, np.array(center_m), 0.2)
        assert ellipse_px is not None
        points_px = project(wide, center_m + 0.2 * directions)
        away = (points_px - ellipse_px[:2]) / ellipse_px[2:]
        assert ((away**2).sum(1) <= 1).all()
        # It is not much larger than the head.
        assert ellipse_px[2] < 0.85 * np.ptp(points_px[:, 0])


def test_heads_behind_and_at_camera() -> None:
    assert sphere_ellipse(CAMERA, np.array([0.0, -6.0, 1.0]), 0.2) is None
    at_camera = sphere_ellipse(CAMERA, np.array([0.0, -4.1, 1.0]), 0.2)
    assert at_camera is not None
    corners_px = np.array([[0.0, 0.0], [639.0, 0.0], [0.0, 479.0], [639.0, 479.0]])
    assert is_inside(corners_px, at_camera[None]).all()


def bodies(points_px: np.ndarray) -> Detections:
    """Detections of one body in each frame."""
    box_px = np.concatenate([np.nanmin(points_px, axis=1), np.nanmax(points_px, axis=1)], axis=1)
    return Detections("front", np.arange(len(points_px)), points_px, np.isfinite(points_px[..., 0]) * 1.0, box_px)


def test_bystander_whom_no_track_took_is_covered() -> None:
    truth_m = walk_m()
    found = bodies(project(CAMERA, truth_m))
    seen = seen_heads([found.within(range(25)), found.within(range(25, NUM_FRAMES))], COCO_17)["front"]
    regions = head_regions(CAMERA, range(NUM_FRAMES), TIME_S, [], seen)
    assert covered(regions, truth_m).all()
    # A few frames in which the detector missed it are filled from those around them.
    is_kept = (found.frame < 20) | (found.frame > 23)
    flickering = SeenHeads(seen.frame[is_kept], seen.ellipse_px[is_kept])
    assert NEAR_S * RATE_HZ > 4
    assert covered(head_regions(CAMERA, range(NUM_FRAMES), TIME_S, [], flickering), truth_m).all()


@pytest.mark.parametrize(
    "missing",
    [
        (),
        ("left_ear", "left_eye"),
        ("nose", "left_eye", "right_eye", "left_ear"),
        FACE,
        (*FACE, "left_hip", "right_hip"),
        tuple(name for name in COCO_17.names if name not in FACE),
    ],
)
def test_head_of_body_in_one_picture(missing: tuple[str, ...]) -> None:
    """Every subset of the joints of people who stand, in profile and from the front, gives a region with the head."""
    for turn_rad in (0.0, 1.5):
        truth_px = project(CAMERA, walker(30, RATE_HZ, turn_rad=turn_rad) - np.array([1.0, 2.0, 0.0]))
        known_px = truth_px.copy()
        known_px[:, COCO_17.indices(missing)] = np.nan
        found = bodies(known_px)
        ellipse_px = head_ellipses(found.keypoints_px, found.box_px, COCO_17)
        for number in range(30):
            assert is_inside(truth_px[number, HEAD], ellipse_px[number : number + 1]).all()


def test_body_without_shoulders_is_covered_whole() -> None:
    truth_px = project(CAMERA, walk_m())
    truth_px[:, [number for number, name in enumerate(COCO_17.names) if "knee" not in name and "ankle" not in name]] = (
        np.nan
    )
    found = bodies(truth_px)
    ellipse_px = head_ellipses(found.keypoints_px, found.box_px, COCO_17)
    corners_px = found.box_px[7].reshape(2, 2)
    assert is_inside(corners_px * 0.999 + corners_px.mean(0) * 0.001, ellipse_px[7:8]).all()


def test_peaks_of_heatmaps_are_as_large_as_heads_of_people() -> None:
    truth_m = walk_m()
    nose_px = project(CAMERA, truth_m[:, COCO_17.index("nose")])
    fields = PafFields(
        camera="front",
        frame=np.arange(NUM_FRAMES),
        peak_row=np.repeat(np.arange(NUM_FRAMES), 2),
        peak_joint=np.tile([COCO_18.index("nose"), COCO_18.index("left_knee")], NUM_FRAMES),
        peak_px=np.stack([nose_px, nose_px + 90], axis=1).reshape(-1, 2),
        peak_score=np.ones(2 * NUM_FRAMES),
        fields=np.zeros((NUM_FRAMES, 0, 2, 1, 1), np.uint8),
        limbs=np.empty((0, 2), int),
        grid=MapGrid((0.0, 0.0), (8.0, 8.0)),
    )
    seen = seen_heads([fields], COCO_18)["front"]
    assert seen.frame.tolist() == list(range(NUM_FRAMES))
    alone = head_regions(CAMERA, range(NUM_FRAMES), TIME_S, [], seen)
    assert is_inside(nose_px[:1], alone.in_frame(0, CAMERA.size_px)).all()
    assert alone.ellipse_px[:, 2].min() == 32.0  # a twentieth of the picture
    with_person = regions_of(truth_m, seen)
    assert float(np.median(with_person.ellipse_px[:, 2])) > 20


def test_body_of_one_joint_has_head_of_usual_size() -> None:
    keypoints_px = np.full((1, len(COCO_17.names), 2), np.nan)
    keypoints_px[0, COCO_17.index("nose")] = 300.0, 200.0
    ellipse_px = head_ellipses(keypoints_px, np.array([[300.0, 200.0, 300.0, 200.0]]), COCO_17)
    regions = head_regions(CAMERA, range(1), TIME_S[:1], [], SeenHeads(np.zeros(1, int), ellipse_px))
    assert regions.ellipse_px.tolist() == [[300.0, 200.0, 32.0, 32.0]]


def test_frames_outside_of_take_are_covered_whole() -> None:
    regions = HeadRegions("front", (640, 480), 10, 20, np.array([12]), np.array([[100.0, 50.0, 20.0, 30.0]]))
    for frame in (9, 20):
        assert is_inside(np.array([[0.0, 0.0], [639.0, 479.0]]), regions.in_frame(frame, (640, 480))).all()
    assert len(regions.in_frame(10, (640, 480))) == 0
    # The outer edges of a copy are those of the picture.
    np.testing.assert_allclose(regions.in_frame(12, (320, 240)), [[49.75, 24.75, 10.0, 15.0]])


def test_clocks_of_cameras_differ() -> None:
    """A head is where it was at the time of the frame, between two output frames."""
    truth_m = walk_m()
    path = head_path(track_of(truth_m, 1), COCO_17, TIMEBASE)
    assert path is not None
    late = head_regions(CAMERA, range(3, 5), np.array([0.5, 0.519]), [path], NOBODY)
    middle_m = (0.525 * truth_m[12] + 0.475 * truth_m[13])[HEAD]
    middle_px = project(CAMERA, (middle_m[3] + middle_m[4]) / 2)
    np.testing.assert_allclose(late.in_frame(4, CAMERA.size_px)[0, :2], middle_px, atol=3.0)
    assert late.in_frame(3, CAMERA.size_px)[0, 0] != late.in_frame(4, CAMERA.size_px)[0, 0]


def test_cameras_are_independent() -> None:
    other: Camera = replace(CAMERA, name="other", size_px=(320, 240), matrix=np.diag([0.5, 0.5, 1.0]) @ CAMERA.matrix)
    path = head_path(track_of(walk_m(), 1), COCO_17, TIMEBASE)
    assert path is not None
    here, there = (head_regions(camera, range(2), TIME_S[:2], [path], NOBODY) for camera in (CAMERA, other))
    np.testing.assert_allclose(here.ellipse_px[0, 2:], 2 * there.ellipse_px[0, 2:], rtol=0.02)
