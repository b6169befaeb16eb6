"""Limbs of neighbours: bodies that take an arm or a leg from somebody who is near them in the picture."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.association.identity import neighbours
from pipeline.association.identity.neighbours import present, return_limbs
from pipeline.association.tracking.observations import gather
from pipeline.core.joints import COCO_17, JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person
from pipeline.run.engine.methods import Association
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import Simulation, find_scene, record

_MIN_SCORE = 0.15
_BODY = slice(COCO_17.index("left_shoulder"), None)


@cache
def crowded() -> tuple[Simulation, tuple[Person, ...]]:
    """Seven people who change places half a metre apart for four seconds, and their tracks.

    A third of the bodies take a limb from a neighbour.
    """
    simulation = record(replace(find_scene("exchange"), duration_s=4.0), 5, 6)
    association = Association(
        simulation.cameras, simulation.times, simulation.timebase, simulation.joints, ReconstructionConfig()
    )
    bodies = gather(simulation.cameras, simulation.times, simulation.detections)
    people = association.assign_identities(association.track(bodies))
    return simulation, tuple(zip(people.tracks, people.observations, strict=True))


def returned(simulation: Simulation, persons: Sequence[Person], joints: JointSet = COCO_17) -> list[Person]:
    return return_limbs(persons, simulation.cameras, simulation.timebase, joints, _MIN_SCORE)


def marks(simulation: Simulation, persons: Sequence[Person]) -> tuple[int, int]:
    """Numbers of the observed joints below the head that show the person who has them, and somebody else."""
    own = foreign = 0
    for track_, seen in persons:
        frames = np.arange(track_.start_frame, track_.start_frame + track_.num_frames)
        truth_m = simulation.truth_m[:, frames]
        apart_m = np.linalg.norm(truth_m[:, :, _BODY] - track_.xyz_m[:, _BODY], axis=-1)
        who = np.nanmean(np.nanmean(apart_m, axis=-1), axis=-1).argmin()
        for number, camera in enumerate(simulation.cameras):
            apart_px = np.linalg.norm(project(camera, truth_m) - seen.points_px[:, number], axis=-1)[..., _BODY]
            is_seen = seen.score[:, number, _BODY] > 0
            is_foreign = is_seen & (apart_px[who] > 30) & (apart_px.min(0) < 0.4 * apart_px[who])
            foreign += int(is_foreign.sum())
            own += int((is_seen & ~is_foreign).sum())
    return own, foreign


def error_mm(simulation: Simulation, persons: Sequence[Person]) -> float:
    return float(score_simulated([track_ for track_, _ in persons], simulation, COCO_17)["mpjpe_mm"])


def test_limbs_go_to_people_whom_they_show() -> None:
    simulation, persons = crowded()

    mended = returned(simulation, persons)

    own, foreign = marks(simulation, persons)
    own_then, foreign_then = marks(simulation, mended)
    assert foreign > 400
    assert foreign_then < 0.4 * foreign
    assert own_then > 0.998 * own
    assert error_mm(simulation, mended) < 0.85 * error_mm(simulation, persons)
    assert [track_.track_id for track_, _ in mended] == [track_.track_id for track_, _ in persons]


def test_neighbour_whom_view_lacks_gets_limb() -> None:
    simulation, persons = crowded()

    def count(some: Sequence[Person]) -> int:
        return sum(int((seen.score > 0).sum()) for _, seen in some)

    # Without gifts each limb that is taken would be one observation less.
    _, foreign = marks(simulation, persons)
    assert count(persons) - count(returned(simulation, persons)) < 0.8 * foreign


@pytest.mark.slow
def test_result_does_not_depend_on_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, persons = crowded()
    whole = returned(simulation, persons)
    monkeypatch.setattr(neighbours, "_BLOCK", 46)
    monkeypatch.setattr(neighbours, "_MAX_PAIRS", len(persons) ** 2 * 60)
    for (_, seen), (_, in_blocks) in zip(whole, returned(simulation, persons), strict=True):
        np.testing.assert_array_equal(seen.points_px, in_blocks.points_px)


def test_blocks_are_shorter_more_pairs_of_people_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    _, persons = crowded()
    whole = range(max(track.start_frame + track.num_frames for track, _ in persons))
    assert list(neighbours._blocks(persons, whole, 5)) == [(whole, whole)]
    most = len(persons) ** 2 * 40
    monkeypatch.setattr(neighbours, "_MAX_PAIRS", most)
    blocks = list(neighbours._blocks(persons, whole, 5))
    assert [frame for block, _ in blocks for frame in block] == list(whole)
    assert all(len(present(persons, frames)) ** 2 * len(frames) <= most for _, frames in blocks)


def changed(person: Person, frame: int, joint: int, place_px: float, score: float) -> Person:
    """Person with another observation of a joint in the third camera."""
    track, seen = person
    points_px, scores = seen.points_px.copy(), seen.score.copy()
    at = frame - track.start_frame, 2, joint
    points_px[at], scores[at] = place_px, score
    return track, replace(seen, points_px=points_px, score=scores)


def test_joint_that_two_neighbours_have_is_of_first() -> None:
    simulation, persons = crowded()
    frame, joint = max(track.start_frame for track, _ in persons[:3]) + 5, COCO_17.index("left_wrist")
    places = (np.nan, 0.0), (200.0, 0.8), (300.0, 0.9)
    three = [changed(person, frame, joint, *place) for person, place in zip(persons, places, strict=False)]
    taken = np.array([[frame, 2, neighbour, joint, 0, joint] for neighbour in (1, 2)])
    given = neighbours._give_back(three, taken, simulation.cameras, simulation.timebase, _MIN_SCORE)
    scores = [seen.score[frame - track.start_frame, 2, joint] for track, seen in given]
    assert scores == [0.8, 0.0, 0.0]
    np.testing.assert_array_equal(given[0][1].points_px[frame - given[0][0].start_frame, 2, joint], 200.0)


def test_somebody_alone_is_returned_as_is() -> None:
    simulation, persons = crowded()
    assert returned(simulation, persons[:1]) == [persons[0]]


def test_joints_without_trunk_are_returned_as_they_are() -> None:
    simulation, persons = crowded()
    head = JointSet(tuple(name.replace("hip", "pelvis") for name in COCO_17.names), ())
    assert returned(simulation, persons, head) == list(persons)
