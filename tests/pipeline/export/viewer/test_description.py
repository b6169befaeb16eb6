"""Files for viewers: what a plain reader finds in them is what the reconstruction holds."""

import base64
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.core.data.people import Doubt
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.viewer.description import ViewerMotion, person_frames
from pipeline.export.viewer.frames import ABSENT, ANGLE_STEP_DEG, encode_person, record_type
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.body import installed
from pipeline.motion.body.makehuman import NUM_COARSE_TRIANGLES
from pipeline.motion.body.shape import shape_body, standing_ankle_m
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.model import find_skeleton, forward_kinematics
from tests.pipeline.export.quality.test_report import CAMERAS, RATE_HZ, shifted
from tests.pipeline.export.viewer.takes import FOOTAGE, read_record, take
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker


def written(reconstruction: Reconstruction) -> tuple[dict[str, Any], bytes]:
    motion = ViewerMotion(reconstruction, person_views(reconstruction), FOOTAGE, quality_report(reconstruction))
    content = b"".join(motion.encode())
    return json.loads(motion.describe()), content


def columns_of(description: dict[str, Any], person: int) -> dict[str, np.ndarray]:
    strips = description["strips"]
    content = np.frombuffer(base64.b64decode(strips["people"][person]), np.uint8)
    return dict(zip(strips["columns"], content.reshape(len(strips["columns"]), -1), strict=True))


def two_people() -> Reconstruction:
    gap_m = walker(60) + np.array([1.5, 0.0, 0.0])
    gap_m[10:13, 9] = np.nan
    second = track_of(gap_m, track_id=4, start_frame=30)
    source = second.source.copy()
    source[20, :5] = 2
    return take(track_of(walker(40)), replace(second, source=source), doubts=((), (Doubt(45, 0.6, 1),)))


def test_records_hold_positions_sources_and_figures() -> None:
    reconstruction = two_people()
    description, content = written(reconstruction)
    assert len(content) == (40 + 60) * description["record"]["num_bytes"]
    for person, (track, motion) in enumerate(zip(reconstruction.tracks, reconstruction.motions, strict=True)):
        skeleton_m = forward_kinematics(motion)
        for row in (0, 11, 20, track.num_frames - 1):
            found = read_record(description, content, person, row)
            angle_deg = joint_angles(motion, track, reconstruction.joints).angle_deg[row]
            shown_deg = [angle_deg[ANGLE_NAMES.index(name)] for name in description["angle_names"]]
            np.testing.assert_allclose(found["angle_deg"], shown_deg, atol=0.051)
            np.testing.assert_allclose(found["joints_m"], track.xyz_m[row], atol=0.6e-4)
            np.testing.assert_allclose(found["skeleton_m"], skeleton_m[row], atol=0.6e-4)
            assert found["source"] == track.source[row].tolist()
            assert found["views"] == track.views[row].tolist()
            np.testing.assert_allclose(found["score"], track.score[row], atol=0.002)
            assert list(found["error"]) == [255 if np.isnan(px) else 4 for px in track.error_px[row]]
            assert found["camera_error"] == (0, 0, 0)


def test_angles_of_many_turns_keep_within_numbers_of_records() -> None:
    turned_deg = np.array([[0.04, -181.26, np.nan], [3200.0, -7200.5, 3276.0]])
    person = person_frames(two_people(), person_views(two_people()), 0)
    person = replace(person, angle_deg=np.repeat(turned_deg, 20, axis=0))
    dtype = record_type(len(COCO_17.names), person.skeleton_m.shape[1], 3, len(person.camera_error_px[0]))
    records = np.frombuffer(b"".join(encode_person(person, dtype)), dtype)
    assert records["angles"][0].tolist() == [0, -1813, ABSENT]
    off_deg = records["angles"][-1] * ANGLE_STEP_DEG - turned_deg[1]
    np.testing.assert_allclose(off_deg, 360.0 * np.round(off_deg / 360.0), atol=0.051)


def test_bodies_have_people_s_bones() -> None:
    installed.install()
    shapes, reconstruction = installed.load(), two_people()
    views, report = person_views(reconstruction), quality_report(reconstruction)
    motion = ViewerMotion(reconstruction, views, FOOTAGE, report, shapes=shapes)
    content = b"".join(motion.encode())
    described = motion.describe()
    plain, same = written(reconstruction)
    assert content == same
    assert plain["body"] is plain["people"][0]["body"] is None
    assert len(described) < len(json.dumps(plain)) + 50_000
    description = json.loads(described)
    body = description["body"]

    def numbers(text: str, kind: str, width: int) -> np.ndarray:
        return np.frombuffer(base64.b64decode(text), kind).reshape(-1, width).astype(float)

    assert len(numbers(body["triangles"], "<u2", 3)) == NUM_COARSE_TRIANGLES
    assert set(numbers(body["weights"], "u1", 4).sum(1)) == {255}
    for person, fitted in zip(description["people"], reconstruction.motions, strict=True):
        floor = reconstruction.animation.floor
        shaped = shape_body(shapes.coarse(), fitted.bone_length_m, standing_ankle_m(fitted, floor))
        vertices_m = body["step_m"] * numbers(person["body"]["vertices"], "<i2", 3)
        joints_m = body["step_m"] * numbers(person["body"]["joints"], "<i2", 3)
        np.testing.assert_allclose(vertices_m, shaped.vertices_m, atol=0.6e-4)
        assert len(joints_m) == len(body["joints"]) == 70
        for joint, place_m in zip(find_skeleton(24), shaped.joints_m[:24], strict=True):
            np.testing.assert_allclose(joints_m[body["joints"].index(joint.name)], place_m, atol=0.6e-4)
        tip = body["joints"].index("LeftHandIndex3")
        np.testing.assert_array_equal(joints_m[tip], joints_m[body["joints"].index("LeftHand")])


