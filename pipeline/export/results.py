"""The files that a reconstruction leaves, by name; the service's results bear the same names."""

import contextlib
import errno
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

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
    for export, limit in too_long_for(exports, num_frames):
        message = f"A {export.upper()} file holds {limit} frames at most; the session has {num_frames}."
        others = " and ".join(unlimited_alternatives(export))
        hint = f"Leave {export} away: {others} have the same {FILE_FORMATS[export].holds} and no such limit."
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
            person = Person(track, motion, shown.joints, shown.timebase, path.name, preset)
            expected_m = skeleton_m if FILE_FORMATS[export].holds == "motion" else track.xyz_m
            with _replacing(path, FORMATS[export].encode(person)) as part:
                on_read = _of_reading(next(parts))
                found_m = FORMATS[export].read_xyz_m(part, preset)
                far_mm[export].append(_furthest_mm(path, expected_m, found_m, on_read))
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
