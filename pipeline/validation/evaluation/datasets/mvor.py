"""MVOR benchmark (Srivastav et al., MICCAI-LABELS 2018): pictures of an operating room from three cameras.

The file ``camma_mvor_2018.json`` has COCO's form with further keys: ``multiview_images``, pictures of one instant;
``annotations`` with boxes and ten joints in 2D, which ``only_bbox`` excludes; ``annotations3D`` with the joints of
people in millimetres of the first camera; and ``cameras_info``, see ``calibration.readers.json_datasets``. Pictures are
files such as ``day1/cam1/color/000000.png``, mostly 75 s apart: each instant stands for itself. Keypoints of the same
pictures are a list of COCO's results, such as the data set has in ``detections_results``.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.registry import read_calibration
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import COCO_17, JointSet
from pipeline.core.parsing import KEYPOINT_PX, UnreadableError, read_numbers
from pipeline.core.problems.finding_codes import BENCHMARK_UNREADABLE, DATASET_INCOMPLETE
from pipeline.detection.bodies import boxes_around
from pipeline.geometry.camera import center_in_world
from pipeline.validation.evaluation.datasets.documents import check_crowd, read_document
from pipeline.validation.evaluation.datasets.footage import first_image

ANNOTATIONS = "camma_mvor_2018.json"
JOINTS = (
    "head",
    "neck",
    "left_shoulder",
    "right_shoulder",
    "left_hip",
    "right_hip",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
)
"""Annotated joints, in the data set's order."""

# Places of the annotations and of the pictures in the folder: of the repository, and of the unpacked pictures.
_ANNOTATION_PLACES = (".", "annotations")
_PICTURE_PLACES = (".", "camma_mvor_dataset", "dataset")
_MAX_BYTES = 1 << 26
# Instants: the data set has 732.
_MAX_INSTANTS = 10_000
_MAX_PROBLEMS = 10
_MILLIMETRE_M = 1e-3
_MAX_METRES = 1e3
# Name of a picture: the number of its frame.
_NUMBER = re.compile(r"\d{1,9}")
_HINT = "Get the file again from the data set's repository, CAMMA-public/MVOR."
_Entry = TypeVar("_Entry")


@dataclass(frozen=True, slots=True, eq=False)
class MvorPicture:
    """Annotated picture of one camera."""

    image_id: int
    file_name: str  # Path below the folder of the pictures
    # Boxes of all people, x0, y0, x1, y1; and joints of those who have any, NaN where a joint is not annotated
    box_px: Float[np.ndarray, "people 4"]
    joints_px: Float[np.ndarray, "annotated 10 2"]


@dataclass(frozen=True, slots=True, eq=False)
class MvorInstant:
    """Pictures of one instant, in the cameras' order, and people in the world."""

    pictures: tuple[MvorPicture, ...]
    truth_m: Float[np.ndarray, "people 10 3"]  # NaN where a joint is unknown


@dataclass(frozen=True, slots=True, eq=False)
class MvorBenchmark:
    """Data set with cameras in the world of the room."""

    cameras: tuple[Camera, ...]
    instants: tuple[MvorInstant, ...]  # By day and number
    annotations: Path  # File of the annotations, which is a calibration, too


@dataclass(frozen=True, slots=True, eq=False)
class MvorDay:
    """Pictures of a day."""

    folders: tuple[Path, ...]  # Folder of each camera
    # Numbers of the day's instants, ascending, and of their frames in the folders
    instants: Int[np.ndarray, " n"]
    frames: Int[np.ndarray, " n"]


def load_mvor(folder: Path) -> MvorBenchmark:
    """Read the annotations of the benchmark.

    Raises ``InputError`` with all problems of the file, or if it is missing.
    """
    path = next(
        (folder / place / ANNOTATIONS for place in _ANNOTATION_PLACES if (folder / place / ANNOTATIONS).is_file()), None
    )
    if path is None:
        message = "The annotations of MVOR are missing."
        hint = "Give the folder that has this file, or has it in the folder annotations."
        raise InputError([Problem(DATASET_INCOMPLETE, message, file=ANNOTATIONS, hint=hint)])
    document = _document(path)
    problems: list[Problem] = []
    cameras: tuple[Camera, ...] = ()
    try:
        cameras = read_calibration(path)
    except InputError as error:
        problems += error.problems
    instants = _instants(document, cameras, path.name, problems)
    if problems:
        raise InputError(problems)
    return MvorBenchmark(cameras, instants, path)


