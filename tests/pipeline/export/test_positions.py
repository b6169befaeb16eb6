"""TRC, C3D and CSV files, read back by third-party libraries."""

import csv
import io
import warnings
from functools import partial
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest
from trc import TRCData

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.joints import BODY_FEET, COCO_17, WHOLE_BODY, JointSet
from pipeline.export.writers import c3d_file, csv_table, trc
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

RATES_HZ = (25.0, 30000 / 1001, 120000 / 1001)
START = 7


def track() -> Track3D:
    """Track of a walk with gaps, a joint without positions, and a frame without joints."""
    xyz_m = walker(40, turn_rad=2.0)
    xyz_m[5:9, 3] = np.nan
    xyz_m[:, 10] = np.nan
    xyz_m[20] = np.nan
    return track_of(xyz_m, start_frame=START)


def larger_track(joints: JointSet) -> Track3D:
    """Track of a walk with feet, or feet and hands, near the joints of the body; some joints are unknown."""
    xyz_m = np.resize(np.moveaxis(track().xyz_m, 1, 0), (len(joints.names), 40, 3)).swapaxes(0, 1).copy()
    xyz_m += 0.01 * np.arange(len(joints.names))[:, None]
    return track_of(xyz_m, start_frame=START)


def timebase(rate_hz: float) -> Timebase:
    return Timebase(0.5, rate_hz, 100)


def y_up(xyz_m: np.ndarray) -> np.ndarray:
    return np.stack([xyz_m[..., 0], xyz_m[..., 2], -xyz_m[..., 1]], axis=-1)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_trc(rate_hz: float, tmp_path: Path) -> None:
    path = tmp_path / "person-1.trc"
    path.write_bytes(b"".join(trc.encode(track(), COCO_17, timebase(rate_hz), path.name)))
    read = TRCData()
    read.load(str(path))
    assert float(read["DataRate"]) == pytest.approx(rate_hz, rel=1e-9)
    assert (int(read["NumFrames"]), int(read["NumMarkers"]), read["Units"]) == (40, 17, "m")
    assert list(read["Markers"]) == list(COCO_17.names)
    expected_m = y_up(track().xyz_m)
    for number in range(40):
        time_s, joints = read[number + 1]
        assert time_s == pytest.approx(0.5 + (START + number) / rate_hz, abs=1e-6)
        np.testing.assert_allclose(np.array(joints, float), expected_m[number], atol=1e-4)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_c3d_by_ezc3d(rate_hz: float, tmp_path: Path) -> None:
    path = tmp_path / "person-1.c3d"
    path.write_bytes(b"".join(c3d_file.encode(track(), COCO_17, timebase(rate_hz), np.zeros(3))))
    read = ezc3d.c3d(str(path))
    point = read["parameters"]["POINT"]
    assert point["RATE"]["value"][0] == pytest.approx(rate_hz, rel=1e-6)
    assert point["LABELS"]["value"] == list(COCO_17.names)
    assert point["UNITS"]["value"] == ["mm"]
    read_m = np.transpose(read["data"]["points"][:3], (2, 1, 0)) / 1000.0
    np.testing.assert_allclose(read_m, track().xyz_m, atol=1e-4)


def test_c3d_by_another_reader(tmp_path: Path) -> None:
    path = tmp_path / "person-1.c3d"
    path.write_bytes(b"".join(c3d_file.encode(track(), COCO_17, timebase(25.0), np.zeros(3))))
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there are no analog channels
        reader = c3d.Reader(file)
        frames = [points.copy() for _, points, _ in reader.read_frames()]
    assert [label.strip() for label in reader.point_labels] == list(COCO_17.names)
    assert reader.point_rate == 25.0
    assert len(frames) == 40
    for points, expected_m in zip(frames, track().xyz_m, strict=True):
        known = np.isfinite(expected_m).all(-1)
        np.testing.assert_array_equal(points[:, 3] >= 0, known)
        np.testing.assert_allclose(points[known, :3] / 1000.0, expected_m[known], atol=1e-4)


