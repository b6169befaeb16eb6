"""People who come back, and people of earlier takes: their numbers and their bones."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.bodies import read_bodies
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.identities import Identities, limbs_of_bones_m
from pipeline.run.live.recorded import DetectedFrame
from pipeline.run.live.records import LiveInstant
from pipeline.run.live.settings import LiveSettings
from pipeline.run.live.skeleton import learn_bones
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.run.live.streams import play, sent_frames

RATE_HZ = 25.0
LEAVE_S, AWAY_S = 6.0, 5.0


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=10.0), 1)


def with_a_break(room: Simulation) -> list[DetectedFrame]:
    """Frames of a take from which everybody is gone for some seconds."""
    return [
        frame if frame.time_s < LEAVE_S else frame._replace(time_s=frame.time_s + AWAY_S) for frame in sent_frames(room)
    ]


def true_people(instant: LiveInstant, truth_m: np.ndarray) -> dict[int, int]:
    """Number of the nearest true person by the live number."""
    return {
        person.id: int(np.argmin([np.nanmean(np.linalg.norm(each - person.xyz_m, axis=-1)) for each in truth_m]))
        for person in instant.people
    }


@pytest.fixture(scope="module")
def instants(room: Simulation) -> list[LiveInstant]:
    return play(LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ)), with_a_break(room))


def test_people_who_come_back_get_their_numbers_and_bones_again(room: Simulation, instants: list[LiveInstant]) -> None:
    before = next(each for each in reversed(instants) if each.time_s < LEAVE_S)
    back = [each for each in instants if each.time_s >= LEAVE_S + AWAY_S]
    frame = round((before.time_s) * RATE_HZ)
    known = true_people(before, room.truth_m[:, frame])
    assert sorted(known) == [1, 2, 3]
    assert {person.id for person in back[5].people} == {4, 5, 6}
    assert all(person.skeleton is None for person in back[5].people)
    last = true_people(back[-1], room.truth_m[:, -1])
    assert last == known
    lengths_m = {person.id: person.skeleton.bone_length_m for person in before.people if person.skeleton}
    for person in back[-1].people:
        assert person.skeleton is not None
        np.testing.assert_array_equal(person.skeleton.bone_length_m, lengths_m[person.id])
    # Whoever has a skeleton keeps the number.
    numbered = [person.id for each in instants for person in each.people if person.skeleton is not None]
    assert set(numbered) == {1, 2, 3}
    for each in instants:
        assert len({person.id for person in each.people}) == len(each.people)


def test_people_of_an_earlier_take_have_the_first_numbers_and_skeletons_soon(
    room: Simulation, instants: list[LiveInstant], tmp_path: Path
) -> None:
    before = next(each for each in reversed(instants) if each.time_s < LEAVE_S)
    order = (3, 1, 2)
    bodies = {person.id: tuple(person.skeleton.bone_length_m) for person in before.people if person.skeleton}
    frames = [frame for frame in sent_frames(room) if frame.time_s < 3.2]
    settings = LiveSettings(RATE_HZ, bodies=tuple(bodies[number] for number in order))
    again = play(LiveCapture(room.cameras, room.joints, settings), frames)
    known = true_people(before, room.truth_m[:, round(before.time_s * RATE_HZ)])
    recognised = true_people(again[-1], room.truth_m[:, len(again) - 1])
    found = {number: person for number, person in recognised.items() if number <= len(order)}
    assert len(found) >= 2
    assert all(known[order[number - 1]] == person for number, person in found.items())
    for person in again[-1].people:
        if person.id in found:
            assert person.skeleton is not None
            np.testing.assert_array_equal(person.skeleton.bone_length_m, settings.bodies[person.id - 1])


def scaled(factor: float) -> np.ndarray:
    """Lengths of bones of somebody of a stature of 1.7 m, times a factor."""
    return np.array([1.7 * factor * joint.stature_share for joint in SKELETON])


def located_m(length_m: np.ndarray, identities: Identities) -> np.ndarray:
    """Joints of somebody who stands, with limbs of these lengths."""
    upper_arm, forearm, thigh, shin, flank, shoulders, hips = limbs_of_bones_m(length_m)
    points: dict[str, np.ndarray] = {}
    for side, sign in (("left", 0.5), ("right", -0.5)):
        hip = np.array([sign * hips, 0.0, thigh + shin])
        sideways = sign * (shoulders - hips)
        shoulder = hip + np.array([sideways, 0.0, np.sqrt(flank**2 - sideways**2)])
        arm = [shoulder, shoulder - [0, 0, upper_arm], shoulder - [0, 0, upper_arm + forearm]]
        leg = [hip, hip - [0, 0, thigh], hip - [0, 0, thigh + shin]]
        names = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
        points |= {f"{side}_{name}": point for name, point in zip(names, [*arm, *leg], strict=True)}
    joints = identities._joints.names
    return np.array([points.get(name, np.full(3, np.nan)) for name in joints])


@pytest.mark.parametrize(("factor", "is_same"), [(1.0, True), (1.12, False)])
def test_only_the_same_proportions_are_the_same_person(room: Simulation, factor: float, is_same: bool) -> None:
    identities = Identities(room.joints, len(room.cameras), [scaled(1.0), scaled(0.88)])
    standing_m = located_m(scaled(factor), identities)
    bodies = [identities.see(1, time_s, standing_m, {}) for time_s in np.arange(0.0, 3.1, 0.04)]
    assert any(body is not None for body in bodies) == is_same
    assert identities.number_of(1) == (1 if is_same else 3)
    # Somebody else of the same proportions is in sight at the same time: another person.
    for time_s in np.arange(4.0, 7.1, 0.04):
        identities.see(2, time_s, standing_m, {})
    assert identities.number_of(2) == 4


def test_the_first_of_very_many_people_are_forgotten_but_not_those_who_were_announced(room: Simulation) -> None:
    identities = Identities(room.joints, len(room.cameras), [scaled(1.0), scaled(0.88)])
    bones = learn_bones(room.truth_m[0, :5], room.joints)
    for tracked in range(1, 101):
        for time_s in np.arange(0.0, 1.1, 0.1):
            identities.see(tracked, time_s, np.full((len(room.joints.names), 3), np.nan), {})
        identities.learn(tracked, bones)
        identities.keep({tracked})
    identities.keep(set())
    assert len(identities) == 64
    assert set(identities.log_odds(102, [1, 2])) == {1, 2}
    with pytest.raises(KeyError):
        identities.log_odds(102, [3])


def test_whoever_was_located_too_seldom_is_not_recognised(room: Simulation) -> None:
    identities = Identities(room.joints, len(room.cameras), [])
    standing_m = located_m(scaled(1.0), identities)
    for time_s in np.arange(0.0, 5.0, 0.25):
        identities.see(1, time_s, standing_m, {})
    identities.learn(1, learn_bones(room.truth_m[0, :5], room.joints))
    identities.keep(set())
    bodies = [identities.see(2, time_s, standing_m, {}) for time_s in np.arange(6.0, 9.0, 0.1)]
    assert all(body is None for body in bodies)
    assert identities.number_of(2) == 2
    for tracked in range(3, 70):
        identities.learn(tracked, learn_bones(room.truth_m[0, :5], room.joints))
        identities.keep({tracked})
    assert identities.number_of(70) == 70


def test_bodies_are_read_from_a_result(room: Simulation, tmp_path: Path) -> None:
    truth_m = room.truth_m[0]
    positions_m = [[point.tolist() for point in frame_m] for frame_m in truth_m]
    positions_m[3][5] = None
    content = {"joint_names": room.joints.names, "tracks": [{"positions_m": positions_m}]}
    path = tmp_path / "skeletons.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    (length_m,) = read_bodies(path)
    np.testing.assert_allclose(length_m, learn_bones(truth_m, room.joints).length_m, atol=1e-3)
    LiveSettings(RATE_HZ, bodies=(length_m,))
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match=r"no skeletons.json"):
        read_bodies(path)
    with pytest.raises(InputError, match="Body 1 must have"):
        LiveSettings(RATE_HZ, bodies=((0.3,),))
