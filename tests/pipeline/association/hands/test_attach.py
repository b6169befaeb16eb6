"""Hands that follow people's bodies."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Bool, Float

from pipeline.association.hands.attach import attach_hands, has_hands, without_fingers
from pipeline.association.identity.identify import identify
from pipeline.association.tracking.observations import gather
from pipeline.association.tracking.track_people import track_bodies
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import People, Source, Track3D
from pipeline.core.joints import BODY_25, COCO_17, WHOLE_BODY
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.association.hands.whole_bodies import HANDS, JOINTS, WholeBodies, with_hands

MIN_SCORE = 0.15


@pytest.fixture(scope="module")
def room() -> WholeBodies:
    return with_hands(record(replace(find_scene("walk"), duration_s=2.0), seed=4))


def attached(simulation: Simulation, detections: Mapping[str, Detections]) -> tuple[People, People]:
    """People without and with hands."""
    cameras, timebase = simulation.cameras, simulation.timebase
    parameters = derive_parameters(cameras, timebase.frame_rate_hz)
    bodies = gather(cameras, simulation.times, detections)
    people = track_bodies(cameras, simulation.times, without_fingers(bodies, JOINTS), timebase, parameters)
    people = identify(people, cameras, COCO_17, timebase, MIN_SCORE)
    return people, attach_hands(people, bodies, cameras, JOINTS, timebase, MIN_SCORE, parameters.lambda_t_hz)


def person_of(simulation: Simulation, track: Track3D) -> int:
    """True person nearest to a track."""
    frames = slice(track.start_frame, track.start_frame + track.num_frames)
    apart_m = np.linalg.norm(simulation.truth_m[:, frames] - track.xyz_m[:, :17], axis=-1)
    return int(np.nanmedian(apart_m, axis=(1, 2)).argmin())


def errors_m(whole: WholeBodies, tracks: Sequence[Track3D]) -> Float[np.ndarray, "rows 40"]:
    """Distances of all people's finger joints from the truth, NaN where a joint was not located."""
    return np.concatenate(
        [
            np.linalg.norm(
                whole.truth_m[person_of(whole.simulation, track)][track.start_frame :][: track.num_frames]
                - track.xyz_m[:, 17:],
                axis=-1,
            )
            for track in tracks
        ]
    )


def exchanged(
    detections: Mapping[str, Detections], names: Sequence[str], chosen: Bool[np.ndarray, " _"] | slice
) -> Mapping[str, Detections]:
    """Detections in which some cameras exchange left and right hands."""
    changed = dict(detections)
    for name in names:
        points_px, score = detections[name].keypoints_px.copy(), detections[name].score.copy()
        for ours, other in (HANDS, HANDS[::-1]):
            points_px[chosen, ours] = detections[name].keypoints_px[chosen, other]
            score[chosen, ours] = detections[name].score[chosen, other]
        changed[name] = replace(detections[name], keypoints_px=points_px, score=score)
    return changed


def test_fingers_are_located_and_bodies_stay_as_they_are(room: WholeBodies) -> None:
    bodies, whole = attached(room.simulation, room.detections)
    assert len(whole.tracks) == len(bodies.tracks) == 2
    for before, after in zip(bodies.tracks, whole.tracks, strict=True):
        for name in ("xyz_m", "score", "source", "error_px", "views"):
            np.testing.assert_array_equal(getattr(after, name)[:, :17], getattr(before, name))
        assert (after.track_id, after.start_frame) == (before.track_id, before.start_frame)
    for before_seen, after_seen in zip(bodies.observations, whole.observations, strict=True):
        np.testing.assert_array_equal(after_seen.points_px[:, :, :17], before_seen.points_px)
        np.testing.assert_array_equal(after_seen.score[:, :, :17], before_seen.score)
    found_m = errors_m(room, whole.tracks)
    assert np.isfinite(found_m).mean() > 0.97
    assert np.nanmedian(found_m) < 0.006
    assert np.nanpercentile(found_m, 99) < 0.02
    fingers = np.concatenate([track.source[:, 17:] for track in whole.tracks])
    assert (fingers == Source.MEASURED).mean() > 0.95
    errors_px = np.concatenate([track.error_px[:, 17:] for track in whole.tracks])
    assert np.nanmedian(errors_px) == pytest.approx(1.0, abs=0.4)  # noise of 1 px in x and y


