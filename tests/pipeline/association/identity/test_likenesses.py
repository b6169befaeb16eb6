"""Likenesses among the people of a take, and poses without them."""

from collections.abc import Sequence

import numpy as np
import pytest
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from pipeline.association.identity.likenesses import (
    Likenesses,
    StillPerson,
    find_likenesses,
    find_mirror,
    find_still,
    without_likenesses,
)
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Poses3D, Source, Track3D
from pipeline.core.joints import COCO_17, other_side
from pipeline.geometry.camera import center_in_world
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.motion.script import Cue, Gesture, Role, Stay, Turn, Walk
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

RATE_HZ = 30.0
OTHERS = COCO_17.indices(tuple(other_side(name) for name in COCO_17.names))
Motion = Float[np.ndarray, "frames joints 3"]
WALK: Sequence[Cue] = (Walk((1.2, 0.6), 1.1), Turn(2.0), Stay(2.0, Gesture.WAVE), Walk((-1.0, -0.5), 1.1), Turn(0.0))


def moving(seed: int, duration_s: float = 8.0, cues: Sequence[Cue] = WALK) -> Motion:
    """Joints of somebody who moves about within 1.5 m of the origin."""
    person = perform(Role((-1.0, 0.2), 0.0, tuple(cues)), duration_s, np.random.default_rng(seed))
    return joints_at(person, np.arange(round(duration_s * RATE_HZ)) / RATE_HZ)


def poster(seed: int, duration_s: float = 8.0) -> Motion:
    """Flat picture of somebody on a wall."""
    pose_m = moving(seed, 1.0)[15] * [0.0, 0.9, 0.9] + [1.8, 0.0, 0.4]
    return np.repeat(pose_m[None], round(duration_s * RATE_HZ), axis=0)


def mirrored(motion_m: Motion, normal: Sequence[float], offset_m: float) -> Motion:
    """Mirror image of somebody, with the names that a detector gives to its joints."""
    direction = np.array(normal) / np.linalg.norm(normal)
    return np.asarray(motion_m - 2 * (motion_m @ direction - offset_m)[..., None] * direction)[:, OTHERS]


def track(xyz_m: Motion, seed: int = 0, noise_m: float = 0.01, start_frame: int = 0) -> Track3D:
    """Track of joints with noise."""
    xyz_m = xyz_m + np.random.default_rng(seed).normal(0.0, noise_m, xyz_m.shape)
    known = np.isfinite(xyz_m[..., 0])
    source = np.where(known, Source.MEASURED, Source.ABSENT)
    return Track3D(1, start_frame, xyz_m, known * 0.9, source, np.where(known, 1.0, np.nan), 3 * known)


RING = build_cameras(Rig(Layout.RING, 6, (4.0, 4.0), 2.2), np.random.default_rng(0))
ALONG_X = (1.0, 0.0, 0.0)


def behind(normal: Sequence[float], offset_m: float) -> np.ndarray:
    """Cameras behind a plane."""
    return np.array([center_in_world(camera) @ np.array(normal) > offset_m for camera in RING])


def likenesses(tracks: Sequence[Track3D], blind: np.ndarray | None = None) -> Likenesses:
    """Likenesses of people whom all cameras see, but those that are blind to the last person."""
    sees = [np.ones((person.num_frames, len(RING)), bool) for person in tracks]
    if blind is not None:
        sees[-1][:, blind] = False
    return find_likenesses(tracks, lambda number: sees[number], RING, COCO_17, RATE_HZ)


@pytest.mark.parametrize(("normal", "offset_m"), [(ALONG_X, 2.2), ((0.6, 0.8, 0.0), 1.9), ((0.0, -1.0, 0.0), 1.6)])
@pytest.mark.parametrize("seed", [1, 2])
def test_image_is_found_with_its_plane(normal: tuple[float, ...], offset_m: float, seed: int) -> None:
    person, image = track(moving(seed), seed), track(mirrored(moving(seed), normal, offset_m), seed + 9, 0.03)
    found = likenesses([person, image], behind(normal, offset_m))
    assert not found.still
    (of_second,) = found.images
    assert (of_second.number, of_second.original, of_second.num_frames) == (1, 0, 240)
    sign = np.sign(of_second.normal @ np.array(normal))
    np.testing.assert_allclose(sign * of_second.normal, normal, atol=0.02)
    assert of_second.normal.max() > -of_second.normal.min()
    assert sign * of_second.offset_m == pytest.approx(offset_m, abs=0.03)
    assert of_second.error_m < 0.03
    assert found.others(2) == [0]


