"""Cross-view tracking from exact and from faulty detections."""

from dataclasses import replace

import numpy as np

from pipeline.association.identity.clothes import measure_clothes
from pipeline.association.tracking.observations import gather
from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Source, Track3D
from pipeline.geometry.camera import project
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.conftest import body, detections_of

RATE_HZ = 25.0
NUM_FRAMES = 50


def two_walkers() -> np.ndarray:
    """World positions (people, frames, joints, 3) of two people who pass each other at 0.7 m."""
    along_m = np.linspace(-1.2, 1.2, NUM_FRAMES)
    paths = np.zeros((2, NUM_FRAMES, 1, 3))
    paths[0, :, 0, 0], paths[0, :, 0, 1] = along_m, 0.35
    paths[1, :, 0, 0], paths[1, :, 0, 1] = -along_m, -0.35
    return body() + paths


def same_times(cameras: tuple[Camera, ...]) -> dict[str, FrameTimes]:
    return {camera.name: FrameTimes(np.arange(NUM_FRAMES) / RATE_HZ) for camera in cameras}


def run(
    cameras: tuple[Camera, ...], detections: dict[str, Detections], times: dict[str, FrameTimes] | None = None
) -> tuple[Track3D, ...]:
    tracks, _ = reconstruct_tracks(
        cameras,
        times or same_times(cameras),
        detections,
        Timebase(0.0, RATE_HZ, NUM_FRAMES),
        derive_parameters(cameras, RATE_HZ),
    )
    return tracks


def assert_same_people(tracks: tuple[Track3D, ...], people_m: np.ndarray, atol_m: float) -> None:
    """Assert that each person has one track over all frames at the true position."""
    assert [(track.start_frame, track.num_frames) for track in tracks] == [(0, NUM_FRAMES)] * len(people_m)
    errors_m = np.array(
        [[np.nanmax(np.linalg.norm(track.xyz_m - person, axis=-1)) for person in people_m] for track in tracks]
    )
    assert sorted(errors_m.argmin(1)) == list(range(len(people_m)))
    assert errors_m.min(1).max() < atol_m


FISHEYE = np.array([0.035, -0.011, 0.002, -0.0005])


def test_two_people_pass_each_other_before_fisheyes(ring: tuple[Camera, ...]) -> None:
    """Exact observations of a wide fisheye give exact people; another lens model would be off by centimetres."""
    people_m = two_walkers()
    wide = np.diag([0.5, 0.5, 1.0])
    fisheyes = tuple(replace(c, matrix=wide @ c.matrix, distortion=FISHEYE, lens="fisheye") for c in ring)
    assert_same_people(run(fisheyes, {c.name: detections_of(c, people_m) for c in fisheyes}), people_m, 1e-6)


def test_joints_beyond_angle_of_fisheye_count_as_not_seen(ring: tuple[Camera, ...]) -> None:
    fisheyes = tuple(replace(c, distortion=FISHEYE, lens="fisheye") for c in ring)
    detections = {c.name: detections_of(c, two_walkers()) for c in fisheyes}
    outside = detections[ring[0].name]
    keypoints_px = outside.keypoints_px.copy()
    keypoints_px[3, 5] = 1e5
    bodies = gather(
        fisheyes, same_times(ring), detections | {ring[0].name: replace(outside, keypoints_px=keypoints_px)}
    )
    assert np.isnan(bodies.seen_px[3, 5]).all()
    assert bodies.score[3, 5] == 0
    assert np.isnan(bodies.seen_px).sum() == 2


