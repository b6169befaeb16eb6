"""Numbers of people who come back to a live capture, by proportions and clothes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.session import open_session
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.detection.appearance import NUM_BINS, PARTS, colour_histograms
from pipeline.detection.chunk import camera_images
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.identities import Identities, LiveClothes, limbs_of_bones_m
from pipeline.run.live.records import DetectedFrame, LiveInstant
from pipeline.run.live.settings import LiveSettings, read_bodies
from pipeline.run.live.skeleton import LearntBones, learn_bones
from pipeline.validation.evaluation.datasets.rendered import load_rendered
from pipeline.validation.simulation.motion import body as bodies
from pipeline.validation.simulation.motion.body import Proportions, random_proportions
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.e2e.datasets import folder_of, needs
from tests.pipeline.clothes import dress
from tests.pipeline.run.live.streams import play, sent_frames

SHIRTS = (0, 16)


def colours_of(shirt: int, rng: np.random.Generator) -> np.ndarray:
    """Colours of a detection of somebody in clothes of four bins from ``shirt`` on, with noise."""
    share = np.ones((len(PARTS), NUM_BINS))
    share[:, np.arange(shirt, shirt + 4) % NUM_BINS] = 60.0
    share *= rng.uniform(0.3, 1.0, share.shape)
    return np.rint(255 * share / share.sum(-1, keepdims=True)).astype(np.uint8)


def same_build(_: np.random.Generator) -> Proportions:
    return random_proportions(np.random.default_rng(7))


@pytest.fixture(scope="module")
def twins() -> Simulation:
    """Two people of the same proportions, who walk about."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bodies, "random_proportions", same_build)
        return record(replace(SCENES["room"], cast=Cast(2, (3.0, 3.0)), duration_s=10.0), 1)


def numbers_around_a_break(twins: Simulation) -> tuple[dict[int, int], dict[int, int], list[LiveInstant]]:
    """Live numbers of the true people before they leave and at the end, and all instants."""
    instants = play(LiveCapture(twins.cameras, twins.joints, LiveSettings(RATE_HZ)), with_a_break(twins))
    before = next(each for each in reversed(instants) if each.time_s < LEAVE_S)
    people = [
        true_people(instant, twins.truth_m[:, round(time_s * RATE_HZ)])
        for instant, time_s in ((before, before.time_s), (instants[-1], instants[-1].time_s - AWAY_S))
    ]
    there, back = [{person: number for number, person in each.items()} for each in people]
    assert sorted(there) == sorted(back) == [0, 1]
    return there, back, instants


@pytest.mark.parametrize("are_exchanged", [False, True])
def test_people_of_one_build_keep_their_numbers_by_their_clothes(twins: Simulation, are_exchanged: bool) -> None:
    """Those who come back in the place of each other, too: the clothes tell who they are."""

    def shirt_of(person: int, time_s: float) -> int:
        return SHIRTS[1 - person if are_exchanged and time_s >= LEAVE_S else person]

    there, back, _ = numbers_around_a_break(dress(twins, shirt_of))
    assert back == ({0: there[1], 1: there[0]} if are_exchanged else there)


def test_people_of_one_build_in_same_clothes_get_new_numbers(twins: Simulation) -> None:
    there, back, instants = numbers_around_a_break(dress(twins, lambda person, time_s: SHIRTS[0]))
    assert set(there.values()) == {1, 2}
    assert set(back.values()) == {3, 4}
    assert all(person.id > 2 for each in instants if each.time_s > LEAVE_S + AWAY_S for person in each.people)


def bytes_of(instants: Sequence[LiveInstant]) -> list[bytes]:
    return [
        person.xyz_m.tobytes() + (b"" if person.skeleton is None else person.skeleton.parent_from_joint.tobytes())
        for instant in instants
        for person in instant.people
    ]