def test_image_is_found_of_person_whose_feet_nobody_saw() -> None:
    """Joints that were never located neither count nor warn."""
    person_m = moving(3)
    person_m[:, COCO_17.indices(("left_ankle", "right_ankle"))] = np.nan
    person, image = track(person_m, 3), track(mirrored(moving(3), ALONG_X, 2.2), 12)
    assert [found.number for found in likenesses([person, image], behind(ALONG_X, 2.2)).images] == [1]


def test_image_may_come_first() -> None:
    person, image = track(moving(3)), track(mirrored(moving(3), ALONG_X, 2.2), 1)
    sees = [np.tile(~behind(ALONG_X, 2.2), (240, 1)), np.ones((240, 6), bool)]
    found = find_likenesses([image, person], lambda number: sees[number], RING, COCO_17, RATE_HZ)
    assert [(image.number, image.original) for image in found.images] == [(0, 1)]


def test_somebody_whom_cameras_behind_plane_see_is_real() -> None:
    """Dancers who mirror each other exactly."""
    assert behind(ALONG_X, 1.6).any()
    pair = track(moving(2)), track(mirrored(moving(2), ALONG_X, 1.6), 1)
    assert find_mirror(*pair, COCO_17, RATE_HZ) is not None
    assert likenesses(pair).images == []


def test_dancers_who_mirror_each_other_for_while_are_real() -> None:
    other_m = mirrored(moving(2), ALONG_X, 2.2)
    other_m[160:] += np.linspace(0.0, 0.6, 80)[:, None, None] * [0.3, 1.0, 0.0]
    assert likenesses([track(moving(2)), track(other_m, 1)], behind(ALONG_X, 2.2)).images == []


@pytest.mark.parametrize("late", [4, 6, 9])
def test_dancers_are_late(late: int) -> None:
    """A fifth of a second, as of people who follow each other."""
    other_m = mirrored(moving(2), ALONG_X, 2.2)
    pair = [track(moving(2)[late:]), track(other_m[:-late], 1)]
    assert likenesses(pair, behind(ALONG_X, 2.2)).images == []


def test_dancers_who_do_same_side_by_side_are_no_images() -> None:
    same_m = moving(2) + np.array([0.0, 2.5, 0.0])
    assert likenesses([track(moving(2)), track(same_m, 1)], behind((0.0, 1.0, 0.0), 1.25)).images == []


def test_left_and_right_are_exchanged_in_mirror() -> None:
    unnamed_m = mirrored(moving(1), ALONG_X, 2.2)[:, OTHERS]
    assert find_mirror(track(moving(1)), track(unnamed_m, 1), COCO_17, RATE_HZ) is None


def test_people_who_stand_opposite_each_other_tell_nothing() -> None:
    still_m = moving(1, cues=(Stay(8.0, Gesture.IDLE),))
    assert find_mirror(track(still_m), track(mirrored(still_m, ALONG_X, 2.2), 1), COCO_17, RATE_HZ) is None


def test_second_in_common_tells_nothing() -> None:
    image = track(mirrored(moving(1)[190:], ALONG_X, 2.2), 1, start_frame=190)
    assert find_mirror(track(moving(1)), image, COCO_17, RATE_HZ) is None


@pytest.mark.parametrize(("num_frames", "num_images"), [(100, 0), (180, 1)])
def test_image_is_one_for_most_of_its_time(num_frames: int, num_images: int) -> None:
    person, image = track(moving(1)[:num_frames]), track(mirrored(moving(1), ALONG_X, 2.2), 1)
    assert len(likenesses([person, image], behind(ALONG_X, 2.2)).images) == num_images


def test_likenesses_leave_other_people() -> None:
    image = track(mirrored(moving(1), ALONG_X, 2.2), 4)
    tracks = [track(poster(1)), track(moving(1), 2), track(moving(5), 3), image]
    found = likenesses(tracks, behind(ALONG_X, 2.2))
    assert [person.number for person in found.still] == [0]
    assert [(image.number, image.original) for image in found.images] == [(3, 1)]
    assert found.others(4) == [1, 2]
    assert likenesses(tracks[:1]).others(1) == [0]
    assert likenesses([]).others(0) == []


def still(person: Track3D) -> StillPerson | None:
    return find_still(0, person, COCO_17, RATE_HZ)


@pytest.mark.parametrize("noise_m", [0.001, 0.01, 0.02])
def test_picture_never_moves(noise_m: float) -> None:
    found = still(track(poster(3), 1, noise_m))
    assert found is not None
    assert found.num_frames == 240
    assert found.moved_m < 1.5 * noise_m


