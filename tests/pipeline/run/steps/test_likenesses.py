"""Pictures of people and mirror images in a whole reconstruction: people, floor, refinement and warnings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float

from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.quality.report import all_checks, quality_report
from pipeline.geometry.camera import center_in_world, project
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.pipeline.association.identity.test_likenesses import RATE_HZ, Motion, mirrored, moving, poster

NUM_FRAMES, CAME = 240, 90
CAMERAS = build_cameras(Rig(Layout.RING, 5, (4.5, 4.5), 2.0, (1920, 1080), 1000.0), np.random.default_rng(4))


def body(camera: int, frame: int, motion_m: Motion, rng: np.random.Generator) -> Float[np.ndarray, "17 2"]:
    return np.asarray(project(CAMERAS[camera], motion_m[frame]) + rng.normal(0.0, 2.5, (17, 2)))


def session(people: Sequence[tuple[Motion, int, Sequence[int]]]) -> KeypointSession:
    """Session of people: their motion, the frame in which they come, and the cameras that see them."""
    rng = np.random.default_rng(5)
    detections, times = {}, {}
    for number, camera in enumerate(CAMERAS):
        seen = [
            (frame, body(number, frame, motion_m, rng))
            for frame in range(NUM_FRAMES)
            for motion_m, came, cameras in people
            if number in cameras and frame >= came
        ]
        points_px = np.array([points_px for _, points_px in seen])
        detections[camera.name] = Detections(
            camera.name,
            np.array([frame for frame, _ in seen]),
            points_px,
            np.full(points_px.shape[:2], 0.9),
            np.concatenate([points_px.min(1), points_px.max(1)], axis=1),
        )
        times[camera.name] = FrameTimes(np.arange(NUM_FRAMES) / RATE_HZ)
    return KeypointSession(CAMERAS, times, Timebase(0.0, RATE_HZ, NUM_FRAMES), detections, COCO_17, {}, ())


@pytest.fixture(scope="module")
def with_poster() -> KeypointSession:
    return session([(poster(6), 0, range(5)), (moving(7), CAME, range(5))])


def checks(take: Reconstruction) -> Mapping[str, Mapping[str, Any]]:
    """Evidence of each failed check."""
    return {check.code: check.evidence for check in all_checks(quality_report(take))}


def test_picture_is_named_and_is_no_floor(with_poster: KeypointSession) -> None:
    take = reconstruct(with_poster, ReconstructionConfig(smoothing="none"))
    assert [track.start_frame for track in take.tracks] == [0, CAME]
    found = checks(take)
    assert found.keys() == {"person_never_moves"}
    (picture,) = found["person_never_moves"]["people"]
    assert (picture["person"], picture["num_frames"]) == (1, NUM_FRAMES)
    assert 0.0 < picture["moved_m"] < 0.015
    assert take.animation.floor is not None
    assert take.animation.floor.z_m == pytest.approx(0.0, abs=0.02)
    assert take.animation.floor.tilt_deg < 0.5


@pytest.mark.slow
def test_of_one_person_to_keep_one_who_moves_is_kept(with_poster: KeypointSession) -> None:
    take = reconstruct(with_poster, ReconstructionConfig(smoothing="none", people=1))
    (track,) = take.tracks
    assert track.start_frame == CAME
    assert checks(take) == {}
    alone = session([(poster(6), 0, range(5))])
    (track,) = reconstruct(alone, ReconstructionConfig(smoothing="none", people=1)).tracks
    assert track.start_frame == 0


@pytest.mark.slow
def test_picture_moves_no_world(with_poster: KeypointSession) -> None:
    take = reconstruct(with_poster, ReconstructionConfig(smoothing="none", refine_calibration="auto"))
    assert take.refinement is not None
    assert take.refinement.world is None


@pytest.mark.slow
def test_mirror_image_is_named_with_its_plane() -> None:
    normal, offset_m = np.array([0.8, 0.6, 0.0]), 2.0
    before = [number for number, camera in enumerate(CAMERAS) if center_in_world(camera) @ normal < offset_m]
    assert len(before) == 3
    image_m = mirrored(moving(8), normal.tolist(), offset_m)
    both = session([(image_m, 0, before), (moving(8), 0, range(5))])
    take = reconstruct(both, ReconstructionConfig(smoothing="none"))
    (image,) = checks(take)["mirror_image"]["people"]
    by_id = {track.track_id: track for track in take.tracks}
    assert len(by_id) == 2
    middle_m = {number: np.nanmedian(track.xyz_m, axis=(0, 1)) for number, track in by_id.items()}
    assert middle_m[image["person"]] @ normal > offset_m > middle_m[image["mirrors"]] @ normal
    np.testing.assert_allclose(image["normal"], normal, atol=0.02)
    assert image["offset_m"] == pytest.approx(offset_m, abs=0.03)
    assert image["num_frames"] > 0.9 * NUM_FRAMES
    (track,) = reconstruct(both, ReconstructionConfig(smoothing="none", people=1)).tracks
    assert np.nanmedian(track.xyz_m, axis=(0, 1)) @ normal < offset_m
