"""Rendered captures: reader of the ground truth, and scores."""

import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.datasets.rendered import (
    RenderedTruth,
    load_rendered,
    score_covered_heads,
    score_rendered,
)
from tests.pipeline.export.test_overlay import CAMERA
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

Arrays = dict[str, np.ndarray]


def truth_arrays(num_frames: int = 10, fps: float = 25.0) -> Arrays:
    """Ground truth of two people who walk side by side."""
    rng = np.random.default_rng(5)
    body = rng.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (17, 3))
    time = np.arange(num_frames) / fps
    starts = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    walk = time[:, None] * np.array([0.0, 1.0, 0.0])
    return {
        "joints": (body + starts[:, None, None] + walk[None, :, None]).astype(np.float32),
        "names": np.array(COCO_17.names),
        "time": time,
    }


def write_capture(folder: Path, arrays: Arrays) -> Path:
    (folder / "videos").mkdir()
    (folder / "calibration.toml").write_text("", encoding="utf-8")
    np.savez(folder / "gt.npz", allow_pickle=False, **arrays)
    return folder


def tracks_of(arrays: Arrays) -> list[Track3D]:
    xyz_m = arrays["joints"].astype(float)
    shape = xyz_m.shape[1:3]
    return [
        Track3D(k + 1, 0, one, np.ones(shape), np.full(shape, Source.MEASURED), np.ones(shape), np.full(shape, 4))
        for k, one in enumerate(xyz_m)
    ]


def test_truth_is_read(tmp_path: Path) -> None:
    arrays = truth_arrays()
    truth = load_rendered(write_capture(tmp_path, arrays))
    np.testing.assert_allclose(truth.xyz_m, arrays["joints"])
    assert truth.names == COCO_17.names
    assert not truth.xyz_m.flags.writeable


def test_scores_have_documented_keys_and_values(tmp_path: Path) -> None:
    arrays = truth_arrays()
    truth = load_rendered(write_capture(tmp_path, arrays))
    tracks = tracks_of(arrays)
    scores = score_rendered(tracks[:1], COCO_17, Timebase(0.0, 25.0, 10), truth)
    assert list(scores) == ["mpjpe_mm", "pck150", "recall", "switches", "ghost_rate", "uncertainty_z"]
    assert scores["uncertainty_z"] is None
    assert scores["mpjpe_mm"] == pytest.approx(0.0, abs=1e-4)
    assert (scores["pck150"], scores["recall"], scores["switches"], scores["ghost_rate"]) == (0.5, 0.5, 0, 0.0)


def test_uncertainty_z_is_ratio_of_errors_to_stated_deviations(tmp_path: Path) -> None:
    arrays = truth_arrays()
    truth = load_rendered(write_capture(tmp_path, arrays))
    arrays["joints"] += np.array([0.0, 0.0, 0.03], np.float32)
    stated_m = np.full(arrays["joints"].shape[1:3], 0.01)
    stated_m[:, :5] = 1.0  # the face does not count
    tracks = [replace(track, uncertainty_m=stated_m) for track in tracks_of(arrays)]
    scores = score_rendered(tracks, COCO_17, Timebase(0.0, 25.0, 10), truth)
    assert scores["uncertainty_z"] == pytest.approx(np.sqrt(3.0), rel=1e-3)


def test_face_does_not_count(tmp_path: Path) -> None:
    arrays = truth_arrays()
    truth = load_rendered(write_capture(tmp_path, arrays))
    arrays["joints"][:, :, :5] += 3.0
    assert score_rendered(tracks_of(arrays), COCO_17, Timebase(0.0, 25.0, 10), truth)["pck150"] == 1.0


def test_frames_are_matched_by_time(tmp_path: Path) -> None:
    truth = load_rendered(write_capture(tmp_path, truth_arrays()))
    # Output at twice the rate, from a tenth of a second on: truth's frames 0-2 come before it.
    late = truth_arrays(num_frames=14, fps=50.0)
    late["joints"] += np.array([0.0, 0.12, 0.0], np.float32)
    scores = score_rendered(tracks_of(late), COCO_17, Timebase(0.12, 50.0, 14), truth)
    assert scores["mpjpe_mm"] == pytest.approx(0.0, abs=1e-3)
    assert scores["recall"] == pytest.approx(0.7)


def without(key: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {name: array for name, array in arrays.items() if name != key}


def changed(**changes: np.ndarray) -> Callable[[Arrays], Arrays]:
    return lambda arrays: arrays | changes


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (without("joints"), "joints"),
        (without("time"), "time"),
        (changed(names=np.arange(17)), "names"),
        (changed(names=np.array([f"joint{k}" for k in range(17)])), "names"),
        (changed(time=np.zeros(10)), "time"),
        (changed(time=np.full(10, np.nan)), "time"),
        (changed(time=np.arange(9.0)), "joints"),
        (changed(joints=np.zeros((2, 10, 17, 2))), "joints"),
        (changed(joints=np.full((2, 10, 17, 3), np.inf)), "joints"),
        (changed(joints=np.zeros((2, 10, 17, 3), dtype=np.int64)), "joints"),
    ],
)
def test_bad_truth_is_named(tmp_path: Path, change: Callable[[Arrays], Arrays], field: str) -> None:
    with pytest.raises(InputError) as caught:
        load_rendered(write_capture(tmp_path, change(truth_arrays())))
    assert {problem.field for problem in caught.value.problems} == {field}
    assert {problem.file for problem in caught.value.problems} == {"gt.npz"}


