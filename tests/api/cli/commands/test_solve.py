"""`multicap solve`: files of 3D points to skeletons, and problems as sentences."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from api.cli.main import app

HEIGHTS_M = {"shoulder": 1.45, "hip": 0.95, "knee": 0.5, "ankle": 0.08}


def write_table(path: Path, unit: str = "m", heights_m: Mapping[str, float] = HEIGHTS_M) -> None:
    """Write ten frames of a person who stands, with the left side at +X."""
    names = [f"{side}_{part}" for part in heights_m for side in ("left", "right")]
    places = [f"{0.15 if name.startswith('left') else -0.15},0,{heights_m[name.partition('_')[2]]}" for name in names]
    head = ",".join(f"{name}_{axis}_{unit}" for name in names for axis in "xyz")
    rows = [f"{k / 25},{','.join(places)}" for k in range(10)]
    path.write_text("\n".join([f"time_s,{head}", *rows]) + "\n")


def test_person_of_table_gets_skeleton(tmp_path: Path) -> None:
    write_table(tmp_path / "stand.csv")
    arguments = ["solve", str(tmp_path / "stand.csv"), "--out", str(tmp_path / "out"), "--exports", "bvh,csv", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert "read as CSV in m with Z up" in answer["warnings"][0]["message"]
    assert {Path(path).name for path in answer["files"]} >= {"person-1.bvh", "person-1.csv", "skeletons.json"}
    content = json.loads((tmp_path / "out" / "skeletons.json").read_text())
    knee = content["joint_names"].index("left_knee")
    np.testing.assert_allclose(content["tracks"][0]["positions_m"][3][knee], [0.15, 0.0, 0.5], atol=1e-4)


def test_all_problems_of_files_come_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text("no")
    arguments = ["solve", str(tmp_path / "a.trc"), str(tmp_path / "b.bvh"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "no header of TRC" in result.output
    assert "The file does not exist" in result.output


def test_stated_mass_scales_momenta(tmp_path: Path) -> None:
    write_table(tmp_path / "stand.csv", heights_m=HEIGHTS_M | {"elbow": 1.15, "wrist": 0.9})
    arguments = ["solve", str(tmp_path / "stand.csv"), "--out", str(tmp_path / "out"), "--exports", "csv", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--mass-kg", "70", "--sex", "female", "--segments", "dumas"])
    assert result.exit_code == 0, result.output
    head = (tmp_path / "out" / "person-1.balance.csv").read_text().partition("\n")[0]
    assert "momentum_x_kg_m_s" in head
