"""The files that a reconstruction leaves, by name; the service's results bear the same names."""

import contextlib
import errno
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.config import Export, Preset
from pipeline.data import Reconstruction, SkeletonMotion, Timebase, Track3D
from pipeline.errors import InputError, Problem
from pipeline.export import bvh, c3d_file, csv_table, glb, skeletons_json, trc
from pipeline.export.presets import PRESETS
from pipeline.export.resample import resample, resampled_timebase
from pipeline.metrics.quality import encode as encode_metrics
from pipeline.metrics.quality import quality_report
from pipeline.progress import OnShare, ignore, part_of, split
from pipeline.quantities import MAX_OUTPUT_FRAMES
from pipeline.skeleton.model import forward_kinematics

DEFAULT_EXPORTS: tuple[Export, ...] = ("bvh",)
METRICS = "metrics.json"

# Of a skeleton's motion; the other formats hold positions of joints.
_OF_MOTIONS: frozenset[Export] = frozenset({"bvh", "glb"})
_MM_PER_M = 1000.0
_DECIMALS_MM = 4


def check_exports(timebase: Timebase, exports: Collection[Export], frame_rate_hz: float | None = None) -> None:
    """Check that files can hold a session.

    Parameters
    ----------
    frame_rate_hz
        Of the motion in the files; ``None``: the session's.

    Raises
    ------
    InputError
        If there are more frames than files hold, or than a format does.
    """
    num_frames = (timebase if frame_rate_hz is None else resampled_timebase(timebase, frame_rate_hz)).num_frames
    problems = []
    if num_frames > MAX_OUTPUT_FRAMES:
        message = f"At this rate the session has {num_frames:,} frames; at most {MAX_OUTPUT_FRAMES:,} are written."
        hint = "Ask for a lower rate, or for fewer frames."
        problems.append(Problem("too_many_frames", message, field="output_rate_hz", hint=hint))
    if "c3d" in exports and num_frames > c3d_file.MAX_FRAMES:
        message = f"A C3D file holds {c3d_file.MAX_FRAMES} frames at most; the session has {num_frames}."
        hint = "Leave c3d away: trc and csv have the same joints and no such limit."
        problems.append(Problem("too_long_for_c3d", message, field="exports", hint=hint))
    if problems:
        raise InputError(problems)


def write_results(
    reconstruction: Reconstruction,
    folder: Path,
    exports: Collection[Export] = DEFAULT_EXPORTS,
    preset: Preset = "default",
    frame_rate_hz: float | None = None,
    on_share: OnShare = ignore,
) -> Iterator[Path]:
    """Write all result files into a folder, which is made if it is missing; yields each as soon as it is there.

    Each is written and read back under a temporary name first, so that no file bears its name that is not whole:
    ``metrics.json``, the last one, says how far joints then are from where they should be, at most.

    Parameters
    ----------
    exports
        Formats of which everybody gets a file, beside the two files of all.
    preset
        How BVH files name, turn and scale the skeleton.
    frame_rate_hz
        Of the motion in all files; ``None``: the session's. What ``metrics.json`` measures is at the session's.
    on_share
        Called while files are read back, and after each file.

    Raises
    ------
    InputError
        As ``check_exports``.
    OSError
        If the folder can't be written to, the disk is full, or a file does not hold what was written.
    """
    check_exports(reconstruction.timebase, exports, frame_rate_hz)
    shown = reconstruction if frame_rate_hz is None else resample(reconstruction, frame_rate_hz)
    folder.mkdir(parents=True, exist_ok=True)
    formats = tuple(dict.fromkeys(exports))
    far_mm: dict[str, list[float | None]] = {"skeletons": [], **{export: [] for export in formats}}
    num_frames = [track.num_frames for track in shown.tracks]
    parts = iter(split(on_share, [sum(num_frames), *(num for num in num_frames for _ in formats), 1 + sum(num_frames)]))
    path = folder / "skeletons.json"
    on_people = iter(split(_of_reading(next(parts)), num_frames))
    with _replacing(path, skeletons_json.encode(shown)) as part:
        for track, read_m in zip(shown.tracks, skeletons_json.read_xyz_m(part), strict=True):
            far_mm["skeletons"].append(_furthest_mm(path, track.xyz_m, [read_m], next(on_people)))
    yield path
    for track, motion in zip(shown.tracks, shown.motions, strict=True):
        skeleton_m = forward_kinematics(motion)
        for export in formats:
            path = folder / f"{motion.name}.{export}"
            expected_m = skeleton_m if export in _OF_MOTIONS else track.xyz_m
            with _replacing(path, _encode(export, shown, track, motion, path.name, preset)) as part:
                on_read = _of_reading(next(parts))
                far_mm[export].append(_furthest_mm(path, expected_m, _read(export, part, preset), on_read))
            yield path
    check = {export: {"max_distance_mm": _largest(everybody)} for export, everybody in far_mm.items()}
    path = folder / METRICS
    with _replacing(path, [encode_metrics(quality_report(reconstruction) | {"exports": check})]):
        pass
    on_share(1.0)
    yield path


def _of_reading(on_share: OnShare) -> OnShare:
    """Report how far a file is read back: writing it takes about as long."""
    return part_of(on_share, 0.5, 1.0)


@contextlib.contextmanager
def _replacing(path: Path, pieces: Iterable[bytes]) -> Iterator[Path]:
    """Write a file beside ``path``, to be looked at in the block; it gets its name after that, unless that fails."""
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as file:
            file.writelines(pieces)
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _encode(
    export: Export, reconstruction: Reconstruction, track: Track3D, motion: SkeletonMotion, name: str, preset: Preset
) -> Iterator[bytes]:
    joints, timebase = reconstruction.joints, reconstruction.timebase
    match export:
        case "bvh":
            return bvh.encode(motion, PRESETS[preset])
        case "glb":
            return glb.encode(motion)
        case "trc":
            return trc.encode(track, joints, timebase, name)
        case "c3d":
            return c3d_file.encode(track, joints, timebase)
        case "csv":
            return csv_table.encode(track, joints, timebase)


def _read(export: Export, path: Path, preset: Preset) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    if export == "bvh":
        return bvh.read_xyz_m(path, PRESETS[preset])
    read = {"glb": glb, "trc": trc, "c3d": c3d_file, "csv": csv_table}[export]
    return read.read_xyz_m(path)


def _furthest_mm(
    path: Path,
    expected_m: Float[np.ndarray, "frames joints 3"],
    read_m: Iterable[Float[np.ndarray, "_ joints 3"]],
    on_share: OnShare,
) -> float | None:
    """Largest distance of what was read of a person's file, some frames at a time, from what should be there.

    Returns
    -------
        ``None`` if no joint is known in any frame.
    """
    spoilt = OSError(errno.EIO, f"{path.name} does not hold what was written to it")
    num_read, far_m = 0, []
    for block_m in read_m:
        expected_block_m = expected_m[num_read : num_read + len(block_m)]
        num_read += len(block_m)
        if block_m.shape != expected_block_m.shape:
            raise spoilt
        known, found = np.isfinite(expected_block_m).all(-1), np.isfinite(block_m).all(-1)
        if (known != found).any():
            raise spoilt
        if known.any():
            far_m.append(np.linalg.norm((block_m - expected_block_m)[known], axis=-1).max())
        on_share(num_read / len(expected_m))
    if num_read != len(expected_m):
        raise spoilt
    return float(max(far_m)) * _MM_PER_M if far_m else None


def _largest(values: Iterable[float | None]) -> float | None:
    largest = max((value for value in values if value is not None), default=None)
    return None if largest is None else round(largest, _DECIMALS_MM)
