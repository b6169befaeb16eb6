"""Result files of a reconstruction: unusual takes, and files with wrong contents."""

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from pygltflib import GLTF2

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17, FINGER_JOINTS, WHOLE_BODY, finger_joints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.file_formats import Export, file_ending, formats_of_people, installed_formats
from pipeline.export.results import write_files, write_results
from pipeline.export.writers import c3d_file, csv_table, fbx_nodes, trc
from pipeline.export.writers.fbx_stored import StoredScene, numbers
from pipeline.export.writers.registry import find_writer
from pipeline.motion.balance.compute import balance_of
from pipeline.motion.skeleton.animate import animate
from tests.e2e.foreign import validate_with_khronos
from tests.pipeline.export.bvh_readers import read_with_bvhio
from tests.pipeline.export.quality.test_report import CAMERAS, observe
from tests.pipeline.export.writers.test_bvh import tumbling
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

EXPORTS = formats_of_people(installed_formats())
# Files with a whole take.
OF_TAKE = {f"take.{file_ending(name)}" for name in EXPORTS if find_writer(name).take}
CSV: tuple[Export, ...] = ("csv",)
ANGLES = ("angles", "mot")
NUMBERS = {*ANGLES, "forces"}
LEGS = [index for index, name in enumerate(COCO_17.names) if name.endswith(("knee", "ankle"))]


def take(*tracks: Track3D, rate_hz: float = 25.0, num_frames: int = 100) -> Reconstruction:
    timebase = Timebase(0.0, rate_hz, num_frames)
    observations = tuple(observe(track) for track in tracks)
    animation = animate(tracks, observations, CAMERAS, timebase, COCO_17, ReconstructionConfig())
    return Reconstruction(CAMERAS, COCO_17, timebase, tracks, observations, animation)


def without(joints: list[int], num_frames: int = 30) -> np.ndarray:
    xyz_m = walker(num_frames)
    xyz_m[:, joints] = np.nan
    return xyz_m


def test_every_file_reports_progress(tmp_path: Path) -> None:
    shares: list[float] = []
    people = (track_of(walker(30)), replace(track_of(walker(30)), track_id=2))
    done: list[float] = []
    write_files(take(*people), tmp_path, EXPORTS, on_share=shares.append, on_file=lambda _: done.append(shares[-1]))
    assert shares == sorted(shares)
    # The tables of balance, one a person, are written at once; files for OpenSim, two a person, with the forces.
    assert len(set(done)) + 5 == len(done) == 8 + len(OF_TAKE) + 2 * len(EXPORTS)
    assert done[-1] == 1.0


