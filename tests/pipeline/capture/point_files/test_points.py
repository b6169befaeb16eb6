"""Sessions of 3D points: our own files come back, and names, axes, units and damage of others are understood."""

import contextlib
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import ezc3d
import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from multicap import (
    InputError,
    PointSession,
    ReconstructionConfig,
    Session,
    open_keypoints,
    reconstruct,
    reconstruct_to_files,
)
from pipeline.capture.point_files.point_names import find_joints, hip_centers_m, pelvis_points
from pipeline.capture.point_files.read_points import answer, nearest_rotations, point_readers, read_table
from pipeline.capture.points import read_names
from pipeline.capture.preflight_npz import decode_points
from pipeline.core.options.edits import Describe, PersonAt
from pipeline.core.runtime.npz import decode_arrays
from pipeline.motion.angles.compute import joint_angles, segments_from
from pipeline.motion.body_segments import ANGLE_NAMES, RIGHT_FRONT_UP, SEGMENT_LABELS
from pipeline.motion.skeleton.model import INDEX, forward_kinematics
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.capture.point_files.mutations import mutated
from tests.pipeline.simulations import write_simulation
from tests.records import encode_record


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with our files of two people."""
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(record(replace(find_scene("walk"), duration_s=1.0), 0, 3), folder)
    session = open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    config = ReconstructionConfig(exports=("bvh", "trc", "c3d", "csv"))
    reconstruct_to_files(session, folder / "take", config)
    return folder / "take"


def positions_m(folder: Path) -> dict[str, np.ndarray]:
    """Positions of all people in `skeletons.json` by joint: people, frames, 3."""
    content = json.loads((folder / "skeletons.json").read_text())
    tracks = [
        [[joint or [np.nan] * 3 for joint in frame] for frame in track["positions_m"]] for track in content["tracks"]
    ]
    return {name: np.array(tracks)[:, :, k] for k, name in enumerate(content["joint_names"])}


def located_m(session: PointSession) -> dict[str, np.ndarray]:
    tracks = np.array([track.xyz_m for track in session.people])
    return {name: tracks[:, :, k] for k, name in enumerate(session.joints.names) if np.isfinite(tracks[:, :, k]).any()}


@pytest.mark.parametrize(
    "names",
    [
        ("person-1.trc", "person-2.trc"),
        ("person-1.c3d", "person-2.c3d"),
        ("person-1.csv", "person-2.csv"),
        ("skeletons.json",),
        ("person-1.bvh", "person-2.bvh"),
    ],
)
def test_own_export_comes_back_within_1_mm(take: Path, names: tuple[str, ...]) -> None:
    session = Session.from_files([take / name for name in names])
    found, expected = located_m(session), positions_m(take)
    assert session.timebase.frame_rate_hz == 25.0
    assert {"left_knee", "right_wrist", "left_hip"} <= found.keys()
    for joint, places_m in found.items():
        if joint in expected:
            known = np.isfinite(expected[joint])
            np.testing.assert_allclose(places_m[known], expected[joint][known], atol=1e-3, err_msg=joint)


def test_solved_points_have_positions_of_source_and_files(take: Path, tmp_path: Path) -> None:
    session = Session.from_files([take / "person-1.trc"])
    config = ReconstructionConfig(exports=("bvh", "trc", "glb", "angles"), report=True)
    paths = {path.name for path in reconstruct_to_files(session, tmp_path, config, cache=tmp_path / "kept").paths}
    assert {"person-1.bvh", "person-1.trc", "person-1.glb", "person-1.angles.csv", "report.html"} <= paths
    found, expected = positions_m(tmp_path), positions_m(take)
    np.testing.assert_allclose(found["left_knee"][0], expected["left_knee"][0], atol=1e-3)
    solved, skeleton = reconstruct(session).motions[0], np.array(expected["left_knee"][0])
    np.testing.assert_allclose(forward_kinematics(solved)[:, INDEX["LeftLeg"]], skeleton, atol=0.03)


def test_range_of_frames_is_solved_alone(take: Path) -> None:
    session = Session.from_files([take / "person-1.csv"])
    part = reconstruct(session, ReconstructionConfig(frame_range=(5, 15)))
    assert part.timebase.num_frames == part.tracks[0].num_frames == 10
    np.testing.assert_array_equal(part.tracks[0].xyz_m, session.people[0].xyz_m[5:15])


@pytest.mark.parametrize(("up", "unit", "scale"), [("y", "mm", 1000.0), ("-z", "cm", 100.0), ("x", "m", 1.0)])
def test_standing_person_tells_axis_and_unit(take: Path, up: str, unit: str, scale: float) -> None:
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).all()]
    world_m = np.stack([expected[name][0] for name in names], axis=1)
    turned = {"y": world_m[..., [0, 2, 1]] * [1, 1, -1], "-z": world_m * [1, -1, -1], "x": world_m[..., [2, 0, 1]]}[up]
    session = Session.from_points(scale * turned, names, 25.0)
    assert session.findings[0].evidence == {"unit": unit, "up": up}
    heights_m = located_m(session)["left_knee"][0, :, 2]
    np.testing.assert_allclose(heights_m, expected["left_knee"][0, :, 2], atol=1e-9)


def test_theia_c3d_has_joints_at_origins_of_segments(take: Path, tmp_path: Path) -> None:
    file = ezc3d.c3d(str(take / "person-1.c3d"))
    origins_mm = file["data"]["rotations"][:3, 3, list(SEGMENT_LABELS).index("left_shank")].T
    file["parameters"]["POINT"]["LABELS"]["value"] = [
        f"p{k}" for k in range(len(file["parameters"]["POINT"]["LABELS"]["value"]))
    ]
    file.write(str(tmp_path / "theia.c3d"))
    knee_m = located_m(Session.from_files([tmp_path / "theia.c3d"]))["left_knee"][0]
    np.testing.assert_allclose(knee_m, origins_mm / 1000, atol=1e-4)


def test_markers_of_plug_in_gait_become_joints() -> None:
    names = [
        "LFHD",
        "RFHD",
        "LBHD",
        "RBHD",
        "LSHO",
        "RSHO",
        "LELB",
        "RELB",
        "LWRA",
        "LWRB",
        "RWRA",
        "RWRB",
        "LASI",
        "RASI",
        "LPSI",
        "RPSI",
        "LKNE",
        "LKNM",
        "RKNE",
        "LANK",
        "RANK",
        "LTOE",
        "LHEE",
    ]
    joints, markers = find_joints(names, {})
    assert joints["left_wrist"] == [names.index("LWRA"), names.index("LWRB")]
    assert joints["left_knee"] == [names.index("LKNE"), names.index("LKNM")]
    assert joints["right_knee"] == [names.index("RKNE")]
    assert joints["left_ear"] == [names.index("LFHD"), names.index("LBHD")]
    assert "right_knee" in markers


def test_centres_of_model_come_before_its_markers() -> None:
    joints, markers = find_joints(["LKNE", "LFEO", "LSHO", "LCLO", "pelvis", "Neck"], {})
    assert (joints["left_knee"], joints["left_shoulder"], joints["mid_hip"], joints["neck"]) == ([1], [3], [4], [5])
    assert not markers


SETS = {
    "helen hayes": "R.Shoulder R.Elbow R.Wrist R.ASIS V.Sacral R.Knee R.Knee.Medial R.Ankle R.Ankle.Medial R.Heel "
    "R.Toe",
    "van sint jan": "R_SAE R_HLE R_HME R_RSP R_USP R_IAS R_IPS R_FLE R_FME R_FAL R_TAM R_FCC R_FM1",
    "rajagopal": "RACR RLEL RMEL RFAradius RFAulna RASI RPSI RLFC RMFC RLMAL RMMAL RCAL RTOE",
    "opencap": "r_shoulder_study r_lelbow_study r_melbow_study r_lwrist_study r_mwrist_study r.ASIS_study r.PSIS_study "
    "r_knee_study r_mknee_study r_ankle_study r_mankle_study r_calc_study r_toe_study",
    "davis": "r.should R.Elbow R.Wrist r.asis V.Sacral r.knee.1 r.mall r.heel R.Toe",
    "cmu": "RSHO RELB RWRA RWRB RFWT RBWT RKNE RANK RHEE RTOE",
    "qualisys animation": "RShoulderTop RElbowOut RElbowIn RWristOut RWristIn WaistRFront WaistRBack RKneeOut RKneeIn "
    "RAnkleOut RHeelBack RToeTip",
}


@pytest.mark.parametrize("markers", SETS.values(), ids=SETS)
def test_markers_of_other_sets_stand_for_joints(markers: str) -> None:
    """Names as in public files of these sets; none of the joints is taken for its centre."""
    right = markers.split()
    other = [name.replace("RFront", "LFront").replace("RBack", "LBack") for name in right]
    left = [name if name in {"V.Sacral"} | {*other} - {*right} else f"L{name[1:]}" for name in other]
    names = list(dict.fromkeys([*right, *left]))
    joints, of_skin = find_joints(names, {})
    parts = {"shoulder", "elbow", "wrist", "knee", "ankle", "heel", "big_toe"}
    assert {f"{side}_{part}" for side in ("left", "right") for part in parts} == {*joints} == {*of_skin}
    assert pelvis_points(names) is not None
    medial = [
        k for k, name in enumerate(names) if name in ("R.Knee.Medial", "R_FME", "RMFC", "r_mknee_study", "RKneeIn")
    ]
    assert {*medial} <= {*joints["right_knee"]}


def test_marker_of_hip_beside_pelvis_is_no_centre() -> None:
    assert find_joints(["LHIP", "RHIP"], {})[0].keys() == {"left_hip", "right_hip"}
    assert not find_joints(["LHIP", "RHIP", "LASI", "RASI", "SACR"], {})[0]


def test_point_that_is_never_seen_leaves_its_joint_to_others(take: Path) -> None:
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).all() and name != "left_knee"]
    points_m = np.stack([*(expected[name][0] for name in names), expected["left_knee"][0]], axis=1)
    empty = np.full((len(points_m), 1, 3), np.nan)
    session = Session.from_points(np.append(points_m, empty, axis=1), [*names, "LKNE", "LKJC"], 25.0)
    np.testing.assert_array_equal(located_m(session)["left_knee"][0], expected["left_knee"][0])


def test_leaning_runner_does_not_tell_the_axis(take: Path) -> None:
    """A trunk that lies points along the floor; legs and trunk together tell that a person stands."""
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).any()]
    points_m = np.stack([expected[name][0] for name in names], axis=1)
    middle_m = (expected["left_hip"][0] + expected["right_hip"][0])[:, None] / 2
    upper = np.array([not any(part in name for part in ("hip", "knee", "ankle", "heel", "toe")) for name in names])
    lean = Rotation.from_euler("y", 85, degrees=True)
    bent_m = np.where(
        upper[:, None], lean.apply((points_m - middle_m).reshape(-1, 3)).reshape(points_m.shape), points_m - middle_m
    )
    (finding,) = Session.from_points(bent_m, names, 25.0).findings
    assert (finding.severity, finding.evidence["up"]) == ("warning", "z")
    assert "no person stands" in finding.message


def test_arrays_of_movement_and_pandas_give_the_same_people() -> None:
    names = ["left_shoulder", "right_shoulder", "left_hip", "right_hip"]
    points_m = np.random.default_rng(0).normal(size=(20, 1, 4, 3))
    poses = xr.DataArray(points_m, {"keypoints": names}, ("time", "individuals", "keypoints", "space"))
    expected = Session.from_points(points_m, names, 25.0, "m").people[0].xyz_m
    for given in (poses.keypoints, pd.Index(names)):
        session = Session.from_points(poses.transpose("time", "space", ...), given, 25.0, "m")
        np.testing.assert_array_equal(session.people[0].xyz_m, expected)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"points": [[0.0]]}, "points must be an array, not"),
        ({"points": pd.DataFrame(np.zeros((3, 6)))}, r"points must be numbers of the shape \(frames, people, 2, 3\)"),
        ({"joint_of": {"a": "elbow"}}, "The table of names must be a JSON object of our joints"),
    ],
)
def test_wrong_points_get_a_sentence(changes: dict[str, Any], sentence: str) -> None:
    arguments: dict[str, Any] = {"points": np.zeros((3, 2, 3)), "names": ["a", "b"], "frame_rate_hz": 25.0}
    with pytest.raises(InputError, match=sentence):
        Session.from_points(**(arguments | changes))


def test_no_files_are_an_error() -> None:
    with pytest.raises(InputError, match=r"There are no files of 3D points\."):
        Session.from_files([])


@pytest.mark.parametrize(("unit", "unit_m"), [("in", 0.0254), ("cmu", 0.0564444)])
def test_unit_of_public_bvh_is_told_by_trunk(take: Path, unit: str, unit_m: float) -> None:
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).any()]
    points_m = np.stack([expected[name][0] for name in names], axis=1)
    session = Session.from_points(points_m / unit_m, names, 25.0)
    assert session.findings[0].evidence["unit"] == unit
    np.testing.assert_allclose(located_m(session)["left_hip"][0], expected["left_hip"][0], atol=1e-5)


def test_unit_that_may_be_another_is_a_warning(take: Path) -> None:
    """A trunk of 30 is a small child's in centimetres, a tall adult's in inches."""
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).any()]
    points_m = np.stack([expected[name][0] for name in names], axis=1)
    shoulders_m, hips_m = (
        points_m[:, [names.index(f"{side}_{part}") for side in ("left", "right")]].mean(1)
        for part in ("shoulder", "hip")
    )
    trunk_m = np.nanmedian(np.linalg.norm(shoulders_m - hips_m, axis=-1))
    (finding,) = Session.from_points(points_m * 30 / trunk_m, names, 25.0).findings
    assert (finding.severity, finding.evidence["unit"]) == ("warning", "in")
    assert "it may be cm: state it" in finding.message


def test_joints_without_a_point_are_a_warning(take: Path) -> None:
    """Markers on the inner knees and ankles come off after a laboratory's static trial, and joint centres with them."""
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).any() and not name.endswith("knee")]
    points_m = np.stack([expected[name][0] for name in names], axis=1)
    (finding,) = Session.from_points(points_m, names, 25.0).findings
    assert finding.severity == "warning"
    assert "no point tells left_knee, right_knee, which the skeleton guesses" in finding.message


