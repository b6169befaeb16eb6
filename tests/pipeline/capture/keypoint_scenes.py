"""Keypoint folders that tests open, change and damage."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.capture.session import Session
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError
from pipeline.validation.simulation.scenes import Simulation


def opened(scene: Path, timed: bool = True, frame_rate_hz: float | None = None) -> KeypointSession:
    timestamps = scene / "timestamps.csv" if timed else None
    return open_keypoints(scene / "keypoints", scene / "calibration.json", timestamps, frame_rate_hz)


def problems_of(scene: Path, timed: bool = True, frame_rate_hz: float | None = None) -> dict[str, str]:
    with pytest.raises(InputError) as raised:
        opened(scene, timed, frame_rate_hz)
    return {problem.code: str(problem) for problem in raised.value.problems}


def messages(session: Session) -> list[str]:
    return [finding.message for finding in session.findings]


def split_frames(scene: Path, camera: int = 0) -> list[Path]:
    return sorted(sorted((scene / "keypoints").iterdir())[camera].iterdir())


def edit(path: Path, change: Callable[[list[list[float]]], object]) -> None:
    """Change the keypoints of the people in a file."""
    people = [one["pose_keypoints_2d"] for one in json.loads(path.read_bytes())["people"]]
    change(people)
    path.write_text(json.dumps({"version": 1.3, "people": [{"pose_keypoints_2d": one} for one in people]}))


def frame_with_people(scene: Path, simulation: Simulation) -> Path:
    first: Detections = simulation.detections[simulation.cameras[0].name]
    return scene / "keypoints" / first.camera / f"frame_{int(first.frame[0]):012d}_keypoints.json"
