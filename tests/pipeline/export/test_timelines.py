"""Frames of people's files, read by independent software: those of the take, or those of the person."""

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from trc import TRCData

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.file_formats import file_ending, formats_of_people, installed_formats
from pipeline.export.presets import PRESETS
from pipeline.export.results import write_results
from pipeline.export.timelines import BLOCK_FRAMES, held, held_blocks, unknown_outside
from pipeline.export.writers import angle_tables, bvh, csv_table, fbx, glb, trc, vrma
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from tests.e2e.foreign import read_with_blender, read_with_three, validate_with_khronos
from tests.pipeline.export.bvh_readers import read_with_bvhio
from tests.pipeline.export.test_results import take
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

EXPORTS = formats_of_people(installed_formats())
NUM_FRAMES, RATE_HZ = 60, 25.0
OF_PERSON = {"person-1": range(60), "person-2": range(10, 40)}
# Frames of the second person in which nobody saw anything.
PAUSE = range(20, 25)


@pytest.fixture(scope="module")
def two_people() -> Reconstruction:
    """A take with a person who is always there, and another one who comes later, goes earlier, and pauses."""
    late = track_of(walker(30) + 1.0, start_frame=OF_PERSON["person-2"].start)
    made = take(track_of(walker(NUM_FRAMES)), replace(late, track_id=2), rate_hz=RATE_HZ, num_frames=NUM_FRAMES)
    first, second = made.tracks
    paused = replace(made.animation, tracks=(first, with_pause(second)))
    return replace(made, animation=paused, timebase=Timebase(2.0, RATE_HZ, NUM_FRAMES))


def with_pause(track: Track3D) -> Track3D:
    rows = slice(PAUSE.start - track.start_frame, PAUSE.stop - track.start_frame)
    xyz_m, score, source = np.array(track.xyz_m), np.array(track.score), np.array(track.source)
    xyz_m[rows], score[rows], source[rows] = np.nan, 0.0, Source.ABSENT
    return replace(track, xyz_m=xyz_m, score=score, source=source)


@pytest.fixture(scope="module")
def of_take(two_people: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("take")
    write_results(two_people, folder, EXPORTS)
    return folder


def nearest_m(made: Reconstruction) -> Mapping[str, np.ndarray]:
    """World positions of the skeletons' joints in all frames of the take: the nearest pose where there is none."""
    found = {}
    for motion in made.motions:
        own = OF_PERSON[f"person-{motion.track_id}"]
        rows = np.clip(np.arange(NUM_FRAMES) - own.start, 0, len(own) - 1)
        found[motion.name] = forward_kinematics(motion)[rows]
    return found


def joints_m(made: Reconstruction) -> Mapping[str, np.ndarray]:
    """World positions of the tracks' joints in all frames of the take, NaN where nobody is."""
    found = {f"person-{track.track_id}": np.full((NUM_FRAMES, 17, 3), np.nan) for track in made.tracks}
    for track in made.tracks:
        found[f"person-{track.track_id}"][track.start_frame : track.start_frame + track.num_frames] = track.xyz_m
    return found


def y_up(xyz_m: np.ndarray) -> np.ndarray:
    return np.stack([xyz_m[..., 0], xyz_m[..., 2], -xyz_m[..., 1]], axis=-1)


def test_bvh_has_all_frames_and_holds_nearest_pose(two_people: Reconstruction, of_take: Path) -> None:
    for name, expected_m in nearest_m(two_people).items():
        path = of_take / f"{name}.bvh"
        assert f"\nFrames: {NUM_FRAMES}\n".encode() in path.read_bytes()
        found = read_with_bvhio(path)
        for joint in ("Hips", "Head", "LeftHand", "RightFoot"):
            np.testing.assert_allclose(found[joint], 100 * y_up(expected_m)[:, INDEX[joint]], atol=0.1)


def test_glb_holds_nearest_pose_and_hides_absent_people(two_people: Reconstruction, of_take: Path) -> None:
    paths = {of_take / f"{name}.glb": name for name in OF_PERSON}
    for path, issues in validate_with_khronos(list(paths)).items():
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), (path, issues["messages"])
    for path, read in read_with_three(list(paths), with_areas=True).items():
        assert read.frame_rate_hz == pytest.approx(RATE_HZ, rel=1e-4)
        expected_m = nearest_m(two_people)[paths[path]]
        for index, joint in enumerate(SKELETON):
            np.testing.assert_allclose(read.positions[joint.name], y_up(expected_m)[:, index], atol=1e-4)
        is_there = np.isfinite(joints_m(two_people)[paths[path]]).any((1, 2))
        (areas_m2,) = read.areas_m2.T
        assert (areas_m2[is_there] > 1.0).all()
        assert (areas_m2[~is_there] < 1e-6).all()
    assert b"absent" not in (of_take / "person-1.glb").read_bytes()


