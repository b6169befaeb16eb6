"""Scales of scores and positions: told by all values of a camera, converted, and reported."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.errors import InputError
from pipeline.core.findings import Finding
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.simulations import write_simulation

Change = Callable[[np.ndarray], np.ndarray]
"""Change of the points of a person: x, y and score of those that were found."""


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=0.4), seed=11, num_views=3)


def rewrite(folder: Path, change: Change, cameras: Sequence[str] | None = None) -> None:
    """Change the people of some cameras, or of all."""
    for path in (folder / "keypoints").rglob("*.json"):
        if cameras is not None and path.parent.name not in cameras:
            continue
        content = json.loads(path.read_bytes())
        for person in content["people"]:
            points = np.array(person["pose_keypoints_2d"]).reshape(-1, 3)
            found = points[:, 2] > 0
            points[found] = change(points[found])
            person["pose_keypoints_2d"] = points.ravel().tolist()
        path.write_text(json.dumps(content))


def opened(folder: Path) -> KeypointSession:
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


def scales_of(session: KeypointSession) -> list[Finding]:
    return [finding for finding in session.findings if finding.code == "keypoints_scale"]


def with_scores(of_score: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda points: np.column_stack([points[:, :2], of_score(points[:, 2])])


def spread(folder: Path) -> None:
    """Spread the scores over all confidences: one joint in five is doubtful."""
    rewrite(
        folder, with_scores(lambda score: np.where(np.arange(len(score)) % 5 == 0, 0.08, np.clip(score, 0.1, 0.97)))
    )


SCALES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "percent": (lambda score: 100 * score, "percent"),
    "8 bits": (lambda score: np.round(255 * score), "0 to 255"),
    "logits": (lambda score: np.log(score / (1 - score)), "logits"),
}


@pytest.mark.parametrize("scale", SCALES)
def test_open_keypoints_scores_on_another_scale_are_confidences(
    tmp_path: Path, simulation: Simulation, scale: str
) -> None:
    write_simulation(simulation, tmp_path)
    spread(tmp_path)
    expected = opened(tmp_path)
    rewrite(tmp_path, with_scores(SCALES[scale][0]))
    session = opened(tmp_path)
    for camera in simulation.cameras:
        ours, theirs = expected.detections[camera.name], session.detections[camera.name]
        np.testing.assert_allclose(theirs.score, ours.score, atol=2e-3)
        np.testing.assert_array_equal(theirs.keypoints_px, ours.keypoints_px)
    findings = scales_of(session)
    assert {finding.camera for finding in findings} == {camera.name for camera in simulation.cameras}
    assert all(SCALES[scale][1] in finding.message and finding.severity == "warning" for finding in findings)


def test_open_keypoints_tells_percent_by_own_camera(tmp_path: Path, simulation: Simulation) -> None:
    write_simulation(simulation, tmp_path)
    expected = opened(tmp_path)
    camera = simulation.cameras[1].name
    rewrite(tmp_path, with_scores(lambda score: 100 * score), [camera])
    session = opened(tmp_path)
    (finding,) = scales_of(session)
    assert finding.camera == camera
    for name, detections in expected.detections.items():
        np.testing.assert_allclose(session.detections[name].score, detections.score, atol=1e-12)


@pytest.mark.parametrize(
    ("of_score", "severities"),
    [
        (lambda score: 1.2 * score, set()),  # maxima of heatmaps
        (lambda score: np.where(score == score.max(), 2.0, 1.0), set()),  # visibility of COCO
        (lambda score: 8.0 * score, {"info"}),  # a network without a last sigmoid
    ],
    ids=["heatmaps", "visibility", "unknown"],
)
def test_open_keypoints_clips_scores_above_one(
    tmp_path: Path, simulation: Simulation, of_score: Callable[[np.ndarray], np.ndarray], severities: set[str]
) -> None:
    write_simulation(simulation, tmp_path)
    before = opened(tmp_path)
    rewrite(tmp_path, with_scores(of_score))
    session = opened(tmp_path)
    assert {finding.severity for finding in scales_of(session)} == severities
    for name, detections in before.detections.items():
        score = np.stack([np.where(of_person > 0, of_score(of_person), 0.0) for of_person in detections.score])
        np.testing.assert_allclose(session.detections[name].score, np.minimum(score, 1.0))


def test_open_keypoints_few_scores_far_above_one_leave_scale(tmp_path: Path, simulation: Simulation) -> None:
    write_simulation(simulation, tmp_path)
    before = opened(tmp_path)
    frame = next(iter((tmp_path / "keypoints").rglob("*_000000000003_keypoints.json")))
    content = json.loads(frame.read_bytes())
    content["people"][0]["pose_keypoints_2d"][2] = 95.0
    frame.write_text(json.dumps(content))
    session = opened(tmp_path)
    assert not scales_of(session)
    assert (session.detections[frame.parent.name].score != before.detections[frame.parent.name].score).sum() == 1


@pytest.mark.parametrize("factor", [1000.0, 65535.0, -1.0])
def test_open_keypoints_scores_of_unknown_scale_are_refused(
    tmp_path: Path, simulation: Simulation, factor: float
) -> None:
    write_simulation(simulation, tmp_path)
    camera = simulation.cameras[2].name
    change = with_scores(lambda score: np.where(np.arange(len(score)) % 2, factor, 0.9) * score)
    rewrite(tmp_path, change, [camera])
    with pytest.raises(InputError) as raised:
        opened(tmp_path)
    (problem,) = raised.value.problems
    assert (problem.code, problem.camera) == ("keypoints_scores", camera)
    assert "percent" in (problem.hint or "")


@pytest.mark.parametrize("low", [0, -1])
@pytest.mark.parametrize("num_cameras", [1, 3])
def test_open_keypoints_shares_of_picture_are_pixels(
    tmp_path: Path, simulation: Simulation, low: int, num_cameras: int
) -> None:
    write_simulation(simulation, tmp_path)
    expected = opened(tmp_path)
    for camera in simulation.cameras[:num_cameras]:
        largest_px = np.array(camera.size_px) - 1.0

        def shares(points: np.ndarray, largest_px: np.ndarray = largest_px) -> np.ndarray:
            return np.column_stack([points[:, :2] / largest_px * (1 - low) + low, points[:, 2]])

        rewrite(tmp_path, shares, [camera.name])
    session = opened(tmp_path)
    for name, detections in expected.detections.items():
        np.testing.assert_allclose(session.detections[name].keypoints_px, detections.keypoints_px, atol=1e-6)
    findings = scales_of(session)
    assert [finding.camera for finding in findings] == [camera.name for camera in simulation.cameras[:num_cameras]]
    assert all(f"from {low} to 1" in finding.message for finding in findings)


@pytest.mark.parametrize(
    ("of_positions", "num_cameras"),
    [
        (lambda xy, size: xy / size * 100.0, 1),
        (lambda xy, size: xy / 2.0, 3),
        (lambda xy, size: xy * 2.0, 1),
    ],
    ids=["percent", "smaller pictures", "larger pictures"],
)
def test_open_keypoints_names_positions_of_other_size(
    tmp_path: Path,
    simulation: Simulation,
    of_positions: Callable[[np.ndarray, np.ndarray], np.ndarray],
    num_cameras: int,
) -> None:
    write_simulation(simulation, tmp_path)
    cameras = [camera.name for camera in simulation.cameras[:num_cameras]]
    size_px = np.array(simulation.cameras[0].size_px)  # of all cameras
    rewrite(
        tmp_path,
        lambda points: np.column_stack([of_positions(points[:, :2], size_px), points[:, 2]]),
        cameras,
    )
    findings = scales_of(opened(tmp_path))
    assert [finding.camera for finding in findings] == cameras
    assert all(f"in a picture of {size_px[0]} x {size_px[1]} pixels" in finding.message for finding in findings)


def test_open_keypoints_few_shares_far_outside_leave_unit(tmp_path: Path, simulation: Simulation) -> None:
    write_simulation(simulation, tmp_path)
    expected = opened(tmp_path)
    largest_px = np.array(simulation.cameras[0].size_px) - 1.0  # of all cameras
    rewrite(tmp_path, lambda points: points / [*largest_px, 1.0])
    frame = next(iter((tmp_path / "keypoints").rglob("*_000000000002_keypoints.json")))
    content = json.loads(frame.read_bytes())
    content["people"][0]["pose_keypoints_2d"][:3] = [9e5, -9e5, 0.5]
    frame.write_text(json.dumps(content))
    session = opened(tmp_path)
    assert len(scales_of(session)) == len(simulation.cameras)
    for name, detections in expected.detections.items():
        far = np.abs(session.detections[name].keypoints_px - detections.keypoints_px) > 1e-6
        assert far.sum() == (2 if name == frame.parent.name else 0)
