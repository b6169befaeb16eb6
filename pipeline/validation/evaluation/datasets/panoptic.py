"""CMU Panoptic (Joo et al., PAMI 2019): reader of a sequence's folder as the toolbox makes it, and scores.

The folder has ``calibration_NAME.json``, ``hdVideos/hd_00_03.mp4`` or ``hdImgs/00_03/00_03_00000000.jpg`` of each
camera, and the poses ``hdPose3d_stage1_coco19/body3DScene_00000000.json``, whose numbers are the HD frames' numbers.
Poses have 19 joints in centimetres, y down, each with a confidence.

VoxelPose's protocol, which papers use: five cameras, every twelfth pose file, 15 joints without eyes and ears. Joints
with a confidence of at most 0.1 are unknown, and people whose centre of the hips is unknown are left out.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.registry import read_calibration
from pipeline.capture.pairing import MIN_CAMERAS
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.joints import JointSet
from pipeline.core.parsing import UnreadableError, read_numbers
from pipeline.core.problems.finding_codes import BENCHMARK_UNREADABLE, DATASET_INCOMPLETE
from pipeline.validation.evaluation.average_precision import InstantPoses, poses_at, score_poses
from pipeline.validation.evaluation.datasets.documents import check_crowd, read_document
from pipeline.validation.evaluation.datasets.footage import first_image, image_numbers
from pipeline.validation.evaluation.mpjpe import accuracy, select_joints

FRAME_RATE_HZ = 30000 / 1001
"""Rate of the HD cameras."""
CAMERAS = ("00_03", "00_06", "00_12", "00_13", "00_23")
"""Cameras of VoxelPose's protocol."""
EVERY = 12
"""Pose files of VoxelPose's protocol: one in so many."""

_POSES = "hdPose3d_stage1_coco19"
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# Joints of COCO behind the 15 joints, which are the neck, the nose, the centre of the hips and the limbs.
_BODY = ("nose", *(f"{side}_{name}" for side in ("left", "right") for name in _LIMBS))
_SHOULDERS, _HIPS = ([_BODY.index(f"{side}_{name}") for side in ("left", "right")] for name in ("shoulder", "hip"))
_NUM_ALL, _NUM_SCORED, _CENTRE = 19, 15, 2
_KNOWN = 0.1
_CENTIMETRE_M = 1e-2
_NUMBER = re.compile(r"body3DScene_(\d{1,9})\.json")
_MAX_BYTES = 1 << 24
_MAX_PROBLEMS = 10
_MAX_METRES = 1e3
# People of a sequence; the arrays of the scores have a row for each.
_MAX_EVERYBODY = 1000
_HINT = "Get the file again with the toolbox, CMU-Perceptual-Computing-Lab/panoptic-toolbox."


@dataclass(frozen=True, slots=True, eq=False)
class PanopticSequence:
    """Files and true poses of a sequence."""

    calibration: Path
    cameras: tuple[str, ...]  # Names of the chosen cameras
    footage: tuple[Path, ...]  # Video, or folder of images, of each chosen camera; empty where keypoints are given
    first_image: int  # Number of the HD frame that is the first one of the footage
    frames: Int[np.ndarray, " instants"]  # Numbers of the HD frames with poses to compare with, ascending
    # True people of each of these, and their numbers
    truth_m: tuple[Float[np.ndarray, "people 15 3"], ...]
    people: tuple[tuple[int, ...], ...]


def load_panoptic(
    folder: Path, cameras: Sequence[str] = CAMERAS, every: int = EVERY, has_footage: bool = True
) -> PanopticSequence:
    """Read a sequence.

    ``cameras``: names of HD cameras, at least two. ``every``: number of pose files of which the first one is compared
    with. ``has_footage``: whether videos or images are needed; else keypoints are given. Raises ``InputError``: with
    all that is missing or unreadable.
    """
    problems: list[Problem] = []
    calibration = _calibration(folder, cameras, problems)
    footage = [_footage(folder, camera, problems) for camera in cameras] if has_footage else []
    first = first_image([path for path in footage if path is not None], problems)
    frames, truth_m, people = _poses(folder, every, problems)
    if problems or calibration is None:
        raise InputError(problems)
    return PanopticSequence(
        calibration, tuple(cameras), tuple(path for path in footage if path), first, frames, truth_m, people
    )