BONE_NAMES = np.array(["Hips", "LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase"])


def test_feet_are_read_from_bones(tmp_path: Path) -> None:
    assert load_rendered(write_capture(tmp_path, truth_arrays())).feet_m is None
    bones = np.random.default_rng(1).uniform(-1, 1, (2, 10, 5, 3)).astype(np.float32)
    np.savez(tmp_path / "gt.npz", allow_pickle=False, **truth_arrays(), bones=bones, bone_names=BONE_NAMES)
    feet_m = load_rendered(tmp_path).feet_m
    assert feet_m is not None
    np.testing.assert_array_equal(feet_m[:, :, 0], bones[:, :, [1, 3]])
    np.testing.assert_array_equal(feet_m[:, :, 1], bones[:, :, [2, 4]])
    np.savez(
        tmp_path / "gt.npz", allow_pickle=False, **truth_arrays(), bones=bones[:, :, :3], bone_names=BONE_NAMES[:3]
    )
    assert load_rendered(tmp_path).feet_m is None


@pytest.mark.parametrize(
    ("bones", "names", "field"),
    [
        (np.zeros((2, 9, 5, 3)), BONE_NAMES, "bones"),
        (np.full((2, 10, 5, 3), np.inf), BONE_NAMES, "bones"),
        (np.zeros((2, 10, 5, 3)), np.arange(5), "bone_names"),
    ],
)
def test_bad_bones_are_named(tmp_path: Path, bones: np.ndarray, names: np.ndarray, field: str) -> None:
    folder = write_capture(tmp_path, truth_arrays() | {"bones": bones, "bone_names": names})
    with pytest.raises(InputError) as caught:
        load_rendered(folder)
    assert [problem.field for problem in caught.value.problems] == [field]


def test_all_missing_parts_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_rendered(tmp_path)
    assert [problem.file for problem in caught.value.problems] == ["videos", "calibration.toml", "gt.npz"]
    assert str(tmp_path) not in str(caught.value)


def test_pickles_are_refused(tmp_path: Path) -> None:
    folder = write_capture(tmp_path, truth_arrays())
    np.savez(folder / "gt.npz", allow_pickle=True, **(truth_arrays() | {"names": np.array([{}], dtype=object)}))
    with pytest.raises(InputError, match="plain arrays"):
        load_rendered(folder)


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04 cut"])
def test_broken_archives_are_refused(tmp_path: Path, content: bytes) -> None:
    folder = write_capture(tmp_path, truth_arrays())
    (folder / "gt.npz").write_bytes(content)
    with pytest.raises(InputError, match="plain arrays"):
        load_rendered(folder)


def test_header_that_promises_more_than_memory_is_refused(tmp_path: Path) -> None:
    folder = write_capture(tmp_path, truth_arrays())
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000, 17, 3), }\n"
    with zipfile.ZipFile(folder / "gt.npz", "w") as archive:
        for key in ("joints", "names", "time"):
            archive.writestr(f"{key}.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    with pytest.raises(InputError, match="plain arrays"):
        load_rendered(folder)


NUM_FRAMES, RATE_HZ = 20, 25.0
TIME_S = np.arange(NUM_FRAMES) / RATE_HZ
WALK_M = walker(NUM_FRAMES, RATE_HZ) - np.array([1.0, 2.0, 0.0])
TRUTH = RenderedTruth(COCO_17.names, TIME_S, np.stack([WALK_M, WALK_M + np.array([0.8, 0.0, 0.0])]))


def take(*xyz_m: np.ndarray) -> Reconstruction:
    tracks = tuple(track_of(person_m, number) for number, person_m in enumerate(xyz_m, 1))
    timebase = Timebase(0.0, RATE_HZ, NUM_FRAMES)
    return Reconstruction((CAMERA,), COCO_17, timebase, tracks, (), Animation(tracks, (), None))


@pytest.mark.parametrize(("num_found", "share"), [(0, 0.0), (1, 0.5), (2, 1.0)])
def test_each_head_counts(num_found: int, share: float) -> None:
    found = take(*TRUTH.xyz_m[:num_found])
    assert score_covered_heads(found, {"front": FrameTimes(TIME_S)}, TRUTH)["heads_covered"] == pytest.approx(share)


def test_only_heads_in_picture_at_known_times_count() -> None:
    found = take(WALK_M)
    far = replace(TRUTH, xyz_m=np.stack([WALK_M, WALK_M + np.array([9.0, 0.0, 0.0])]))
    assert score_covered_heads(found, {"front": FrameTimes(TIME_S)}, far)["heads_covered"] == 1.0
    late = FrameTimes(TIME_S + 100.0)
    assert score_covered_heads(found, {"front": late}, TRUTH)["heads_covered"] is None
