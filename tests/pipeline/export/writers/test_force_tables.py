"""Files of forces: CSV, and external loads that OpenSim applies to feet."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import ezc3d
import numpy as np
import pytest

from pipeline.capture.points import SessionMaker
from pipeline.core.data.cameras import Timebase
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.file_formats import Export
from pipeline.export.timelines import read_rows
from pipeline.export.writers.estimated_plates import estimated_plates
from pipeline.export.writers.force_tables import external_loads
from pipeline.run.engine.local import reconstruct_to_files
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.forces.physical_people import estimated, truth_of
from tests.pipeline.motion.gait.walks import exercise, gait_of, walk

ACT = exercise(Gesture.SQUAT)
MASS_KG = 70.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a person of 70 kg, and of the same person without a stated mass."""
    path = tmp_path_factory.mktemp("forces")
    points_m = truth_of(ACT).xyz_m[:150]
    session = SessionMaker.from_points(points_m, ACT.joints.names, ACT.rate_hz, "m")
    for name, mass_kg in (("massive", MASS_KG), ("unknown", None)):
        reconstruct_to_files(session, path / name, ReconstructionConfig(exports=("forces",), mass_kg=mass_kg))
    slow = ReconstructionConfig(exports=("forces",), mass_kg=MASS_KG, output_rate_hz=ACT.rate_hz / 2)
    reconstruct_to_files(session, path / "slow", slow)
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="ascii", newline="") as file:
        return list(csv.DictReader(file))


def test_csv_has_a_row_a_frame_in_newtons(folder: Path) -> None:
    rows = rows_of(folder / "massive" / "person-1.forces.csv")
    assert [row["frame"] for row in rows] == [str(number) for number in range(150)]
    weight_n = np.median([float(row["force_z_n"]) for row in rows])
    assert weight_n == pytest.approx(MASS_KG * 9.81, rel=0.02)
    feet_n = float(rows[75]["left_force_z_n"]) + float(rows[75]["right_force_z_n"])
    assert feet_n == pytest.approx(float(rows[75]["force_z_n"]), abs=0.001)
    assert {"left_knee_flexion_nm", "right_hip_flexion_sigma_nm", "left_ankle_w", "may_touch_person"} <= rows[0].keys()


def test_unknown_mass_is_estimated_and_forces_are_for_each_kilogram_too(folder: Path) -> None:
    guess, whole = (rows_of(folder / name / "person-1.forces.csv")[75] for name in ("unknown", "massive"))
    assert float(guess["force_z_n_kg"]) * MASS_KG == pytest.approx(float(whole["force_z_n"]), abs=0.01)
    assert float(guess["force_z_n_kg"]) * float(guess["mass_kg"]) == pytest.approx(float(guess["force_z_n"]), abs=0.05)
    assert (float(guess["mass_is_estimated"]), float(whole["mass_is_estimated"])) == (1.0, 0.0)
    assert float(guess["force_z_sigma_n"]) > 5.0 * float(whole["force_z_sigma_n"])
    assert "force_z_n_kg" not in whole
    document = json.loads((folder / "unknown" / "metrics.json").read_text())["forces"][0]
    assert document["mass_is_estimated"]
    assert document["mass_kg"] == pytest.approx(float(guess["mass_kg"]), abs=0.06)
    setup = (folder / "unknown" / "person-1.forces.xml").read_text()
    assert f"<!-- Mass {document['mass_kg']:.0f} kg, estimated from the stature" in setup


def test_external_loads_are_forces_on_axes_of_opensim(folder: Path) -> None:
    rows = rows_of(folder / "massive" / "person-1.forces.csv")
    with (folder / "massive" / "person-1.forces.mot").open() as file:
        head = [next(file).strip() for _ in range(6)]
        names = next(file).split()
        values = np.concatenate(list(read_rows(file, "\t")))
    assert head[2:] == ["nRows=150", "nColumns=19", "inDegrees=yes", "endheader"]
    assert len(values) == 150
    assert np.isfinite(values).all()
    for side in ("left", "right"):
        force = [values[75, names.index(f"{side}_ground_force_v{axis}")] for axis in "xyz"]
        x, y, z = (float(rows[75][f"{side}_force_{axis}_n"]) for axis in "xyz")
        assert force == pytest.approx([x, z, -y], abs=1e-4)
        place = [values[75, names.index(f"{side}_ground_force_p{axis}")] for axis in "xyz"]
        x, y, z = (float(rows[75][f"{side}_pressure_{axis}_m"]) for axis in "xyz")
        assert place == pytest.approx([x, z, -y], abs=1e-4)


def test_undetermined_forces_are_zeros_in_loads_and_plates() -> None:
    forces, gap = estimated(ACT), slice(40, 60)
    values = {name: np.array(getattr(forces.feet, name)) for name in ("force", "pressure_m", "free_moment", "sigma")}
    for of_feet in values.values():
        of_feet[gap] = np.nan
    forces = replace(forces, feet=replace(forces.feet, **values))
    timebase = Timebase(0.0, ACT.rate_hz, len(forces.total))
    text = b"".join(external_loads(forces, timebase, forces.frames, "person-1.forces.mot")).decode()
    loads = np.loadtxt(io.StringIO(text), skiprows=7)[:, 1:]
    plates = estimated_plates(forces, timebase, forces.frames)
    assert plates is not None
    for samples in (loads, plates.samples):
        assert np.isfinite(samples).all()
        assert (samples[gap] == 0.0).all()
        assert (samples[39] != 0.0).any()