@pytest.mark.parametrize("num_wrong", [1, 2])
def test_hands_that_camera_exchanges_are_exchanged_back(room: WholeBodies, num_wrong: int) -> None:
    names = [camera.name for camera in room.simulation.cameras[:num_wrong]]
    _, whole = attached(room.simulation, exchanged(room.detections, names, slice(None)))
    found_m = errors_m(room, whole.tracks)
    assert np.isfinite(found_m).mean() > 0.97
    assert np.nanpercentile(found_m, 99) < 0.02
    views = np.concatenate([track.views[:, 17:] for track in whole.tracks])
    _, right = attached(room.simulation, room.detections)
    assert views.mean() > 0.97 * np.concatenate([track.views[:, 17:] for track in right.tracks]).mean()


def test_hand_of_somebody_else_is_dropped(room: WholeBodies) -> None:
    """One camera gives each person the hands of the other person."""
    name = room.simulation.cameras[0].name
    seen, person = room.detections[name], room.simulation.identities[name]
    points_px = seen.keypoints_px.copy()
    num_exchanged = 0
    for frame in np.unique(seen.frame):
        rows = np.flatnonzero(seen.frame == frame)
        if sorted(person[rows].tolist()) == [0, 1]:
            points_px[rows, 17:] = seen.keypoints_px[rows[::-1], 17:]
            num_exchanged += 1
    assert num_exchanged > 20
    _, whole = attached(room.simulation, {**room.detections, name: replace(seen, keypoints_px=points_px)})
    found_m = errors_m(room, whole.tracks)
    assert np.isfinite(found_m).mean() > 0.97
    assert np.nanpercentile(found_m, 99) < 0.02


def test_hand_that_one_camera_sees_is_not_located(room: WholeBodies) -> None:
    seen = {
        name: replace(
            one, score=np.where((np.arange(57) < 17) | (name == room.simulation.cameras[0].name), one.score, 0)
        )
        for name, one in room.detections.items()
    }
    _, whole = attached(room.simulation, seen)
    for track, observed in zip(whole.tracks, whole.observations, strict=True):
        assert (track.source[:, 17:] == Source.ABSENT).all()
        assert (observed.score[:, :, 17:] == 0).all()
        assert np.isnan(observed.points_px[:, :, 17:]).all()


def test_views_that_disagree_give_no_hand(room: WholeBodies) -> None:
    """Two cameras see hands; one of them sees the hand 100 px off."""
    first, second = room.simulation.cameras[0].name, room.simulation.cameras[2].name
    seen = {}
    for name, one in room.detections.items():
        points_px = one.keypoints_px + (100.0 if name == second else 0.0) * (np.arange(57) >= 17)[:, None]
        score = np.where((np.arange(57) < 17) | (name in (first, second)), one.score, 0)
        seen[name] = replace(one, keypoints_px=points_px, score=score)
    _, whole = attached(room.simulation, seen)
    measured = np.concatenate([track.source[:, 17:] == Source.MEASURED for track in whole.tracks])
    assert measured.mean() < 0.05


def test_cameras_that_are_not_synchronised() -> None:
    whole = with_hands(record(replace(find_scene("unsynchronised"), duration_s=2.0), seed=4), noise_px=0.5)
    _, people = attached(whole.simulation, whole.detections)
    found_m = errors_m(whole, people.tracks)
    assert np.isfinite(found_m).mean() > 0.8
    assert np.nanmedian(found_m) < 0.008


def test_sets_with_hands() -> None:
    assert has_hands(JOINTS)
    assert has_hands(WHOLE_BODY)
    assert not has_hands(BODY_25)
