"""Archives for OpenSim: models of the size of people, motions with our angles, files that OpenSim reads and runs."""

import json
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.data.rigid import Rigid3
from pipeline.core.runtime.child_processes import python_command
from pipeline.export.opensim import setup
from pipeline.export.opensim.anatomy import MARKERS
from pipeline.export.opensim.model_files import OpenSimPerson, write_opensim_files
from pipeline.export.opensim.setup import read_columns
from pipeline.export.quality.report import estimate_stature_m
from pipeline.motion.angles.compute import JointAngles, joint_angles
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.model import INDEX
from tests.cases import accuracy_but
from tests.pipeline.export.opensim.conftest import archived, needs_opensim, take_of
from tests.pipeline.motion.angles.simulated_people import rmse_deg

pytestmark = needs_opensim

COORDINATES = {
    "hip_flexion": "hip_flexion",
    "hip_adduction": "hip_adduction",
    "knee_flexion": "knee_angle",
    "elbow_flexion": "elbow_flex",
}
"""Coordinates of the model by our names."""


def apart_deg(take: Reconstruction, folder: Path) -> dict[str, float]:
    """RMS of the differences of OpenSim's angles from ours, of each kind, both sides together."""
    angles: JointAngles = joint_angles(take.motions[0], take.tracks[0], take.joints, has_sigmas=False)
    columns = read_columns((folder / "ik.mot").read_text())
    frames = np.rint(columns["time"] * take.timebase.frame_rate_hz).astype(int) - take.tracks[0].start_frame
    apart = {}
    for name, coordinate in COORDINATES.items():
        of_sides = [
            columns[f"{coordinate}_{side[0]}"] - angles.angle_deg[frames, ANGLE_NAMES.index(f"{side}_{name}")]
            for side in ("left", "right")
        ]
        both = np.concatenate(of_sides)
        apart[name] = rmse_deg(both[np.isfinite(both)])
    return apart


def run_in(folder: Path, code: str) -> str:
    """Output of a program with OpenSim, in a process of its own in a folder."""
    quiet = "import opensim\nopensim.Logger.removeFileSink()\nopensim.Logger.setLevelString('Off')\n"
    command = python_command("-c", quiet + code)
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_walk_has_model_that_follows_markers_and_angles(
    walk: Reconstruction, walk_archive: tuple[OpenSimPerson, Path]
) -> None:
    person, folder = walk_archive
    assert (person.problem, person.num_frames) == (None, 60)
    assert person.marker_rms_mm is not None
    assert person.farthest_mm is not None
    assert person.marker_rms_mm < 25.0
    assert person.marker_rms_mm < person.farthest_mm < 80.0
    assert person.farthest_marker in MARKERS
    assert {name: far for name, far in apart_deg(walk, folder).items() if far > 5.0} == {}


def test_model_has_size_and_mass_of_person(walk: Reconstruction, walk_archive: tuple[OpenSimPerson, Path]) -> None:
    person, folder = walk_archive
    code = """
model = opensim.Model("scaled.osim")
state = model.initSystem()
joints = [model.getJointSet().get(name) for name in ("hip_r", "walker_knee_r", "ankle_r", "acromial_r", "elbow_r")]
places = [joint.getParentFrame().getPositionInGround(state).to_numpy() for joint in joints]
lengths = [float(((end - start) ** 2).sum() ** 0.5) for start, end in zip(places, places[1:])]
print([lengths[0], lengths[1], lengths[3], float(model.getTotalMass(state))])
"""
    thigh_m, shank_m, upper_arm_m, mass_kg = json.loads(run_in(folder, code).splitlines()[-1])
    motion = walk.motions[0]
    expected_m = [
        np.mean([motion.bone_length_m[INDEX[f"{side}{joint}"]] for side in ("Left", "Right")])
        for joint in ("Leg", "Foot", "ForeArm")
    ]
    np.testing.assert_allclose([thigh_m, shank_m, upper_arm_m], expected_m, rtol=0.01)
    assert person.mass_kg == pytest.approx(mass_kg, abs=0.01)
    assert 55.0 < mass_kg < 80.0
    stated = setup.model_size(motion, walk.tracks[0], walk.joints, Subject(mass_kg=91.5))
    assert b"<mass>91.500</mass>" in setup.encode_scale_setup("heavy", stated)


def test_opensim_reads_files_and_runs_setups_by_hand(walk_archive: tuple[OpenSimPerson, Path], tmp_path: Path) -> None:
    """The setups name files beside them: a program that is started in the folder runs them as README.txt says."""
    _, folder = walk_archive
    copy = tmp_path / "by hand" / "person"
    shutil.copytree(folder, copy)
    for name in ("scaled.osim", "ik.mot", "person-1_ik_marker_errors.sto"):
        (copy / name).unlink()
    code = """
opensim.ScaleTool("scale.xml").run()
opensim.InverseKinematicsTool("ik.xml").run()
markers, motion = opensim.TimeSeriesTableVec3("markers.trc"), opensim.TimeSeriesTable("ik.mot")
print(markers.getNumRows(), markers.getNumColumns(), motion.getNumRows(), motion.getNumColumns())
"""
    counts = run_in(copy, code).splitlines()[-1].split()
    assert counts == ["60", str(len(json.loads((copy / "report.json").read_text())["markers"])), "60", "40"]
    assert (copy / "ik.mot").read_bytes() == (folder / "ik.mot").read_bytes()
    assert (copy / "scaled.osim").read_bytes() == (folder / "scaled.osim").read_bytes()
    assert {path.name for path in copy.iterdir()} == {path.name for path in folder.iterdir()}


