"""Records come back from their archives, and equal records are equal bytes."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Float

from pipeline.association.clustering.skeleton import LimbLengths
from pipeline.core.data.animation import Animation, Floor, FootContact, FootPart, SkeletonMotion
from pipeline.core.data.arrays import no_colours, no_detections
from pipeline.core.data.detections import DamagedVideo, Detections, MapGrid, PafFields, PictureChanges
from pipeline.core.data.people import Doubt, Leftovers, Observations, People, PersonLoss, Poses3D, Track3D
from pipeline.core.joints import COCO_17
from pipeline.core.options.edits import PersonSpan
from pipeline.core.runtime import record_archive
from pipeline.core.runtime.npz import open_archive
from pipeline.core.runtime.record_archive import RecordArchive, decode, encode, save
from pipeline.run.engine.methods import MeasuredBones
from pipeline.run.engine.stored_people import StoredPeople, write_people

RNG = np.random.default_rng(3)
NOBODY = People((), (), 0)


class Segment(NamedTuple):
    word: str
    share: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    points: Float[np.ndarray, " n"]
    parts: tuple[Segment, ...]
    rows: Sequence[Sequence[int]]
    pair: tuple[str, float]
    nothing: Segment | None
    counts: Mapping[str, int]
    more: tuple[Float[np.ndarray, " n"], ...] = ()
    inner: "Inner | None" = None
    rest: Float[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True, slots=True)
class Inner:
    flag: bool
    size_px: tuple[int, int] = (0, 0)


texts = st.text(max_size=5)
floats = st.floats(allow_nan=False)
parts = st.builds(Segment, texts, floats)


@given(
    points=st.lists(st.floats(width=64), max_size=4).map(np.array),
    parts=st.lists(parts, max_size=3).map(tuple),
    rows=st.lists(st.lists(st.integers(-(2**60), 2**60), max_size=3).map(tuple), max_size=3).map(tuple),
    pair=st.tuples(texts, floats),
    nothing=st.none() | parts,
    counts=st.dictionaries(texts, st.integers(0, 9), max_size=3),
    inner=st.none() | st.builds(Inner, st.booleans(), st.tuples(st.integers(), st.integers())),
)
def test_any_record_comes_back(**values: object) -> None:
    record = Whole(**values, more=(np.arange(2.0), np.array([np.nan])))  # type: ignore[arg-type]
    content = encode(record)
    back = decode(Whole, content)
    assert encode(back) == encode(record) == content
    for name in ("parts", "rows", "pair", "nothing", "counts", "inner"):
        assert getattr(back, name) == values[name], name
    np.testing.assert_array_equal(back.points, values["points"])
    assert back.points.dtype == np.float64
    for ours, theirs in zip(record.more, back.more, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(back.rest, np.zeros(2))


def test_default_costs_no_byte_and_is_told_from_another_type() -> None:
    record = Whole(np.zeros(3), (), (), ("a", 1.0), None, {})
    assert "rest" not in np.load(io.BytesIO(encode(record))).files
    for other in (np.zeros(3), np.zeros(2, np.float32), np.array([0.0, -1.0])):
        back = decode(Whole, encode(replace(record, rest=other)))
        np.testing.assert_array_equal(back.rest, other)
        assert back.rest.dtype == other.dtype


def test_part_is_read_alone(tmp_path: Path) -> None:
    floor = Floor(0.1, 0.01, -0.02)
    track = people_of_two_lengths().tracks[0]
    save(Animation((track,), (), floor), tmp_path / "animation")
    archive = RecordArchive(tmp_path / "animation")
    assert archive.find(Floor, "floor") == floor
    assert_equal(archive.read(Track3D, "tracks", 0), track)
    assert RecordArchive(encode(Animation((), (), None))).find(Floor, "floor") is None


def test_entries_of_archive_are_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thousands of people have ten thousands of entries: listing them again for each person took minutes."""
    write_people(tmp_path / "people", people_of_two_lengths())
    listed = Mock(wraps=open_archive)
    monkeypatch.setattr(record_archive, "open_archive", listed)
    people = StoredPeople(tmp_path / "people").people
    assert len([*people.tracks, *people.observations]) == 4
    listed.assert_called_once_with(tmp_path / "people")