def test_without_pictures_nothing_changes(twins: Simulation) -> None:
    """Colours that are unknown everywhere say as much as none: people of one build get new numbers."""
    there, back, instants = numbers_around_a_break(twins)
    assert (set(there.values()), set(back.values())) == ({1, 2}, {3, 4})
    unseen = dress(twins, lambda person, time_s: SHIRTS[0])
    for of_camera in unseen.detections.values():
        of_camera.colour[:] = 0
    assert bytes_of(numbers_around_a_break(unseen)[2]) == bytes_of(instants)


@pytest.mark.parametrize(
    "colour", [np.zeros((1, 2, 32)), np.zeros((1, 2, 31), np.uint8), np.zeros((2, 2, 32), np.uint8), [[[0]]]]
)
def test_colours_of_another_form_are_refused(twins: Simulation, colour: np.ndarray) -> None:
    capture = LiveCapture(twins.cameras, twins.joints, LiveSettings(RATE_HZ))
    with pytest.raises(InputError) as error:
        capture.push(0, 0.0, np.zeros((1, 17, 2)), np.zeros((1, 17)), colour)
    assert [problem.field for problem in error.value.problems] == ["colour"]


def stand(
    identities: Identities, start_s: float, people: Mapping[int, np.ndarray], clothes: Mapping[int, int] | None = None
) -> None:
    """People by the tracker's numbers stand for four seconds, each in clothes or unseen."""
    rng = np.random.default_rng(round(start_s))
    for time_s in np.arange(start_s, start_s + 4.0, 0.04).tolist():
        identities.keep(people.keys())
        for tracked, standing_m in people.items():
            colours = {} if clothes is None else {camera: colours_of(clothes[tracked], rng) for camera in range(4)}
            identities.see(tracked, time_s, standing_m, colours)


@pytest.fixture(scope="module")
def bones() -> LearntBones:
    truth_m = record(replace(SCENES["room"], duration_s=0.4), 1).truth_m[0]
    return learn_bones(truth_m, COCO_17)


@pytest.mark.parametrize(("shirt", "number"), [(None, 1), (SHIRTS[0], 1), (8, 3)])
def test_stranger_of_equal_build_in_other_clothes_is_new(bones: LearntBones, shirt: int | None, number: int) -> None:
    identities = Identities(COCO_17, 4, [])
    first_m, second_m = located_m(scaled(1.0), identities), located_m(scaled(0.85), identities)
    stand(identities, 0.0, {1: first_m, 2: second_m}, None if shirt is None else {1: SHIRTS[0], 2: SHIRTS[1]})
    for tracked in (1, 2):
        identities.learn(tracked, bones)
    stand(identities, 10.0, {3: first_m}, None if shirt is None else {3: shirt})
    assert identities.person_number(3) == number