def keypoint_session(benchmark: MvorBenchmark, detections: Mapping[str, Detections]) -> KeypointSession:
    """Session of detections at the benchmark's instants, a second apart: instant k is output frame k."""
    num_instants = len(benchmark.instants)
    times = FrameTimes(np.arange(float(num_instants)))
    return KeypointSession(
        cameras=benchmark.cameras,
        times={camera.name: times for camera in benchmark.cameras},
        timebase=Timebase(0.0, 1.0, num_instants),
        detections=detections,
        joints=COCO_17,
        folders={},
        findings=(),
    )


def read_keypoints(
    path: Path, benchmark: MvorBenchmark
) -> tuple[Mapping[str, Detections], Mapping[str, Float[np.ndarray, " bodies"]]]:
    """Read keypoints of the benchmark's pictures: a list of people with ``image_id`` and 17 joints of COCO.

    The joints are ``coco_keypoints``, else ``keypoints``, as x, y and score. A joint at (0, 0) is not detected.

    Raises ``InputError`` with all problems of the file.

    Returns detections by camera name, whose frames are the numbers of the instants; and the score of each body.
    """
    listed = _read(path)
    if not isinstance(listed, list):
        raise InputError([_unreadable(path.name, "The file is not a list of people.", "Give COCO's results.")])
    problems: list[Problem] = []
    place = {
        picture.image_id: (number, camera.name)
        for number, instant in enumerate(benchmark.instants)
        for camera, picture in zip(benchmark.cameras, instant.pictures, strict=True)
    }

    def parse_body(person: Any) -> tuple[str, int, np.ndarray, float]:
        frame, camera = place[person["image_id"]]
        points = _numbers(person.get("coco_keypoints") or person["keypoints"], (len(COCO_17.names), 3))
        _check_pixels(points[points[:, 2] > 0, :2])
        (score,) = _numbers([person.get("score", points[:, 2].mean())], (1,)).tolist()
        return camera, frame, points, score

    bodies = list(_parsed(listed, parse_body, path.name, "", problems))
    in_picture = Counter((camera, frame) for camera, frame, _, _ in bodies)
    _check_crowds(in_picture.values(), path.name, "", problems)
    if problems:
        raise InputError(problems)
    detections, scores = {}, {}
    for camera in benchmark.cameras:
        of_camera = sorted((body for body in bodies if body[0] == camera.name), key=lambda body: body[1])
        points = np.array([body[2] for body in of_camera]).reshape(-1, len(COCO_17.names), 3)
        is_seen = (points[..., 2] > 0) & points[..., :2].any(-1)
        kept = is_seen.any(1)
        frames = np.array([body[1] for body in of_camera], int)
        scores[camera.name] = np.array([body[3] for body in of_camera])[kept]
        detections[camera.name] = _detections(camera.name, frames[kept], points[kept], is_seen[kept])
    return detections, scores


def load_days(folder: Path, benchmark: MvorBenchmark) -> tuple[MvorDay, ...]:
    """Find the pictures of the benchmark.

    Raises ``InputError`` with all days whose pictures are missing, or begin with different numbers.
    """
    pictures = [picture for instant in benchmark.instants for picture in instant.pictures]
    roots = [folder / place for place in _PICTURE_PLACES]
    root = max(roots, key=lambda root: sum((root / picture.file_name).is_file() for picture in pictures))
    days: list[MvorDay] = []
    problems: list[Problem] = []
    for name in dict.fromkeys(map(_day, pictures)):
        rows = [row for row, instant in enumerate(benchmark.instants) if _day(instant.pictures[0]) == name]
        names = [picture.file_name for row in rows for picture in benchmark.instants[row].pictures]
        missing = [file_name for file_name in names if not (root / file_name).is_file()]
        if missing:
            message = f"{len(missing)} of {len(names)} pictures of {name} are missing, such as {missing[0]}."
            hint = "Unpack the data set's pictures into the folder, or give keypoints of them with --detections."
            problems.append(Problem(DATASET_INCOMPLETE, message, file=Path(missing[0]).name, hint=hint))
            continue
        folders = tuple((root / picture.file_name).parent for picture in benchmark.instants[rows[0]].pictures)
        first = first_image(folders, problems)
        frames = np.array([_number(benchmark.instants[row].pictures[0]) for row in rows]) - first
        days.append(MvorDay(folders, np.array(rows), frames))
    if problems:
        raise InputError(problems)
    return tuple(days)


