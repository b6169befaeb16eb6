"""Pieces of outputs: found again after other edits, with the bytes that the work would make."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import Exchange, Merge, PeopleEdit, Rename, Split
from pipeline.core.options.file_formats import Export, formats_of_people, installed_formats
from pipeline.core.progress import ignore
from pipeline.export.person_files import take_people
from pipeline.export.quality.views import GetViews, person_views
from pipeline.export.results import keep_people, write_files
from pipeline.export.writers import bvh, c3d_file, csv_table, fbx, glb, skeletons_json, trc, vrma
from pipeline.export.writers.registry import PersonContent, find_writer
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.skeleton.model import forward_kinematics
from pipeline.run.engine import refitting
from pipeline.run.engine.local import reconstruct, session_facts
from pipeline.run.engine.pieces import FilesInPieces, Pieces, TakeInPieces
from pipeline.run.engine.plan import STAGE_BY_NAME, plan
from pipeline.run.engine.stage import EXPORT, REPORT, WRITE
from pipeline.run.engine.take import viewer_files
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

FORMATS = formats_of_people(installed_formats())
# Writers of formats whose files hold the person's name, and of the other formats.
WITH_NAMES = (fbx, glb, vrma, *([import_module("pipeline.export.writers.usd")] if "usd" in FORMATS else []))
WITHOUT_NAMES = (bvh, c3d_file, csv_table, trc)
HALF = 25


class KeptPieces(Pieces):
    """Pieces of many tasks, kept in memory."""

    def __init__(self) -> None:
        self._key = "key of a task"
        self.kept: dict[str, bytes] = {}

    def find(self, key: str) -> bytes | None:
        return self.kept.get(key)

    def keep(self, key: str, path: Path) -> None:
        self.kept[key] = path.read_bytes()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(dataclasses.replace(find_scene("room"), duration_s=2.0), seed=6), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def edited(session: KeypointSession, cache: Path | None, *edits: PeopleEdit) -> Reconstruction:
    return reconstruct(session, dataclasses.replace(ReconstructionConfig(), edits=edits), cache=cache)


def fail(*_: object) -> NoReturn:
    raise AssertionError


def files(
    take: Reconstruction, folder: Path, pieces: Pieces, frame_rate_hz: float | None = None
) -> Mapping[str, bytes]:
    paths = write_files(take, folder, FORMATS, "default", frame_rate_hz, kept=FilesInPieces(pieces, folder)).paths
    return {path.name: path.read_bytes() for path in paths}


@pytest.mark.slow
def test_people_are_fitted_once_whatever_is_edited_elsewhere(
    session: KeypointSession, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange = Exchange(person=1, other=2, start_frame=HALF)
    edited(session, cache, exchange)
    alone = edited(session, None, Split(person=3, frame=HALF), exchange, Merge(person=3, other=4))
    monkeypatch.setattr(refitting, "animate", fail)
    # The exchanged people have been fitted; the third one is whole again.
    found = edited(session, cache, Split(person=3, frame=HALF), exchange, Merge(person=3, other=4))
    assert [motion.track_id for motion in found.motions] == [motion.track_id for motion in alone.motions]
    for one, other in zip(found.motions, alone.motions, strict=True):
        np.testing.assert_array_equal(one.parent_from_joint, other.parent_from_joint)
    with pytest.raises(AssertionError):
        edited(session, cache, Exchange(person=1, other=2, start_frame=HALF + 1))


def test_files_are_written_once_and_renamed_people_anew(
    session: KeypointSession, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, pieces = edited(session, cache), KeptPieces()
    first = files(plain, tmp_path / "first", pieces)
    for format_ in (*WITHOUT_NAMES, *WITH_NAMES):
        monkeypatch.setattr(format_, "encode", fail)
    monkeypatch.setattr(skeletons_json, "encode_track", fail)
    assert files(plain, tmp_path / "again", pieces) == first
    renamed = edited(session, cache, Rename(person=2, name="Zoë"))
    with pytest.raises(AssertionError):
        files(renamed, tmp_path / "failed", pieces)
    monkeypatch.undo()
    fresh = files(renamed, tmp_path / "fresh", KeptPieces())
    # Of the renamed person the files that hold the name are written, and no others.
    written: list[str] = []
    for format_ in WITHOUT_NAMES:
        monkeypatch.setattr(format_, "encode", fail)
    monkeypatch.setattr(skeletons_json, "encode_track", fail)

    def noted(encode: Callable[..., Iterator[bytes]], motion: SkeletonMotion, *others: Any) -> Iterator[bytes]:
        written.append(motion.name)
        return encode(motion, *others)

    for format_ in WITH_NAMES:
        monkeypatch.setattr(format_, "encode", partial(noted, format_.encode))
    assert files(renamed, tmp_path / "kept", pieces) == fresh
    assert written == ["Zoë"] * len(WITH_NAMES)
    changed = {name for name in fresh if fresh[name] != first[name]}
    of_take = {"take.fbx", "take.glb", "take.usdc"} & set(fresh)
    of_person = {"person-2.fbx", "person-2.glb", "person-2.usdc", "person-2.vrma"} & set(fresh)
    # A warning about forces names people.
    assert changed == {"skeletons.json", "metrics.json", *of_person, *of_take}
    assert fresh["metrics.json"].replace(rb"Zo\u00eb", b"person-2") == first["metrics.json"]


@pytest.mark.slow
def test_name_changes_no_report_and_no_motion_for_viewers(
    session: KeypointSession, cache: Path, tmp_path: Path
) -> None:
    def figures(
        pieces: Pieces, *edits: PeopleEdit, views: GetViews = person_views
    ) -> tuple[dict[str, Any], list[bytes]]:
        take = edited(session, cache, *edits)
        of_take = TakeInPieces(pieces, tmp_path, edits)
        report = of_take.report(take, views)
        made = of_take.viewer_files(take, lambda: viewer_files(take, views(take), session, report, tmp_path))
        return report, [file.path.read_bytes() for file in made]

    split, name = Split(person=1, frame=HALF), Rename(person=2, name="Zoë")
    pieces = KeptPieces()
    figures(pieces, split)
    kept = figures(pieces, split, name, views=fail)
    assert kept == figures(KeptPieces(), split, name)
    assert "Zoë" in [person["name"] for person in json.loads(kept[1][1])["people"]]
    with pytest.raises(AssertionError):
        figures(pieces, Split(person=1, frame=HALF + 1), name, views=fail)


@pytest.mark.parametrize("name", FORMATS)
def test_formats_say_whether_their_files_hold_names(session: KeypointSession, cache: Path, name: Export) -> None:
    (one, *_) = take_people(edited(session, cache), "take", "capsules")

    def content(motion: SkeletonMotion) -> bytes:
        of_person = PersonContent(
            *(one.track, motion, one.joints, one.timebase, "f", one.frames, one.is_present, one.origin_m, "default"),
            one.body,
            lambda: forward_kinematics(motion),
            lambda: joint_angles(motion, one.track, one.joints),
        )
        return b"".join(find_writer(name).encode(of_person))

    holds_name = content(one.motion) != content(dataclasses.replace(one.motion, name="Somebody else"))
    assert holds_name == find_writer(name).holds_name


def test_names_change_keys_of_files_alone(session: KeypointSession) -> None:
    def keys(*edits: PeopleEdit) -> dict[str, list[str]]:
        config = dataclasses.replace(ReconstructionConfig(), edits=edits, report=True)
        stages = plan(session_facts(session, ("digest",)), config, dict.fromkeys(STAGE_BY_NAME, "code"))
        return {stage.name: [task.key for task in stage.tasks] for stage in stages}

    split, anna, zoe = Split(person=1, frame=HALF), Rename(person=1, name="Anna"), Rename(person=2, name="Zoë")
    # Without another edit nobody is fitted or written ahead.
    assert keys(anna).keys() == keys().keys()
    for before, after in (
        (keys(), keys(anna)),
        (keys(split), keys(anna, split)),
        (keys(split, anna), keys(split, zoe)),
    ):
        assert {name for name in after if after[name] != before[name]} == {REPORT, EXPORT}
    assert keys(split)[EXPORT] != keys(Split(person=2, frame=HALF))[EXPORT]


@pytest.mark.slow
def test_parts_of_people_are_written_ahead_at_any_rate(
    session: KeypointSession, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, pieces, rate_hz = edited(session, cache, Rename(person=2, name="Zoë")), KeptPieces(), 10.0
    fresh = files(take, tmp_path / "fresh", KeptPieces(), rate_hz)
    for number in range(2):
        folder = tmp_path / f"part-{number}"
        folder.mkdir()
        kept = FilesInPieces(pieces, tmp_path)
        rows = slice(number, None, 2)
        keep_people(take, rows, folder, FORMATS, "default", rate_hz, "take", "capsules", ignore, kept)
        assert not list(folder.iterdir())
    monkeypatch.setattr(bvh, "encode", fail)
    assert files(take, tmp_path / "found", pieces, rate_hz) == fresh


def test_stages_name_their_pieces_alike(session: KeypointSession) -> None:
    def piece_keys(**choices: Any) -> list[str]:
        config = dataclasses.replace(ReconstructionConfig(), **choices)
        stages = plan(session_facts(session, ("digest",)), config, dict.fromkeys(STAGE_BY_NAME, "code"))
        return [task.piece_key for stage in stages if stage.name in {WRITE, EXPORT} for task in stage.tasks]

    unedited = piece_keys()
    edits = piece_keys(edits=(Rename(person=1, name="Anna"), Split(person=1, frame=HALF)))
    num_parts = STAGE_BY_NAME[WRITE].num_parts(range(session.timebase.num_frames))
    assert (num_parts, edits) == (2, unedited * 3)
    others: list[dict[str, Any]] = [{"exports": ("bvh", "glb")}, {"output_rate_hz": 10.0}, {"timeline": "person"}]
    assert len({*unedited, *(key for choices in others for key in piece_keys(**choices))}) == 4
    assert piece_keys(exports=(), timeline="person") == piece_keys(exports=())


def test_key_depends_on_every_value(session: KeypointSession, cache: Path) -> None:
    one, other = list(take_people(edited(session, cache), "take", "capsules"))[:2]
    pieces = KeptPieces()
    moved = one.track.xyz_m.copy()
    moved[0, 0, 0] += 1e-12
    people = [
        one,
        other,
        dataclasses.replace(one, track=dataclasses.replace(one.track, xyz_m=moved)),
        dataclasses.replace(one, motion=dataclasses.replace(one.motion, name="Zoë")),
        dataclasses.replace(one, motion=dataclasses.replace(one.motion, contacts=())),
        dataclasses.replace(one, timebase=dataclasses.replace(one.timebase, start_time_s=1.0)),
        dataclasses.replace(one, origin_m=one.origin_m + 1.0),
        dataclasses.replace(one, frames=one.track.frames[1:]),
        dataclasses.replace(one, is_present=~one.is_present),
    ]
    keys = [pieces.key(person) for person in people]
    assert len(set(keys)) == len(keys)
    assert pieces.key(dataclasses.replace(one)) == keys[0]


def test_forces_depend_on_people_who_may_touch(session: KeypointSession, cache: Path, tmp_path: Path) -> None:
    person = next(iter(take_people(edited(session, cache), "take", "capsules")))
    kept, (first, *_) = FilesInPieces(KeptPieces(), tmp_path), person.others
    moved_m = first.xyz_m.copy()
    moved_m[0, 0, 0] += 1.0
    changed = [
        dataclasses.replace(first, start_frame=first.start_frame + 1),
        dataclasses.replace(first, xyz_m=moved_m),
    ]
    people = [person, *(dataclasses.replace(person, others=(other,)) for other in changed)]
    for name, num_keys in (("forces", 3), ("bvh", 1)):
        assert len({kept._key(one, name) for one in people}) == num_keys
