"""Write the result files of a reconstruction; the service's results have the same names."""

import contextlib
import errno
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.calibration.write import encode as encode_calibration
from pipeline.config import (
    FILE_FORMATS,
    MAX_OUTPUT_FRAMES,
    Export,
    JobChoices,
    Preset,
    too_long_for,
    unlimited_alternatives,
)
from pipeline.data import Reconstruction, Timebase
from pipeline.errors import InputError, Problem
from pipeline.export.formats import FORMATS, Person
from pipeline.export.resample import resample, resampled_timebase
from pipeline.export.writers import skeletons_json
from pipeline.progress import OnShare, ignore, part_of, split
from pipeline.quality.report import encode as encode_metrics
from pipeline.quality.report import quality_report
from pipeline.skeleton.model import forward_kinematics

DEFAULT_EXPORTS: tuple[Export, ...] = JobChoices().exports
METRICS = "metrics.json"
CALIBRATION = "calibration.json"
"""Refined cameras, in the format that ``pipeline.calibration.write`` writes and every command reads."""

_MM_PER_M = 1000.0
_DECIMALS_MM = 4


def check_exports(timebase: Timebase, exports: Collection[Export], frame_rate_hz: float | None = None) -> None:
    """Check that the number of frames is within the limits of result files.

    Parameters
    ----------
    frame_rate_hz
        Rate of the motion in the files; ``None``: the session's rate.

    Raises
    ------
    InputError
        If there are more frames than any result, or one of the formats, may have.
    """
    num_frames = (timebase if frame_rate_hz is None else resampled_timebase(timebase, frame_rate_hz)).num_frames
    problems = []
    if num_frames > MAX_OUTPUT_FRAMES:
        message = f"At this rate the session has {num_frames:,} frames; at most {MAX_OUTPUT_FRAMES:,} are allowed."
        hint = "Choose a lower rate or fewer frames."
        problems.append(Problem("too_many_frames", message, field="output_rate_hz", hint=hint))
    for export, limit in too_long_for(exports, num_frames):
        message = f"A {export.upper()} file holds {limit} frames at most; the session has {num_frames}."
        others = " and ".join(unlimited_alternatives(export))
        hint = f"Omit {export}: {others} have the same {FILE_FORMATS[export].holds} and no such limit."
        problems.append(Problem(f"too_long_for_{export}", message, field="exports", hint=hint))
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
    """Write all result files into a folder, which is created if missing; yield each path when its file is complete.

    Each file is written and read back under a temporary name, so that no incomplete file has its final name.
    ``calibration.json`` is written if the calibration was refined. ``metrics.json`` is the last file. It contains the
    largest distance, for each format, between joints read back and their true positions.

    Parameters
    ----------
    exports
        Formats of the files of each person. ``skeletons.json`` and ``metrics.json`` are always written.
    preset
        Convention of BVH files.
    frame_rate_hz
        Rate of the motion in all files; ``None``: the session's rate. The figures in ``metrics.json`` are always at the
        session's rate.
    on_share
        Called with the progress while files are read back, and after each file.

    Raises
    ------
    InputError
        See ``check_exports``.
    OSError
        If the folder can't be written to, the disk is full, or the content of a file differs from the written content.
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
            path = folder / f"person-{track.track_id}.{export}"
            person = Person(track, motion, shown.joints, shown.timebase, path.name, preset)
            expected_m = skeleton_m if FILE_FORMATS[export].holds == "motion" else track.xyz_m
            with _replacing(path, FORMATS[export].encode(person)) as part:
                on_read = _of_reading(next(parts))
                found_m = FORMATS[export].read_xyz_m(part, preset)
                far_mm[export].append(_furthest_mm(path, expected_m, found_m, on_read))
            yield path
    check = {export: {"max_distance_mm": _largest(everybody)} for export, everybody in far_mm.items()}
    if reconstruction.refinement is not None and reconstruction.refinement.has_new_cameras:
        path = folder / CALIBRATION
        with _replacing(path, [encode_calibration(reconstruction.cameras)]):
            pass
        yield path
    path = folder / METRICS
    with _replacing(path, [encode_metrics(quality_report(reconstruction) | {"exports": check})]):
        pass
    on_share(1.0)
    yield path


def _of_reading(on_share: OnShare) -> OnShare:
    """Progress of reading a file back: the second half, because writing takes about as long."""
    return part_of(on_share, 0.5, 1.0)


@contextlib.contextmanager
def _replacing(path: Path, pieces: Iterable[bytes]) -> Iterator[Path]:
    """Write a file under a temporary name for the block; rename it to ``path`` if the block succeeds."""
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as file:
            file.writelines(pieces)
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _furthest_mm(
    path: Path,
    expected_m: Float[np.ndarray, "frames joints 3"],
    read_m: Iterable[Float[np.ndarray, "_ joints 3"]],
    on_share: OnShare,
) -> float | None:
    """Largest distance in mm between positions read from a person's file, block by block, and the expected positions.

    Returns
    -------
        ``None`` if no joint is known in any frame.

    Raises
    ------
    OSError
        If shapes or unknown joints differ.
    """
    spoilt = OSError(errno.EIO, f"{path.name} does not hold what was written to it")
    num_read, far_m = 0, []
    for block_m in read_m:
        expected_block_m = expected_m[num_read : num_read + len(block_m)]
        num_read += len(block_m)
        if block_m.shape != expected_block_m.shape:
            raise spoilt
        known, known_in_file = np.isfinite(expected_block_m).all(-1), np.isfinite(block_m).all(-1)
        if (known != known_in_file).any():
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
