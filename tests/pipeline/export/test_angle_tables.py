"""Tables of joint angles: CSV and MOT, read by other programs' rules, and told from what was not written."""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.cameras import Timebase
from pipeline.core.options.file_formats import Export
from pipeline.export.results import write_files
from pipeline.export.writers import angle_tables
from pipeline.motion.angles.compute import JointAngles
from pipeline.motion.body_segments import ANGLE_NAMES
from tests.pipeline.export.test_results import take
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

CLOCK = Timebase(2.0, 50.0, 12)
FRAMES = range(12)


def some_angles() -> JointAngles:
    """Angles of the frames 3 to 9, one of which is unknown."""
    angle_deg = np.arange(7 * len(ANGLE_NAMES), dtype=float).reshape(7, -1) / 7.0 - 100.0
    angle_deg[2, 4] = np.nan
    return JointAngles(3, angle_deg, np.where(np.isnan(angle_deg), np.nan, 1.25))


def test_csv_has_angles_and_standard_deviations_in_degrees() -> None:
    content = b"".join(angle_tables.encode_csv(some_angles(), CLOCK, FRAMES)).decode("ascii")
    rows = list(csv.DictReader(io.StringIO(content, newline="")))
    assert [int(row["frame"]) for row in rows] == list(FRAMES)
    assert float(rows[3]["time_s"]) == pytest.approx(2.06)
    assert float(rows[3]["pelvis_obliquity_deg"]) == pytest.approx(-100.0 + 1 / 7, abs=1e-3)
    assert rows[3]["left_hip_flexion_sigma_deg"] == "1.250"
    assert {row["trunk_bending_deg"] for row in rows} >= {""}
    assert rows[5][f"{ANGLE_NAMES[4]}_deg"] == rows[5][f"{ANGLE_NAMES[4]}_sigma_deg"] == ""
    assert set(rows[0].values()) == {"0", "2.000000", ""}


def test_mot_has_form_of_opensim() -> None:
    content = b"".join(angle_tables.encode_mot(some_angles(), CLOCK, "person-1.mot", FRAMES)).decode("ascii")
    head, _, body = content.partition("endheader\n")
    assert head == "person-1.mot\nversion=1\nnRows=12\nnColumns=44\ninDegrees=yes\n"
    assert body.splitlines()[0].split("\t") == ["time", *ANGLE_NAMES]
    assert "nan" not in content
    table = np.genfromtxt(io.StringIO(body), delimiter="\t", skip_header=1)
    assert table.shape == (12, 44)
    np.testing.assert_allclose(table[:, 0], 2.0 + np.arange(12) / 50.0, atol=1e-6)
    angle_deg = some_angles().angle_deg.copy()
    # An unknown angle is between its neighbours, and the first and the last pose hold.
    angle_deg[2, 4] = (angle_deg[1, 4] + angle_deg[3, 4]) / 2
    np.testing.assert_allclose(table[3:10, 1:], angle_deg, atol=6e-4)
    np.testing.assert_allclose(table[[0, 1, 2, 10, 11], 1:], angle_deg[[0, 0, 0, 6, 6]], atol=6e-4)


def test_mot_leaves_out_angles_that_are_never_known(tmp_path: Path) -> None:
    angle_deg = np.full((7, len(ANGLE_NAMES)), np.nan)
    for known, header in (((), "time"), (("left_knee_flexion",), "time\tleft_knee_flexion")):
        for name in known:
            angle_deg[2:4, ANGLE_NAMES.index(name)] = 12.5
        angles = JointAngles(3, angle_deg, np.full_like(angle_deg, np.nan))
        path = tmp_path / "person-1.mot"
        path.write_bytes(b"".join(angle_tables.encode_mot(angles, CLOCK, path.name, FRAMES)))
        lines = path.read_text().splitlines()
        assert lines[3] == f"nColumns={1 + len(known)}"
        assert lines[6] == header
        found = np.concatenate(list(angle_tables.read_mot(path)))
        assert found.shape == (12, len(known), 1)
        assert (found == 12.5).all()


def test_files_are_read_back_as_they_were_written(tmp_path: Path) -> None:
    angles = some_angles()
    filled_deg = angle_tables.filled_angles(angles).angle_deg
    for name, content, read, expected in (
        (
            "a.csv",
            angle_tables.encode_csv(angles, CLOCK, FRAMES),
            angle_tables.read_csv,
            angle_tables.with_sigmas(angles),
        ),
        ("a.mot", angle_tables.encode_mot(angles, CLOCK, "a", FRAMES), angle_tables.read_mot, filled_deg),
    ):
        (tmp_path / name).write_bytes(b"".join(content))
        found = np.concatenate(list(read(tmp_path / name)))
        assert found.shape == (12, expected.shape[1], 1)
        np.testing.assert_allclose(found[3:10, :, 0], expected, atol=6e-4)


def test_results_hold_angles_and_report_changed_angle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    person = take(track_of(walker(30)), num_frames=40)
    paths = write_files(person, tmp_path / "first", ("angles", "mot")).paths
    assert [path.name for path in paths] == ["person-1.angles.csv", "person-1.mot", "skeletons.json", "metrics.json"]
    table = np.genfromtxt(tmp_path / "first/person-1.angles.csv", delimiter=",", names=True)
    assert len(table) == 40
    # Knees of the walker bend, and thighs swing by half a radian.
    assert ((table["left_knee_flexion_deg"] > -5.0) & (table["left_knee_flexion_deg"] < 80.0)).sum() == 30
    assert np.nanmax(table["left_hip_flexion_deg"]) == pytest.approx(np.degrees(0.5), abs=0.5)
    encode = angle_tables.encode_csv

    def moved(angles: JointAngles, *others: object) -> Iterator[bytes]:
        angle_deg = angles.angle_deg.copy()
        angle_deg[3, ANGLE_NAMES.index("left_knee_flexion")] += 0.5
        return encode(replace(angles, angle_deg=angle_deg), *others)  # type: ignore[arg-type]

    monkeypatch.setattr(angle_tables, "encode_csv", moved)
    exports: tuple[Export, ...] = ("angles",)
    metrics = write_files(person, tmp_path / "second", exports).paths[-1]
    check = json.loads(metrics.read_bytes())["exports"]["angles"]
    assert check["max_difference_deg"] == pytest.approx(0.5, abs=0.002)
