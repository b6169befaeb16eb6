import io
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.preflight_npz import decode_session, encode_session
from pipeline.capture.session import CaptureSession
from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.data import (
    Animation,
    Camera,
    DamagedVideo,
    Detections,
    FootContact,
    FootPart,
    FrameTimes,
    MapGrid,
    Observations,
    PafFields,
    People,
    PictureChanges,
    Poses3D,
    SkeletonMotion,
    Track3D,
    no_detections,
)
from pipeline.findings import Finding
from pipeline.geometry.rigid import Rigid3
from pipeline.stages.outputs_npz import (
    decode_animation,
    decode_damaged_videos,
    decode_detections,
    decode_fields,
    decode_lengths,
    decode_poses,
    encode_animation,
    encode_colours,
    encode_detections,
    encode_fields,
    encode_lengths,
    encode_poses,
    open_people,
    with_colours,
    write_people,
)
from pipeline.video.info import VideoInfo

RNG = np.random.default_rng(3)
NOBODY = People((), (), 0)


def video(name: str, num_frames: int) -> VideoInfo:
    pts = np.arange(num_frames) * 512
    return VideoInfo(Path("/a/b") / name, "h264", (640, 480), 90, pts, pts[::10], pts / 15360.0, 30.0)


def camera(name: str) -> Camera:
    return Camera(name, (640, 480), RNG.normal(size=(3, 3)), RNG.normal(size=5), Rigid3(np.eye(3), RNG.normal(size=3)))


def test_session_comes_back_with_its_videos_where_they_are_now(tmp_path: Path) -> None:
    session = CaptureSession(
        cameras=(camera("left"), camera("Käm 2")),
        videos=(video("left.mp4", 30), video("Käm 2.mp4", 20)),
        times={"left": FrameTimes(np.arange(30) / 30.0), "Käm 2": FrameTimes(np.arange(20) / 30.0 + 0.1)},
        findings=(Finding("calibration_note", "They are near."),),
    )
    content = encode_session(session)
    assert encode_session(session) == content
    back = decode_session(content, tmp_path)
    assert back.findings == session.findings
    for ours, theirs in zip(session.cameras, back.cameras, strict=True):
        assert (theirs.name, theirs.size_px) == (ours.name, ours.size_px)
        np.testing.assert_array_equal(theirs.matrix, ours.matrix)
        np.testing.assert_array_equal(theirs.distortion, ours.distortion)
        np.testing.assert_array_equal(theirs.cam_from_world.rotation, ours.cam_from_world.rotation)
        np.testing.assert_array_equal(theirs.cam_from_world.translation_m, ours.cam_from_world.translation_m)
        np.testing.assert_array_equal(back.times[ours.name].time_s, session.times[ours.name].time_s)
    for our_video, their_video in zip(session.videos, back.videos, strict=True):
        assert their_video.path == tmp_path / our_video.path.name
        for field in fields(VideoInfo):
            if field.name != "path":
                np.testing.assert_array_equal(getattr(their_video, field.name), getattr(our_video, field.name))


def test_detections_come_back() -> None:
    found = Detections(
        "left", np.array([0, 0, 3]), RNG.normal(size=(3, 17, 2)), RNG.uniform(size=(3, 17)), RNG.normal(size=(3, 4))
    )
    back = decode_detections(encode_detections(found))
    assert back.camera == "left"
    for name in ("frame", "keypoints_px", "score", "box_px"):
        np.testing.assert_array_equal(getattr(back, name), getattr(found, name))


def test_changes_of_pictures_come_back() -> None:
    samples = np.arange(6, dtype=np.uint8).reshape(2, 3)
    changes = PictureChanges(np.array([3, 4]), np.array([np.nan, 2.5], np.float32), *samples)
    plain = Detections("left", np.array([4]), RNG.normal(size=(1, 17, 2)), np.ones((1, 17)), np.ones((1, 4)))
    for back in (
        decode_detections(encode_detections(replace(plain, changes=changes))),
        decode_fields(encode_fields(replace(fields_of_two_frames(), changes=changes))),
    ):
        for field in fields(PictureChanges):
            np.testing.assert_array_equal(getattr(back.changes, field.name), getattr(changes, field.name))
    assert len(decode_detections(encode_detections(plain)).changes.frame) == 0
    doubled = (DamagedVideo("left", "a.mp4", 0, 60, 0.0, 0.0, (0.5, 1.5)),)
    lengths = LimbLengths(np.array([[0.3]]), np.array([0.5]))
    assert decode_damaged_videos(encode_lengths(lengths, doubled)) == doubled