def test_repeated_name_is_said(take: Path) -> None:
    expected = positions_m(take)
    names = [name for name in expected if np.isfinite(expected[name][0]).any()]
    points_m = np.stack([expected[name][0] for name in names], axis=1)
    renamed = ["LKNE" if name in ("left_knee", "left_ankle") else name for name in names]
    (finding,) = Session.from_points(points_m, renamed, 25.0).findings
    assert "several points have the name LKNE" in finding.message


@pytest.mark.parametrize("mark", [",", " "])
def test_trc_with_other_separators_is_read(take: Path, tmp_path: Path, mark: str) -> None:
    lines = (take / "person-1.trc").read_text().splitlines()
    rows = [mark.join(cell or "nan" for cell in line.split("\t")) for line in lines[5:] if line.strip()]
    head = [mark.join(filter(None, line.split("\t"))) if mark == " " else line.replace("\t", ",") for line in lines[:5]]
    (tmp_path / "a.trc").write_text("\n".join([*head, *rows]))
    (table, _), (own, _) = read_table(tmp_path / "a.trc"), read_table(take / "person-1.trc")
    assert table.names == own.names
    np.testing.assert_array_equal(table.xyz, own.xyz)


def test_hip_centres_follow_regression_of_harrington() -> None:
    front_mm, back_mm, width_mm = 0.0, -150.0, 240.0
    points_m = (
        np.array([[[-width_mm / 2, front_mm, 0], [width_mm / 2, front_mm, 0], [-50, back_mm, 0], [50, back_mm, 0]]])
        / 1000
    )
    left_m, right_m = hip_centers_m(points_m)
    expected_mm = [0.33 * width_mm + 7.3, -(0.24 * 150 + 9.9), -(0.30 * width_mm + 10.9)]
    np.testing.assert_allclose(right_m[0] * 1000, expected_mm)
    np.testing.assert_allclose(left_m[0] * 1000, [-expected_mm[0], *expected_mm[1:]])