def test_picture_that_somebody_hides_in_passing_never_moves() -> None:
    xyz_m = poster(4)
    xyz_m[60:75] = np.nan
    xyz_m[80:90, 5:11] = moving(0)[80:90, 5:11]
    found = still(track(xyz_m))
    assert found is not None
    assert found.num_frames == 225


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gesture", [Gesture.IDLE, Gesture.TALK, Gesture.WAVE])
def test_people_at_one_place_move(seed: int, gesture: Gesture) -> None:
    assert still(track(moving(seed, cues=(Stay(8.0, gesture),)), seed)) is None


def sitting(seed: int) -> Motion:
    """Somebody who sits still: trunk and feet stay, the head sways by a centimetre and the hands move a little more."""
    rng = np.random.default_rng(seed)
    xyz_m = np.repeat(moving(seed, 1.0)[:1], 600, axis=0)
    for joints, sway_m in ((slice(0, 5), 0.01), (slice(9, 10), 0.02), (slice(10, 11), 0.02)):
        noise = gaussian_filter1d(rng.normal(size=(600, 3)), 30.0, axis=0)
        xyz_m[:, joints] += sway_m * (noise / noise.std(0))[:, None]
    return xyz_m


@pytest.mark.parametrize("seed", range(4))
def test_people_who_sit_still_move(seed: int) -> None:
    assert still(track(sitting(seed), seed)) is None


def test_somebody_who_stands_and_then_goes_moves() -> None:
    xyz_m = np.concatenate([np.repeat(moving(0)[:1], 400, axis=0), moving(0)[:60]])
    assert still(track(xyz_m)) is None


def test_hand_that_waves_fast_moves() -> None:
    xyz_m = poster(5)
    xyz_m[:, [7, 9]] += 0.2 * np.sin(2 * np.pi * 2.0 * np.arange(240) / RATE_HZ)[:, None, None]
    assert still(track(xyz_m)) is None


def test_little_is_not_enough() -> None:
    few_joints = poster(3)
    few_joints[:, 7:] = np.nan
    assert still(track(few_joints)) is None
    assert still(track(poster(3, 2.9))) is None
    assert still(track(poster(3), noise_m=0.05)) is None  # in such noise people would seem still
    assert still(track(np.full((240, 17, 3), np.nan))) is None


CAMERAS = build_cameras(Rig(Layout.RING, 3, (4.0, 4.0), 2.2), np.random.default_rng(0))
TIMEBASE, STEP = Timebase(0.0, RATE_HZ, 240), 3


def poses(people_m: Sequence[Motion], seen: Sequence[Sequence[int]]) -> Poses3D:
    """Poses of people at every third frame, instant by instant, in a changing order."""
    rng = np.random.default_rng(1)
    rows = [(frame, int(person)) for frame in range(0, 240, STEP) for person in rng.permutation(len(people_m))]
    xyz_m = np.array([people_m[person][frame] for frame, person in rows])
    points_px = np.full((len(rows), 17, 3, 2), np.nan)
    for row, (_, person) in enumerate(rows):
        points_px[row][:, list(seen[person])] = person
    xyz_m += rng.normal(0.0, 0.01, xyz_m.shape)
    return Poses3D(np.array([frame for frame, _ in rows]), xyz_m, points_px, np.isfinite(points_px[..., 0]) * 0.9)


def kept(of_instants: Sequence[Poses3D]) -> np.ndarray:
    """Numbers of the people whose poses are left, which are their points."""
    left = without_likenesses(of_instants, CAMERAS, COCO_17, TIMEBASE, STEP)
    assert all(len(some.frame) == len(some.xyz_m) == len(some.score) for some in left)
    return np.concatenate([np.nanmax(some.points_px.reshape(len(some.frame), -1), axis=1) for some in left])


def test_those_who_move_are_left() -> None:
    normal = -CAMERAS[0].cam_from_world.rotation[2] * [1.0, 1.0, 0.0]
    normal /= np.linalg.norm(normal)
    image_m = mirrored(moving(2), normal, 1.8)  # a wall before the first camera
    all_poses = poses([moving(2), poster(1), image_m], [(0, 1, 2), (0, 1, 2), (1, 2)])
    assert kept([all_poses]).tolist() == [0.0] * 80
    halves = [
        Poses3D(all_poses.frame[rows], all_poses.xyz_m[rows], all_poses.points_px[rows], all_poses.score[rows])
        for rows in (slice(0, 117), slice(117, None))
    ]
    assert kept(halves).tolist() == [0.0] * 80


def test_all_stay_if_nobody_moves() -> None:
    assert len(kept([poses([poster(1), poster(2) + np.array([0.0, 1.5, 0.0])], [(0, 1), (1, 2)])])) == 160
    assert without_likenesses([], CAMERAS, COCO_17, TIMEBASE, STEP) == []
