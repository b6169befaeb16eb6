"""Rendered captures with exact ground truth: folders with ``videos/``, ``calibration.toml`` and ``gt.npz``."""

import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import SeenHeads
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import DATASET_INCOMPLETE, TRUTH_UNREADABLE
from pipeline.export.privacy.heads import FACE, head_path, head_regions
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, GATE_M, UNMATCHED, accuracy, match_frames, select_joints

_TRUTH_FILE = "gt.npz"
_KEYS = ("joints", "names", "time")
_BONE_KEYS = ("bones", "bone_names")
_FOOT_BONES = (("LeftFoot", "LeftToeBase"), ("RightFoot", "RightToeBase"))
# Limit of the arrays' size: an hour of ten people at 50 frames a second.
_MAX_BYTES = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class RenderedTruth:
    """Ground truth of a rendered capture."""

    names: tuple[str, ...]  # Names of the joints
    time_s: Float[np.ndarray, " frames"]  # Times of the truth on the session's clock, ascending
    xyz_m: Float[np.ndarray, "people frames joints 3"]  # World positions of the joints, NaN where a person is absent
    # World positions of ankle and toe base of the left and of the right foot; ``None`` if the truth has no bones
    feet_m: Float[np.ndarray, "people frames 2 2 3"] | None = None


def load_rendered(folder: Path) -> RenderedTruth:
    """Read the truth of a rendered capture.

    Raises ``InputError`` if a part of the folder is missing, or the truth is incomplete or inconsistent.
    """
    problems = [
        Problem(DATASET_INCOMPLETE, "A part of the rendered capture is missing.", file=name, hint=hint)
        for name, present, hint in (
            ("videos", (folder / "videos").is_dir(), "Expected a folder with one video a camera."),
            ("calibration.toml", (folder / "calibration.toml").is_file(), "Expected the cameras' calibration."),
            (_TRUTH_FILE, (folder / _TRUTH_FILE).is_file(), "Expected the true joints as a NumPy archive."),
        )
        if not present
    ]
    arrays: dict[str, np.ndarray] = {}
    if (folder / _TRUTH_FILE).is_file():
        arrays, unreadable = _read_arrays(folder / _TRUTH_FILE)
        problems += unreadable or _contradictions(arrays)
    if problems:
        raise InputError(problems)
    return RenderedTruth(
        names=tuple(str(name) for name in arrays["names"]),
        time_s=read_only(arrays["time"].astype(np.float64)),
        xyz_m=read_only(arrays["joints"].astype(np.float64)),
        feet_m=_feet_m(arrays),
    )


def score_rendered(
    tracks: Sequence[Track3D], joints: JointSet, timebase: Timebase, truth: RenderedTruth
) -> dict[str, Any]:
    """Score tracks on the twelve body joints by the metrics of ``pipeline.validation.evaluation.mpjpe``.

    Each instant of the truth is compared with the nearest output frame within half a period. An instant without such a
    frame has no predictions. Returns ``mpjpe_mm``, ``pck150``, ``recall``, ``switches`` and ``ghost_rate``; and
    ``uncertainty_z``, the root mean square of errors over stated standard deviations. ``None`` for a figure without
    data.
    """
    position = np.rint((truth.time_s - timebase.start_time_s) * timebase.frame_rate_hz)
    inside = (position >= 0) & (position < timebase.num_frames)
    frames = np.where(inside, position, -1).astype(np.int64)
    columns = [truth.names.index(name) for name in BODY_JOINTS]
    predicted_m = select_joints(tracks, joints, BODY_JOINTS, frames)
    truth_m = truth.xyz_m[:, :, columns]
    ratio = None
    stated = [
        replace(track, xyz_m=np.stack([track.uncertainty_m] * 3, axis=-1))
        for track in tracks
        if track.uncertainty_m is not None
    ]
    if stated and len(stated) == len(tracks):
        stated_m = select_joints(stated, joints, BODY_JOINTS, frames)
        matched = match_frames(predicted_m, truth_m, GATE_M)
        people, instants = np.nonzero(matched != UNMATCHED)
        found = matched[people, instants], instants
        ratios = (predicted_m[found] - truth_m[people, instants]) / stated_m[found]
        ratio = float(np.sqrt(np.nanmean(ratios**2))) if np.isfinite(ratios).any() else None
    return asdict(accuracy(predicted_m, truth_m, GATE_M)) | {"uncertainty_z": ratio}


def _read_arrays(path: Path) -> tuple[dict[str, np.ndarray], list[Problem]]:
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {info.filename.removesuffix(".npy"): info.file_size for info in archive.infolist()}
        missing = [_truth_problem(f"The truth has no array {key!r}.", key) for key in _KEYS if key not in sizes]
        if missing:
            return {}, missing
        keys = (*_KEYS, *(_BONE_KEYS if set(_BONE_KEYS) <= sizes.keys() else ()))
        if sum(sizes[key] for key in keys) > _MAX_BYTES:
            return {}, [_truth_problem("The truth's arrays are larger than 1 GiB.")]
        with np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in keys}, []
    except (OSError, EOFError, ValueError, MemoryError, zipfile.BadZipFile, zlib.error, NotImplementedError):
        return {}, [_truth_problem("The truth can't be read as a NumPy archive of plain arrays.")]