def test_equal_takes_give_equal_bytes_and_nothing_is_left_behind(
    walk: Reconstruction, walk_archive: tuple[OpenSimPerson, Path], tmp_path: Path
) -> None:
    archived(walk, tmp_path)
    assert (tmp_path / "person-1.osim.zip").read_bytes() == (walk_archive[1].parent / "person-1.osim.zip").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["person-1", "person-1.osim.zip"]
    with zipfile.ZipFile(tmp_path / "person-1.osim.zip") as archive:
        assert {"LICENSE.txt", "README.txt", "generic.osim"} <= {name.partition("/")[2] for name in archive.namelist()}


def test_person_without_hips_has_no_archive_and_reason(walk: Reconstruction, tmp_path: Path) -> None:
    track = walk.tracks[0]
    xyz_m = np.array(track.xyz_m)
    xyz_m[1:, walk.joints.index("left_hip")] = np.nan
    unseen = replace(walk, animation=replace(walk.animation, tracks=(replace(track, xyz_m=xyz_m),)))
    (written,) = write_opensim_files(unseen, slice(None), tmp_path)
    assert written.path is None
    assert "Hips and shoulders" in str(written.person.problem)
    assert list(tmp_path.iterdir()) == []


def test_people_in_survey_coordinates_are_found(
    walk: Reconstruction, walk_archive: tuple[OpenSimPerson, Path], tmp_path: Path
) -> None:
    """OpenSim does not find a person at 300 km from its origin."""
    away_m = np.array([300_000.0, -40_000.0, 120.0])
    (track,), (motion,) = walk.tracks, walk.motions
    animation = replace(
        walk.animation,
        tracks=(replace(track, xyz_m=track.xyz_m + away_m),),
        motions=(replace(motion, root_m=motion.root_m + away_m),),
    )
    cameras = tuple(
        replace(camera, cam_from_world=Rigid3(pose.rotation, pose.translation_m - pose.rotation @ away_m))
        for camera in walk.cameras
        for pose in [camera.cam_from_world]
    )
    person, folder = archived(replace(walk, cameras=cameras, animation=animation), tmp_path)
    assert person.problem is None
    assert person.marker_rms_mm == pytest.approx(walk_archive[0].marker_rms_mm, abs=0.1)
    origin_m = json.loads((folder / "report.json").read_text())["origin_m"]
    np.testing.assert_allclose(np.subtract(origin_m, away_m), [0.0, 0.0, 2.0], atol=1.0)


def test_bones_of_impossible_size_are_named(walk: Reconstruction, tmp_path: Path) -> None:
    motion = walk.motions[0]
    lengths_m = np.array(motion.bone_length_m)
    lengths_m[[INDEX["LeftForeArm"], INDEX["RightForeArm"]]] = 1.2
    stretched = replace(walk, animation=replace(walk.animation, motions=(replace(motion, bone_length_m=lengths_m),)))
    person, folder = archived(stretched, tmp_path)
    assert "humerus_l (4.19)" in str(person.problem)
    assert not (folder / "ik.mot").exists()
    assert str(person.problem) in (folder / "README.txt").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "seed", "size"),
    accuracy_but(
        [("squat", 2, 1.0), ("walk", 4, 0.53)],
        [("walk", 1, 1.0), ("squat", 2, 1.0), ("kick", 3, 1.0), ("walk", 4, 0.53), ("walk", 5, 1.25)],
    ),
)
def test_children_and_tall_people_are_as_documented(motion: str, seed: int, size: float, tmp_path: Path) -> None:
    take = take_of(motion, None, seed, size)
    person, folder = archived(take, tmp_path)
    assert person.problem is None
    assert person.marker_rms_mm is not None
    assert person.marker_rms_mm < 25.0
    assert person.stature_m == pytest.approx(estimate_stature_m(take.tracks[0], take.joints), rel=0.01)
    assert 1.6 < (person.stature_m or 0.0) / size < 2.0
    assert {name: far for name, far in apart_deg(take, folder).items() if far > 5.0} == {}


@pytest.mark.slow
def test_gaps_are_left_out_of_motion(tmp_path: Path) -> None:
    take = take_of("walk", 5.0, gaps=[(slice(90, 190), ""), (slice(210, 290), "left_")])
    person, folder = archived(take, tmp_path)
    assert person.problem is None
    assert person.marker_rms_mm is not None
    assert person.marker_rms_mm < 25.0
    frames = np.rint(read_columns((folder / "ik.mot").read_text())["time"] * 60.0).astype(int)
    assert person.num_frames == len(frames) < 220
    assert not {*range(95, 185)} & {*frames.tolist()}
    assert {name: far for name, far in apart_deg(take, folder).items() if far > 5.0} == {}
