"""The stage that runs OpenSim: an archive for each person, figures in ``metrics.json``, warnings of what failed."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.errors import InputError
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.opensim import model_files
from pipeline.export.opensim.model_files import OpenSimLog
from pipeline.export.quality.report import all_checks
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct, reconstruct_to_files
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.export.opensim.conftest import needs_opensim
from tests.pipeline.simulations import write_simulation

pytestmark = needs_opensim
CONFIG = ReconstructionConfig(exports=("bvh", "osim"))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(replace(find_scene("room"), duration_s=1.0), seed=6), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


def test_each_person_has_archive_and_figures(session: Any, tmp_path: Path) -> None:
    written = reconstruct_to_files(session, tmp_path, CONFIG)
    people = written.metrics["people"]
    assert len(people) > 1
    found = {person["id"]: person for person in written.metrics["opensim"]}
    assert list(found) == [person["id"] for person in people]
    for person in people:
        figures = found[person["id"]]
        assert figures["problem"] is None
        assert figures["marker_rms_mm"] < 25.0
        assert figures["stature_m"] == pytest.approx(person["stature_m"], rel=0.03)
        with zipfile.ZipFile(tmp_path / f"person-{person['id']}.osim.zip") as archive:
            report = json.loads(archive.read(f"person-{person['id']}/report.json"))
        assert {name: report[name] for name in figures} == figures
    assert {"osim", "bvh"} & written.metrics["exports"].keys() == {"bvh"}
    assert "opensim_failed" not in {finding.code for finding in all_checks(written.metrics)}


def test_person_whom_opensim_can_t_follow_is_warning(
    session: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = "Inverse kinematics failed after 0.5 s, where the marker RKnee was 300 mm off: AssemblySolver"
    monkeypatch.setattr(model_files, "run_opensim", lambda *_: (OpenSimLog(), problem))
    written = reconstruct_to_files(session, tmp_path, CONFIG)
    warned = [finding.message for finding in all_checks(written.metrics) if finding.code == "opensim_failed"]
    people = [f"Person {person['id']}: {problem}" for person in written.metrics["people"]]
    assert warned == [f"People without a motion of OpenSim. {' '.join(people)}"]
    with zipfile.ZipFile(tmp_path / "person-1.osim.zip") as archive:
        names = {name.partition("/")[2] for name in archive.namelist()}
    assert {"scale.xml", "ik.xml", "markers.trc", "generic.osim"} <= names
    assert "ik.mot" not in names
    assert (tmp_path / "person-1.bvh").exists()


def test_write_results_says_who_writes_models(session: Any, tmp_path: Path) -> None:
    take = reconstruct(session, CONFIG)
    with pytest.raises(InputError, match="Use `reconstruct_to_files`, or `multicap reconstruct`"):
        write_results(take, tmp_path, CONFIG.exports)
