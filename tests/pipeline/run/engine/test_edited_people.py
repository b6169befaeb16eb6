"""Edits in a reconstruction: whom they change is fitted again, everybody else stays as it was to the last bit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.animation import Animation
from pipeline.core.data.people import People, PersonLoss
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edited_take import apply_edits, place_edits
from pipeline.core.options.edits import (
    Cut,
    Exchange,
    IgnoreDetections,
    KeyJoint,
    Merge,
    PeopleEdit,
    PersonSpan,
    Remove,
    Rename,
    Split,
)
from pipeline.export.results import write_results
from pipeline.motion.skeleton.model import forward_kinematics
from pipeline.run.engine import edited_people
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.stored_people import StoredPeople, write_people
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

PLAIN = ReconstructionConfig()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(replace(find_scene("room"), duration_s=3.0), seed=6), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def plain(session: KeypointSession, cache: Path) -> Reconstruction:
    return reconstruct(session, PLAIN, cache=cache)


def edited(session: KeypointSession, cache: Path, *edits: PeopleEdit) -> Reconstruction:
    return reconstruct(session, replace(PLAIN, edits=edits), cache=cache)


def same_motion(one: Reconstruction, number: int, other: Reconstruction, other_number: int) -> bool:
    motions = one.motions[number], other.motions[other_number]
    return all(
        np.array_equal(*(getattr(motion, name) for motion in motions)) for name in ("root_m", "parent_from_joint")
    )


def test_person_with_known_places_is_unchanged_by_name() -> None:
    span = PersonSpan(1, 5, 10, places=((5, 0.0, 1.0, 1.0), (14, 2.0, 1.0, 1.0)))
    named, cut = (
        apply_edits([span], edits, range(20)).people[0]
        for edits in ([Rename(person=1, name="Anna")], [Split(person=1, frame=9)])
    )
    assert edited_people.unchanged_from(named, [span]) == 1
    assert edited_people.unchanged_from(cut, [span]) is None


def test_exchange_changes_two_people_and_nobody_else(
    session: KeypointSession, cache: Path, plain: Reconstruction
) -> None:
    half = plain.timebase.num_frames // 2
    take = edited(session, cache, Exchange(person=1, other=2, start_frame=half))
    assert [track.track_id for track in take.tracks] == [track.track_id for track in plain.tracks]
    one, two = take.located[0], take.located[1]
    before, after = slice(0, half), slice(half, None)
    np.testing.assert_array_equal(one.xyz_m[before], plain.located[0].xyz_m[before])
    np.testing.assert_array_equal(one.xyz_m[after], plain.located[1].xyz_m[after])
    np.testing.assert_array_equal(two.xyz_m[after], plain.located[0].xyz_m[after])
    np.testing.assert_array_equal(take.observations[0].points_px[after], plain.observations[1].points_px[after])
    # The new skeleton is where the joints are: far from the exchange, at the pelvis of the other person.
    last = forward_kinematics(take.motions[0])[-5, 0], forward_kinematics(plain.motions[1])[-5, 0]
    assert np.linalg.norm(last[0] - last[1]) < 0.1
    assert not same_motion(take, 0, plain, 0)
    for number in range(2, len(plain.motions)):
        assert same_motion(take, number, plain, number)
    assert take.animation.floor == plain.animation.floor


def test_halves_are_merged_again(session: KeypointSession, cache: Path, plain: Reconstruction) -> None:
    new = len(plain.tracks) + 1
    split = edited(session, cache, Split(person=1, frame=40))
    assert [split.tracks[0].num_frames, split.tracks[-1].start_frame, split.tracks[-1].track_id] == [40, 40, new]
    merged = edited(session, cache, Split(person=1, frame=40), Merge(person=1, other=new))
    assert len(merged.tracks) == len(plain.tracks)
    assert all(same_motion(merged, number, plain, number) for number in range(len(plain.tracks)))


def test_cut_keeps_motion_of_its_frames(session: KeypointSession, cache: Path, plain: Reconstruction) -> None:
    take = edited(session, cache, Cut(start_frame=20, stop_frame=50))
    assert (take.timebase.num_frames, take.timebase.start_time_s) == (30, plain.timebase.time_s(20))
    for cut, whole in zip(take.motions, plain.motions, strict=True):
        np.testing.assert_array_equal(cut.root_m, whole.root_m[20:50])
        assert all(0 <= one.start_frame < one.start_frame + one.num_frames <= 30 for one in cut.contacts)
    for cut_track, whole_track in zip(take.tracks, plain.tracks, strict=True):
        assert cut_track.start_frame == 0
        np.testing.assert_array_equal(cut_track.xyz_m, whole_track.xyz_m[20:50])
    assert take.observations[0].points_px.shape[0] == take.located[0].num_frames == 30


def test_files_bear_numbers_and_names(session: KeypointSession, cache: Path, tmp_path: Path) -> None:
    take = edited(session, cache, Remove(person=1), Rename(person=2, name="Zoë / 2"))
    paths = {path.name: path for path in write_results(take, tmp_path, ("bvh", "glb"))}
    assert "person-1.bvh" not in paths
    assert {"person-2.bvh", "person-2.glb"} <= paths.keys()
    tracks = json.loads(paths["skeletons.json"].read_bytes())["tracks"]
    assert (tracks[0]["id"], tracks[0]["name"]) == (2, "Zoë / 2")


def key_of(plain: Reconstruction, number: int, frame: int, up_m: float = 0.1) -> KeyJoint:
    x, y, z = plain.tracks[number].xyz_m[frame, plain.joints.index("left_elbow")]
    return KeyJoint(person=number + 1, joint="left_elbow", frame=frame, place_m=(float(x), float(y), float(z) + up_m))


def test_key_changes_one_person_around_it(session: KeypointSession, cache: Path, plain: Reconstruction) -> None:
    key = key_of(plain, 0, 30)
    take = edited(session, cache, key)
    elbow = plain.joints.index("left_elbow")
    assert np.linalg.norm(take.tracks[0].xyz_m[30, elbow] - key.place_m) < 0.002
    np.testing.assert_array_equal(take.tracks[0].xyz_m[45:], plain.tracks[0].xyz_m[45:])
    assert all(same_motion(take, number, plain, number) for number in range(1, len(plain.motions)))


def test_corrections_go_with_exchanged_body(session: KeypointSession, cache: Path, plain: Reconstruction) -> None:
    spans = tuple(PersonSpan(track.track_id, track.start_frame, track.num_frames) for track in plain.tracks)
    exchange, ignore = Exchange(person=1, other=2, start_frame=40), key_of(plain, 0, 60)
    config = replace(PLAIN, edits=(ignore, exchange))
    take = edited_people.edited_take(spans, config, plain.timebase)
    # Before the exchange, the person with the number 1 had this body.
    assert [len(person.corrections) for person in take.people[:2]] == [0, 1]
    elbow = plain.joints.index("left_elbow")
    found = edited(session, cache, ignore, exchange)
    assert np.linalg.norm(found.tracks[1].xyz_m[60, elbow] - ignore.place_m) < 0.002


def test_ignored_detections_leave_observations(session: KeypointSession, cache: Path, plain: Reconstruction) -> None:
    camera = plain.cameras[1].name
    ignore = IgnoreDetections(person=1, camera=camera, part="left_arm", start_frame=20, stop_frame=30)
    take = edited(session, cache, ignore)
    wrist = plain.joints.index("left_wrist")
    assert not take.observations[0].score[20:30, 1, wrist].any()
    np.testing.assert_array_equal(take.observations[0].score[30:], plain.observations[0].score[30:])
    assert take.located[0].views[20:30, wrist].max() < len(plain.cameras)


def test_losses_of_people_who_did_not_change_stay_and_are_cut(plain: Reconstruction) -> None:
    place_m = (0.0, 0.0, 1.0)
    lost = [
        PersonLoss("vanished", 1, 10, 50, place_m),
        PersonLoss("vanished", 2, 5, 70, place_m),
        PersonLoss("phantom", 0, 1, 4, place_m),
    ]
    people = People(plain.located, plain.observations, losses=lost)
    spans = tuple(PersonSpan(track.track_id, track.start_frame, track.num_frames) for track in plain.tracks)
    config = replace(PLAIN, edits=(Remove(person=2),))
    nobody = People((), ()), Animation((), (), None)
    take = edited_people.edited_take(spans, config, plain.timebase)
    kept, _ = edited_people.put_together(people, plain.animation, spans, *nobody, take, plain.cameras, plain.joints)
    assert list(kept.losses) == [lost[0], lost[2]]
    shorter = edited_people.cut(replace(plain, losses=kept.losses), range(8, 40))
    assert list(shorter.losses) == [PersonLoss("vanished", 1, 2, 32, place_m)]


def test_places_follow_people_within_tolerance(plain: Reconstruction, tmp_path: Path) -> None:
    people = People(plain.located, plain.observations)
    write_people(tmp_path / "people", people, joints=plain.joints)
    hips = plain.joints.indices(("left_hip", "right_hip"))
    for track, span in zip(plain.located, StoredPeople(tmp_path / "people").spans, strict=True):
        assert len(span.places) < track.num_frames / 3
        centre_m = track.xyz_m[:, hips].mean(1)
        for row in np.flatnonzero(np.isfinite(centre_m).all(-1)):
            place_m = span.place_m(track.start_frame + int(row))
            assert np.linalg.norm(centre_m[row] - place_m) < 0.051  # 5 cm, and places are rounded


def test_edits_hold_in_runs_of_other_methods_and_frames(
    session: KeypointSession, cache: Path, plain: Reconstruction, tmp_path: Path
) -> None:
    write_people(tmp_path / "people", People(plain.located, plain.observations), joints=plain.joints)
    frames = range(plain.timebase.num_frames)
    made = (Rename(person=2, name="Bo"), Split(person=3, frame=40), Remove(person=1))
    edits = place_edits(StoredPeople(tmp_path / "people").spans, made, frames)
    config = replace(PLAIN, method="clustering", frame_range=(10, 70), edits=edits)
    take = reconstruct(session, config, cache=cache)
    assert len(take.tracks) == len(plain.tracks)
    (bo,) = (number for number, motion in enumerate(take.motions) if motion.name == "Bo")
    middle_m = [take.located[bo].xyz_m[30 - take.located[bo].start_frame], plain.located[1].xyz_m[40]]
    assert np.nanmax(np.abs(middle_m[0] - middle_m[1])) < 0.2
    assert sorted((track.start_frame, track.num_frames) for track in take.tracks)[-1] == (30, 30)
    removed_m = np.nanmean(plain.located[0].xyz_m[40], axis=0)
    assert all(
        np.linalg.norm(np.nanmean(track.xyz_m[30 - track.start_frame], axis=0) - removed_m) > 0.5
        for track in take.located
        if track.start_frame <= 30 < track.start_frame + track.num_frames
    )


def test_independent_edits_give_same_bytes_in_any_order(
    session: KeypointSession, cache: Path, plain: Reconstruction, tmp_path: Path
) -> None:
    write_people(tmp_path / "people", People(plain.located, plain.observations), joints=plain.joints)
    spans, frames = StoredPeople(tmp_path / "people").spans, range(plain.timebase.num_frames)
    numbered = (Rename(person=2, name="Bo"), Split(person=3, frame=40), Remove(person=1), Split(person=3, frame=20))
    (edits,) = {tuple(place_edits(spans, [edit], frames)[0] for edit in numbered)}
    for config in (PLAIN, replace(PLAIN, method="clustering")):
        files = []
        for number, order in enumerate((edits, edits[::-1], (edits[3], edits[0], edits[2], edits[1]))):
            take = reconstruct(session, replace(config, edits=order), cache=cache)
            paths = write_results(take, tmp_path / f"{config.method}-{number}", ("bvh", "glb"))
            files.append({path.name: path.read_bytes() for path in paths})
        assert len(files[0]) > 2 * 4
        assert files[0] == files[1] == files[2]