def test_archive_with_pickle_is_refused() -> None:
    file = io.BytesIO()
    np.savez(file, record=np.array([{"a": 1}], object))
    with pytest.raises(ValueError, match="allow_pickle"):
        decode(Whole, file.getvalue())


def test_detections_come_back() -> None:
    found = Detections(
        "left", np.array([0, 0, 3]), RNG.normal(size=(3, 17, 2)), RNG.uniform(size=(3, 17)), RNG.normal(size=(3, 4))
    )
    back = decode(Detections, encode(found))
    assert back.camera == "left"
    for name in ("frame", "keypoints_px", "score", "box_px"):
        np.testing.assert_array_equal(getattr(back, name), getattr(found, name))


def test_changes_of_pictures_come_back() -> None:
    samples = np.arange(6, dtype=np.uint8).reshape(2, 3)
    changes = PictureChanges(np.array([3, 4]), np.array([np.nan, 2.5], np.float32), *samples)
    plain = Detections("left", np.array([4]), RNG.normal(size=(1, 17, 2)), np.ones((1, 17)), np.ones((1, 4)))
    for back in (
        decode(Detections, encode(replace(plain, changes=changes))),
        decode(PafFields, encode(replace(fields_of_two_frames(), changes=changes))),
    ):
        for part in fields(PictureChanges):
            np.testing.assert_array_equal(getattr(back.changes, part.name), getattr(changes, part.name))
    assert len(decode(Detections, encode(plain)).changes.frame) == 0
    doubled = (DamagedVideo("left", "a.mp4", 0, 60, 0.0, 0.0, (0.5, 1.5)),)
    lengths = LimbLengths(np.array([[0.3]]), np.array([0.5]))
    assert decode(MeasuredBones, encode(MeasuredBones(lengths, doubled))).damaged == doubled


def test_colours_are_apart_from_detections() -> None:
    plain = Detections("left", np.array([4]), RNG.normal(size=(1, 17, 2)), np.ones((1, 17)), np.ones((1, 4)))
    coloured = replace(plain, colour=RNG.integers(0, 256, (1, 2, 32), np.uint8))
    assert encode(replace(coloured, colour=no_colours())) == encode(plain)
    np.testing.assert_array_equal(decode(Detections, encode(coloured)).colour, coloured.colour)
    assert decode(Detections, encode(plain)).colour.size == 0


def test_damage_comes_back_and_costs_no_byte_where_there_is_none(tmp_path: Path) -> None:
    found = Detections("left", np.array([4]), RNG.normal(size=(1, 17, 2)), np.ones((1, 17)), np.ones((1, 4)))
    assert "damaged" not in np.load(io.BytesIO(encode(found))).files
    assert decode(Detections, encode(found)).damaged.tolist() == []
    damaged = replace(found, damaged=np.array([5, 6]))
    assert decode(Detections, encode(damaged)).damaged.tolist() == [5, 6]

    fields_found = fields_of_two_frames()
    assert decode(PafFields, encode(fields_found)).damaged.tolist() == []
    content = encode(replace(fields_found, damaged=np.array([5])))
    assert decode(PafFields, content).damaged.tolist() == [5]

    lengths = LimbLengths(np.array([[0.3]]), np.array([0.5]))
    videos = (DamagedVideo("left", "a.mp4", 2, 60, 0.5, 1.0), DamagedVideo("right", "b.mp4", 1, 60, 0.1, 0.1))
    assert decode(MeasuredBones, encode(MeasuredBones(lengths, ()))).damaged == ()
    people = tmp_path / "people"
    write_people(people, NOBODY)
    assert StoredPeople(people).damaged == ()
    write_people(people, NOBODY, videos)
    measured = decode(MeasuredBones, encode(MeasuredBones(lengths, videos)))
    assert StoredPeople(people).damaged == measured.damaged == videos
    np.testing.assert_array_equal(measured.lengths[0], lengths[0])


