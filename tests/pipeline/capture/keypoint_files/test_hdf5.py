"""HDF5 of DeepLabCut and SLEAP: their forms, and files that are hostile or damaged."""

import io
import json
import os
import pickle
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipeline.capture.keypoint_files.folders import Contents, read_folder
from pipeline.capture.keypoint_files.own_points import split_own
from pipeline.capture.keypoint_files.read_hdf5 import answer
from pipeline.capture.keypoint_files.readers import hdf5
from pipeline.core.errors import Problem
from pipeline.core.joints import COCO_17
from pipeline.core.runtime.child_processes import python_command
from pipeline.validation.simulation.scenes import find_scene, record
from tests.cases import slow_but
from tests.pipeline.capture.keypoint_files import hdf5_files
from tests.pipeline.keypoint_programs import keypoint_files

NAMES = [b"Nose", b"LShoulder", b"RShoulder", b"LHip", b"RHip", b"Hat"]
# Frames x tracks x nodes x (x, y)
POSITIONS = np.arange(4.0 * 2 * 6 * 2).reshape(4, 2, 6, 2) + 10.0
SCORES = np.linspace(0.1, 0.9, 48).reshape(4, 2, 6)


def written(write: Callable[[h5py.File], Any]) -> bytes:
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        write(file)
    return content.getvalue()


def analysis(file: h5py.File, positions: np.ndarray = POSITIONS, scores: np.ndarray | None = SCORES) -> h5py.File:
    file["node_names"] = NAMES
    file["tracks"] = positions.transpose(1, 3, 2, 0)
    if scores is not None:
        file["point_scores"] = scores.transpose(1, 2, 0)
    return file