def test_fbx_has_all_frames_and_holds_nearest_pose(two_people: Reconstruction, of_take: Path) -> None:
    paths = {of_take / f"{name}.fbx": name for name in OF_PERSON}
    for path, read in read_with_three(list(paths)).items():
        assert read.frame_rate_hz == pytest.approx(RATE_HZ, rel=1e-4)
        expected_m = nearest_m(two_people)[paths[path]]
        for index, joint in enumerate(SKELETON):
            np.testing.assert_allclose(read.positions[joint.name], 100 * y_up(expected_m)[:, index], atol=1e-2)


@pytest.mark.blender
def test_blender_draws_nobody_who_is_not_there(two_people: Reconstruction, of_take: Path, tmp_path: Path) -> None:
    path = of_take / "person-2.glb"
    read = read_with_blender([(path, RATE_HZ, {})], tmp_path)[path]
    np.testing.assert_allclose(read.positions["Head"], nearest_m(two_people)["person-2"][:, INDEX["Head"]], atol=1e-4)
    is_there = np.isfinite(joints_m(two_people)["person-2"]).any((1, 2))
    (areas_m2,) = read.areas_m2.T
    assert (areas_m2[is_there] > 1.0).all()
    assert (areas_m2[~is_there] < 1e-6).all()


def test_files_of_joints_have_all_frames_and_no_joints_of_nobody(two_people: Reconstruction, of_take: Path) -> None:
    times_s = 2.0 + np.arange(NUM_FRAMES) / RATE_HZ
    for name, expected_m in joints_m(two_people).items():
        c3d = ezc3d.c3d(str(of_take / f"{name}.c3d"))
        assert (c3d["header"]["points"]["first_frame"], c3d["header"]["points"]["last_frame"]) == (0, NUM_FRAMES - 1)
        found_m = np.transpose(c3d["data"]["points"][:3], (2, 1, 0)) / 1000.0
        np.testing.assert_allclose(found_m[:, :17], expected_m, atol=1e-4)
        residuals = c3d["data"]["meta_points"]["residuals"][0].T[:, :17]
        np.testing.assert_array_equal(residuals < 0, np.isnan(expected_m).any(-1))
        table = TRCData()
        table.load(str(of_take / f"{name}.trc"))
        assert int(table["NumFrames"]) == NUM_FRAMES
        np.testing.assert_allclose([table[number + 1][0] for number in range(NUM_FRAMES)], times_s, atol=1e-6)
        found_m = np.array([table[number + 1][1] for number in range(NUM_FRAMES)], dtype=float)
        np.testing.assert_allclose(found_m, y_up(expected_m), atol=1e-4)
        with (of_take / f"{name}.csv").open(newline="", encoding="ascii") as file:
            rows = list(csv.DictReader(file))
        assert [int(row["frame"]) for row in rows] == list(range(NUM_FRAMES))
        np.testing.assert_allclose([float(row["time_s"]) for row in rows], times_s, atol=1e-6)
        is_empty = [not row["nose_x_m"] for row in rows]
        np.testing.assert_array_equal(is_empty, np.isnan(expected_m[:, 0, 0]))


