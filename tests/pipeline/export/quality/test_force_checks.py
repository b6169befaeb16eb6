"""Findings about forces that are missing or rest on a guess."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.points import SessionMaker
from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.person_files import take_people
from pipeline.export.quality.force_checks import force_checks
from pipeline.run.engine.local import reconstruct, reconstruct_to_files
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.forces.physical_people import truth_of
from tests.pipeline.motion.gait.walks import exercise

ACT = exercise(Gesture.SQUAT)
SESSION = SessionMaker.from_points(truth_of(ACT).xyz_m[:90], ACT.joints.names, ACT.rate_hz, "m")


def figures_of(take: Reconstruction, **frames: int) -> dict[str, int]:
    none = {f"num_{kind}_frames": frames.get(kind, 0) for kind in ("seated", "undetermined", "touching")}
    return {"id": take.tracks[0].track_id, **none}


@pytest.fixture(scope="module")
def take() -> Reconstruction:
    return reconstruct(SESSION)


def test_people_with_forces_have_no_finding(take: Reconstruction) -> None:
    assert not list(force_checks(take, [figures_of(take)]))


def test_person_without_forces_is_named(take: Reconstruction) -> None:
    (found,) = force_checks(take, [])
    assert found["code"] == "forces_missing"
    assert take.motions[0].name in found["message"]


def test_person_without_heels_and_toes_is_named(take: Reconstruction) -> None:
    (track,) = take.tracks
    xyz_m = np.array(track.xyz_m)
    xyz_m[:, [k for k, name in enumerate(take.joints.names) if "heel" in name or "toe" in name]] = np.nan
    animation = replace(take.animation, tracks=(replace(track, xyz_m=xyz_m),))
    (found,) = force_checks(replace(take, animation=animation), [figures_of(take)])
    assert found["code"] == "forces_without_feet"
    assert take.motions[0].name in found["message"]


def test_seats_and_unknown_contacts_are_named(take: Reconstruction) -> None:
    (found,) = force_checks(take, [figures_of(take, seated=30, undetermined=7)])
    assert found["code"] == "forces_beside_feet"
    name = take.motions[0].name
    assert f"{name} 30 on a seat" in found["message"]
    assert f"{name} 7 on hands" in found["message"]
    assert "hold each other" not in found["message"]


def test_forces_of_equal_people_are_computed_once(take: Reconstruction) -> None:
    (first,), (second,) = (list(take_people(take, timeline, "capsules")) for timeline in ("take", "person"))
    forces = first.forces()
    assert forces is not None
    assert second.forces() is forces
    for other in (
        replace(first, subject=Subject(mass_kg=50.0)),
        replace(first, track=replace(first.track, xyz_m=first.track.xyz_m + 0.1)),
    ):
        assert other.forces() is not forces


def test_files_of_few_frames_a_second_say_that_forces_are_missing(tmp_path: Path) -> None:
    reconstruct_to_files(SESSION, tmp_path, ReconstructionConfig(exports=("forces",), output_rate_hz=10.0))
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    (found,) = [check for check in metrics["capture_checks"] if check["code"] == "forces_missing"]
    assert found["evidence"] == {"frame_rate_hz": 10.0}
    assert metrics["forces"]  # figures are of the session's rate