def test_names_of_users_table_come_first(tmp_path: Path) -> None:
    table = tmp_path / "names.json"
    table.write_text(json.dumps({"KnieL1": "left_knee", "KnieL2": "left_knee", "LKnee": "right_knee"}))
    joints, _ = find_joints(["LKnee", "KnieL1", "KnieL2"], read_names(table))
    assert joints == {"right_knee": [0], "left_knee": [1, 2]}
    table.write_text('{"KnieL1": "knee"}')
    with pytest.raises(InputError, match="JSON object of our joints"):
        read_names(table)


def folder_of_frames(
    folder: Path, person: Callable[[np.ndarray], dict[str, object]], take: Path, key: str
) -> dict[str, np.ndarray]:
    """Write a file a frame with a person; return the expected positions."""
    expected = positions_m(take)
    xyz_m = np.stack([expected[name][0] for name in expected], axis=1)
    for number, frame in enumerate(xyz_m):
        rows = np.column_stack([frame, np.ones(len(frame))])
        (folder / f"frame_{number:06}.json").write_text(json.dumps({key: [person(rows)]}))
    return expected


@pytest.mark.parametrize("field", ["pose_keypoints_3d", "keypoints3d"])
def test_folder_of_3d_json_is_a_take(take: Path, tmp_path: Path, field: str) -> None:
    flat = field == "pose_keypoints_3d"
    expected = folder_of_frames(
        tmp_path, lambda rows: {field: rows.ravel().tolist() if flat else rows.tolist()}, take, "people"
    )
    found = located_m(Session.from_files([tmp_path], 25.0))
    np.testing.assert_allclose(found["left_knee"][0], expected["left_knee"][0])