def test_camera_s_error_is_mean_of_body_s_joints() -> None:
    reconstruction = two_people()
    seen = reconstruction.observations
    off = replace(reconstruction, observations=(seen[0], shifted(seen[1], 1, (3.0, 4.0))))
    unseen = off.observations[1].score.copy()
    unseen[5, 2] = 0.0
    off = replace(off, observations=(off.observations[0], replace(off.observations[1], score=unseen)))
    description, content = written(off)
    # 5 px are 10 steps; 255: the camera sees nothing of the person.
    assert read_record(description, content, 1, 4)["camera_error"] == (0, 10, 0)
    assert read_record(description, content, 1, 5)["camera_error"] == (0, 10, 255)
    strips = columns_of(description, 1)
    assert strips["cameras"][33:37].tolist() == [3, 3, 2, 3]
    # Mean of 0, 5 and 0 px, and of 0 and 5 px, in steps of a half.
    assert strips["error"][33:37].tolist() == [3, 3, 5, 3]


def test_strips_tell_where_person_is_doubtful() -> None:
    description, content = written(two_people())
    assert description["strips"]["frames_per_bucket"] == 1
    strips = columns_of(description, 1)
    assert {name: len(column) for name, column in strips.items()} == dict.fromkeys(strips, 100)
    assert strips["measured"][29:31].tolist() == [0, 255]
    assert strips["measured"][41] == round(255 * 16 / 17)
    assert (strips["measured"][50], strips["interpolated"][50]) == (round(255 * 12 / 17), round(255 * 5 / 17))
    assert strips["measured"][90:].tolist() == [0] * 10
    assert strips["error"][90:].tolist() == [255] * 10
    # Half a second around the doubt.
    assert (strips["identity"] == round(255 * 0.6)).nonzero()[0].tolist() == list(range(30, 61))
    assert read_record(description, content, 1, 15)["identity"] == round(255 * 0.6) / 255
    assert read_record(description, content, 1, 31)["identity"] == 1.0


@pytest.mark.slow
def test_long_takes_have_few_buckets_that_keep_worst_frame() -> None:
    num_frames = 2500
    one = take(track_of(np.tile(walker(25), (100, 1, 1))), num_frames=num_frames)
    score = one.observations[0].score.copy()
    score[1234, 0] = 0.0
    description, _ = written(replace(one, observations=(replace(one.observations[0], score=score),)))
    assert description["strips"]["frames_per_bucket"] == 3
    strips = columns_of(description, 0)
    assert len(strips["cameras"]) == 834
    assert (strips["cameras"] == 2).nonzero()[0].tolist() == [1234 // 3]


def test_cameras_are_described_as_they_are() -> None:
    description, _ = written(two_people())
    assert [camera["name"] for camera in description["cameras"]] == ["a", "b", "c"]
    found, camera = description["cameras"][1], CAMERAS[1]
    assert (found["size_px"], found["lens"], found["video"]) == ([1280, 720], "standard", "b.mp4")
    assert found["distortion"] == camera.distortion.tolist()
    assert found["matrix"] == camera.matrix.tolist()
    assert found["cam_from_world"]["translation_m"] == camera.cam_from_world.translation_m.tolist()
    assert found["clock"] == [[0, 0.25, 0.0], [99, 0.25 + round(99 / RATE_HZ, 6), round(99 / RATE_HZ, 6)]]


def test_people_have_names_colours_and_figures() -> None:
    reconstruction = two_people()
    description, _ = written(reconstruction)
    first, second = description["people"]
    assert (first["name"], second["name"], second["id"]) == ("person-1", "person-4", 4)
    assert (second["start_frame"], second["num_frames"]) == (30, 60)
    assert second["offset_bytes"] == 40 * description["record"]["num_bytes"]
    assert first["color"] != second["color"]
    assert second["identity"]["doubts"] == [{"frame": 45, "confidence": 0.6, "other": 1}]
    contacts = reconstruction.motions[1].contacts
    assert [contact[2:] for contact in second["contacts"]] == [
        [30 + one.start_frame, one.num_frames] for one in contacts
    ]
    assert (first["gait"], first["movements"]) == (None, [])


def test_far_joints_take_coarser_steps() -> None:
    far_m = walker(20)
    far_m[7, 0] += (40.0, 0.0, 0.0)
    reconstruction = take(track_of(far_m))
    description, content = written(reconstruction)
    step_m = description["people"][0]["position_step_m"]
    assert 40.0 / 32767 < step_m < 45.0 / 32767
    np.testing.assert_allclose(read_record(description, content, 0, 7)["joints_m"], far_m[7], atol=0.6 * step_m)


def test_take_without_people_is_valid() -> None:
    description, content = written(take())
    assert (description["people"], description["strips"]["people"], content) == ([], [], b"")


def test_equal_takes_give_equal_bytes() -> None:
    assert written(two_people()) == written(two_people())