def test_colours_are_apart_from_detections() -> None:
    plain = Detections("left", np.array([4]), RNG.normal(size=(1, 17, 2)), np.ones((1, 17)), np.ones((1, 4)))
    coloured = replace(plain, colour=RNG.integers(0, 256, (1, 2, 32), np.uint8))
    assert encode_detections(coloured) == encode_detections(plain)
    back = with_colours(decode_detections(encode_detections(coloured)), encode_colours(coloured))
    np.testing.assert_array_equal(back.colour, coloured.colour)
    assert decode_detections(encode_detections(coloured)).colour.size == 0


def test_damage_comes_back_and_costs_no_byte_where_there_is_none(tmp_path: Path) -> None:
    found = Detections("left", np.array([4]), RNG.normal(size=(1, 17, 2)), np.ones((1, 17)), np.ones((1, 4)))
    assert "damaged" not in np.load(io.BytesIO(encode_detections(found))).files
    assert decode_detections(encode_detections(found)).damaged.tolist() == []
    damaged = replace(found, damaged=np.array([5, 6]))
    assert decode_detections(encode_detections(damaged)).damaged.tolist() == [5, 6]

    fields_found = fields_of_two_frames()
    assert decode_fields(encode_fields(fields_found)).damaged.tolist() == []
    content = encode_fields(replace(fields_found, damaged=np.array([5])))
    assert decode_fields(content).damaged.tolist() == [5]

    lengths = LimbLengths(np.array([[0.3]]), np.array([0.5]))
    videos = (DamagedVideo("left", "a.mp4", 2, 60, 0.5, 1.0), DamagedVideo("right", "b.mp4", 1, 60, 0.1, 0.1))
    assert encode_lengths(lengths) == encode_lengths(lengths, ())
    assert decode_damaged_videos(encode_lengths(lengths)) == ()
    people = tmp_path / "people"
    write_people(people, NOBODY)
    assert decode_damaged_videos(people) == ()
    write_people(people, NOBODY, videos)
    assert decode_damaged_videos(people) == decode_damaged_videos(encode_lengths(lengths, videos)) == videos
    np.testing.assert_array_equal(decode_lengths(encode_lengths(lengths, videos))[0], lengths[0])


def people_of_two_lengths() -> People:
    tracks, observations = [], []
    for track_id, num_frames in ((1, 4), (2, 6)):
        shape = (num_frames, 17)
        score, error_px = RNG.uniform(size=shape), RNG.normal(size=shape)
        source, num_views = RNG.integers(0, 4, shape).astype(np.int8), RNG.integers(0, 3, shape)
        xyz_m = RNG.normal(size=(*shape, 3))
        tracks.append(Track3D(track_id, 10 * track_id, xyz_m, score, source, error_px, num_views))
        points_px = RNG.normal(size=(num_frames, 2, 17, 2))
        detection = RNG.integers(-1, 90, (num_frames, 2), np.int32) if track_id == 2 else no_detections()
        observations.append(Observations(track_id, points_px, RNG.uniform(size=(num_frames, 2, 17)), detection))
    return People(tracks, observations, 3)


def assert_equal(ours: Track3D | Observations, theirs: Track3D | Observations) -> None:
    for field in fields(ours):
        np.testing.assert_array_equal(getattr(theirs, field.name), getattr(ours, field.name))


def test_people_come_back_one_by_one(tmp_path: Path) -> None:
    people, path = people_of_two_lengths(), tmp_path / "people"
    write_people(path, people)
    back = open_people(path)
    assert back.num_approximate_frames == 3
    for track, back_track in zip(people.tracks, back.tracks, strict=True):
        assert_equal(track, back_track)
    for seen, back_seen in zip(people.observations, back.observations, strict=True):
        assert_equal(seen, back_seen)
    assert [one.track_id for one in back.tracks[-1:]] == [back.observations[-1].track_id] == [2]