def people_of_two_lengths() -> People:
    tracks, observations = [], []
    for track_id, num_frames in ((1, 4), (2, 6)):
        shape = (num_frames, 17)
        score, error_px = RNG.uniform(size=shape), RNG.normal(size=shape)
        source, num_views = RNG.integers(0, 4, shape).astype(np.int8), RNG.integers(0, 3, shape)
        xyz_m = RNG.normal(size=(*shape, 3))
        tracks.append(Track3D(track_id, 10 * track_id, xyz_m, score, source, error_px, num_views))
        points_px = RNG.normal(size=(num_frames, 2, 17, 2))
        detection = RNG.integers(-1, 90, (num_frames, 2), np.int32) if track_id == 2 else no_detections()
        observations.append(Observations(track_id, points_px, RNG.uniform(size=(num_frames, 2, 17)), detection))
    return People(tracks, observations, 3)


def assert_equal(ours: Track3D | Observations, theirs: Track3D | Observations) -> None:
    for part in fields(ours):
        np.testing.assert_array_equal(getattr(theirs, part.name), getattr(ours, part.name))


def test_people_come_back_one_by_one(tmp_path: Path) -> None:
    people, path = people_of_two_lengths(), tmp_path / "people"
    write_people(path, people)
    back = StoredPeople(path).people
    assert back.num_approximate_frames == 3
    for track, back_track in zip(people.tracks, back.tracks, strict=True):
        assert_equal(track, back_track)
    for seen, back_seen in zip(people.observations, back.observations, strict=True):
        assert_equal(seen, back_seen)
    assert [one.track_id for one in back.tracks[-1:]] == [back.observations[-1].track_id] == [2]
    assert StoredPeople(path).spans == (PersonSpan(1, 10, 4), PersonSpan(2, 20, 6))
    write_people(path, people, joints=COCO_17)
    hips_m = people.tracks[1].xyz_m[[0, -1]][:, COCO_17.indices(("left_hip", "right_hip"))].mean(1)
    places = StoredPeople(path).spans[1].places
    assert (places[0][0], places[-1][0]) == (20, 25)
    np.testing.assert_allclose([places[0][1:], places[-1][1:]], hips_m, atol=0.0005)
    assert (back.doubts, back.leftovers) == ((), None)


def test_losses_come_back(tmp_path: Path) -> None:
    losses = [PersonLoss("vanished", 2, 12, 40, (0.5, -1.25, 1.0)), PersonLoss("phantom", 0, 3, 9, (0.0, 0.1, 0.2))]
    write_people(tmp_path / "people", people_of_two_lengths()._replace(losses=losses))
    assert list(StoredPeople(tmp_path / "people").people.losses) == losses


def test_doubts_and_leftovers_come_back(tmp_path: Path) -> None:
    left = Leftovers(np.array([3]), np.array([1]), RNG.normal(size=(1, 17, 2)), RNG.uniform(size=(1, 17)))
    doubts = [[], [Doubt(12, 0.1 + 0.2, 1), Doubt(14, 0.9, 0)]]
    write_people(tmp_path / "people", people_of_two_lengths()._replace(doubts=doubts, leftovers=left))
    back = StoredPeople(tmp_path / "people").people
    assert [list(of_person) for of_person in back.doubts] == doubts
    assert back.leftovers is not None
    for part in fields(Leftovers):
        np.testing.assert_array_equal(getattr(back.leftovers, part.name), getattr(left, part.name))


