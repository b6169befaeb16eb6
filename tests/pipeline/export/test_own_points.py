"""Result files with points of the user's own: names, places, and nothing of them in files of other sessions."""

import base64
import csv
import json
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest

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
from pipeline.run.engine.local import reconstruct
from tests.pipeline.own_point_scenes import own_scene


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
