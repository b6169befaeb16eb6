"""Points of the user's own: who has them, where they are, and how exact that is."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.own_points.locate import locate_own_points
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.own_points import OwnTracks
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.local import reconstruct
from tests.pipeline.own_point_scenes import OwnScene, own_scene


@pytest.fixture(scope="module")
def scene() -> OwnScene:
    return own_scene()


@pytest.fixture(scope="module")
def take(scene: OwnScene) -> Reconstruction:
    return reconstruct(scene.session, ReconstructionConfig(refine_calibration="off"))


def located(session: KeypointSession, take: Reconstruction) -> OwnTracks:
    """Own points of a session with other points, for the people of a take."""
    parts = session.cameras, session.times, session.timebase, session.detections, session.own, session.joints
    parameters = derive_parameters(session.cameras, session.timebase.frame_rate_hz)
    return locate_own_points(*parts, take.tracks, take.observations, parameters)


def test_rackets_stay_with_their_people(scene: OwnScene, take: Reconstruction) -> None:
    assert take.own.names == ("racket_tip",)
    people = set()
    for points, track in zip(take.own.of_people, take.tracks, strict=True):
        assert points.frames == track.frames
        truth_m = scene.truth_m["racket_tip"][:, track.start_frame : track.frames.stop]
        apart_m = np.linalg.norm(points.xyz_m[:, 0] - truth_m, axis=-1)
        person = int(np.nanmedian(apart_m, axis=1).argmin())
        people.add(person)
        assert np.isfinite(apart_m[person]).mean() > 0.95
        rms_m = np.sqrt(np.nanmean(apart_m[person] ** 2))
        assert rms_m < 0.01
        # Stated deviations are of an axis: three of them make the distance.
        assert points.uncertainty_m is not None
        stated_m = np.sqrt(3 * np.nanmean(points.uncertainty_m**2))
        assert stated_m == pytest.approx(rms_m, rel=0.25)
    assert people == {0, 1, 2}


def test_ball_listed_with_anybody_is_object(scene: OwnScene, take: Reconstruction) -> None:
    (ball,) = take.own.objects
    assert (ball.name, ball.track.frames) == ("ball", range(take.timebase.num_frames))
    apart_m = np.linalg.norm(ball.track.xyz_m[:, 0] - scene.truth_m["ball"], axis=-1)
    assert np.isfinite(apart_m).mean() > 0.95
    assert np.nanmedian(apart_m) < 0.01


def test_point_of_scene_near_person_is_persons(scene: OwnScene, take: Reconstruction) -> None:
    """A racket that is listed without a person belongs to the only person."""
    own, session = scene.session.own, scene.session
    person = take.tracks[0].track_id
    tip = take.own.of_people[0]
    of_scene = {}
    for number, camera in enumerate(session.cameras):
        points_px = np.full((len(session.times[camera.name].time_s), 2, 2), np.nan)
        rows = own.of_bodies[camera.name]
        scores = np.zeros(points_px.shape[:2])
        for frame in range(len(points_px)):
            seen = take.observations[0].points_px[min(frame, len(tip.xyz_m) - 1), number, 0]
            among = np.flatnonzero(rows.frame == frame)
            noses = session.detections[camera.name].keypoints_px[among, 0]
            if len(among) and np.isfinite(seen).all():
                apart_px = np.linalg.norm(noses - seen, axis=-1)
                if np.nanmin(apart_px, initial=np.inf) < 20:
                    points_px[frame, 0] = rows.keypoints_px[among[int(np.nanargmin(apart_px))], 0]
        scores[:, 0] = np.isfinite(points_px[:, 0, 0]) * 0.9
        frames = np.arange(len(points_px))
        of_scene[camera.name] = replace(rows, frame=frames, keypoints_px=points_px, score=scores)
    of_bodies = {
        name: replace(rows, keypoints_px=np.full(rows.keypoints_px.shape, np.nan), score=np.zeros(rows.score.shape))
        for name, rows in own.of_bodies.items()
    }
    found = located(replace(session, own=replace(own, of_bodies=of_bodies, of_scene=of_scene)), take)
    assert found.names == ("racket_tip",)
    assert not found.objects
    assert [np.isfinite(points.xyz_m).any() for points in found.of_people] == [
        track.track_id == person for track in take.tracks
    ]


def test_wrong_view_of_point_does_not_pull_it(scene: OwnScene, take: Reconstruction) -> None:
    camera = scene.session.cameras[0].name
    rows = scene.session.own.of_bodies[camera]
    wrong = {**scene.session.own.of_bodies, camera: replace(rows, keypoints_px=rows.keypoints_px + 150.0)}
    found = located(replace(scene.session, own=replace(scene.session.own, of_bodies=wrong)), take)
    assert found.names == ("racket_tip",)
    for points, right in zip(found.of_people, take.own.of_people, strict=True):
        apart_m = np.linalg.norm(points.xyz_m - right.xyz_m, axis=-1)
        assert np.nanmedian(apart_m) < 0.01
        assert np.nanmax(points.views) == 3


def test_point_of_views_that_disagree_is_unknown(scene: OwnScene, take: Reconstruction) -> None:
    """Each camera shows another place: no two rays come within 6 cm of each other."""
    wrong = {
        name: replace(rows, keypoints_px=rows.keypoints_px + np.array([0.0, 300.0 * number]))
        for number, (name, rows) in enumerate(scene.session.own.of_bodies.items())
    }
    found = located(replace(scene.session, own=replace(scene.session.own, of_bodies=wrong)), take)
    assert found.names == ()
    known = [np.isfinite(thing.track.xyz_m[..., 0]).mean() for thing in found.objects if thing.name == "racket_tip"]
    assert max(known, default=0.0) < 0.2