def test_uncertainty_comes_back_where_there_is_any() -> None:
    first, second = people_of_two_lengths().tracks
    certain = replace(first, uncertainty_m=np.where(first.source > 0, RNG.uniform(size=first.score.shape), np.nan))
    motions = tuple(
        SkeletonMotion(
            track.track_id,
            "",
            track.start_frame,
            25.0,
            np.ones(22),
            np.zeros((track.num_frames, 3)),
            np.zeros((track.num_frames, 22, 4)),
            (),
        )
        for track in (certain, second)
    )
    back = decode(Animation, encode(Animation((certain, second), motions, None)))
    assert_equal(certain, back.tracks[0])
    assert back.tracks[1].uncertainty_m is None


@pytest.mark.parametrize("num_joints", [24, 64])
def test_motions_with_and_without_fingers_come_back(num_joints: int) -> None:
    motions = tuple(
        SkeletonMotion(
            track.track_id,
            "person",
            track.start_frame,
            25.0,
            RNG.uniform(size=num_joints),
            RNG.normal(size=(track.num_frames, 3)),
            RNG.normal(size=(track.num_frames, num_joints, 4)),
            (),
        )
        for track in people_of_two_lengths().tracks
    )
    back = decode(Animation, encode(Animation(tuple(people_of_two_lengths().tracks), motions, None)))
    for motion, found in zip(motions, back.motions, strict=True):
        for name in ("bone_length_m", "root_m", "parent_from_joint"):
            np.testing.assert_array_equal(getattr(found, name), getattr(motion, name))


@pytest.mark.parametrize("part", ["foot", "heel", "toe"])
def test_contacts_come_back_with_their_part(part: FootPart) -> None:
    contact = FootContact("right", 3, 5, 0.9, pinned=True, slide_before_m=0.01, slide_after_m=0.002, part=part)
    (track,) = people_of_two_lengths().tracks[:1]
    turned = np.zeros((track.num_frames, 24, 4))
    motion = SkeletonMotion(
        track.track_id, "", track.start_frame, 25.0, np.ones(24), np.zeros((track.num_frames, 3)), turned, (contact,)
    )
    back = decode(Animation, encode(Animation((track,), (motion,), None)))
    assert back.motions[0].contacts == (contact,)


def test_equal_people_are_equal_bytes(tmp_path: Path) -> None:
    people = people_of_two_lengths()
    for name in ("one", "other"):
        write_people(tmp_path / name, people)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


def fields_of_two_frames() -> PafFields:
    return PafFields(
        camera="left",
        frame=np.array([3, 4]),
        peak_row=np.array([0, 1, 1]),
        peak_joint=np.array([2, 0, 5]),
        peak_px=RNG.normal(size=(3, 2)),
        peak_score=RNG.uniform(size=3),
        fields=RNG.integers(0, 256, (2, 19, 2, 6, 8)).astype(np.uint8),
        limbs=np.arange(38).reshape(19, 2),
        grid=MapGrid((3.5, 3.4), (8.0, 8.1)),
    )


def test_fields_come_back() -> None:
    found = fields_of_two_frames()
    content = encode(found)
    assert encode(found) == content
    back = decode(PafFields, content)
    assert back.grid == found.grid
    for part in fields(PafFields):
        if part.name not in {"changes", "grid"}:
            np.testing.assert_array_equal(getattr(back, part.name), getattr(found, part.name))


def test_lengths_and_poses_come_back() -> None:
    lengths = LimbLengths(np.array([[np.nan, 0.3], [0.2, 0.25]]), np.array([0.0, 0.5]))
    for ours, theirs in zip(lengths, decode(LimbLengths, encode(lengths)), strict=True):
        np.testing.assert_array_equal(theirs, ours)
    poses = Poses3D(
        np.array([0, 0, 2]),
        RNG.normal(size=(3, 14, 3)),
        RNG.normal(size=(3, 14, 4, 2)),
        RNG.uniform(size=(3, 14, 4)),
        np.array([2]),
    )
    back = decode(Poses3D, encode(poses))
    for part in fields(Poses3D):
        np.testing.assert_array_equal(getattr(back, part.name), getattr(poses, part.name))