@pytest.mark.parametrize("joints", [BODY_FEET, WHOLE_BODY])
def test_feet_and_hands_in_all_formats(joints: JointSet, tmp_path: Path) -> None:
    larger, clock = larger_track(joints), timebase(25.0)
    path = tmp_path / "person-1.c3d"
    path.write_bytes(b"".join(c3d_file.encode(larger, joints, clock, np.zeros(3))))
    np.testing.assert_allclose(np.concatenate(list(c3d_file.read_xyz_m(path))), larger.xyz_m, atol=1e-4)
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there are no analog channels
        reader = c3d.Reader(file)
        assert [label.strip() for label in reader.point_labels] == list(joints.names)
        frames = [points.copy() for _, points, _ in reader.read_frames()]
    known = np.isfinite(larger.xyz_m).all(-1)
    np.testing.assert_allclose(np.array(frames)[known][:, :3] / 1000.0, larger.xyz_m[known], atol=1e-4)

    path = tmp_path / "person-1.trc"
    path.write_bytes(b"".join(trc.encode(larger, joints, clock, path.name)))
    np.testing.assert_allclose(np.concatenate(list(trc.read_xyz_m(path))), larger.xyz_m, atol=1e-4)
    read = TRCData()
    read.load(str(path))
    assert list(read["Markers"]) == list(joints.names)
    assert int(read["NumMarkers"]) == len(joints.names)
    np.testing.assert_allclose(np.array(read[40][1], float), y_up(larger.xyz_m)[39], atol=1e-4)

    path = tmp_path / "person-1.csv"
    path.write_bytes(b"".join(csv_table.encode(larger, joints, clock)))
    np.testing.assert_allclose(np.concatenate(list(csv_table.read_xyz_m(path))), larger.xyz_m, atol=1e-4)
    with path.open(newline="", encoding="ascii") as file:
        header = next(csv.reader(file))
    assert header[-3:] == [f"{joints.names[-1]}_{axis}_m" for axis in "xyz"]
    assert len(header) == 2 + 3 * len(joints.names)


def test_csv() -> None:
    content = b"".join(csv_table.encode(track(), COCO_17, timebase(25.0))).decode("utf-8")
    rows = list(csv.DictReader(io.StringIO(content)))
    assert [int(row["frame"]) for row in rows] == list(range(START, START + 40))
    assert float(rows[0]["time_s"]) == pytest.approx(0.5 + START / 25.0)
    for row, expected_m in zip(rows, track().xyz_m, strict=True):
        cells = [[row[f"{name}_{axis}_m"] for axis in "xyz"] for name in COCO_17.names]
        read_m = np.array([[float(cell) if cell else np.nan for cell in joint] for joint in cells])
        np.testing.assert_allclose(read_m, expected_m, atol=1e-4)


def test_same_track_always_gives_same_bytes() -> None:
    for encode in (partial(c3d_file.encode, origin_m=np.zeros(3)), csv_table.encode):
        assert b"".join(encode(track(), COCO_17, timebase(25.0))) == b"".join(encode(track(), COCO_17, timebase(25.0)))


@pytest.mark.parametrize("num_frames", [1, 2])
def test_short_tracks_and_nothing_seen(num_frames: int, tmp_path: Path) -> None:
    unseen = track_of(np.full((num_frames, 17, 3), np.nan))
    path = tmp_path / "a.c3d"
    path.write_bytes(b"".join(c3d_file.encode(unseen, COCO_17, timebase(25.0), np.zeros(3))))
    assert np.isnan(ezc3d.c3d(str(path))["data"]["points"][:3]).all()
    assert b"".join(trc.encode(unseen, COCO_17, timebase(25.0), "a.trc")).count(b"\n") == 6 + num_frames
    assert b"".join(csv_table.encode(unseen, COCO_17, timebase(25.0))).count(b"\n") == 1 + num_frames