def _contradictions(arrays: Mapping[str, np.ndarray]) -> list[Problem]:
    """Problems of the arrays' types, shapes and values."""
    xyz, names, time = (arrays[key] for key in _KEYS)
    problems = []
    if xyz.ndim != 4 or xyz.shape[-1:] != (3,) or xyz.dtype.kind != "f" or np.isinf(xyz).any():
        problems.append(_truth_problem("Joints must be positions (people, frames, joints, 3) in metres.", "joints"))
    if names.ndim != 1 or names.dtype.kind != "U":
        problems.append(_truth_problem("Names must be a list of words.", "names"))
    if time.ndim != 1 or time.dtype.kind != "f" or not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        problems.append(_truth_problem("Times must be finite seconds and ascend.", "time"))
    if "bones" in arrays:
        problems += _contradictions_of_bones(arrays)
    if problems:
        return problems
    if xyz.shape[1:3] != (len(time), len(names)):
        problems.append(
            _truth_problem(
                f"Joints are given at {xyz.shape[1]} instants for {xyz.shape[2]} joints, "
                f"but there are {len(time)} times and {len(names)} names.",
                "joints",
            )
        )
    lacking = [name for name in BODY_JOINTS if name not in set(names.tolist())]
    if lacking:
        problems.append(_truth_problem(f"The truth lacks {', '.join(lacking)}.", "names"))
    return problems


def _contradictions_of_bones(arrays: Mapping[str, np.ndarray]) -> list[Problem]:
    bones, names = (arrays[key] for key in _BONE_KEYS)
    if names.ndim != 1 or names.dtype.kind != "U":
        return [_truth_problem("Names of bones must be a list of words.", "bone_names")]
    if bones.dtype.kind != "f" or np.isinf(bones).any() or bones.shape != (*arrays["joints"].shape[:2], len(names), 3):
        return [_truth_problem("Bones must be positions (people, frames, bones, 3) in metres.", "bones")]
    return []


def _feet_m(arrays: Mapping[str, np.ndarray]) -> Float[np.ndarray, "people frames 2 2 3"] | None:
    names = arrays["bone_names"].tolist() if "bones" in arrays else []
    if not {bone for foot in _FOOT_BONES for bone in foot} <= set(names):
        return None
    columns = [[names.index(bone) for bone in foot] for foot in _FOOT_BONES]
    return read_only(arrays["bones"][:, :, columns].astype(np.float64))


def _truth_problem(message: str, field: str | None = None) -> Problem:
    return Problem(TRUTH_UNREADABLE, message, file=_TRUTH_FILE, field=field)


_NOBODY = SeenHeads(np.empty(0, np.int64), np.empty((0, 4)))


def score_covered_heads(
    take: Reconstruction, times: Mapping[str, FrameTimes], truth: RenderedTruth
) -> dict[str, float | None]:
    """Score the regions of heads that follow from the people of a take, without any detection beside them.

    Each frame of a camera is compared with the truth of the nearest time within half a period, and each true nose, eye
    and ear whose projection lies in the picture counts, hidden ones too. ``times`` are the times of the cameras' frames
    by name. Returns ``heads_covered``, the share inside a region; ``None`` without any.
    """
    tracks = [*take.located, *take.tracks]
    people = [path for track in tracks if (path := head_path(track, take.joints, take.timebase)) is not None]
    face = [truth.names.index(name) for name in FACE if name in truth.names]
    half_s = 0.5 / take.timebase.frame_rate_hz
    num_inside = num_shown = 0
    for camera in take.cameras:
        time_s = times[camera.name].time_s
        regions = head_regions(camera, range(len(time_s)), time_s, people, _NOBODY)
        for frame, now_s in enumerate(time_s):
            nearest = int(np.abs(truth.time_s - now_s).argmin())
            if abs(truth.time_s[nearest] - now_s) > half_s:
                continue
            points_px = project(camera, truth.xyz_m[:, nearest, face].reshape(-1, 3))
            with np.errstate(invalid="ignore"):
                shown_px = points_px[((points_px >= -0.5) & (points_px <= np.array(camera.size_px) - 0.5)).all(axis=1)]
            ellipse_px = regions.in_frame(frame, camera.size_px)
            away = (shown_px[:, None] - ellipse_px[None, :, :2]) / ellipse_px[None, :, 2:]
            num_inside += int(((away**2).sum(axis=2) <= 1.0).any(axis=1).sum())
            num_shown += len(shown_px)
    return {"heads_covered": num_inside / num_shown if num_shown else None}
