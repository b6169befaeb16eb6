"""Random crowded sessions: right rigs have no finding, and a camera that was moved a little is named.

``pytest -m accuracy -s tests/pipeline/run/session_check/test_crowds.py`` prints the numbers of 300 sessions.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import pytest

from pipeline.core.data.cameras import Camera
from pipeline.core.findings import Finding
from pipeline.run.session_check.people import check_people
from pipeline.run.session_check.sightings import SimultaneousPeople
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.run.session_check.crowds import CrowdedSession, crowded_session, disturbed
from tests.pipeline.run.session_check.rigs import bumped, sightings

NUM_SESSIONS = 300


def wrong(cameras: Sequence[Camera], seen: SimultaneousPeople) -> list[Finding]:
    """Findings, without cameras that see no person: shelves hide all people from some."""
    return [finding for finding in check_people(cameras, seen).findings if finding.code != "camera_sees_nobody"]


def named(session: CrowdedSession, cameras: Sequence[Camera]) -> list[str | None]:
    """Cameras that disagree, in the order of the findings."""
    findings = check_people(cameras, session.sightings).findings
    return [finding.camera for finding in findings if finding.code == "camera_disagrees"]


def moved_camera(session: CrowdedSession, cameras: Sequence[Camera]) -> str:
    return next(now.name for now, then in zip(cameras, session.cameras, strict=True) if now is not then)


# 4 cameras and 20 people, 12 and 18, 5 and 9; behind shelves or in small pictures.
@pytest.mark.parametrize("seed", [7, pytest.param(3, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)])
def test_crowds_find_moved_camera_only(seed: int) -> None:
    session = crowded_session(seed)
    assert wrong(session.cameras, session.sightings) == []
    cameras = disturbed(session, seed)
    assert named(session, cameras) == [moved_camera(session, cameras)]


@pytest.mark.slow
def test_sixteen_people_among_shelves_are_no_finding() -> None:
    simulation = record(replace(find_scene("store-large"), duration_s=6.0), seed=21)
    assert wrong(simulation.cameras, sightings(simulation)) == []


@pytest.mark.parametrize("degrees", [pytest.param(2.0, marks=pytest.mark.slow), 5.0, 20.0])
def test_camera_that_was_turned_far_is_error_in_crowd(degrees: float) -> None:
    session = crowded_session(9)
    cameras = [*session.cameras[:2], bumped(session.cameras[2], degrees), *session.cameras[3:]]
    errors = [finding for finding in wrong(cameras, session.sightings) if finding.severity == "error"]
    assert [(error.code, error.camera) for error in errors] == [("camera_disagrees", cameras[2].name)]


@pytest.mark.accuracy
def test_three_hundred_crowds_find_moved_cameras_only() -> None:
    """One camera is turned by 0.5 degrees and shifted by 1 cm, along random axes."""
    false_errors, false_warnings, found, first = 0, 0, 0, 0
    for seed in range(NUM_SESSIONS):
        session = crowded_session(seed)
        severities = {finding.severity for finding in wrong(session.cameras, session.sightings)}
        false_errors += "error" in severities
        false_warnings += "warning" in severities
        cameras = disturbed(session, seed)
        names, moved = named(session, cameras), moved_camera(session, cameras)
        found += moved in names
        first += names[:1] == [moved]
    numbers = f"{false_errors} false errors, {false_warnings} false warnings, {found} found, {first} named first"
    sys.stdout.write(f"{NUM_SESSIONS} sessions: {numbers}\n")
    assert false_errors == 0
    assert false_warnings <= 0.02 * NUM_SESSIONS
    assert found >= 0.95 * NUM_SESSIONS
    assert first >= 0.9 * NUM_SESSIONS