def at_instants(detections: Detections, joints: JointSet, day: MvorDay) -> Detections:
    """Detections in the pictures of a day, with COCO's joints and the numbers of the instants as frames."""
    place = dict(zip(day.frames.tolist(), day.instants.tolist(), strict=True))
    instants = np.array([place.get(frame, -1) for frame in detections.frame.tolist()], int)
    inside = detections.select(instants >= 0)
    columns = joints.indices(COCO_17.names)
    return Detections(
        camera=detections.camera,
        frame=instants[instants >= 0],
        keypoints_px=inside.keypoints_px[:, columns],
        score=inside.score[:, columns],
        box_px=inside.box_px,
    )


def _day(picture: MvorPicture) -> str:
    return Path(picture.file_name).parts[0]


def _number(picture: MvorPicture) -> int:
    return int(Path(picture.file_name).stem)


def _read(path: Path) -> Any:
    """Parsed JSON of a file."""
    try:
        return read_document(path, _MAX_BYTES)
    except UnreadableError as error:
        hint = "Check that it is the right file, and its permissions."
        raise InputError([_unreadable(path.name, f"The file can't be read ({error}).", hint)]) from error


def _document(path: Path) -> Mapping[str, Any]:
    document = _read(path)
    keys = ("multiview_images", "annotations", "annotations3D", "cameras_info")
    lacking = [key for key in keys if not isinstance(document, dict) or not document.get(key)]
    if lacking:
        message = f"The file lacks {', '.join(lacking)}."
        raise InputError([_unreadable(path.name, message, _HINT)])
    return document


def _unreadable(file: str, message: str, hint: str, field: str | None = None) -> Problem:
    return Problem(BENCHMARK_UNREADABLE, message, file=file, field=field, hint=hint)