def score_panoptic(
    tracks: Sequence[Track3D],
    joints: JointSet,
    timebase: Timebase,
    sequence: PanopticSequence,
    time_s: Mapping[int, float],
) -> dict[str, Any]:
    """Score tracks of COCO's joints.

    ``timebase``: output frames of the tracks. Poses at other times do not count. ``time_s``: time of each HD frame by
    its number.

    The result has:

    - ``instants``, ``people``: number of the compared instants, and of the people in them.
    - ``mean_ap``, ``ap``, ``recall_500``, ``mpjpe_500_mm``: see ``evaluation.average_precision``.
    - ``mpjpe_mm``, ``pck150``, ``recall``, ``switches``, ``ghost_rate``: see ``evaluation.mpjpe``; the data set's
      numbers of people change where it lost a person.
    """
    placed = [
        (row, round((time_s[number] - timebase.start_time_s) * timebase.frame_rate_hz))
        for row, number in enumerate(sequence.frames.tolist())
        if number in time_s
    ]
    placed = [(row, frame) for row, frame in placed if 0 <= frame < timebase.num_frames]
    frames = np.array([frame for _, frame in placed], int)
    truth_m = [sequence.truth_m[row] for row, _ in placed]
    numbers = [sequence.people[row] for row, _ in placed]
    poses = [InstantPoses(_scored(each.xyz_m), each.score) for each in poses_at(tracks, joints, _BODY, frames)]
    by_pose = score_poses(poses, truth_m)
    everybody = sorted(set().union(*numbers))
    true_m = np.full((len(everybody), len(frames), _NUM_SCORED, 3), np.nan)
    for column, people_m in enumerate(truth_m):
        true_m[[everybody.index(number) for number in numbers[column]], column] = people_m
    whole = accuracy(_scored(select_joints(tracks, joints, _BODY, frames)), true_m)
    return {
        "instants": len(frames),
        "people": sum(map(len, truth_m)),
        "mean_ap": by_pose.mean_ap,
        "ap": dict(by_pose.ap),
        "recall_500": by_pose.recall_500,
        "mpjpe_500_mm": by_pose.mpjpe_500_mm,
        **asdict(whole),
    }


def _scored(body_m: Float[np.ndarray, "*batch 13 3"]) -> Float[np.ndarray, "*batch 15 3"]:
    """The 15 joints of the data set, from COCO's joints."""
    neck_m, centre_m = (body_m[..., pair, :].mean(-2, keepdims=True) for pair in (_SHOULDERS, _HIPS))
    return np.concatenate([neck_m, body_m[..., :1, :], centre_m, body_m[..., 1:, :]], axis=-2)


def _problem(message: str, file: str, hint: str = _HINT, field: str | None = None) -> Problem:
    return Problem(BENCHMARK_UNREADABLE, message, file=file, field=field, hint=hint)


def _calibration(folder: Path, cameras: Sequence[str], problems: list[Problem]) -> Path | None:
    if len(set(cameras)) < MIN_CAMERAS or len(set(cameras)) < len(cameras):
        hint = "Name two cameras at least, each once, such as 00_03,00_06."
        problems.append(Problem(BENCHMARK_UNREADABLE, "The choice of cameras can't be used.", hint=hint))
    found = sorted(folder.glob("calibration_*.json")) if folder.is_dir() else []
    if len(found) != 1:
        message = f"There are {len(found)} calibrations; a sequence has one."
        hint = "Give the folder of one sequence, as the toolbox makes it."
        problems.append(Problem(DATASET_INCOMPLETE, message, file="calibration_*.json", hint=hint))
        return None
    try:
        known = {camera.name for camera in read_calibration(found[0])}
    except InputError as error:
        problems += error.problems
        return None
    if lacking := [camera for camera in cameras if camera not in known]:
        message = f"The calibration has no camera {listed_names(lacking)}."
        problems.append(_problem(message, found[0].name, "Name HD cameras of the sequence with --cameras."))
    return found[0]


def _footage(folder: Path, camera: str, problems: list[Problem]) -> Path | None:
    video, images = folder / "hdVideos" / f"hd_{camera}.mp4", folder / "hdImgs" / camera
    if video.is_file():
        return video
    if images.is_dir() and image_numbers(images):
        return images
    message = f"There is neither the video hdVideos/{video.name} nor a folder hdImgs/{camera} with images."
    hint = "Get it with the toolbox, choose other cameras with --cameras, or give keypoints with --keypoints."
    problems.append(Problem(DATASET_INCOMPLETE, message, file=video.name, camera=camera, hint=hint))
    return None