def seconds_of(shirt: int, seed: int) -> list[tuple[int, np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [(camera, colours_of(shirt, rng)) for camera in (0, 1) for _ in range(10)]


def test_clothes_are_two_means_for_any_time(bones: LearntBones) -> None:
    clothes = LiveClothes(3)
    for second in range(40):
        clothes.add(1, seconds_of(0, second))
    earlier, later = clothes._halves[1]
    assert earlier.num_detections.tolist() == [[320, 320], [320, 320], [0, 0]]
    assert later.num_detections.tolist() == [[80, 80], [80, 80], [0, 0]]
    np.testing.assert_allclose(earlier.share[:2].sum(-1), 1.0)
    assert clothes._halves[1].whole.num_detections[0, 0] == 400


def test_clothes_of_people_together_tell_differences() -> None:
    clothes = LiveClothes(3)
    for second in range(4):
        for number, shirt in ((1, 0), (2, 16), (3, 0)):
            clothes.add(number, seconds_of(shirt, 10 * second + number))
    # Nobody is known to be another person than anybody else.
    assert clothes.log_ratios(3, [1, 2, 9]) == {1: 0.0, 2: 0.0, 9: 0.0}
    clothes.meet(1, [2])
    apart = clothes.log_ratios(3, [1, 2])
    assert apart[1] > 1.0 > -2.0 > apart[2]
    # Once the third person is known as the first one, all of both is that person's.
    clothes.meet(3, [2])
    clothes.merge(3, 1)
    assert len(clothes) == 2
    assert clothes._halves[1].whole.num_detections[0, 0] == 80
    assert clothes._others == {1: {2}, 2: {1}}
    clothes.keep({2})
    assert list(clothes._halves) == list(clothes._others) == [2]
    assert not clothes._others[2]


@needs("rendered")
def test_rendered_people_of_one_build_keep_their_numbers(bones: LearntBones) -> None:
    """Colours of rendered clothes in the first half of a clip, then in the second one, to and fro, in another order."""
    folder = folder_of("rendered")
    truth, session = load_rendered(folder), open_session(folder / "videos", folder / "calibration.toml")
    places = [truth.names.index(name) for name in COCO_17.names]
    num_people, num_frames = truth.xyz_m.shape[:2]
    colours: list[list[dict[int, np.ndarray]]] = [[{} for _ in range(num_people)] for _ in range(num_frames)]
    for number, camera in enumerate(session.cameras):
        for frame, image_rgb in camera_images(session, camera.name, range(num_frames)):
            points_px = project(camera, truth.xyz_m[:, frame, places])
            score = np.isfinite(points_px[..., 0]).astype(float)
            for person, colour in enumerate(colour_histograms(image_rgb, points_px, score, COCO_17)):
                colours[frame][person][number] = colour
    identities = Identities(COCO_17, len(session.cameras), [])
    standing_m = located_m(scaled(1.0), identities)

    def visit(start_s: float, frames: Sequence[int], people: Mapping[int, int]) -> None:
        """People by the tracker's numbers are there in some frames."""
        for place, frame in enumerate(frames):
            identities.keep(people.keys())
            for tracked, person in people.items():
                identities.see(tracked, start_s + place * 0.04, standing_m, colours[frame][person])

    half = num_frames // 2
    visit(0.0, range(half), {1: 0, 2: 1, 3: 2})
    for tracked in (1, 2, 3):
        identities.learn(tracked, bones)
    visit(10.0, [*range(half, num_frames), *reversed(range(half, num_frames))], {4: 1, 5: 2, 6: 0})
    assert [identities.person_number(tracked) for tracked in (4, 5, 6)] == [2, 3, 1]


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


def test_people_of_earlier_take_have_first_numbers(
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
def test_only_same_proportions_are_same_person(room: Simulation, factor: float, is_same: bool) -> None:
    identities = Identities(room.joints, len(room.cameras), [scaled(1.0), scaled(0.88)])
    standing_m = located_m(scaled(factor), identities)
    bodies = [identities.see(1, time_s, standing_m, {}) for time_s in np.arange(0.0, 3.1, 0.04)]
    assert any(body is not None for body in bodies) == is_same
    assert identities.person_number(1) == (1 if is_same else 3)
    # Somebody else of the same proportions is in sight at the same time: another person.
    for time_s in np.arange(4.0, 7.1, 0.04):
        identities.see(2, time_s, standing_m, {})
    assert identities.person_number(2) == 4


def test_first_of_many_people_are_forgotten_not_announced(room: Simulation) -> None:
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
    assert identities.person_number(2) == 2
    for tracked in range(3, 70):
        identities.learn(tracked, learn_bones(room.truth_m[0, :5], room.joints))
        identities.keep({tracked})
    assert identities.person_number(70) == 70


def test_bodies_are_read_from_result(room: Simulation, tmp_path: Path) -> None:
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
    with pytest.raises(InputError, match=r"is not the skeletons.json"):
        read_bodies(path)
    with pytest.raises(InputError, match="Body 1 must have"):
        LiveSettings(RATE_HZ, bodies=((0.3,),))
