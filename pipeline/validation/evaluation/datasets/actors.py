"""Shelf and Campus (Belagiannis et al., CVPR 2014): reader of the published folders, and scores of their actors.

The folder has ``actorsGT.mat`` (see ``read_truth``), or ``gt.npz`` with its array ``gt``: actors x images x 14 joints x
3 metres, NaN where not annotated; a calibration ``calibration.json``, or VoxelPose's ``calibration_shelf.json``; and
the pictures ``Camera0/img_000300.png`` or ``Camera0/campus4-c0-00350.png``, whose numbers are the images' numbers in
the truth. Papers score the images of ``TESTED`` and the first three actors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.capture.session import Session
from pipeline.core.data.people import Track3D
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import COCO_17, JointSet
from pipeline.core.parsing import UnreadableError
from pipeline.core.problems.finding_codes import BENCHMARK_UNREADABLE, DATASET_INCOMPLETE
from pipeline.core.runtime.npz import read_untrusted_arrays
from pipeline.validation.evaluation.datasets.footage import first_image, image_numbers
from pipeline.validation.evaluation.datasets.read_truth import read_truth
from pipeline.validation.evaluation.mpjpe import select_joints
from pipeline.validation.evaluation.pcp import HEAD_RULES, benchmark_joints, score_pcp

FRAME_RATE_HZ = 25.0
TESTED: Mapping[str, tuple[range, ...]] = {
    "shelf": (range(300, 600),),
    "campus": (range(350, 471), range(650, 751)),
}
"""Numbers of the images that are scored, by data set, ascending."""
NUM_SCORED_ACTORS = 3

_TRUTH, _CONVERTED = "actorsGT.mat", "gt.npz"
_MAX_BYTES = 2**30


@dataclass(frozen=True, slots=True, eq=False)
class ActorSequence:
    """Files and truth of the tested images, and of the images between them."""

    calibration: Path
    footage: tuple[Path, ...]  # Folder of pictures of each camera; empty where keypoints are given
    first_image: int  # Number of the first picture of the footage
    images: range  # Numbers of the images, from the first tested one to the last one
    truth_m: Float[np.ndarray, "actors images 14 3"]  # NaN where not annotated, or not tested


def load_actors(folder: Path, dataset: str, has_footage: bool = True) -> ActorSequence:
    """Read a published folder.

    ``dataset``: name in ``TESTED``. ``has_footage``: whether pictures are needed; else keypoints are given. Raises
    ``InputError`` with all that is missing or unreadable.
    """
    problems: list[Problem] = []
    images, truth_m = read_actor_truth(folder, dataset, problems)
    calibration = find_calibration(folder, dataset)
    if not calibration.is_file():
        hint = f"Put the cameras into the folder, such as VoxelPose's calibration_{dataset}.json."
        message = "The calibration is missing."
        problems.append(Problem(DATASET_INCOMPLETE, message, file=calibration.name, hint=hint))
    cameras = sorted(path for path in folder.glob("Camera[0-9]*") if path.is_dir()) if has_footage else []
    footage = tuple(path for path in cameras if image_numbers(path))
    if has_footage and not footage:
        hint = "Unpack the pictures into the folder, or give keypoints of them with --keypoints."
        message = "There are no folders Camera0, Camera1, ... with pictures."
        problems.append(Problem(DATASET_INCOMPLETE, message, file="Camera0", hint=hint))
    first = first_image(footage, problems)
    if problems:
        raise InputError(problems)
    return ActorSequence(calibration, footage, first, images, truth_m)


def find_calibration(folder: Path, dataset: str) -> Path:
    """Calibration of a folder: VoxelPose's, if there is no ``calibration.json``."""
    own = folder / "calibration.json"
    return own if own.is_file() else folder / f"calibration_{dataset}.json"


