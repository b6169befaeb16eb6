"""OpenSim in its child process: failures that name a marker or a segment, limits, ends from outside."""

import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.errors import ChildError
from pipeline.core.progress import ignore
from pipeline.export.opensim import model_files
from pipeline.export.opensim.model_files import OpenSimPerson, run_opensim
from tests.pipeline.export.opensim.conftest import needs_opensim

pytestmark = needs_opensim


@pytest.fixture
def setups(walk_archive: tuple[OpenSimPerson, Path], tmp_path: Path) -> Path:
    """The files that OpenSim is run on, in a folder of their own."""
    for name in ("generic.osim", "markers.xml", "markers.trc", "scale.xml", "ik.xml"):
        (tmp_path / name).write_bytes((walk_archive[1] / name).read_bytes())
    return tmp_path


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_unknown_body_of_marker_is_named(setups: Path) -> None:
    change(setups / "markers.xml", "/bodyset/head", "/bodyset/tail")
    _, problem = run_opensim(setups, 60, ignore)
    assert problem is not None
    assert problem.startswith("Scaling failed")
    assert "tail" in problem


def test_broken_model_is_problem_and_not_crash(setups: Path) -> None:
    (setups / "generic.osim").write_bytes(b"<OpenSimDocument Version='40000'><Model><BodySet>\x00")
    _, problem = run_opensim(setups, 60, ignore)
    assert problem is not None
    assert problem.startswith("Scaling failed")


def test_frame_and_marker_where_it_stopped_are_named(setups: Path) -> None:
    lines = (setups / "markers.trc").read_text().splitlines()
    head, rows = lines[:6], [line.split("\t") for line in lines[6:]]
    rows[20][2:] = ["nan"] * (len(rows[20]) - 2)
    (setups / "markers.trc").write_text("\n".join([*head, *map("\t".join, rows)]) + "\n")
    log, problem = run_opensim(setups, 60, ignore)
    assert log.num_frames == 20
    assert problem is not None
    assert problem.startswith(f"Inverse kinematics failed after {19 / 60:g} s"[:40])
    assert f"the marker {log.last} was" in problem


def test_run_beyond_its_computing_time_is_ended(setups: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_files, "_MAX_CPU_S", 3)
    monkeypatch.setattr(model_files, "_MAX_CPU_S_A_FRAME", 0)
    lines = (setups / "markers.trc").read_text().splitlines()
    rows = [line.split("\t") for line in lines[6:]]
    longer = [[row[0], f"{float(row[1]) + second:.6f}", *row[2:]] for second in range(20) for row in rows]
    (setups / "markers.trc").write_text("\n".join([*lines[:6], *map("\t".join, longer)]) + "\n")
    change(setups / "ik.xml", "0.983333</time_range>", "20</time_range>")
    log, problem = run_opensim(setups, 1200, ignore)
    assert log.num_frames < 1200
    assert problem is not None
    assert "limits on time and memory" in problem


def test_end_from_outside_is_not_person_s_fault(setups: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Watched(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr("pipeline.core.runtime.confinement.subprocess.Popen", Watched)

    def kill(_: float) -> None:
        os.kill(started[0].pid, signal.SIGKILL)

    with pytest.raises(ChildError, match="run of OpenSim failed, the file is not at fault: it was ended by SIGKILL"):
        run_opensim(setups, 60, kill)


def test_canceled_task_ends_child(setups: Path) -> None:
    class CanceledError(Exception):
        pass

    def cancel(_: float) -> None:
        raise CanceledError

    with pytest.raises(CanceledError):
        run_opensim(setups, 60, cancel)
    assert not (setups / "ik.mot").exists()
    assert not (setups / "opensim.log").exists()
