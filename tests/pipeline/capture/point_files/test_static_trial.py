"""Joints that a static trial defines, in a movement whose markers of the joints are gone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multicap import InputError, Session
from pipeline.capture.point_files.point_reader import PointTable
from pipeline.capture.point_files.read_points import read_table
from pipeline.capture.point_files.static_trial import with_static_joints

RNG = np.random.default_rng(3)
SHANK = {"R.Shank.Upper": (0.05, 0.0, 0.35), "R.Shank.Front": (0.08, 0.05, 0.25), "R.Shank.Rear": (0.0, -0.04, 0.2)}
FOOT = {"R.Heel": (0.0, -0.06, 0.03), "R.Midfoot.Sup": (0.0, 0.08, 0.07), "R.Toe.Tip": (0.02, 0.15, 0.03)}
KNEE = {"R.Knee.Lat": (0.055, 0.0, 0.45), "R.Knee.Med": (-0.055, 0.0, 0.45)}
MIDDLE_M = np.array([0.0, 0.0, 0.45])


def tables(noise_m: float = 0.0, num_frames: int = 50) -> tuple[PointTable, PointTable, np.ndarray]:
    """Movement without the knee's markers, static trial with them, and the true knee of the movement in metres."""
    turns = Rotation.from_euler("XYZ", np.outer(np.sin(np.arange(num_frames) / 8), (70.0, 30.0, 20.0)), degrees=True)
    own = Rotation.from_rotvec(np.outer(np.cos(np.arange(num_frames) / 5), (0.7, 0.0, 0.0)))
    way_m = np.stack([np.arange(num_frames) * 0.02, np.zeros(num_frames), np.ones(num_frames)], axis=1)
    moving = [turns.apply(place) + way_m for place in SHANK.values()]
    moving += [turns.apply(own.apply(place)) + way_m for place in FOOT.values()]
    xyz = np.stack(moving, axis=1)
    xyz += RNG.normal(0.0, noise_m, xyz.shape)
    every = {**SHANK, **FOOT, **KNEE}
    standing = np.array(list(every.values())) @ Rotation.from_euler("Z", 50.0, degrees=True).as_matrix() + 3.0
    static = PointTable(tuple(every), np.repeat(1000.0 * standing[None], 10, axis=0), 60.0, "mm")
    return PointTable((*SHANK, *FOOT), 100.0 * xyz, 60.0, "cm"), static, turns.apply(MIDDLE_M) + way_m


def knee_m(table: PointTable) -> np.ndarray:
    return table.xyz[:, table.names.index("right_knee")] / 100.0


def test_joint_of_static_trial_moves_with_its_segment() -> None:
    table, static, expected_m = tables()
    found = with_static_joints(table, static, {})
    assert found.names == (*table.names, "right_knee")
    np.testing.assert_allclose(knee_m(found), expected_m, atol=1e-9)


def test_noise_of_markers_is_averaged() -> None:
    table, static, expected_m = tables(noise_m=0.001, num_frames=400)
    error_m = np.linalg.norm(knee_m(with_static_joints(table, static, {})) - expected_m, axis=1)
    assert np.sqrt((error_m**2).mean()) < 0.006  # 1 mm on markers 0.1 m apart, 0.2 m below the knee


def test_joint_is_unknown_while_fewer_than_three_markers_are_seen() -> None:
    table, static, _ = tables()
    xyz = table.xyz.copy()
    xyz[7, 0] = np.nan
    found = knee_m(with_static_joints(replace(table, xyz=xyz), static, {}))
    assert np.isnan(found[7]).all()
    assert np.isfinite(np.delete(found, 7, axis=0)).all()


def test_static_trial_without_more_joints_is_refused() -> None:
    table, _, _ = tables()
    with pytest.raises(InputError) as raised:
        with_static_joints(table, table, {})
    assert raised.value.problems[0].field == "static"


def test_stated_unit_is_the_unit_of_both_files() -> None:
    table, static, expected_m = tables()
    table, static = replace(table, xyz=10.0 * table.xyz, unit=None), replace(static, unit=None)
    found = with_static_joints(table, static, {}, "mm")
    np.testing.assert_allclose(found.xyz[:, found.names.index("right_knee")] / 1000.0, expected_m, atol=1e-9)


@pytest.mark.parametrize("unit", [None, "furlong"])
def test_static_trial_of_unknown_unit_is_refused(unit: str | None) -> None:
    table, static, _ = tables()
    with pytest.raises(InputError) as raised:
        with_static_joints(table, replace(static, unit=unit), {})
    assert raised.value.problems[0].field == "units"


def test_damaged_static_file_is_one_problem_of_many_files(tmp_path: Path) -> None:
    (tmp_path / "static.trc").write_text("nothing")
    (tmp_path / "walk.trc").write_text("nothing")
    with pytest.raises(InputError) as raised:
        Session.from_files([tmp_path / "walk.trc"] * 2, static=tmp_path / "static.trc")
    assert [problem.file for problem in raised.value.problems] == ["static.trc", "walk.trc", "walk.trc"]


def test_trc_with_uneven_tabs_has_its_unit(tmp_path: Path) -> None:
    lines = ["PathFileType\t4\t(X/Y/Z)\ta.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits"]
    lines += [
        "  100.0\t\t  100.0\t\t 1\t\t 1\t\t mm",
        "Frame#\tTime\tR.Heel\t\t",
        "\t\tX1\tY1\tZ1",
        "1\t0.0\t10\t20\t30",
    ]
    (tmp_path / "a.trc").write_text("\n".join(lines))
    table, _ = read_table(tmp_path / "a.trc")
    assert (table.unit, table.rate_hz, table.names) == ("mm", 100.0, ("R.Heel",))


def test_session_takes_joints_of_static_file(tmp_path: Path) -> None:
    trunk = {"L.ASIS": (-0.12, 0.1, 1.0), "R.ASIS": (0.12, 0.1, 1.0), "V.Sacral": (0.0, -0.1, 1.02)}
    trunk |= {"L.Acromium": (-0.18, 0.0, 1.45), "R.Acromium": (0.18, 0.0, 1.45)}
    still = {**trunk, **SHANK, **FOOT, **KNEE}

    def written(name: str, points: dict[str, tuple[float, float, float]]) -> Path:
        head = ["PathFileType\t4\t(X/Y/Z)\ta.trc", "DataRate\tUnits\tNumFrames", "50\tm\t30"]
        head += ["Frame#\tTime\t" + "\t\t\t".join(points), "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(9))]
        cells = "\t".join(f"{x}\t{z}\t{-y}" for x, y, z in points.values())
        (tmp_path / name).write_text("\n".join([*head, *(f"{k + 1}\t{k / 50}\t{cells}" for k in range(30))]))
        return tmp_path / name

    static = written("static.trc", still)
    walk = written("walk.trc", {name: place for name, place in still.items() if name not in KNEE})
    session = Session.from_files([walk], static=static)
    place_m = session.people[0].xyz_m[:, session.joints.index("right_knee")]
    np.testing.assert_allclose(place_m, np.tile(MIDDLE_M, (30, 1)), atol=1e-6)
