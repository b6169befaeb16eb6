"""Result files with points of the user's own: names, places, and nothing of them in files of other sessions."""

import base64
import csv
import json
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.association.own_points.rigid import RigidMotion, rigid_motions
from pipeline.core.data.own_points import OwnTracks
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.presets import GLTF
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.resample import resample
from pipeline.export.results import write_results
from pipeline.export.viewer.description import ViewerMotion
from pipeline.export.writers.csv_table import read_xyz_m as read_csv_m
from pipeline.export.writers.glb import GlbReader
from pipeline.export.writers.trc import read_xyz_m as read_trc_m
from pipeline.motion.body_segments import SEGMENT_LABELS
from pipeline.run.engine.local import reconstruct
from tests.pipeline.own_point_scenes import own_scene, rigid_scene, with_shapes


@pytest.fixture(scope="module")
def take() -> Reconstruction:
    return reconstruct(own_scene(duration_s=1.0).session, ReconstructionConfig(refine_calibration="off"))


@pytest.fixture(scope="module")
def folder(take: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    write_results(take, folder, exports=("csv", "trc", "c3d"))
    return folder


def test_json_has_points_and_objects(take: Reconstruction, folder: Path) -> None:
    document = json.loads((folder / "skeletons.json").read_text())
    assert document["own_point_names"] == ["racket_tip"]
    for track, points in zip(document["tracks"], take.own.of_people, strict=True):
        own = track["own_points"]
        assert set(own) == {"positions_m", "scores", "sources", "error_px", "uncertainty_m"}
        found_m = np.array([row[0] or [np.nan] * 3 for row in own["positions_m"]])
        np.testing.assert_allclose(found_m, points.xyz_m[:, 0], atol=6e-5)
        assert len(own["uncertainty_m"]) == len(track["positions_m"])
    (ball,) = document["objects"]
    assert (ball["name"], ball["point_names"], ball["start_frame"]) == ("ball", ["ball"], 0)
    assert len(ball["positions_m"]) == take.timebase.num_frames


def test_tables_have_points_behind_joints(take: Reconstruction, folder: Path) -> None:
    for track, points in zip(take.tracks, take.own.of_people, strict=True):
        stem = folder / f"person-{track.track_id}"
        with stem.with_suffix(".csv").open() as file:
            assert next(csv.reader(file))[-3:] == [f"racket_tip_{axis}_m" for axis in "xyz"]
        for name, read_m in ((".csv", read_csv_m), (".trc", read_trc_m)):
            read = np.concatenate(list(read_m(stem.with_suffix(name))))[track.start_frame : track.frames.stop, -1]
            np.testing.assert_allclose(read, points.xyz_m[:, 0], atol=6e-5)
    (ball,) = take.own.objects
    for name, read_m in (("objects.csv", read_csv_m), ("objects.trc", read_trc_m)):
        np.testing.assert_allclose(np.concatenate(list(read_m(folder / name))), ball.track.xyz_m, atol=6e-5)


def test_c3d_has_points_with_deviations(take: Reconstruction, folder: Path) -> None:
    (ball,) = take.own.objects
    content = ezc3d.c3d(str(folder / "objects.c3d"))
    assert content["parameters"]["POINT"]["LABELS"]["value"] == ["ball"]
    assert ball.track.uncertainty_m is not None
    known = np.isfinite(ball.track.xyz_m[:, 0, 0])
    places_mm = content["data"]["points"][:3, 0].T
    np.testing.assert_allclose(places_mm[known], 1000 * ball.track.xyz_m[known, 0], atol=0.01)
    # ezc3d takes the bytes of mask and residual for each other in files of floats (its issue 386).
    residuals_mm = 2 ** np.arange(7) @ content["data"]["meta_points"]["camera_masks"][:, 0]
    measured = ball.track.source[:, 0] == 1
    expected_mm = np.maximum(np.rint(1000 * ball.track.uncertainty_m[measured, 0]), 1)
    np.testing.assert_allclose(residuals_mm[measured], expected_mm)
    labels = ezc3d.c3d(str(folder / "person-1.c3d"))["parameters"]["POINT"]["LABELS"]["value"]
    assert "racket_tip" in labels


def test_take_without_own_points_has_no_trace_of_them(take: Reconstruction, folder: Path, tmp_path: Path) -> None:
    write_results(replace(take, own=OwnTracks()), tmp_path, exports=["csv"])
    assert not (tmp_path / "objects.csv").exists()
    document = json.loads((tmp_path / "skeletons.json").read_text())
    with_own = json.loads((folder / "skeletons.json").read_text())
    for key in ("own_point_names", "objects"):
        del with_own[key]
    for track in with_own["tracks"]:
        del track["own_points"]
    assert with_own == document


def test_points_are_resampled_with_people(take: Reconstruction) -> None:
    half = resample(take, take.timebase.frame_rate_hz / 2)
    (ball,), (full,) = half.own.objects, take.own.objects
    np.testing.assert_array_equal(ball.track.xyz_m, full.track.xyz_m[::2])
    for points, track in zip(half.own.of_people, half.tracks, strict=True):
        assert points.frames == track.frames


def hidden(ball: Track3D, frames: range) -> Track3D:
    """Track whose points are unknown in some frames."""
    xyz_m = ball.xyz_m.copy()
    xyz_m[frames.start : frames.stop] = np.nan
    return replace(ball, xyz_m=xyz_m)


@pytest.fixture(scope="module")
def partly_seen(take: Reconstruction) -> Reconstruction:
    (ball,) = take.own.objects
    return replace(take, own=replace(take.own, objects=(ball._replace(track=hidden(ball.track, range(5, 8))),)))


def test_glb_has_moving_nodes(partly_seen: Reconstruction, tmp_path: Path) -> None:
    write_results(partly_seen, tmp_path, exports=["glb"])
    with (tmp_path / "take.glb").open("rb") as file:
        reader = GlbReader(file)
        nodes, (animation,) = reader.document["nodes"], reader.document["animations"]
        names = [node["name"] for node in nodes]
        tracks = [
            (f"{motion.name} racket_tip", points)
            for motion, points in zip(partly_seen.motions, partly_seen.own.of_people, strict=True)
        ]
        for name, points in [*tracks, ("ball", partly_seen.own.objects[0].track)]:
            number = names.index(name)
            assert number in reader.document["scenes"][0]["nodes"]
            outputs = {
                channel["target"]["path"]: animation["samplers"][channel["sampler"]]["output"]
                for channel in animation["channels"]
                if channel["target"]["node"] == number
            }
            rows = slice(0, partly_seen.timebase.num_frames)
            places_m = GLTF.xyz_m_from_file(reader.rows(outputs["translation"], rows))[
                points.start_frame : points.frames.stop
            ]
            known = np.isfinite(points.xyz_m[:, 0, 0])
            np.testing.assert_allclose(places_m[known], points.xyz_m[known, 0], atol=1e-5)
            if name == "ball":
                sizes = reader.rows(outputs["scale"], rows)[:, 0]
                assert np.flatnonzero(sizes == 0.0).tolist() == [5, 6, 7]


def test_usd_has_moving_prims(partly_seen: Reconstruction, tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr")
    write_results(partly_seen, tmp_path, exports=["usd"])
    stage = pxr.Usd.Stage.Open(str(tmp_path / "take.usdc"))
    ball = stage.GetPrimAtPath("/take/ball")
    track = partly_seen.own.objects[0].track
    place_m = pxr.UsdGeom.Xformable(ball).GetLocalTransformation(3.0).ExtractTranslation()
    np.testing.assert_allclose(place_m, track.xyz_m[3, 0], atol=1e-9)
    visible = [pxr.UsdGeom.Imageable(ball).ComputeVisibility(float(frame)) for frame in (4, 5, 7, 8)]
    assert visible == ["inherited", "invisible", "invisible", "inherited"]
    tips = [prim for prim in stage.Traverse() if prim.GetName() == "racket_tip"]
    assert len(tips) == len(partly_seen.tracks)


def test_viewer_has_points(partly_seen: Reconstruction) -> None:
    report = quality_report(partly_seen)
    motion = ViewerMotion(partly_seen, person_views(partly_seen), {}, report)
    list(motion.encode())
    points = json.loads(motion.describe())["points"]
    assert [(point["name"], point["person"]) for point in points] == [
        *(("racket_tip", track.track_id) for track in partly_seen.tracks),
        ("ball", None),
    ]
    ball = points[-1]
    steps = np.frombuffer(base64.b64decode(ball["positions"]), "<i2").reshape(-1, 3)
    assert np.flatnonzero((steps == -32768).all(1)).tolist() == [5, 6, 7]
    places_m = np.where(steps == -32768, np.nan, steps * ball["position_step_m"] + ball["origin_m"])
    np.testing.assert_allclose(places_m, partly_seen.own.objects[0].track.xyz_m[:, 0], atol=2e-4)
    without = ViewerMotion(replace(partly_seen, own=OwnTracks()), person_views(partly_seen), {}, report)
    list(without.encode())
    assert "points" not in json.loads(without.describe())


@pytest.fixture(scope="module")
def rigid_take() -> Reconstruction:
    """Take with rackets of people and a box, whose points are unknown in three frames."""
    session = with_shapes(rigid_scene(duration_s=0.6).session)
    take = reconstruct(session, ReconstructionConfig(refine_calibration="off"))
    (box,) = take.own.objects
    return replace(take, own=replace(take.own, objects=(box._replace(track=hidden(box.track, range(5, 8))),)))


@pytest.fixture(scope="module")
def rigid_folder(rigid_take: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rigid")
    write_results(rigid_take, folder, exports=("csv", "c3d", "glb", "usd"))
    return folder


def motions_of(take: Reconstruction) -> tuple[list[RigidMotion], RigidMotion]:
    """Rackets, and the box."""
    *rackets, box = rigid_motions(take.own)
    assert [racket.person for racket in rackets] == [track.track_id for track in take.tracks]
    assert np.flatnonzero(np.isnan(box.rms_m)).tolist() == [5, 6, 7]
    return rackets, box


def matrices(motion: RigidMotion) -> tuple[np.ndarray, np.ndarray]:
    """Frames with a pose, and its rotations in them."""
    known = np.flatnonzero(np.isfinite(motion.rms_m))
    return known, Rotation.from_quat(motion.quat_xyzw[known]).as_matrix()


def test_json_has_poses_and_bones(rigid_take: Reconstruction, rigid_folder: Path) -> None:
    document = json.loads((rigid_folder / "skeletons.json").read_text())
    assert document["own_point_bones"] == [["grip", "tip"]]
    assert document["objects"][0]["bones"] == [["box_a", "box_b"]]
    rackets, box = motions_of(rigid_take)
    for entry, motion in zip(document["rigid_objects"], [*rackets, box], strict=True):
        assert (entry["name"], entry["person"], entry["start_frame"]) == (
            motion.shape.name,
            motion.person,
            motion.frames.start,
        )
        assert entry["point_names"] == list(motion.shape.points)
        np.testing.assert_allclose(entry["points_m"], motion.shape.xyz_m, atol=6e-5)
        for field, values in (("positions_m", motion.place_m), ("rotations_xyzw", motion.quat_xyzw)):
            unknown = [np.nan] * values.shape[1]
            np.testing.assert_allclose([row or unknown for row in entry[field]], values, atol=6e-5)
        assert [row is None for row in entry["rms_m"]] == np.isnan(motion.rms_m).tolist()


def test_table_has_poses(rigid_take: Reconstruction, rigid_folder: Path) -> None:
    rackets, box = motions_of(rigid_take)
    with (rigid_folder / "rigid.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head[:3] == ["frame", "time_s", "person_1_racket_x_m"]
    assert head[-8:] == [f"box_{column}" for column in ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "rms_m")]
    values = np.array([[float(cell or "nan") for cell in row[-8:]] for row in rows])
    np.testing.assert_allclose(values, np.column_stack([box.place_m, box.quat_xyzw, box.rms_m]), atol=1e-6)
    assert len(rackets) == 3


def test_c3d_has_poses_behind_segments(rigid_take: Reconstruction, rigid_folder: Path) -> None:
    rackets, box = motions_of(rigid_take)
    for name, motion, labels in (
        ("objects", box, []),
        *((f"person-{racket.person}", racket, list(SEGMENT_LABELS.values())) for racket in rackets),
    ):
        content = ezc3d.c3d(str(rigid_folder / f"{name}.c3d"))
        assert content["parameters"]["ROTATION"]["LABELS"]["value"] == [*labels, motion.shape.name]
        known, turns = matrices(motion)
        poses = content["data"]["rotations"][:, :, len(labels), motion.frames.start :]
        np.testing.assert_allclose(poses[:3, :3, known].transpose(2, 0, 1), turns, atol=1e-6)
        np.testing.assert_allclose(poses[:3, 3, known].T, 1000 * motion.place_m[known], atol=0.01)
    hidden_poses = ezc3d.c3d(str(rigid_folder / "objects.c3d"))["data"]["rotations"][:3, :3, 0, 5:8]
    assert not np.nan_to_num(hidden_poses).any()


def test_glb_has_objects_with_their_points_below(rigid_take: Reconstruction, rigid_folder: Path) -> None:
    _, box = motions_of(rigid_take)
    with (rigid_folder / "take.glb").open("rb") as file:
        reader = GlbReader(file)
        nodes, (animation,) = reader.document["nodes"], reader.document["animations"]
        names = [node["name"] for node in nodes]
        assert names.count("box_a") == 1
        assert {f"{motion.name} racket" for motion in rigid_take.motions} <= set(names)
        number = names.index("box")
        children = [nodes[child] for child in nodes[number]["children"]]
        assert [child["name"] for child in children] == list(box.shape.points)
        outputs = {
            channel["target"]["path"]: animation["samplers"][channel["sampler"]]["output"]
            for channel in animation["channels"]
            if channel["target"]["node"] == number
        }
        rows = slice(0, rigid_take.timebase.num_frames)
        quat, places = (reader.rows(outputs[path], rows) for path in ("rotation", "translation"))
        sizes = reader.rows(outputs["scale"], rows)[:, 0]
    assert np.flatnonzero(sizes == 0.0).tolist() == [5, 6, 7]
    known, turns = matrices(box)
    below = np.array([child["translation"] for child in children])
    shown = np.einsum("fij,pj->fpi", Rotation.from_quat(quat[known]).as_matrix(), below) + places[known, None]
    true_m = np.einsum("fij,pj->fpi", turns, box.shape.xyz_m) + box.place_m[known, None]
    np.testing.assert_allclose(GLTF.xyz_m_from_file(shown), true_m, atol=1e-5)


def test_usd_has_objects_with_their_points_below(rigid_take: Reconstruction, rigid_folder: Path) -> None:
    pxr = pytest.importorskip("pxr")
    stage = pxr.Usd.Stage.Open(str(rigid_folder / "take.usdc"))
    _, box = motions_of(rigid_take)
    corner = stage.GetPrimAtPath("/take/box/box_b")
    known, turns = matrices(box)
    for frame, turn in zip(known.tolist()[:3], turns, strict=False):
        shown = pxr.UsdGeom.XformCache(float(frame)).GetLocalToWorldTransform(corner).ExtractTranslation()
        true_m = turn @ box.shape.xyz_m[box.shape.points.index("box_b")] + box.place_m[frame]
        np.testing.assert_allclose(shown, true_m, atol=1e-5)
    visible = [pxr.UsdGeom.Imageable(corner).ComputeVisibility(float(frame)) for frame in (4, 5, 7, 8)]
    assert visible == ["inherited", "invisible", "invisible", "inherited"]


def test_viewer_has_bones(rigid_take: Reconstruction) -> None:
    motion = ViewerMotion(rigid_take, person_views(rigid_take), {}, quality_report(rigid_take))
    list(motion.encode())
    document = json.loads(motion.describe())
    points = [(point["person"], point["name"]) for point in document["points"]]
    ends = [tuple(points[place] for place in bone) for bone in document["point_bones"]]
    rackets = [((track.track_id, "grip"), (track.track_id, "tip")) for track in rigid_take.tracks]
    assert ends == [*rackets, ((None, "box_a"), (None, "box_b"))]


def test_poses_are_resampled(rigid_take: Reconstruction) -> None:
    """Every second pose is a pose of the take; a pose between two frames is between their poses."""
    _, box = motions_of(rigid_take)
    half, twice = (
        list(rigid_motions(resample(rigid_take, rate_hz * rigid_take.timebase.frame_rate_hz).own))[-1]
        for rate_hz in (0.5, 2.0)
    )
    np.testing.assert_allclose(half.place_m, box.place_m[::2], atol=1e-9)
    np.testing.assert_allclose(twice.place_m[::2], box.place_m, atol=1e-9)
    middle_m = (box.place_m[1:] + box.place_m[:-1]) / 2
    known = np.isfinite(middle_m).all(-1)
    assert np.nanmax(np.linalg.norm(twice.place_m[1::2][known] - middle_m[known], axis=1)) < 0.005