def test_setup_applies_each_force_to_its_foot(folder: Path) -> None:
    root = ElementTree.parse(folder / "massive" / "person-1.forces.xml").getroot()  # noqa: S314 - our own file
    bodies = {force.get("name"): force.findtext("applied_to_body") for force in root.iter("ExternalForce")}
    assert bodies == {"left": "calcn_l", "right": "calcn_r"}
    assert root.findtext("ExternalLoads/datafile") == "person-1.forces.mot"


def test_figures_are_of_the_session_at_any_rate_of_files(folder: Path) -> None:
    own, slow = (json.loads((folder / name / "metrics.json").read_text()) for name in ("massive", "slow"))
    assert len(rows_of(folder / "slow" / "person-1.forces.csv")) == 75
    assert own["forces"]
    assert slow["forces"] == own["forces"]


def test_metrics_have_figures_of_forces(folder: Path) -> None:
    text = (folder / "massive" / "metrics.json").read_text()
    assert '"flight_residual_bw": null' in text
    assert '"max_difference_si"' in text


@pytest.fixture(scope="module")
def with_plates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """C3D files of the person of 70 kg with and without forces."""
    path = tmp_path_factory.mktemp("plates")
    session = SessionMaker.from_points(truth_of(ACT).xyz_m[:150], ACT.joints.names, ACT.rate_hz, "m")
    choices: dict[str, tuple[Export, ...]] = {"both": ("c3d", "forces"), "alone": ("c3d",)}
    for name, exports in choices.items():
        reconstruct_to_files(session, path / name, ReconstructionConfig(exports=exports, mass_kg=MASS_KG))
    return path


def test_c3d_has_estimated_plates_that_ezc3d_reads(with_plates: Path) -> None:
    rows = rows_of(with_plates / "both" / "person-1.forces.csv")
    read = ezc3d.c3d(str(with_plates / "both" / "person-1.c3d"), extract_forceplat_data=True)
    assert read["data"]["analogs"].shape == (1, 12, 150)
    platform = read["parameters"]["FORCE_PLATFORM"]
    assert list(platform["TYPE"]["value"]) == [2, 2]
    assert all("estimated" in text for text in platform["DESCRIPTIONS"]["value"])
    assert all(label.endswith("_estimated") for label in read["parameters"]["ANALOG"]["LABELS"]["value"])
    for side, plate in zip(("left", "right"), read["data"]["platform"], strict=True):
        ground_n = [[float(row[f"{side}_force_{axis}_n"]) for row in rows] for axis in "xyz"]
        np.testing.assert_allclose(-plate["force"], ground_n, atol=0.01)
        stands = np.array(ground_n[2]) > 20.0
        places_m = np.array([[float(row[f"{side}_pressure_{axis}_m"] or "nan") for row in rows] for axis in "xy"])
        # The floor of a squat is flat: the force meets it where the foot presses.
        np.testing.assert_allclose(plate["center_of_pressure"][:2, stands] / 1000.0, places_m[:, stands], atol=0.002)
        free_nm = [float(row[f"{side}_free_moment_nm"]) for row in rows]
        np.testing.assert_allclose(-plate["Tz"][2] / 1000.0, free_nm, atol=0.01)
        corners_m = plate["corners"][:2] / 1000.0
        assert (corners_m.min(1) < np.nanmin(places_m, 1)).all()
        assert (corners_m.max(1) > np.nanmax(places_m, 1)).all()


def test_c3d_without_forces_has_no_plates(with_plates: Path) -> None:
    read = ezc3d.c3d(str(with_plates / "alone" / "person-1.c3d"))
    assert "FORCE_PLATFORM" not in read["parameters"] or not read["parameters"]["FORCE_PLATFORM"]["USED"]["value"][0]
    assert read["data"]["analogs"].shape[1] == 0


def test_cycles_are_means_over_steady_strides(tmp_path: Path) -> None:
    act = walk(1.2)
    session = SessionMaker.from_points(truth_of(act).xyz_m, act.joints.names, act.rate_hz, "m")
    reconstruct_to_files(session, tmp_path, ReconstructionConfig(exports=("forces",), mass_kg=MASS_KG))
    rows = rows_of(tmp_path / "person-1.force_cycles.csv")
    assert [row["percent"] for row in rows] == [str(percent) for percent in range(101)]
    frames = rows_of(tmp_path / "person-1.forces.csv")
    steady = [stride for stride in gait_of(act).strides if stride.is_steady]
    for side in ("left", "right"):
        spans = [(stride.strike_row, stride.next_row) for stride in steady if stride.side == side]
        assert {row[f"{side}_force_z_n_kg_strides"] for row in rows} == {f"{len(spans):.4f}"}
        force = np.array([float(row[f"{side}_force_z_n"]) for row in frames]) / MASS_KG
        expected = [np.interp(np.linspace(*span, 101), np.arange(len(force)), force) for span in spans]
        mean = [float(row[f"{side}_force_z_n_kg_mean"]) for row in rows]
        # Strikes of the session's own fit differ by hundredths of a frame.
        np.testing.assert_allclose(mean, np.mean(expected, axis=0), atol=0.4)
    assert {"left_knee_flexion_nm_kg_mean", "right_hip_flexion_nm_kg_std", "left_ankle_w_kg_mean"} <= rows[0].keys()


def test_people_without_steady_strides_have_no_cycles(folder: Path) -> None:
    assert not list((folder / "massive").glob("*.force_cycles.csv"))