def read_actor_truth(
    folder: Path, dataset: str, problems: list[Problem]
) -> tuple[range, Float[np.ndarray, "actors images 14 3"]]:
    """Numbers of the images from the first tested one to the last one, and the actors in the tested ones of these."""
    tested = TESTED[dataset]
    images = range(tested[0].start, tested[-1].stop)
    path = folder / (_CONVERTED if (folder / _CONVERTED).exists() else _TRUTH)
    try:
        if path.name == _CONVERTED:
            everything_m = read_untrusted_arrays(path, ("gt",), _MAX_BYTES)["gt"].astype(np.float64)
        else:
            everything_m = read_truth(path, "actors")
        shape = everything_m.shape
        if shape[2:] != (14, 3) or shape[0] < NUM_SCORED_ACTORS or shape[1] < images.stop:
            raise UnreadableError(f"the shape is {shape}, not actors x images x 14 x 3")
        is_tested = np.isin(np.arange(shape[1]), np.concatenate(tested))[:, None, None]
        truth_m = np.where(is_tested, everything_m, np.nan)[:, images.start : images.stop]
        is_annotated = np.isfinite(truth_m[:NUM_SCORED_ACTORS]).all((-2, -1))
        if not np.all(np.any(is_annotated, axis=1)):
            raise UnreadableError("an actor is not annotated in any tested image")
    except ValueError as error:
        hint = f"Give the folder of {dataset.capitalize()} with {_TRUTH}."
        problems.append(Problem(BENCHMARK_UNREADABLE, f"The truth can't be read: {error}.", file=path.name, hint=hint))
        truth_m = np.empty((0, len(images), 14, 3))
    return images, truth_m


def tested_frames(session: Session, sequence: ActorSequence) -> tuple[int, int]:
    """First of a session's output frames with a tested image, and the frame after the last one.

    Raises ``InputError`` if the session lacks a part of the images.
    """
    first = sequence.first_image if session.camera_videos else session.timebase.first_source_frame
    images = sequence.images
    if first > images.start or first + session.timebase.num_frames < images.stop:
        message = f"The images are {first} to {first + session.timebase.num_frames - 1}."
        hint = f"Give the images, or keypoints of them, from {images.start} to {images.stop - 1}."
        raise InputError([Problem(DATASET_INCOMPLETE, message, hint=hint)])
    return images.start - first, images.stop - first


def score_actors(
    tracks: Sequence[Track3D],
    joints: JointSet,
    frames: Int[np.ndarray, " images"],
    truth_m: Float[np.ndarray, "actors images 14 3"],
) -> dict[str, Any]:
    """Score tracks with COCO's joints: PCP and PCK150 in percent, MPJPE and identity switches.

    ``frames``: output frame of each image. The result has:

    - ``pcp``: ``average`` (mean of actors 1-3), ``actors`` and ``parts`` for the head rule ``crossview``, and the
      average ``by_head_rule``.
    - ``mpjpe_mm``, ``pck150``: mean joint error of each actor, ``None`` without any pose; joints within 150 mm.
    - ``switches``: number of changes of an annotated actor's nearest track since the actor's previous annotation.
    """
    located_m = select_joints(tracks, joints, COCO_17.names, frames).swapaxes(0, 1)
    by_rule = {rule: score_pcp(list(benchmark_joints(located_m, rule)), truth_m) for rule in HEAD_RULES}
    reference = by_rule["crossview"]
    averages = {rule: float(np.mean(scores.actors[:NUM_SCORED_ACTORS])) for rule, scores in by_rule.items()}
    errors_mm = reference.mpjpe_mm[:NUM_SCORED_ACTORS].tolist()
    histories = (row[row >= 0] for row in reference.chosen)
    return {
        "pcp": {
            "average": averages["crossview"],
            "actors": reference.actors[:NUM_SCORED_ACTORS].tolist(),
            "parts": {name: values[:NUM_SCORED_ACTORS].tolist() for name, values in reference.parts.items()},
            "by_head_rule": averages,
        },
        "mpjpe_mm": [None if np.isnan(error_mm) else error_mm for error_mm in errors_mm],
        "pck150": reference.pck150[:NUM_SCORED_ACTORS].tolist(),
        "switches": sum(int(np.count_nonzero(np.diff(history))) for history in histories),
    }