def test_files_of_own_frames_equal_files_of_motion(two_people: Reconstruction, tmp_path: Path) -> None:
    """They begin at the person's first frame and mark no presence."""
    write_results(two_people, tmp_path, EXPORTS, timeline="person")
    for track, motion in zip(two_people.tracks, two_people.motions, strict=True):
        name, (joints, clock) = motion.name, (two_people.joints, two_people.timebase)
        angles = joint_angles(motion, track, joints)
        contents = {
            "bvh": bvh.encode(motion, PRESETS["default"]),
            "glb": glb.encode(motion, np.zeros(3)),
            "fbx": fbx.encode(motion, "default", np.zeros(3)),
            "vrma": vrma.encode(motion, np.zeros(3)),
            "trc": trc.encode(track, joints, clock, f"{name}.trc"),
            "csv": csv_table.encode(track, joints, clock),
            "angles.csv": angle_tables.encode_csv(angles, clock, track.frames),
            "mot": angle_tables.encode_mot(angles, clock, f"{name}.mot", track.frames),
        }
        for export, content in contents.items():
            assert (tmp_path / f"{name}.{export}").read_bytes() == b"".join(content), (name, export)
    assert len(next(iter(read_with_bvhio(tmp_path / "person-2.bvh").values()))) == len(OF_PERSON["person-2"])


def test_only_files_of_people_depend_on_timeline(two_people: Reconstruction, of_take: Path, tmp_path: Path) -> None:
    write_results(two_people, tmp_path, EXPORTS, timeline="person")
    for name in ("skeletons.json", "metrics.json", "person-1.bvh", "person-1.trc", "person-1.c3d", "person-1.glb"):
        assert (tmp_path / name).read_bytes() == (of_take / name).read_bytes(), name
    for export in EXPORTS:
        assert (tmp_path / f"person-2.{file_ending(export)}").read_bytes() != (
            of_take / f"person-2.{file_ending(export)}"
        ).read_bytes()


def test_all_files_have_frames_of_take_at_another_rate(two_people: Reconstruction, tmp_path: Path) -> None:
    write_results(two_people, tmp_path, EXPORTS, frame_rate_hz=50.0)
    for name in OF_PERSON:
        assert len(read_with_bvhio(tmp_path / f"{name}.bvh")["Hips"]) == 2 * NUM_FRAMES - 1
        assert ezc3d.c3d(str(tmp_path / f"{name}.c3d"))["header"]["points"]["last_frame"] == 2 * NUM_FRAMES - 2
        assert len(np.concatenate(list(glb.read_xyz_m(tmp_path / f"{name}.glb")))) == 2 * NUM_FRAMES - 1
        in_fbx_m = list(fbx.read_xyz_m(tmp_path / f"{name}.fbx", "default"))
        assert len(np.concatenate(in_fbx_m)) == 2 * NUM_FRAMES - 1


@pytest.mark.parametrize("frames", [range(3, 12), range(5, 8), range(6, 7), range(3), range(20, 30), range(7, 2000)])
def test_blocks_of_poses_that_hold_make_up_frames(frames: range) -> None:
    own, values = range(5, 8), np.array([5, 6, 7])
    blocks = list(held_blocks(own, frames))
    found = [values[frame - own.start] for block, num_times in blocks for frame in list(block) * num_times]
    np.testing.assert_array_equal(found, held(values, own, frames))
    assert max(len(block) * num_times for block, num_times in blocks) <= BLOCK_FRAMES


def test_values_hold_or_are_unknown_outside_of_their_frames() -> None:
    values = np.array([[1.0], [2.0], [3.0]])
    np.testing.assert_array_equal(held(values, range(5, 8), range(3, 10))[:, 0], [1, 1, 1, 2, 3, 3, 3])
    np.testing.assert_array_equal(held(values, range(5, 8), range(9, 11))[:, 0], [3, 3])
    np.testing.assert_array_equal(
        unknown_outside(values, range(5, 8), range(3, 10))[:, 0], [np.nan, np.nan, 1, 2, 3, np.nan, np.nan]
    )
    assert np.isnan(unknown_outside(values, range(5, 8), range(2))).all()
