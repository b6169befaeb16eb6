"""People of one build who come back: their numbers by the colours of their clothes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.session import open_session
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.detection.appearance import NUM_BINS, PARTS, colour_histograms
from pipeline.detection.chunk import camera_images
from pipeline.geometry.camera import project
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.clothing import LiveClothes
from pipeline.run.live.identities import Identities
from pipeline.run.live.records import LiveInstant
from pipeline.run.live.settings import LiveSettings
from pipeline.run.live.skeleton import LearntBones, learn_bones
from pipeline.validation.evaluation.datasets.rendered import load_rendered
from pipeline.validation.simulation.clothes import dress
from pipeline.validation.simulation.motion import performance
from pipeline.validation.simulation.motion.body import Proportions, random_proportions
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.e2e.datasets import folder_of, needs
from tests.pipeline.run.live.streams import play
from tests.pipeline.run.live.test_identities import (
    AWAY_S,
    LEAVE_S,
    RATE_HZ,
    located_m,
    scaled,
    true_people,
    with_a_break,
)

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
        patch.setattr(performance, "random_proportions", same_build)
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


def test_people_of_one_build_in_the_same_clothes_get_new_numbers(twins: Simulation) -> None:
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
def test_a_stranger_of_the_same_build_in_other_clothes_is_nobody_who_was_there(
    bones: LearntBones, shirt: int | None, number: int
) -> None:
    identities = Identities(COCO_17, 4, [])
    first_m, second_m = located_m(scaled(1.0), identities), located_m(scaled(0.85), identities)
    stand(identities, 0.0, {1: first_m, 2: second_m}, None if shirt is None else {1: SHIRTS[0], 2: SHIRTS[1]})
    for tracked in (1, 2):
        identities.learn(tracked, bones)
    stand(identities, 10.0, {3: first_m}, None if shirt is None else {3: shirt})
    assert identities.number_of(3) == number


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


def test_clothes_tell_what_people_who_were_there_together_differ_by() -> None:
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
    assert [identities.number_of(tracked) for tracked in (4, 5, 6)] == [2, 3, 1]