def table_of_others(take: Path, heads: list[list[str]], more: list[str]) -> str:
    """CSV of another program in millimetres: rows of headers, and further numbers behind the three of each joint."""
    places = np.concatenate([*np.stack(list(positions_m(take).values()), axis=2)], axis=1) * 1000.0
    lines = [",".join(head) for head in heads]
    lines += [
        ",".join([str(frame), *(",".join([*map(repr, point.tolist()), *more]) for point in points)])
        for frame, points in enumerate(places)
    ]
    return "\n".join(lines) + "\n"


def test_csv_of_deeplabcut_in_3d_has_its_individuals(take: Path, tmp_path: Path) -> None:
    names = list(positions_m(take))
    heads = [
        ["scorer", *["DLC_3D"] * 6 * len(names)],
        ["individuals", *[animal for animal in ("one", "two") for _ in range(3 * len(names))]],
        ["bodyparts", *[name for name in names * 2 for _ in range(3)]],
        ["coords", *["x", "y", "z"] * 2 * len(names)],
    ]
    (tmp_path / "a_DLC_3D.csv").write_text(table_of_others(take, heads, []))
    session = Session.from_files([tmp_path / "a_DLC_3D.csv"], 25.0)
    for joint, places_m in located_m(session).items():
        np.testing.assert_allclose(places_m, positions_m(take)[joint], atol=1e-9)
    assert len(session.people) == 2


