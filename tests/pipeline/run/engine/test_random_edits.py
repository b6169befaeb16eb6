"""Random lists of edits over two runs: the same bytes from the list alone, in any order of independent edits."""

import shutil
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.people import People
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edited_take import apply_edits, place_edits
from pipeline.core.options.edits import (
    Accept,
    Contact,
    Exchange,
    ExchangeSides,
    IgnoreDetections,
    KeyJoint,
    Limb,
    Merge,
    PeopleEdit,
    PersonSpan,
    PlaceDetection,
    Remove,
    Rename,
    Split,
)
from pipeline.core.options.file_formats import Export
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.stored_people import StoredPeople, write_people
from pipeline.validation.simulation.scenes import find_scene, record
from tests.cases import accuracy_but
from tests.pipeline.simulations import write_simulation

RUNS = [ReconstructionConfig(), ReconstructionConfig(method="clustering")]
FRAMES = range(38)
TABLES: tuple[Export, ...] = ("csv",)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(replace(find_scene("room"), duration_s=len(FRAMES) / 25.0), seed=6), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


@pytest.fixture(scope="module")
def found(session: KeypointSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cache of both runs without edits."""
    cache = tmp_path_factory.mktemp("found")
    for config in RUNS:
        assert len(reconstruct(session, config, cache=cache).tracks) == 3
    return cache


@pytest.fixture(scope="module")
def used(found: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cache of both runs with many lists of edits."""
    return Path(shutil.copytree(found, tmp_path_factory.mktemp("used") / "cache"))


@pytest.fixture(scope="module")
def plain(session: KeypointSession, found: Path) -> Reconstruction:
    return reconstruct(session, RUNS[0], cache=found)


@pytest.fixture(scope="module")
def spans(plain: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> tuple[PersonSpan, ...]:
    path = tmp_path_factory.mktemp("people") / "people"
    write_people(path, People(plain.located, plain.observations), joints=plain.joints)
    return StoredPeople(path).spans


def correction(person: int, plain: Reconstruction, random: Random) -> PeopleEdit:
    track = plain.tracks[person - 1]
    joint = random.choice(["left_elbow", "right_wrist", "left_ankle", "nose"])
    frame = random.choice(range(2, len(FRAMES) - 8))
    frames: dict[str, Any] = {"start_frame": frame, "stop_frame": frame + random.choice(range(1, 8))}
    camera = random.choice(plain.cameras).name
    x, y, z = track.xyz_m[frame, plain.joints.index(joint)].tolist()
    limbs: list[Limb] = ["left_foot", "right_foot", "left_hand"]
    limb = random.choice(limbs)
    made: list[PeopleEdit] = [
        KeyJoint(person=person, joint=joint, frame=frame, place_m=(x, y + 0.05, z + 0.05)),
        IgnoreDetections(person=person, camera=camera, part=random.choice(["left_arm", "all"]), **frames),
        PlaceDetection(person=person, camera=camera, joint=joint, frame=frame, place_px=(400.0, 300.0)),
        ExchangeSides(person=person, part=random.choice(["arms", "legs", "all"]), **frames),
        Contact(person=person, limb=limb, stands=random.choice([True, False]), **frames),
        Accept(person=person, kind="sides", **frames),
    ]
    return random.choice(made)


def queues_of(plain: Reconstruction, random: Random) -> list[list[PeopleEdit]]:
    """Lists of edits that are independent of each other: of a person, or of two people who are edited together."""
    queues: list[list[PeopleEdit]] = []
    for people in random.choice([[[1], [2], [3]], [[1, 2], [3]], [[1, 3], [2]]]):
        queue: list[PeopleEdit] = []
        for _ in range(random.choice(range(4))):
            person, frame = random.choice(people), random.choice(range(5, 30))
            made: list[PeopleEdit] = [
                Rename(person=person, name=f"Name {person} {random.random()}"),
                Split(person=person, frame=frame),
                *(correction(person, plain, random) for _ in range(5)),
            ]
            if len(people) > 1:
                one, other = random.sample(people, 2)
                made += [Exchange(person=one, other=other, start_frame=frame), Merge(person=one, other=other)]
            queue.append(random.choice([*made, Remove(person=person)]))
        queues.append(queue)
    return queues


def placed(queues: list[list[PeopleEdit]], spans: tuple[PersonSpan, ...]) -> list[list[PeopleEdit]]:
    """Edits that name people by places; edits are left out that the earlier ones of their list make impossible."""
    lists = []
    for queue in queues:
        kept: list[PeopleEdit] = []
        for edit in queue:
            (one,) = place_edits(spans, [edit], FRAMES)
            if apply_edits(spans, [*kept, one], FRAMES).outcomes[-1].problem is None:
                kept.append(one)
        lists.append(kept)
    return lists


@pytest.mark.slow
@pytest.mark.parametrize("seed", accuracy_but(range(4), range(200)))
def test_random_edits_give_same_bytes_in_any_order(
    seed: int,
    session: KeypointSession,
    found: Path,
    used: Path,
    plain: Reconstruction,
    spans: tuple[PersonSpan, ...],
    tmp_path: Path,
) -> None:
    """A run that has seen other lists gives the bytes of one that has seen none."""
    random = Random(seed)  # noqa: S311 - no secret
    lists = placed(queues_of(plain, random), spans)
    in_order, mixed = [edit for edits in lists for edit in edits], []
    while waiting := [edits for edits in lists if edits]:
        mixed.append(random.choice(waiting).pop(0))
    shutil.copytree(found, tmp_path / "new")
    for config in RUNS:
        files: list[dict[str, bytes]] = []
        for edits, folder in ((in_order, used), (mixed, tmp_path / "new")):
            take = reconstruct(session, replace(config, edits=tuple(edits)), cache=folder)
            paths = write_results(take, tmp_path / f"{config.method}-{len(files)}", TABLES)
            files.append({path.name: path.read_bytes() for path in paths})
        assert files[0] == files[1]