def test_two_people_pass_each_other(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()
    # Each camera lists the people in an order of its own.
    detections = {c.name: detections_of(c, people_m, np.array([k % 2, 1 - k % 2])) for k, c in enumerate(ring)}
    tracks = run(ring, detections)
    assert_same_people(tracks, people_m, atol_m=1e-4)
    assert all((track.source == Source.MEASURED).all() and (track.views == 4).all() for track in tracks)


def test_unsynchronised_cameras_agree_on_output_instants(ring: tuple[Camera, ...]) -> None:
    """Interpolation is nearly exact for straight motion at constant speed with cameras of different phases."""
    times, detections = {}, {}
    base_m, speed_m_s = body() + np.array([-0.8, 0.0, 0.0]), np.array([0.8, 0.3, 0.0])
    for k, camera in enumerate(ring):
        time_s = np.arange(NUM_FRAMES + 1) / RATE_HZ - k * 0.011
        times[camera.name] = FrameTimes(time_s)
        detections[camera.name] = detections_of(camera, (base_m + time_s[:, None, None] * speed_m_s)[None])
    (track,) = run(ring, detections, times)
    instants_s = np.arange(NUM_FRAMES) / RATE_HZ
    truth_m = base_m + instants_s[:, None, None] * speed_m_s
    inner = slice(1, NUM_FRAMES - 1)
    np.testing.assert_allclose(track.xyz_m[inner], truth_m[inner], atol=2e-3)


def test_two_cameras_in_opposite_phase_and_at_half_rate_meet(ring: tuple[Camera, ...]) -> None:
    """Cameras of 25 Hz and 12.5 Hz without common frame times."""
    pair, base_m, speed_m_s = ring[:2], body() + np.array([-0.5, 0.0, 0.0]), np.array([0.5, 0.2, 0.0])
    times = {
        "cam0": FrameTimes(np.arange(NUM_FRAMES) / RATE_HZ),
        "cam1": FrameTimes(np.arange(NUM_FRAMES // 2) / (RATE_HZ / 2) + 0.02),
    }
    detections = {
        camera.name: detections_of(camera, (base_m + times[camera.name].time_s[:, None, None] * speed_m_s)[None])
        for camera in pair
    }
    (track,) = run(pair, detections, times)
    assert track.num_frames >= NUM_FRAMES - 4
    instants_s = (track.start_frame + np.arange(track.num_frames)) / RATE_HZ
    truth_m = base_m + instants_s[:, None, None] * speed_m_s
    np.testing.assert_allclose(track.xyz_m[1:-1], truth_m[1:-1], atol=5e-3)


def test_wrong_wrist_in_one_view_does_not_pull_joint(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()[:1]
    detections = {camera.name: detections_of(camera, people_m) for camera in ring}
    spoiled = detections["cam1"].keypoints_px.copy()
    spoiled[:, 5] += [0.0, 120.0]
    detections["cam1"] = replace(detections["cam1"], keypoints_px=spoiled)
    (track,) = run(ring, detections)
    # Plain least squares would be off by some 15 cm.
    assert np.linalg.norm(track.xyz_m[:, 5] - people_m[0][:, 5], axis=-1).max() < 0.02


def test_identity_survives_occlusion_in_all_views(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()
    detections = {}
    for camera in ring:
        seen = detections_of(camera, people_m)
        hidden = (np.tile([0, 1], NUM_FRAMES) == 1) & (seen.frame >= 20) & (seen.frame < 32)
        detections[camera.name] = Detections(
            camera.name, seen.frame[~hidden], seen.keypoints_px[~hidden], seen.score[~hidden], seen.box_px[~hidden]
        )
    tracks = run(ring, detections)
    assert len(tracks) == 2
    second = tracks[1] if np.isnan(tracks[1].xyz_m[25]).all() else tracks[0]
    assert second.num_frames == NUM_FRAMES
    assert (second.source[20:32] == Source.ABSENT).all()
    np.testing.assert_allclose(second.xyz_m[40:], people_m[1, 40:], atol=1e-3)


def hidden_while_walking(ring: tuple[Camera, ...], person_m: np.ndarray) -> dict[str, Detections]:
    """Detections of a person who is hidden from all cameras from frame 20 to frame 38."""
    detections = {}
    for camera in ring:
        seen = detections_of(camera, person_m[None])
        left = (seen.frame < 20) | (seen.frame >= 38)
        detections[camera.name] = Detections(
            camera.name, seen.frame[left], seen.keypoints_px[left], seen.score[left], seen.box_px[left]
        )
    return detections


def test_identity_survives_turn_behind_occlusion(ring: tuple[Camera, ...]) -> None:
    person_m = two_walkers()[0]
    speed_m = person_m[1] - person_m[0]
    sideways_m = speed_m[:, [1, 0, 2]]
    since = np.maximum(np.arange(NUM_FRAMES) - 22, 0)[:, None, None]
    (track,) = run(ring, hidden_while_walking(ring, person_m + since * (sideways_m - speed_m)))
    assert (track.start_frame, track.num_frames) == (0, NUM_FRAMES)


def test_person_out_of_walking_reach_is_new(ring: tuple[Camera, ...]) -> None:
    person_m = two_walkers()[0].copy()
    person_m[30:, :, 1] -= 2.5
    tracks = run(ring, hidden_while_walking(ring, person_m))
    assert [(track.start_frame, track.num_frames) for track in tracks] == [(0, 20), (38, 12)]


def test_photographs_a_second_apart_are_each_read_alone(ring: tuple[Camera, ...]) -> None:
    """Four people stand elsewhere in each picture, often near the place of another person in the picture before."""
    rng = np.random.default_rng(4)
    corners_m = np.array([(x, y, 0.0) for x in (-0.8, 0.0, 0.8) for y in (-0.8, 0.0, 0.8)])
    places_m = np.array([rng.permutation(corners_m)[:4] for _ in range(NUM_FRAMES)]).swapaxes(0, 1)
    people_m = body() + places_m[:, :, None] + rng.normal(0.0, 0.02, (4, NUM_FRAMES, 17, 3))
    pictures = {camera.name: FrameTimes(np.arange(float(NUM_FRAMES))) for camera in ring[:3]}
    detections = {camera.name: detections_of(camera, people_m) for camera in ring[:3]}
    timebase, parameters = Timebase(0.0, 1.0, NUM_FRAMES), derive_parameters(ring[:3], 1.0)
    tracks, _ = reconstruct_tracks(ring[:3], pictures, detections, timebase, parameters)
    found = np.full((len(tracks), NUM_FRAMES, 17, 3), np.nan)
    for number, track in enumerate(tracks):
        found[number, track.start_frame : track.start_frame + track.num_frames] = track.xyz_m
    apart_m = np.linalg.norm(found[:, None] - people_m, axis=-1).mean(-1)
    assert (np.nanmin(np.nan_to_num(apart_m, nan=np.inf), axis=0) < 0.1).mean() > 0.99


def test_short_gaps_of_joint_are_interpolated_and_marked(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()[:1]
    detections = {}
    for camera in ring:
        seen = detections_of(camera, people_m)
        points_px, score = seen.keypoints_px.copy(), seen.score.copy()
        points_px[10:13, 4], score[10:13, 4] = np.nan, 0.0
        points_px[30:45, 4], score[30:45, 4] = np.nan, 0.0
        detections[camera.name] = replace(seen, keypoints_px=points_px, score=score)
    (track,) = run(ring, detections)
    assert (track.source[10:13, 4] == Source.INTERPOLATED).all()
    np.testing.assert_allclose(track.xyz_m[10:13, 4], people_m[0, 10:13, 4], atol=1e-3)
    assert (track.source[30:45, 4] == Source.ABSENT).all()
    assert np.isnan(track.xyz_m[30:45, 4]).all()


def test_doubled_detection_makes_no_second_person(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()[:1]
    rng = np.random.default_rng(3)
    detections = {}
    for camera in ring:
        one = detections_of(camera, people_m)
        twice = np.repeat(np.arange(NUM_FRAMES), 2)
        points_px = one.keypoints_px[twice] + rng.normal(0, 2.0, (2 * NUM_FRAMES, 17, 2))
        detections[camera.name] = Detections(camera.name, twice, points_px, one.score[twice], one.box_px[twice])
    (track,) = run(ring, detections)
    assert track.num_frames == NUM_FRAMES


def test_false_positives_without_second_view_make_nobody(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()[:1]
    detections = {camera.name: detections_of(camera, people_m) for camera in ring}
    lamp_px = project(ring[0], body() + np.array([1.5, 1.5, 0.0]))
    one = detections["cam0"]
    detections["cam0"] = Detections(
        "cam0",
        np.repeat(np.arange(NUM_FRAMES), 2),
        np.stack([one.keypoints_px, np.broadcast_to(lamp_px, one.keypoints_px.shape)], axis=1).reshape(-1, 17, 2),
        np.repeat(one.score, 2, axis=0),
        np.repeat(one.box_px, 2, axis=0),
    )
    assert_same_people(run(ring, detections), people_m, atol_m=1e-3)


def test_nobody_anywhere(ring: tuple[Camera, ...]) -> None:
    empty = {
        c.name: Detections(c.name, np.empty(0, int), np.empty((0, 17, 2)), np.empty((0, 17)), np.empty((0, 4)))
        for c in ring
    }
    assert run(ring, empty) == ()


def test_observations_name_detections_and_so_their_colours() -> None:
    """Everybody wears a colour of their own, in cameras that are not synchronised."""
    scene = record(replace(find_scene("unsynchronised"), duration_s=3.0), seed=4)
    detections = {}
    for name, one in scene.detections.items():
        colour = np.zeros((len(one.frame), 2, 32), np.uint8)
        colour[np.arange(len(one.frame)), :, scene.identities[name]] = 255
        detections[name] = replace(one, colour=colour)
    parameters = derive_parameters(scene.cameras, scene.timebase.frame_rate_hz)
    tracked = scene.cameras, scene.times
    tracks, observations = reconstruct_tracks(*tracked, detections, scene.timebase, parameters)
    bodies = gather(*tracked, detections)
    worn = []
    for seen in observations:
        # Every camera that observes a joint has a detection near by, except between two frames.
        np.testing.assert_array_equal(seen.detection.shape, seen.score.shape[:2])
        assert ((seen.detection >= 0) & (seen.score > 0).any(-1)).sum() > 0.85 * (seen.score > 0).any(-1).sum()
        at_s = scene.timebase.start_time_s + (tracks[seen.track_id - 1].start_frame + np.arange(len(seen.score))) / (
            scene.timebase.frame_rate_hz
        )
        frames, cameras = np.nonzero(seen.detection >= 0)
        rows = seen.detection[frames, cameras]
        assert (bodies.camera[rows] == cameras).all()
        assert np.abs(bodies.time_s[rows] - at_s[frames]).max() <= 0.5 / scene.timebase.frame_rate_hz + 1e-9
        clothes = measure_clothes(seen.detection, bodies.colour, len(scene.cameras))
        assert clothes.num_detections.sum() == 2 * len(rows)
        worn.append(int(clothes.share.sum((0, 1)).argmax()))
        assert clothes.share[..., worn[-1]].min() > 0.9
    assert sorted(worn) == [0, 1, 2]


def test_without_colours_no_detections_are_recorded(ring: tuple[Camera, ...]) -> None:
    people_m = two_walkers()
    detections = {camera.name: detections_of(camera, people_m) for camera in ring}
    bodies = gather(ring, same_times(ring), detections)
    assert bodies.colour.shape == (len(bodies.frame), 0, 0)
    _, observations = reconstruct_tracks(
        ring, same_times(ring), detections, Timebase(0.0, RATE_HZ, NUM_FRAMES), derive_parameters(ring, RATE_HZ)
    )
    assert [seen.detection.size for seen in observations] == [0, 0]
    # A camera without colours has unknown ones beside the others.
    first, *_ = ring
    count = len(detections[first.name].frame)
    detections[first.name] = replace(detections[first.name], colour=np.full((count, 2, 32), 8, np.uint8))
    mixed = gather(ring, same_times(ring), detections)
    assert mixed.colour.any((1, 2)).sum() == count
    assert mixed.colour.shape == (len(bodies.frame), 2, 32)