def test_csv_with_decimal_commas_has_the_same_places(take: Path, tmp_path: Path) -> None:
    text = (take / "person-1.csv").read_text()
    (tmp_path / "person-1.csv").write_text(text.replace(",", ";").replace(".", ","))
    expected = located_m(Session.from_files([take / "person-1.csv"]))
    for joint, places_m in located_m(Session.from_files([tmp_path / "person-1.csv"])).items():
        np.testing.assert_array_equal(places_m, expected[joint])


def test_csv_of_anipose_keeps_errors_and_axes_apart(take: Path, tmp_path: Path) -> None:
    columns = "x", "y", "z", "error", "ncams", "score"
    head = ["fnum", *[f"{person}:{name}_{part}" for person in "ab" for name in positions_m(take) for part in columns]]
    text = table_of_others(take, [head], ["1.5", "3.0", "0.9"])
    axes = ["M_00", "M_01", "center_0"], ["1.0", "0.0", "0.5"]
    lines = [",".join([line, *axes[number > 0]]) for number, line in enumerate(text.splitlines())]
    (tmp_path / "pose-3d.csv").write_text("\n".join(lines))
    for joint, places_m in located_m(Session.from_files([tmp_path / "pose-3d.csv"], 25.0)).items():
        np.testing.assert_allclose(places_m, positions_m(take)[joint], atol=1e-9)


