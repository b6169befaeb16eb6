"""Sessions with the C3D file of a laboratory beside keypoints, by the real check."""

import json
from typing import Any

import pytest

from pipeline.validation.simulation.motion.script import Gesture
from pipeline.validation.simulation.scenes import Simulation
from tests.api.conftest import Live, problem_of
from tests.api.web.sessions.test_keypoint_programs import checking, parts, simulation  # noqa: F401 - fixtures
from tests.pipeline.keypoint_programs import keypoint_files
from tests.pipeline.motion.gait.walks import exercise
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes, plates_m, simulated

ACT = exercise(Gesture.JUMP)
C3D = c3d_bytes(simulated(ACT, 0.0, 1.0, plates_m(ACT, ((0.2, 0.0),))))


def sent(simulation: Simulation, content: bytes = C3D, **facts: Any) -> list[tuple[str, Any]]:  # noqa: F811
    files = parts(simulation, keypoint_files(simulation, "AlphaPose"))
    manifest = ("manifest", (None, json.dumps({"laboratory": facts})))
    return [*files, ("laboratory", ("trial.c3d", content)), manifest]


def test_session_has_the_laboratory_s_file(checking: Live, simulation: Simulation) -> None:  # noqa: F811
    facts: dict[str, Any] = {"clock": "contacts", "place": [0.5, 0.0, 0.0, 90.0]}
    session = checking.client.post("/v1/sessions", files=sent(simulation, **facts)).raise_for_status().json()
    assert {file["name"]: file["kind"] for file in session["files"]}["trial.c3d"] == "laboratory"
    (finding,) = [each for each in session["preflight"]["findings"] if each["code"] == "laboratory_read"]
    assert finding["message"].startswith("trial.c3d has 6 channels at 1000 Hz, 1 force plates")
    assert finding["evidence"]["clock"] == "contacts"
    # A copy of the session has the file and its facts.
    calibration = next(content for name, content in sent(simulation) if name == "calibration")
    spec = ("spec", (None, json.dumps({"method": "file"})))
    rig = checking.client.post("/v1/calibrations", files=[("calibration", calibration), spec]).raise_for_status().json()
    copied = {"session_id": session["id"], "calibration_id": rig["id"]}
    copy = checking.client.post("/v1/sessions", json=copied).raise_for_status().json()
    assert "laboratory" in {file["kind"] for file in copy["files"]}
    assert finding in copy["preflight"]["findings"]


@pytest.mark.parametrize(
    ("content", "facts", "code", "pointer"),
    [
        (b"no C3D", {}, "laboratory_unreadable", "/laboratory"),
        (C3D[:-512], {}, "laboratory_unreadable", "/laboratory"),
        (C3D, {"clock": "trigger"}, "laboratory_clock", "/manifest/laboratory"),
        (C3D, {"place": [0.0, 1.0]}, "invalid_value", "/manifest/laboratory/place"),
    ],
)
def test_wrong_file_or_facts_are_named(
    checking: Live,  # noqa: F811
    simulation: Simulation,  # noqa: F811
    content: bytes,
    facts: dict[str, Any],
    code: str,
    pointer: str,
) -> None:
    answer = checking.client.post("/v1/sessions", files=sent(simulation, content, **facts))
    problems = problem_of(answer, 422, "invalid_request")["errors"]
    assert [problem["pointer"].startswith(pointer) for problem in problems] == [True] * len(problems)
    if code != "invalid_value":
        assert [problem["code"] for problem in problems] == [code]