@pytest.mark.parametrize(
    ("xyz_m", "rate_hz"),
    [
        pytest.param(walker(1), 25.0, id="one frame"),
        pytest.param(walker(2), 25.0, id="two frames"),
        pytest.param(without(LEGS), 25.0, id="no legs"),
        pytest.param(without([9]), 25.0, id="a joint that was never seen"),
        pytest.param(without(list(range(17))), 25.0, id="nothing ever seen"),
        pytest.param(walker(30), 30000 / 1001, id="29.97"),
        pytest.param(walker(30), 120000 / 1001, id="119.88"),
    ],
)
def test_odd_takes_leave_valid_files(xyz_m: np.ndarray, rate_hz: float, tmp_path: Path) -> None:
    short = take(track_of(xyz_m), rate_hz=rate_hz, num_frames=len(xyz_m))
    paths = write_results(short, tmp_path, EXPORTS)
    has_forces = len(xyz_m) >= 12 and np.isfinite(xyz_m).all()
    assert {path.name for path in paths} == {
        "skeletons.json",
        "metrics.json",
        "person-1.balance.csv",
        *(f"person-1.{file_ending(export)}" for export in EXPORTS),
        *OF_TAKE,
        *(f"person-1.forces.{ending}" for ending in ("mot", "xml") if has_forces),
    }
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in paths}
    assert paths[-1].name == "metrics.json"
    positions = read_with_bvhio(tmp_path / "person-1.bvh")
    assert all(np.isfinite(found).all() and len(found) == len(xyz_m) for found in positions.values())
    check = json.loads(paths[-1].read_bytes())["exports"]
    assert set(check) == {"skeletons", *EXPORTS}
    for export, figures in check.items():
        if export in ANGLES:
            found_deg = figures.pop("max_difference_deg")
            assert figures == {}
            assert found_deg is None if np.isnan(xyz_m).all() else 0.0 <= found_deg < 0.001
            continue
        if export == "forces":
            difference = figures.pop("max_difference_si")
            assert figures == {}
            assert difference is None or 0.0 <= difference < 0.001
            continue
        of_joints = export not in {"bvh", "glb", "fbx", "usd", "vrma", "npz"}
        if of_joints and np.isnan(xyz_m).all():
            assert figures == {"max_distance_mm": None}
        elif export in {"bvh", "fbx"} and len(xyz_m) > 1:
            assert 0.0 <= figures["max_distance_mm"] < 0.5
            assert set(figures) == {"max_distance_mm", "between_frames"}
        else:
            assert set(figures) == {"max_distance_mm"}
            assert 0.0 <= figures["max_distance_mm"] < 0.5
    assert validate_with_khronos([tmp_path / "person-1.glb"])[tmp_path / "person-1.glb"]["numErrors"] == 0


def test_nobody(tmp_path: Path) -> None:
    paths = write_results(take(), tmp_path, EXPORTS)
    assert [path.name for path in paths] == ["skeletons.json", "metrics.json"]
    check = json.loads(paths[-1].read_bytes())["exports"]
    figure = {export: "max_difference_deg" if export in ANGLES else "max_distance_mm" for export in check}
    figure["forces"] = "max_difference_si"
    assert set(check) == {"skeletons", *EXPORTS}
    assert check == {export: {figure[export]: None} for export in check}


def test_too_many_frames_at_other_rate_are_refused_first(tmp_path: Path) -> None:
    long = take(num_frames=200_000)
    with pytest.raises(InputError) as refused:
        write_results(long, tmp_path / "out", EXPORTS, frame_rate_hz=240.0)
    (problem,) = refused.value.problems
    assert (problem.code, problem.field) == ("too_many_frames", "output_rate_hz")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("fault", ["a row is lost", "a joint is lost", "a joint is made up"])