def test_uncertainty_comes_back_where_there_is_any() -> None:
    first, second = people_of_two_lengths().tracks
    certain = replace(first, uncertainty_m=np.where(first.source > 0, RNG.uniform(size=first.score.shape), np.nan))
    motions = tuple(
        SkeletonMotion(
            track.track_id,
            "",
            track.start_frame,
            25.0,
            np.ones(22),
            np.zeros((track.num_frames, 3)),
            np.zeros((track.num_frames, 22, 4)),
            (),
        )
        for track in (certain, second)
    )
    back = decode_animation(encode_animation(Animation((certain, second), motions, None)))
    assert_equal(certain, back.tracks[0])
    assert back.tracks[1].uncertainty_m is None


@pytest.mark.parametrize("num_joints", [24, 64])
def test_motions_with_and_without_fingers_come_back(num_joints: int) -> None:
    motions = tuple(
        SkeletonMotion(
            track.track_id,
            "person",
            track.start_frame,
            25.0,
            RNG.uniform(size=num_joints),
            RNG.normal(size=(track.num_frames, 3)),
            RNG.normal(size=(track.num_frames, num_joints, 4)),
            (),
        )
        for track in people_of_two_lengths().tracks
    )
    back = decode_animation(encode_animation(Animation(tuple(people_of_two_lengths().tracks), motions, None)))
    for motion, found in zip(motions, back.motions, strict=True):
        for name in ("bone_length_m", "root_m", "parent_from_joint"):
            np.testing.assert_array_equal(getattr(found, name), getattr(motion, name))


@pytest.mark.parametrize("part", ["foot", "heel", "toe"])
def test_contacts_come_back_with_their_part(part: FootPart) -> None:
    contact = FootContact("right", 3, 5, 0.9, pinned=True, slide_before_m=0.01, slide_after_m=0.002, part=part)
    (track,) = people_of_two_lengths().tracks[:1]
    turned = np.zeros((track.num_frames, 24, 4))
    motion = SkeletonMotion(
        track.track_id, "", track.start_frame, 25.0, np.ones(24), np.zeros((track.num_frames, 3)), turned, (contact,)
    )
    back = decode_animation(encode_animation(Animation((track,), (motion,), None)))
    assert back.motions[0].contacts == (contact,)


def test_equal_people_are_equal_bytes(tmp_path: Path) -> None:
    people = people_of_two_lengths()
    for name in ("one", "other"):
        write_people(tmp_path / name, people)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


def fields_of_two_frames() -> PafFields:
    return PafFields(
        camera="left",
        frame=np.array([3, 4]),
        peak_row=np.array([0, 1, 1]),
        peak_joint=np.array([2, 0, 5]),
        peak_px=RNG.normal(size=(3, 2)),
        peak_score=RNG.uniform(size=3),
        fields=RNG.integers(0, 256, (2, 19, 2, 6, 8)).astype(np.uint8),
        limbs=np.arange(38).reshape(19, 2),
        grid=MapGrid((3.5, 3.4), (8.0, 8.1)),
    )


def test_fields_come_back() -> None:
    found = fields_of_two_frames()
    content = encode_fields(found)
    assert encode_fields(found) == content
    back = decode_fields(content)
    for field in fields(PafFields):
        if field.name != "changes":
            np.testing.assert_array_equal(getattr(back, field.name), getattr(found, field.name))


def test_lengths_and_poses_come_back() -> None:
    lengths = LimbLengths(np.array([[np.nan, 0.3], [0.2, 0.25]]), np.array([0.0, 0.5]))
    for ours, theirs in zip(lengths, decode_lengths(encode_lengths(lengths)), strict=True):
        np.testing.assert_array_equal(theirs, ours)
    poses = Poses3D(
        np.array([0, 0, 2]),
        RNG.normal(size=(3, 14, 3)),
        RNG.normal(size=(3, 14, 4, 2)),
        RNG.uniform(size=(3, 14, 4)),
        np.array([2]),
    )
    back = decode_poses(encode_poses(poses))
    for field in fields(Poses3D):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(poses, field.name))
