"""The report of a run: what it states about choices and files, and that it is the same each time."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import Rename
from pipeline.export.report.contents import list_settings
from pipeline.run.engine.local import reconstruct, reconstruct_to_files
from pipeline.validation.simulation.scenes import find_scene, record
from tests.cases import slow_but
from tests.pipeline.simulations import write_simulation


def test_settings_are_words_and_changes_are_said() -> None:
    config = ReconstructionConfig(
        smoothing="none",
        frame_range=(10, 50),
        exports=("bvh", "glb"),
        tracking={"alpha_3d_m": 0.3},
        edits=(Rename(person=2, name="Ada"),),
    )
    rows = {label: (value, is_default) for label, value, is_default in list_settings(config)}
    assert rows["Smoothing"] == ("None", "no")
    assert rows["Frames"] == ("10 to 49", "no")
    assert rows["Files of each person"] == ("BVH, animation, GLB, body and animation", "no")
    assert rows["Largest number of people"] == ("Everyone", "yes")
    assert rows["Report"] == ("no", "yes")
    assert rows["Parameter alpha_3d_m"] == ("0.3", "no")
    assert rows["Edit of people"] == ("action rename, person 2, name Ada", "no")


def test_same_take_gives_same_report_with_digests(tmp_path: Path) -> None:
    write_simulation(record(replace(find_scene("room"), duration_s=1.0), seed=6), tmp_path)
    calibration = tmp_path / "calibration.json"
    session = open_keypoints(tmp_path / "keypoints", calibration, tmp_path / "timestamps.csv")
    texts = []
    for number in range(2):
        # The second run finds all other outputs.
        config, cache = ReconstructionConfig(report=True, exports=("csv",)), tmp_path / "cache"
        folder = tmp_path / str(number)
        written = reconstruct_to_files(session, folder, config, cache=cache, name="take", sources=[calibration])
        assert written.paths[0] == folder / "report.html"
        assert sorted(folder.iterdir()) == sorted(written.paths)
        assert json.loads((folder / "metrics.json").read_bytes()) == written.metrics
        texts.append(written.paths[0].read_text(encoding="utf-8"))
    assert texts[0] == texts[1]
    assert hashlib.sha256(calibration.read_bytes()).hexdigest() in texts[0]
    assert texts[0].count("data:image/jpeg;base64,") >= len(session.cameras)
    knee = written.metrics["people"][0]["angles"]["left_knee_flexion"]
    assert f"{round(knee['min_deg'])} to {round(knee['max_deg'])}°" in texts[0]
    assert texts[0].count('aria-label="Knee flexion from') == len(written.metrics["people"])


@pytest.mark.parametrize("is_wanted", slow_but([True], [False, True]))
def test_nothing_is_made_that_is_not_asked_for(tmp_path: Path, is_wanted: bool) -> None:
    write_simulation(record(replace(find_scene("room"), duration_s=0.5), seed=6), tmp_path)
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    # Keypoints have no videos to draw over; without a folder nothing can be made.
    config = ReconstructionConfig(report=not is_wanted, overlay=True)
    if is_wanted:
        names = [path.name for path in reconstruct_to_files(session, tmp_path / "out", config).paths]
        assert [name for name in names if not name.startswith("person-")] == ["skeletons.json", "metrics.json"]
        return
    found = reconstruct(session, config)
    assert not (tmp_path / "out").exists()
    assert "overlay_without_videos" in [warning.code for warning in found.warnings]