def test_file_that_does_not_hold_what_was_written_is_no_result(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode = csv_table.encode

    def spoilt(*arguments: object) -> Iterator[bytes]:
        rows = b"".join(encode(*arguments)).splitlines(keepends=True)  # type: ignore[arg-type]
        cells = rows[5].split(b",")
        match fault:
            case "a row is lost":
                del rows[5]
            case "a joint is lost":
                rows[5] = b",".join([*cells[:2], b"", b"", b"", *cells[5:]])
            case "a joint is made up":
                rows[5] = b",".join([*cells[:29], b"1.0", b"1.0", b"1.0", *cells[32:]])
        yield b"".join(rows)

    monkeypatch.setattr(csv_table, "encode", spoilt)
    with pytest.raises(OSError, match=r"person-1\.csv"):
        write_files(take(track_of(without([9]))), tmp_path, CSV)
    assert not list(tmp_path.iterdir())


def test_joint_beside_its_place_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    encode = csv_table.encode

    def moved(track: Track3D, *arguments: object) -> Iterator[bytes]:
        xyz_m = track.xyz_m.copy()
        xyz_m[7, 3, 1] += 0.012
        return encode(track_of(xyz_m), *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(csv_table, "encode", moved)
    paths = list(write_results(take(track_of(walker(30))), tmp_path, CSV))
    check = json.loads(paths[-1].read_bytes())["exports"]
    assert check["csv"]["max_distance_mm"] == pytest.approx(12.0, abs=0.2)
    assert check["skeletons"]["max_distance_mm"] < 0.1


def test_survey_coordinates_have_origin_near_people(tmp_path: Path) -> None:
    """Two people in projected coordinates, 5,400 km from the equator, are within 0.1 mm in files of every format."""
    away_m = np.array([500_123.4, 5_412_345.6, 312.7])
    cameras = tuple(
        replace(camera, cam_from_world=camera.cam_from_world @ Rigid3(np.eye(3), -away_m)) for camera in CAMERAS
    )
    tracks = tuple(replace(track_of(walker(30) + away_m), track_id=number) for number in (1, 2))
    timebase = Timebase(0.0, 25.0, 30)
    observations = tuple(observe(track, cameras) for track in tracks)
    animation = animate(tracks, observations, cameras, timebase, COCO_17, ReconstructionConfig())
    far = Reconstruction(cameras, COCO_17, timebase, tracks, observations, animation)
    write_results(far, tmp_path, EXPORTS)
    check = json.loads((tmp_path / "metrics.json").read_bytes())["exports"]
    assert all(figures["max_distance_mm"] < 0.1 for name, figures in check.items() if name not in NUMBERS), check
    origin_m = np.array(check["c3d"]["origin_m"])
    with_origin = {"glb", "fbx", "usd", "vrma", "c3d"}
    assert {name for name, figures in check.items() if "origin_m" in figures} == with_origin & set(EXPORTS)
    assert check["glb"]["origin_m"] == origin_m.tolist() == origin_m.round().tolist()
    assert np.linalg.norm(origin_m - away_m) < 10.0
    # Other programs find the origin where the documentation says, and the people near it.
    for number in (1, 2):
        content = ezc3d.c3d(str(tmp_path / f"person-{number}.c3d"))
        assert content["parameters"]["WORLD"]["ORIGIN_M"]["value"].tolist() == origin_m.tolist()
        points_m = content["data"]["points"][:3].transpose(2, 1, 0) / 1000.0 + origin_m
        np.testing.assert_allclose(points_m[:, :17], far.tracks[number - 1].xyz_m, atol=1e-4)
        (scene,) = GLTF2.load_binary(str(tmp_path / f"person-{number}.glb")).animations
        assert scene.extras["origin_m"] == origin_m.tolist()
        models = StoredScene(fbx_nodes.read((tmp_path / f"person-{number}.fbx").read_bytes())).find_all("Model", "Null")
        assert [numbers(top, "origin_m", 3) for top in models.values()] == [tuple(origin_m)]


def test_usual_worlds_keep_their_origin(tmp_path: Path) -> None:
    write_results(take(track_of(walker(5))), tmp_path, EXPORTS)
    check = json.loads((tmp_path / "metrics.json").read_bytes())["exports"]
    assert all("origin_m" not in figures for figures in check.values())
    assert "WORLD" not in ezc3d.c3d(str(tmp_path / "person-1.c3d"))["parameters"]


def test_metrics_name_joint_and_frame_of_worst_interpolation(tmp_path: Path) -> None:
    only_bvh: tuple[Export, ...] = ("bvh",)
    alone = take(track_of(walker(60)))
    motions = (tumbling(), replace(tumbling(), track_id=2, start_frame=30, root_m=tumbling().root_m + 3.0))
    tracks = tuple(replace(track_of(walker(60)), track_id=number) for number in (1, 2))
    people = replace(alone, animation=replace(alone.animation, tracks=tracks, motions=motions))
    write_files(people, tmp_path, only_bvh, preset="unity-humanoid", report=lambda _: {"capture_checks": []})
    between = json.loads((tmp_path / "metrics.json").read_bytes())["exports"]["bvh"]["between_frames"]
    assert 2.0 < between["max_distance_mm"] < 3.0
    assert (between["program"], between["person"], between["joint"]) == ("Blender", 1, "LeftUpLeg")
    assert 100 <= between["frame"] < 159


def test_fingers_that_nobody_saw_are_in_no_file_of_joints(tmp_path: Path) -> None:
    """The left hand is seen in five frames, the right one never; both rest elsewhere."""
    num_frames = 20
    body_m = walker(num_frames)
    xyz_m = np.concatenate([body_m, np.repeat(body_m[:, [9]], len(WHOLE_BODY.names) - 17, axis=1)], axis=1)
    located = track_of(xyz_m)
    source = np.array(located.source)
    fingers = [WHOLE_BODY.names.index(name) for name in WHOLE_BODY.names if name in FINGER_JOINTS]
    left = [WHOLE_BODY.names.index(name) for name in finger_joints("left")]
    source[:, fingers] = Source.PREDICTED
    source[5:10, left[3]] = Source.MEASURED
    track = replace(located, source=source)
    (motion,) = take(track_of(body_m)).motions
    timebase = Timebase(0.0, 25.0, num_frames)
    animation = Animation((track,), (motion,), None)
    reconstruction = Reconstruction(CAMERAS, WHOLE_BODY, timebase, (track,), (observe(track),), animation)
    write_files(reconstruction, tmp_path, ("trc", "c3d", "csv"))
    known = np.isfinite(xyz_m).all(-1)
    known[:, fingers] = False
    known[5:10, left] = True
    for name, read in (("trc", trc.read_xyz_m), ("c3d", c3d_file.read_xyz_m), ("csv", csv_table.read_xyz_m)):
        path = tmp_path / f"person-1.{name}"
        in_file_m = np.concatenate(list(read(path)))
        # A C3D file has two centres of mass behind the joints.
        np.testing.assert_array_equal(np.isfinite(in_file_m[:, : known.shape[1]]).all(-1), known)
    skeletons = json.loads(next(tmp_path.rglob("skeletons.json")).read_text())
    (person,) = skeletons["tracks"]
    assert person["positions_m"][0][left[0]] is not None


def test_centre_of_mass_is_in_table_and_points_of_c3d(tmp_path: Path) -> None:
    one = replace(take(track_of(walker(30))), subject=Subject("dumas", "female", 60.0))
    write_results(one, tmp_path, ("csv", "c3d"))
    expected = balance_of(one.motions[0], one.tracks[0], COCO_17, one.subject)
    assert expected is not None
    with (tmp_path / "person-1.balance.csv").open(newline="", encoding="ascii") as file:
        rows = list(csv.DictReader(file))
    centre_m = [[float(row[f"center_{axis}_m"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(centre_m, expected.centre_m, atol=1e-5)
    spin = [[float(row[f"angular_momentum_{axis}_kg_m2_s"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(spin, expected.angular_momentum, atol=1e-5)
    momentum = [float(row["momentum_x_kg_m_s"]) for row in rows]
    np.testing.assert_allclose(momentum, 60.0 * expected.velocity_m_s[:, 0], atol=1e-5)
    content = ezc3d.c3d(str(tmp_path / "person-1.c3d"))
    assert content["parameters"]["POINT"]["LABELS"]["value"][17:] == ["center_of_mass", "extrapolated_center_of_mass"]
    points_m = content["data"]["points"][:3].transpose(2, 1, 0)[:30] / 1000.0
    np.testing.assert_allclose(points_m[:, 17], expected.centre_m, atol=1e-5)
    np.testing.assert_allclose(points_m[:, 18, :2], expected.extrapolated_m, atol=1e-5)
    np.testing.assert_allclose(points_m[:, 18, 2], 0.0, atol=1e-9)
    figures = json.loads((tmp_path / "metrics.json").read_bytes())["people"][0]["balance"]
    assert figures["height_m"] == pytest.approx(expected.centre_m[:, 2].mean(), abs=1e-3)
    assert figures["mass_kg"] == 60.0