def test_array_of_freemocap_is_read_by_its_number_of_points(take: Path, tmp_path: Path) -> None:
    expected = positions_m(take)
    array = np.full((len(expected["nose"][0]), 33, 3), np.nan)
    for joint, point in {
        "left_shoulder": 11,
        "right_shoulder": 12,
        "left_hip": 23,
        "right_hip": 24,
        "left_knee": 25,
    }.items():
        array[:, point] = 1000 * expected[joint][0]
    np.save(tmp_path / "mediapipe_skeleton_3d.npy", array)
    with pytest.raises(InputError, match="no times"):
        Session.from_files([tmp_path / "mediapipe_skeleton_3d.npy"])
    session = Session.from_files([tmp_path / "mediapipe_skeleton_3d.npy"], 30.0)
    assert "the unit is told by the trunk's length" in session.findings[0].message
    np.testing.assert_allclose(located_m(session)["left_knee"][0], expected["left_knee"][0])


def write_netcdf(path: Path, take: Path) -> None:
    """Write poses as `to_xarray().to_netcdf` does, without its packages."""
    expected = positions_m(take)
    with h5py.File(path, "w") as file:
        xyz = np.stack(list(expected.values()), axis=2)  # people, frames, joints, space
        scales = {
            "time": np.arange(xyz.shape[1]) / 25.0,
            "space": np.array(["x", "y", "z"], h5py.string_dtype()),
            "keypoints": np.array(list(expected), h5py.string_dtype()),
            "individuals": np.array([f"p{k}" for k in range(len(xyz))], h5py.string_dtype()),
        }
        position = file.create_dataset("position", data=xyz.transpose(1, 3, 2, 0))
        position.attrs["units"] = "m"
        for axis, (name, values) in enumerate(scales.items()):
            file.create_dataset(name, data=values).make_scale(name)
            position.dims[axis].attach_scale(file[name])
        file.attrs["time_unit"] = "seconds"


def test_netcdf_of_movement_has_its_people(take: Path, tmp_path: Path) -> None:
    write_netcdf(tmp_path / "take.nc", take)
    session = Session.from_files([tmp_path / "take.nc"])
    assert session.timebase.frame_rate_hz == 25.0
    for joint, places_m in located_m(session).items():
        np.testing.assert_array_equal(places_m, positions_m(take)[joint])


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.txt", "", r"Files of 3D points end with \.bvh, \.c3d"),
        ("a.trc", "hello", "no header of TRC"),
        ("a.csv", "a,b\n1,2\n", "no columns such as left_knee_x"),
        ("a.csv", "a_x,a_y,a_z,a_X\n1,2,3,4\n", "more than one column a_X"),
        ("a.csv", "a_x_m,a_y_m,a_z_mm\n1,2,3\n", "units m, mm"),
        (
            "a.csv",
            "scorer,s,s,s\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,1,2,1\n",
            "no columns such as left_knee_x, left_knee_y and left_knee_z",
        ),
        (
            "a.csv",
            "time,a_x,a_y,a_z\n0,1,2,3\n0.1,1,2,3\n",
            "missing are left_hip, left_shoulder, right_hip, right_shoulder. The points are a",
        ),
        ("a.bvh", "HIERARCHY", "do not fit the joints' channels"),
        ("a.json", '{"people": []}', "there is no person"),
        ("a.c3d", "x", "The file is no C3D file"),
        ("a.nc", "x", "damaged, or not in the format NetCDF"),
    ],
)
def test_unusable_file_gets_sentence(tmp_path: Path, name: str, content: str, sentence: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=sentence):
        Session.from_files([tmp_path / name], 25.0)