def _poses(
    folder: Path, every: int, problems: list[Problem]
) -> tuple[Int[np.ndarray, " instants"], tuple[np.ndarray, ...], tuple[tuple[int, ...], ...]]:
    """Numbers of the HD frames with people, and people by frame."""
    files = {
        int(match[1]): path
        for place in (folder / _POSES, folder / _POSES / "hd")
        for path in sorted(place.glob("body3DScene_*.json"))
        if (match := _NUMBER.fullmatch(path.name))
    }
    if not files:
        packed = (folder / f"{_POSES}.tar").is_file()
        hint = f"Unpack {_POSES}.tar in the folder." if packed else "Get the poses with the toolbox."
        message = f"There are no poses body3DScene_*.json in {_POSES}."
        problems.append(Problem(DATASET_INCOMPLETE, message, file=_POSES, hint=hint))
    found: dict[int, tuple[np.ndarray, tuple[int, ...]]] = {}
    unreadable: list[Problem] = []
    for number in sorted(files)[::every]:
        try:
            people_m, numbers = _people(files[number])
        except UnreadableError as error:
            unreadable.append(_problem(f"The poses can't be read ({error}).", files[number].name))
            continue
        if len(numbers):
            found[number] = people_m, numbers
    problems += unreadable[:_MAX_PROBLEMS]
    if len(unreadable) > _MAX_PROBLEMS:
        message = f"{len(unreadable) - _MAX_PROBLEMS} more files of poses can't be read."
        problems.append(_problem(message, _POSES))
    num_everybody = len({number for _, numbers in found.values() for number in numbers})
    if num_everybody > _MAX_EVERYBODY:
        message = f"The poses number {num_everybody:,} people; at most {_MAX_EVERYBODY:,} are allowed."
        problems.append(_problem(message, _POSES, "Compare with fewer of them: a larger --every."))
    if files and not found and not unreadable:
        problems.append(_problem("The files of poses have no person.", _POSES, "Compare with more of them: --every 1."))
    return (
        np.array(list(found), int),
        tuple(people_m for people_m, _ in found.values()),
        tuple(numbers for _, numbers in found.values()),
    )


def _people(path: Path) -> tuple[Float[np.ndarray, "people 15 3"], tuple[int, ...]]:
    """People of a file of poses, and their numbers; raises ``UnreadableError`` with the reason."""
    document = read_document(path, _MAX_BYTES)
    bodies = document.get("bodies") if isinstance(document, dict) else None
    if not isinstance(bodies, list) or not all(isinstance(body, dict) for body in bodies):
        raise UnreadableError("no list of bodies")
    check_crowd(len(bodies))
    people: dict[int, np.ndarray] = {}
    for body in bodies:
        number, joints_m = body.get("id"), _joints_m(body)
        if not isinstance(number, int) or number in people:
            raise UnreadableError("a body has no number of its own")
        if np.isfinite(joints_m[_CENTRE]).all():
            people[number] = joints_m
    return np.array(list(people.values())).reshape(-1, _NUM_SCORED, 3), tuple(people)


def _joints_m(body: Mapping[str, Any]) -> Float[np.ndarray, "15 3"]:
    """The 15 joints of a body in metres, Z up, NaN where one is unknown."""
    if "joints19" not in body:
        raise UnreadableError("joints15 of an older version" if "joints15" in body else "a body has no joints19")
    joints = read_numbers(body["joints19"])
    if joints.shape != (4 * _NUM_ALL,) or not np.isfinite(joints).all():
        raise UnreadableError(f"joints19 has {4 * _NUM_ALL} finite numbers")
    x_cm, y_cm, z_cm, confidence = joints.reshape(_NUM_ALL, 4)[:_NUM_SCORED].T
    xyz_m = _CENTIMETRE_M * np.stack([x_cm, z_cm, -y_cm], axis=-1)
    if np.abs(xyz_m).max() > _MAX_METRES:
        raise UnreadableError("a joint is kilometres away")
    return np.where(confidence[:, None] > _KNOWN, xyz_m, np.nan)