def _parsed(
    listed: Any, parser: Callable[[Any], _Entry], file: str, name: str, problems: list[Problem]
) -> Iterator[_Entry]:
    """Entries of a list as a parser reads them; the first of those that it can't read are problems."""
    if not isinstance(listed, list):
        problems.append(_unreadable(file, "This is not a list.", _HINT, name))
        return
    num_unreadable = 0
    for position, entry in enumerate(listed):
        try:
            yield parser(entry)
        except (UnreadableError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            num_unreadable += 1
            if num_unreadable <= _MAX_PROBLEMS:
                message = f"The entry can't be read ({_reason(error)})."
                problems.append(_unreadable(file, message, _HINT, f"{name}[{position}]"))
    if num_unreadable > _MAX_PROBLEMS:
        message = f"{num_unreadable - _MAX_PROBLEMS} more entries can't be read."
        problems.append(_unreadable(file, message, _HINT, name or None))


def _reason(error: Exception) -> str:
    match error:
        case KeyError(args=(key, *_)):
            return f"{key!r} is missing or unknown"
        case UnreadableError(args=(reason, *_)):
            return str(reason)
    return "a value of a wrong kind"


def _numbers(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Array of finite numbers that were listed in one row; raises ``UnreadableError`` for other values."""
    array = read_numbers(value)
    if array.ndim != 1 or array.size != np.prod(shape) or not np.isfinite(array).all():
        raise UnreadableError(f"{np.prod(shape)} finite numbers are needed")
    return array.reshape(shape)


def _check_pixels(points_px: Float[np.ndarray, "*batch 2"]) -> None:
    """Raise ``UnreadableError`` for points that no picture can have."""
    if not KEYPOINT_PX.holds(points_px):
        raise UnreadableError(f"coordinates must be within {KEYPOINT_PX}")


def _check_crowds(counts: Iterable[int], file: str, name: str, problems: list[Problem]) -> None:
    """Note a problem if the largest number of people in a picture, or at an instant, is too large."""
    try:
        check_crowd(max(counts, default=0))
    except UnreadableError as error:
        message = f"Too many people are at one place ({error})."
        problems.append(_unreadable(file, message, "Omit the people with low scores.", name or None))


def _instants(
    document: Mapping[str, Any], cameras: Sequence[Camera], file: str, problems: list[Problem]
) -> tuple[MvorInstant, ...]:
    def parse_box(person: Any) -> tuple[int, np.ndarray, np.ndarray | None]:
        x, y, width, height = _numbers(person["bbox"], (4,)).tolist()
        box_px = np.array([x, y, x + width, y + height])
        points = None if person["only_bbox"] else _numbers(person["keypoints"], (len(JOINTS), 3))
        _check_pixels(box_px.reshape(2, 2))
        if points is not None:
            _check_pixels(points[:, :2])
        return _image_id(person["image_id"]), box_px, points

    def parse_person(person: Any) -> tuple[str, np.ndarray]:
        # Two more joints, of the hands, follow the ten.
        points = _numbers(person["keypoints3D"], (len(JOINTS) + 2, 4))[: len(JOINTS)]
        is_known = (points[:, 3:] > 0) & (points[:, 2:3] > 0)
        if np.abs(points[:, :3]).max() * _MILLIMETRE_M > _MAX_METRES:
            raise UnreadableError("a joint is kilometres away")
        return str(person["image_ids"]), np.where(is_known, points[:, :3] * _MILLIMETRE_M, np.nan)

    boxes: dict[int, list[np.ndarray]] = {}
    joints: dict[int, list[np.ndarray]] = {}
    for image_id, box_px, points in _parsed(document["annotations"], parse_box, file, "annotations", problems):
        boxes.setdefault(image_id, []).append(box_px)
        if points is not None and points[:, :2].any():
            joints.setdefault(image_id, []).append(np.where(points[:, :2].any(1, keepdims=True), points[:, :2], np.nan))
    _check_crowds(map(len, boxes.values()), file, "annotations", problems)
    people: dict[str, list[np.ndarray]] = {}
    for instant_id, xyz_m in _parsed(document["annotations3D"], parse_person, file, "annotations3D", problems):
        people.setdefault(instant_id, []).append(_in_room(xyz_m, cameras))
    _check_crowds(map(len, people.values()), file, "annotations3D", problems)

    def parse_picture(image: Any) -> MvorPicture:
        image_id, name = _image_id(image["id"]), Path(str(image["file_name"]))
        if name.is_absolute() or ".." in name.parts or len(name.parts) < 2 or not _NUMBER.fullmatch(name.stem):
            raise UnreadableError(f"{str(name)!r} is not the path of a picture")
        return MvorPicture(
            image_id,
            name.as_posix(),
            np.array(boxes.get(image_id, [])).reshape(-1, 4),
            np.array(joints.get(image_id, [])).reshape(-1, len(JOINTS), 2),
        )

    def parse_instant(images: Any) -> MvorInstant:
        pictures = tuple(map(parse_picture, images["images"]))
        if len(pictures) != len(cameras):
            raise UnreadableError(f"{len(pictures)} pictures of {len(cameras)} cameras")
        if len({(_day(picture), _number(picture)) for picture in pictures}) > 1:
            raise UnreadableError("the pictures are of several days, or have several numbers")
        return MvorInstant(pictures, np.array(people.pop(str(images["id"]), [])).reshape(-1, len(JOINTS), 3))

    if not cameras:
        return ()
    if isinstance(document["multiview_images"], list) and len(document["multiview_images"]) > _MAX_INSTANTS:
        message = f"The file has {len(document['multiview_images']):,} instants; at most {_MAX_INSTANTS:,} are allowed."
        problems.append(_unreadable(file, message, _HINT, "multiview_images"))
        return ()
    instants = tuple(_parsed(document["multiview_images"], parse_instant, file, "multiview_images", problems))
    if people and not problems:
        message = f"People are annotated in 3D at instants that are not listed, such as {next(iter(people))[:60]}."
        problems.append(_unreadable(file, message, _HINT, "annotations3D"))
    return tuple(sorted(instants, key=lambda instant: (_day(instant.pictures[0]), _number(instant.pictures[0]))))


def _image_id(value: Any) -> int:
    if not isinstance(value, int):
        raise UnreadableError("the number of a picture is not whole")
    return value


def _in_room(xyz_m: Float[np.ndarray, "joints 3"], cameras: Sequence[Camera]) -> Float[np.ndarray, "joints 3"]:
    """Positions in the room, of positions in the first camera."""
    if not cameras:
        return xyz_m
    pose: Rigid3 = cameras[0].cam_from_world
    return xyz_m @ pose.rotation + center_in_world(cameras[0])


def _detections(camera: str, frames: np.ndarray, points: np.ndarray, is_seen: np.ndarray) -> Detections:
    points_px = np.where(is_seen[..., None], points[..., :2], np.nan)
    return Detections(
        camera=camera,
        frame=frames,
        keypoints_px=points_px,
        score=np.where(is_seen, np.clip(points[..., 2], 0.0, 1.0), 0.0),
        box_px=boxes_around(points_px),
    )
