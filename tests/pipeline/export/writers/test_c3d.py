"""C3D files by other readers: poses of segments, residuals, cameras, long takes, long lists."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest

from pipeline.capture.laboratory.c3d_content import read_parameters
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import BODY_FEET
from pipeline.export.writers import c3d_file
from pipeline.export.writers.c3d_file import parameter_bytes
from pipeline.motion.angles.compute import segments_from
from pipeline.motion.body_segments import SEGMENT_LABELS
from pipeline.motion.gait.analysis import MarkedEvent
from pipeline.motion.skeleton.model import INDEX, posed_joints
from tests.pipeline.export.writers.test_bvh import walk
from tests.pipeline.motion.gait.walks import track_of
from tests.pipeline.motion.gait.walks import walk as walk_act

RATE_HZ = 60.0


def written(path: Path, track: Track3D, frames: range | None = None, **options: object) -> Path:
    clock = Timebase(0.0, RATE_HZ, track.frames.stop)
    origin_m = np.array([1.0, -2.0, 0.5])
    path.write_bytes(b"".join(c3d_file.encode(track, BODY_FEET, clock, origin_m, frames, **options)))  # type: ignore[arg-type]
    return path


def track_with(num_frames: int, start_frame: int = 0) -> Track3D:
    track = track_of(walk_act(1.2))
    rows = np.arange(num_frames) % track.num_frames
    return replace(
        track,
        start_frame=start_frame,
        xyz_m=track.xyz_m[rows],
        score=track.score[rows],
        source=track.source[rows],
        error_px=track.error_px[rows],
        views=track.views[rows],
        uncertainty_m=np.full(track.source[rows].shape, 0.0123),
    )


def test_poses_of_segments_by_ezc3d(tmp_path: Path) -> None:
    """Origins are the joints, and axes those of joint angles: right, front, up."""
    motion = replace(walk(30), start_frame=4)
    track = track_with(30, start_frame=4)
    read = ezc3d.c3d(str(written(tmp_path / "a.c3d", track, range(0, 40), motion=motion)))
    group = read["parameters"]["ROTATION"]
    assert group["LABELS"]["value"] == list(SEGMENT_LABELS.values())
    assert read["data"]["rotations"].shape == (4, 4, len(SEGMENT_LABELS), 40)
    expected = segments_from(motion)
    joint_m, _ = posed_joints(motion)
    for number, name in enumerate(SEGMENT_LABELS):
        found = read["data"]["rotations"][:, :, number, 4:34]
        turn = np.moveaxis(found[:3, :3], 2, 0)
        # An element off by 1e-6 is less than 0.0001 degrees.
        np.testing.assert_allclose(turn, expected[name][..., [2, 0, 1]], atol=1e-6)
        if name == "left_shank":
            np.testing.assert_allclose(
                found[:3, 3].T / 1000.0 + [1.0, -2.0, 0.5], joint_m[:, INDEX["LeftLeg"]], atol=1e-5
            )


def test_upright_person_has_segments_right_front_and_up() -> None:
    motion = walk(1)
    rest = replace(motion, parent_from_joint=np.tile([0.0, 0.0, 0.0, 1.0], (*motion.parent_from_joint.shape[:2], 1)))
    axes = segments_from(rest)["pelvis"][0][:, [2, 0, 1]]
    np.testing.assert_allclose(axes.T, [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-9)


def test_residuals_and_numbers_of_cameras(tmp_path: Path) -> None:
    track = track_with(10)
    source, views = track.source.copy(), track.views.copy()
    source[3, 2], source[4, 5], views[:] = Source.INTERPOLATED, Source.ABSENT, 3
    xyz_m = track.xyz_m.copy()
    xyz_m[4, 5] = np.nan
    path = written(tmp_path / "a.c3d", replace(track, xyz_m=xyz_m, source=source, views=views))
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there are no analog channels
        points = np.array([points for _, points, _ in c3d.Reader(file).read_frames()])
    is_measured = source == Source.MEASURED
    np.testing.assert_array_equal(points[is_measured, 3], 12.0)
    np.testing.assert_array_equal(points[is_measured, 4], 0b111)
    assert points[3, 2, 3:].tolist() == [0.0, 0.0]
    assert points[4, 5, 3] == -1.0
    # ezc3d takes the bytes of mask and residual for each other in files of floats (its issue 386).
    residuals = ezc3d.c3d(str(path))["data"]["meta_points"]["residuals"][0]
    np.testing.assert_array_equal(residuals < 0.0, ~np.isfinite(xyz_m).all(-1).T)


def test_file_that_ezc3d_has_written_again_is_read_by_others(tmp_path: Path) -> None:
    track = track_with(10)
    again = tmp_path / "again.c3d"
    ezc3d.c3d(str(written(tmp_path / "a.c3d", track))).write(str(again))
    with again.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        points = np.array([points for _, points, _ in c3d.Reader(file).read_frames()])
    np.testing.assert_allclose(points[..., :3] / 1000.0 + [1.0, -2.0, 0.5], track.xyz_m, atol=1e-4)


@pytest.mark.slow
def test_filling_of_long_take_s_last_block_is_no_point(tmp_path: Path) -> None:
    track = track_with(65_541)
    read = ezc3d.c3d(str(written(tmp_path / "a.c3d", track)))
    filling = read["data"]["meta_points"]["residuals"][0, :, 65_541:]
    assert filling.size
    assert (filling < 0.0).all()


@pytest.mark.slow
def test_long_take(tmp_path: Path) -> None:
    """70,000 frames: readers that know the convention find all, others the first 65,535."""
    track = track_with(70_000)
    path = written(tmp_path / "a.c3d", track)
    assert path.stat().st_size < 16 * 70_000 * len(BODY_FEET.names) + 4096
    read_m = np.concatenate(list(c3d_file.read_xyz_m(path)))
    np.testing.assert_allclose(read_m, track.xyz_m, atol=1e-4)
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = c3d.Reader(file)
        assert (reader.first_frame, reader.last_frame) == (1, 70_000)
        *_, (_, points, _) = reader.read_frames()
    last_m = track.xyz_m[-1]
    known = np.isfinite(last_m).all(-1)
    np.testing.assert_allclose(points[known, :3] / 1000.0 + [1.0, -2.0, 0.5], last_m[known], atol=1e-4)


@pytest.mark.slow
def test_poses_that_format_can_not_place_are_left_out(tmp_path: Path) -> None:
    """Their first block would be beyond the 65,535th."""
    motion = walk(30)
    rows = np.arange(110_000) % 30
    longer = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    path = written(tmp_path / "a.c3d", track_with(110_000), motion=longer)
    assert path.stat().st_size < 16 * 110_000 * len(BODY_FEET.names) + 4096
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert c3d.Reader(file).get("ROTATION") is None


@pytest.mark.parametrize("count", [255, 256, 600])
def test_more_items_than_parameter_holds(count: int, tmp_path: Path) -> None:
    events = [MarkedEvent("Foot Strike", "Left", float(number) / 8, 0.01, 0.9) for number in range(count)]
    group = ezc3d.c3d(str(written(tmp_path / "a.c3d", track_with(100), events=events)))["parameters"]["EVENT"]
    labels: Sequence[str] = [
        *group["LABELS"]["value"],
        *(label for number in (2, 3) if f"LABELS{number}" in group for label in group[f"LABELS{number}"]["value"]),
    ]
    assert labels == ["Foot Strike"] * count
    assert group["USED"]["value"][0] == count


def test_numbers_of_parameters_are_read_back() -> None:
    groups = read_parameters(parameter_bytes({"A": {"X": [1, 65_535], "T": ["word"]}, "B": {"Y": np.eye(3)}}))
    assert np.asarray(groups["A"]["X"]).tolist() == [1, 65_535]
    assert groups["A"]["T"] == ["word"]
    assert np.asarray(groups["B"]["Y"]).tolist() == np.eye(3).tolist()
    with pytest.raises(ValueError, match="blocks"):
        parameter_bytes({"A": {f"X{number}": ["x" * 200] * 255 for number in range(5)}})
