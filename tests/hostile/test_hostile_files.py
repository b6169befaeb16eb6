"""Damaged calibrations, keypoints and timestamps: each gives a session or clear problems within seconds."""

import io
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_calibration, read_contents
from pipeline.capture import preflight
from pipeline.core.errors import InputError, listed
from pipeline.core.options.job_choices import Units
from pipeline.validation.simulation.scenes import Simulation
from tests.hostile.calibrations import in_every_format, spoilt_calibrations
from tests.hostile.keypoints import keypoint_files, simulate, spoilt_keypoints
from tests.hostile.programs import of_programs, packed, spoilt_programs

SEED = 18
MAX_S = 10.0  # processor time of a check
MAX_PROBLEMS = 61


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate()


def check(folder: Path, files: Mapping[str, bytes]) -> dict[str, Any]:
    """Check a session of keypoints as the service's child does, in this process: no exception and no warning."""
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (calibration,) = set(files) - {"timestamps.csv"} - {name for name in files if name.endswith(".zip")}
    archives = [str(folder / name) for name in files if name.endswith(".zip")]
    words = ["--keypoints", *archives, "--calibration", str(folder / calibration)]
    words += ["--timestamps", str(folder / "timestamps.csv"), "--record", str(folder / "record.npz")]
    output = io.StringIO()
    started_s = time.process_time()
    with redirect_stdout(output):
        exit_code = preflight.main(words)
    assert time.process_time() - started_s < MAX_S
    found: dict[str, Any] = json.loads(output.getvalue())
    assert exit_code == (2 if "problems" in found else 0)
    return found


# Codes of problems that are of no single file or camera.
OF_ALL_FILES = {"more_problems", "keypoints_mixed", "pairing_unknown"}


def is_clear(problems: list[dict[str, Any]]) -> bool:
    """Return whether there are at most some dozens of problems, each with a sentence and its place."""
    return 0 < len(problems) <= MAX_PROBLEMS and all(
        problem["message"].endswith(".")
        and len(json.dumps(problem)) < 10_000
        and (problem["file"] or problem["camera"] or problem["code"] in OF_ALL_FILES)
        and not any("\ud800" <= character <= "\udfff" for text in problem.values() if text for character in text)
        for problem in problems
    )


def numbered(folder: Path) -> Iterator[Path]:
    number = 0
    while True:
        number += 1
        yield folder / str(number)


def test_good_ones_are_read_in_every_format(tmp_path: Path, simulation: Simulation) -> None:
    for name, content in in_every_format(simulation.cameras).items():
        (tmp_path / name).write_bytes(content)
        cameras = read_calibration(tmp_path / name)
        # Human3.6M's files have no sizes of pictures.
        sizes_px = [UNKNOWN_SIZE if name == "human36m.json" else camera.size_px for camera in simulation.cameras]
        assert [camera.size_px for camera in cameras] == sizes_px
    assert len(check(tmp_path / "session", keypoint_files(simulation))["cameras"]) == 2


def test_files_of_other_programs(tmp_path: Path, simulation: Simulation) -> None:
    for name, members in of_programs(simulation.cameras).items():
        (tmp_path / name).write_bytes(packed(members))
        units: Units | None = "mm" if name == "anipose.toml" else None
        assert len(read_contents(tmp_path / name, units).cameras) == len(simulation.cameras)
    refused = 0
    for name, content in spoilt_programs(simulation.cameras, SEED, 300):
        path = tmp_path / name
        path.write_bytes(content)
        notes, problems = notes_and_problems(path)
        refused += bool(problems)
        assert not problems or is_clear(problems), problems
        assert all(note.isprintable() and len(note) < 600 for note in notes)
    assert refused > 150


def notes_and_problems(path: Path) -> tuple[Sequence[str], list[dict[str, Any]]]:
    """Notes of a calibration that is read, or the problems of one that is not."""
    try:
        return read_contents(path).notes, []
    except InputError as error:
        return (), [asdict(problem) for problem in listed(error.problems)]


@pytest.mark.parametrize("count", [150, pytest.param(400, marks=pytest.mark.hostile)])
def test_calibrations(tmp_path: Path, simulation: Simulation, count: int) -> None:
    good = {name: one for name, one in keypoint_files(simulation).items() if name != "calibration.json"}
    refused = 0
    spoilt = spoilt_calibrations(simulation.cameras, SEED, count)
    for folder, (name, content) in zip(numbered(tmp_path), spoilt, strict=False):
        found = check(folder, good | {name: content})
        if "problems" in found:
            refused += 1
            assert is_clear(found["problems"]), found["problems"]
    assert refused > count // 2


def test_keypoints_and_timestamps(tmp_path: Path, simulation: Simulation) -> None:
    refused = 0
    for folder, files in zip(numbered(tmp_path), spoilt_keypoints(simulation, SEED, 250), strict=False):
        found = check(folder, files)
        if "problems" in found:
            refused += 1
            assert is_clear(found["problems"]), found["problems"]
    assert refused > 100