@pytest.mark.parametrize("number", [10, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["person-1.trc", "person-1.csv", "person-1.bvh", "skeletons.json", "points.npy"])
def test_mutated_files_give_points_or_a_problem(take: Path, tmp_path: Path, name: str, number: int) -> None:
    np.save(take / "points.npy", np.ones((20, 33, 3)))
    whole, damaged, random = (
        (take / name).read_bytes(),
        tmp_path / f"damaged{Path(name).suffix}",
        np.random.default_rng(3),
    )
    reader = next(reader for reader in point_readers() if damaged.suffix in reader.suffixes)
    problems = 0
    for _ in range(number):
        damaged.write_bytes(mutated(whole, random, b"0123456789.,-+e \t\n{}[]naPRJ"))
        head = json.loads(str(decode_arrays(answer(damaged, reader.name))["head"]))
        problems += "problem" in head
    assert problems > 0


@pytest.mark.parametrize("number", [3, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["person-1.c3d", "take.nc"])
def test_mutated_binary_files_give_points_or_a_sentence(take: Path, tmp_path: Path, name: str, number: int) -> None:
    """In children of their own: the libraries may crash a process, or hang."""
    write_netcdf(take / "take.nc", take)
    whole, damaged, random = (
        (take / name).read_bytes(),
        tmp_path / f"damaged{Path(name).suffix}",
        np.random.default_rng(3),
    )
    for _ in range(number):
        damaged.write_bytes(mutated(whole, random))
        with contextlib.suppress(InputError):  # any other exception fails the test
            Session.from_files([damaged])


def test_rotations_of_c3d_are_the_skeletons(take: Path, tmp_path: Path) -> None:
    """Bones have the orientations that the file states, within 0.1 degrees, also where points alone tell others."""
    file = ezc3d.c3d(str(take / "person-1.c3d"))
    turn = Rotation.from_euler("XYZ", [5.0, -4.0, 3.0], degrees=True).as_matrix()
    rotations = file["data"]["rotations"]
    rotations[:3, :3] = np.einsum("ijsf,jk->iksf", rotations[:3, :3], turn)
    rotations[:, :, list(SEGMENT_LABELS).index("head")] = 0.0
    file.write(str(tmp_path / "turned.c3d"))
    session = Session.from_files([tmp_path / "turned.c3d"])
    solved = reconstruct(session)
    found = segments_from(solved.motions[0])
    for number, name in enumerate(SEGMENT_LABELS):
        if name != "head":
            stated = rotations[:3, :3, number].transpose(2, 0, 1)[..., np.argsort(RIGHT_FRONT_UP)]
            between = Rotation.from_matrix(np.swapaxes(found[name], 1, 2) @ stated).magnitude()
            assert np.degrees(between).max() < 0.1, name
    angles = joint_angles(solved.motions[0], solved.tracks[0], session.joints, has_sigmas=False).angle_deg
    assert np.isfinite(angles[:, ANGLE_NAMES.index("left_hip_rotation")]).all()
    hips_m = forward_kinematics(solved.motions[0])[:, INDEX["Hips"]]
    middle_m = np.mean([located_m(session)[f"{side}_hip"][0] for side in ("left", "right")], axis=0)
    np.testing.assert_allclose(hips_m, middle_m, atol=0.05)


def test_record_of_service_keeps_the_session(take: Path) -> None:
    session = Session.from_files([take / "person-1.c3d"])
    again = decode_points(encode_record(session))
    assert asdict(again.timebase) == asdict(session.timebase)
    assert (again.joints, again.findings) == (session.joints, session.findings)
    for name, array in session.people[0].joint_arrays.items():
        np.testing.assert_array_equal(getattr(again.people[0], name), array, err_msg=name)
    assert "world_from_segment" in session.people[0].joint_arrays


def test_matrices_that_are_no_rotations_are_unknown() -> None:
    matrices = np.stack(
        [np.eye(3), np.diag([1.0, 1.0, -1.0]), 1.1 * np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)]
    )
    known = np.isfinite(nearest_rotations(matrices, 6)).all((1, 2))
    assert known.tolist() == [True, False, False, False, False, False]


def test_mass_of_person_is_in_files_of_that_person(take: Path, tmp_path: Path) -> None:
    session = Session.from_files([take / "person-1.csv", take / "person-2.csv"])
    hips_m = np.mean([located_m(session)[f"{side}_hip"][0, 0] for side in ("left", "right")], axis=0)
    place = PersonAt(frame=0, place_m=(float(hips_m[0]), float(hips_m[1]), float(hips_m[2])))
    edits = (Describe(person=place, sex="male", mass_kg=90.0),)
    written = reconstruct_to_files(session, tmp_path, ReconstructionConfig(exports=("csv",), edits=edits))
    heads = [(tmp_path / f"person-{k}.balance.csv").read_text().splitlines()[0] for k in (1, 2)]
    assert ["kg_m_s" in head for head in heads] == [True, False]
    masses = [person["balance"]["mass_kg"] for person in written.metrics["people"]]
    assert masses == [90.0, None]