def read(folder: Path, content: bytes, name: str = "take.h5") -> tuple[Contents, list[Problem]]:
    folder = folder / "cam"
    folder.mkdir(exist_ok=True)
    (folder / name).write_bytes(content)
    problems: list[Problem] = []
    return read_folder(folder, "left", (640, 480), 10**9, [], problems), problems


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Well-formed files are read in this process, without a child for each."""
    monkeypatch.setattr(hdf5, "run_confined", lambda program, arguments, *_, **__: answer(Path(arguments[0])))


def refused(folder: Path, write: Callable[[h5py.File], Any]) -> str:
    contents, problems = read(folder, written(write))
    assert not contents.frames
    (problem,) = problems
    assert (problem.code, problem.file) == ("keypoints_unreadable", "cam/take.h5")
    return problem.message


def test_axes_of_sleap_as_file_states_them(tmp_path: Path) -> None:
    def standard(file: h5py.File) -> None:
        file["node_names"] = ["Nose", "LShoulder", "RShoulder", "LHip", "RHip", "Hat"]
        file["tracks"], file["point_scores"] = POSITIONS, SCORES
        file["tracks"].attrs["dims"] = json.dumps(["frame", "track", "node", "xy"])

    def unturned(file: h5py.File) -> None:
        file["node_names"] = NAMES
        file["tracks"], file["point_scores"] = POSITIONS.transpose(0, 2, 3, 1), SCORES.transpose(0, 2, 1)
        file.attrs["transpose"] = False

    for write in (analysis, standard, unturned):
        contents, problems = read(tmp_path, written(write))
        assert not problems
        assert contents.forms == {"SLEAP"}
        assert list(contents.frames) == [0, 1, 2, 3]
        assert contents.own == ("Hat",)
        frames, own = split_own(contents.frames, contents.own, contents.own)
        np.testing.assert_array_equal(own.of_people[1][:, 0, :2], POSITIONS[1, :, 5])
        for number, people in frames.items():
            taken = COCO_17.indices(("nose", "left_shoulder", "right_shoulder", "left_hip", "right_hip"))
            np.testing.assert_array_equal(people[:, taken, :2], POSITIONS[number, :, :5])
            np.testing.assert_array_equal(people[:, taken, 2], SCORES[number, :, :5])


def test_points_without_scores_and_tracks_that_are_not_seen(tmp_path: Path) -> None:
    positions, scores = POSITIONS.copy(), SCORES.copy()
    positions[1, 0] = positions[2] = np.nan
    scores[3, 1, 1] = np.nan
    contents, _ = read(tmp_path, written(lambda file: analysis(file, positions, scores)))
    frames, _ = split_own(contents.frames, contents.own, contents.own)
    assert [len(people) for people in frames.values()] == [2, 1, 0, 2]
    np.testing.assert_array_equal(frames[1][0, 0], [*POSITIONS[1, 1, 0], SCORES[1, 1, 0]])
    assert frames[3][1, 5, 2] == 1.0  # labelled by hand
    without, _ = read(tmp_path, written(lambda file: analysis(file, scores=None)))
    assert without.frames[0][0, 0].tolist() == [10.0, 11.0, 1.0]


def test_table_without_likelihood_and_with_several_blocks(tmp_path: Path) -> None:
    columns = [("us", name.decode(), coord) for name in NAMES for coord in ("x", "y")]
    values = POSITIONS[:, 0].reshape(4, 12)

    def write(file: h5py.File) -> None:
        kinds = [("index", "S40"), ("values_block_0", "<f4", (2,)), ("values_block_1", "<i8", (10,))]
        table = np.zeros(4, kinds)
        table["index"] = [f"labeled-data/walk/img{number:03d}.png".encode() for number in (7, 8, 11, 12)]
        table["values_block_0"], table["values_block_1"] = values[:, 10:], values[:, :10]
        for name in ("notes", "df_with_missing"):
            file.create_group(name).attrs["pandas_type"] = np.bytes_("frame_table")
        stored = file["df_with_missing"].create_dataset("table", data=table)
        stored.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(columns[10:], 0))
        stored.attrs["values_block_1_kind"] = np.bytes_(pickle.dumps(columns[:10], 4))

    contents, problems = read(tmp_path, written(write))
    assert not problems
    assert contents.forms == {"DeepLabCut"}
    assert list(contents.frames) == [7, 8, 11, 12]
    np.testing.assert_array_equal(contents.frames[11][0, 0], [*POSITIONS[2, 0, 0], 1.0])
    np.testing.assert_array_equal(contents.frames[12][0, 12, :2], POSITIONS[3, 0, 4])


def test_of_csv_and_hdf5_with_one_name_csv_is_read(tmp_path: Path) -> None:
    lines = ["scorer,us,us,us,us,us,us,us,us", "bodyparts,LHip,LHip,RHip,RHip,LShoulder,LShoulder,RShoulder,RShoulder"]
    lines += ["coords,x,y,x,y,x,y,x,y", "0,1,2,3,4,5,6,7,8"]
    (tmp_path / "cam").mkdir()
    (tmp_path / "cam" / "take.csv").write_text("\n".join(lines))
    contents, problems = read(tmp_path, written(analysis))
    assert not problems
    assert contents.forms == {"DeepLabCut"}
    assert len(contents.frames) == 1
    _, problems = read(tmp_path, written(analysis), "take_filtered.h5")
    assert "take.csv, take_filtered.h5" in problems[0].message


def test_data_in_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other.h5").write_bytes(written(analysis))
    (tmp_path / "other.raw").write_bytes(POSITIONS.tobytes())
    shape = POSITIONS.transpose(1, 3, 2, 0).shape

    def linked(file: h5py.File) -> None:
        file["node_names"], file["tracks"] = NAMES, h5py.ExternalLink(str(tmp_path / "other.h5"), "/tracks")

    def virtual(file: h5py.File) -> None:
        layout = h5py.VirtualLayout(shape, "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "tracks", shape)
        file["node_names"] = NAMES
        file.create_virtual_dataset("tracks", layout)

    def external(file: h5py.File) -> None:
        file["node_names"] = NAMES
        file.create_dataset("tracks", shape, "f8", external=[(str(tmp_path / "other.raw"), 0, h5py.h5f.UNLIMITED)])

    def soft(file: h5py.File) -> None:
        analysis(file)
        file["elsewhere"] = file["tracks"]
        del file["tracks"]
        file["tracks"] = h5py.SoftLink("/elsewhere")

    assert "tracks of the HDF5 file lies in another file" in refused(tmp_path, linked)
    assert "tracks of the HDF5 file lies in other files" in refused(tmp_path, virtual)
    assert "tracks of the HDF5 file lies in other files" in refused(tmp_path, external)
    assert "tracks of the HDF5 file is a link" in refused(tmp_path, soft)


def test_sizes_are_looked_at_first(tmp_path: Path) -> None:
    def vast(file: h5py.File) -> None:  # nothing of it is stored
        file["node_names"] = NAMES
        file.create_dataset("tracks", (9_000, 2, 6, 10_000), "f8", chunks=(1, 2, 6, 100), compression="gzip")

    def in_vast_chunks(file: h5py.File) -> None:
        file["node_names"] = NAMES
        chunks = (400, 2, 6, 10_000)
        file.create_dataset("tracks", (2, 2, 6, 40), "f8", maxshape=(None, 2, 6, None), chunks=chunks)

    def packed(file: h5py.File) -> None:
        file["node_names"] = NAMES
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk((2, 2, 6, 4))
        properties.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, (1,))
        space = h5py.h5s.create_simple((2, 2, 6, 4))
        h5py.h5d.create(file.id, b"tracks", h5py.h5t.IEEE_F64LE, space, properties)

    def of_a_million_frames(file: h5py.File) -> None:
        file["node_names"] = NAMES
        file.create_dataset("tracks", (1, 2, 6, 1_000_001), "f8", chunks=(1, 1, 1, 10_000), compression="gzip")

    assert "tracks of the HDF5 file is too large: 512 MiB" in refused(tmp_path, vast)
    assert "tracks of the HDF5 file is too large" in refused(tmp_path, in_vast_chunks)
    assert "a filter that is not read; write the file again" in refused(tmp_path, packed)
    assert "1,000,001 frames" in refused(tmp_path, of_a_million_frames)


class _Harmful:
    def __reduce__(self) -> Any:
        return os.system, ("echo harm >&2; exit 3",)


def table_with(labels: Any, file: h5py.File, index: list[int] | None = None, key: str = "tracks") -> h5py.File:
    table = np.zeros(2, [("index", "<i8"), ("values_block_0", "<f8", (8,))])
    table["index"] = index or [0, 1]
    file.create_group(key).attrs["pandas_type"] = np.bytes_("frame_table")
    stored = file[key].create_dataset("table", data=table)
    stored.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(labels, 2))
    return file


PARTS = [("us", name.decode(), coord) for name in NAMES[1:5] for coord in ("x", "y")]
HAT = [("us", "Hat", "x"), ("us", "Hat", "y")]


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda file: table_with([_Harmful()] * 8, file), "is not a keypoint file"),
        (lambda file: table_with([*PARTS[:6], *HAT], file), "shoulders and hips are required"),
        (lambda file: table_with([*PARTS, ("us", "Nose", "x")], file), "is not a keypoint file"),
        (lambda file: table_with([(1, 2, 3)] * 8, file), "must be texts"),
        (lambda file: table_with([("us", "x")] * 8, file), "must have the levels"),
        (lambda file: table_with([PARTS[0], *PARTS[:7]], file), "the same headers"),
        (lambda file: table_with(PARTS, file, [4, 4]), "Frame 4 is listed twice"),
        (lambda file: table_with(PARTS, file, [-1, 4]), "at most 15 digits"),
        (lambda file: table_with(PARTS, table_with(PARTS, file), key="b"), "several tables: b, tracks"),
        (lambda file: file.create_group("df").attrs.create("pandas_type", np.bytes_("frame")), "is not a keypoint"),
        (lambda file: analysis(file, POSITIONS[..., :1]), "tracks is 2 x 1 x 6 x 4"),
        (lambda file: analysis(file, scores=SCORES[:3]), "other sizes"),
        (lambda file: analysis(file)["tracks"].attrs.create("dims", "[1]"), "must list the axes"),
        (lambda file: analysis(file)["tracks"].attrs.create("dims", "["), "is not a keypoint file"),
        (lambda file: file.update({"tracks": [1.0], "node_names": [1]}), "not texts"),
        (lambda file: file.update({"node_names": NAMES, "tracks/a": [1]}), "is not a keypoint file"),
        (lambda file: file.update(dict.fromkeys(("instances", "points", "pred_points"), 1)), "SLEAP's project"),
        (lambda file: file.create_dataset("poseest", data=[1]), "SLEAP's tracks; it has poseest"),
        (lambda file: None, "it has nothing"),
    ],
    ids=map(str, range(100)),
)  # fmt: skip
@pytest.mark.usefixtures("here")
def test_files_that_cant_be_used_say_why(tmp_path: Path, write: Callable[[h5py.File], Any], words: str) -> None:
    message = refused(tmp_path, write)
    assert words in message


def test_group_that_contains_itself_is_no_matter(tmp_path: Path) -> None:
    def write(file: h5py.File) -> None:
        file["self"] = file["/"]
        analysis(file)

    contents, problems = read(tmp_path, written(write))
    assert not problems
    assert len(contents.frames) == 4


@pytest.mark.parametrize(
    "content",
    [b"", b"\x89HDF\r\n\x1a\n", b"scorer,a\n", written(analysis)[:3000]],
    ids=["empty", "signature", "text", "truncated"],
)
def test_files_that_are_no_hdf5(tmp_path: Path, content: bytes) -> None:
    _, (problem,) = read(tmp_path, content)
    assert problem.code == "keypoints_unreadable"
    assert "not a keypoint file of a known format" in problem.message


@pytest.mark.parametrize("program", slow_but(("SLEAP",), ("DeepLabCut, HDF5", "DeepLabCut, HDF5 of pictures", "SLEAP")))
def test_damaged_files_are_read_or_refused(tmp_path: Path, program: str) -> None:
    rng = np.random.default_rng(11)
    simulation = record(replace(find_scene("room"), duration_s=1.0), seed=4, num_views=2)
    (whole,) = keypoint_files(simulation, program)[simulation.cameras[0].name].values()
    # Structure lies at the beginning, and around the names of links and attributes.
    places = [whole.find(word) for word in (b"TREE", b"SNOD", b"HEAP", b"tracks", b"kind", b"table", b"GCOL")]
    starts = [0, *(place for place in places if place >= 0)]
    for number in range(100):
        damaged = bytearray(whole)
        for _ in range(rng.integers(1, 8)):
            at = int(rng.choice(starts) + rng.integers(300)) if rng.random() < 0.7 else int(rng.integers(len(whole)))
            damaged[at : at + 1] = bytes([rng.choice([0, 1, 255, int(rng.integers(256))])])
        (tmp_path / f"{number}.h5").write_bytes(
            damaged[: int(rng.integers(len(whole)))] if number % 20 == 0 else damaged
        )
    root = Path(hdf5_files.__file__).parents[4]
    driver = python_command("-m", "tests.pipeline.capture.keypoint_files.hdf5_files", str(tmp_path))
    run = subprocess.run(driver, capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": str(root)})
    endings = json.loads(run.stdout)
    assert len(endings) == 100
    assert set(endings) <= {"read", "problem", "limit"}
    assert endings.count("problem") > 20
