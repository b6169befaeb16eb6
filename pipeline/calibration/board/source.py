"""Pictures in which a board is looked for: frames of a video, or photographs."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.calibration.board.corner_search.find_board import DetectedBoard, find_board, is_exchanged
from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews
from pipeline.core.data.arrays import read_only
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import BOARD_FRAMES
from pipeline.core.problems.session_codes import IMAGE_SIZE, IMAGE_UNREADABLE, IMAGES_MISSING
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo

_ENDINGS = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"})
_MAX_SIDE_PX = 16_384
# Pictures without the board, before it is found, in which it is looked for with columns and rows exchanged.
_TRIED_EXCHANGED = 60
# Names of Pose2Sim's folders of photographs.
_POSE2SIM = re.compile(r"(?:int|ext)_(.+)_img")

OnFrame = Callable[[], None]


def frames_to_look_at(
    time_s: Float[np.ndarray, " frames"], span_s: tuple[float, float], interval_s: float
) -> list[int]:
    """Numbers of a camera's frames nearest to instants that are the same for all cameras, ascending.

    Times are on the session's clock, ``span_s`` its first and last one. The instants are ``interval_s`` apart, the
    interval of the session's frames, or farther if there are too many.
    """
    begin_s, end_s = span_s
    number = min(BOARD_FRAMES, round((end_s - begin_s) / interval_s) + 1)
    instants_s = begin_s + (end_s - begin_s) * np.arange(number) / max(number - 1, 1)
    after = np.clip(np.searchsorted(time_s, instants_s), 1, max(len(time_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(time_s) - 1)
    nearest = np.where(np.abs(time_s[after] - instants_s) < np.abs(time_s[before] - instants_s), after, before)
    frames: list[int] = np.unique(nearest[np.abs(time_s[nearest] - instants_s) <= interval_s]).tolist()
    return frames


def photographs_to_look_at(number: int) -> list[int]:
    """Numbers of a camera's photographs, ascending: all of them, or as many as are looked at, spread evenly."""
    chosen: list[int] = np.unique(np.linspace(0, number - 1, min(number, BOARD_FRAMES)).round().astype(int)).tolist()
    return chosen


def look_in_video(
    video: VideoInfo,
    camera: str,
    time_s: Float[np.ndarray, " frames"],
    frames: Sequence[int],
    board: Board,
    on_frame: OnFrame = lambda: None,
) -> BoardViews:
    """Look for the board in some frames of a video.

    Times are on the session's clock, and numbers of frames ascend. Raises as ``pipeline.video.decode.decode``; problems
    name the camera.
    """

    def pictures() -> Iterator[tuple[float, np.ndarray]]:
        with closing(decode(video, 0, video.num_frames, only=frames)) as images:
            for number, image_rgb in images:
                yield float(time_s[number]), image_rgb
                on_frame()

    try:
        return _views(camera, video.size_px, pictures(), board)
    except InputError as error:
        raise InputError([replace(problem, camera=camera) for problem in error.problems]) from error


def find_photographs(folder: Path) -> Mapping[str, Sequence[Path]]:
    """Photographs of each camera: a subfolder a camera, or a folder of one camera.

    Folders that are named as Pose2Sim does, ``int_cam01_img``, give the camera ``cam01``. Raises ``InputError`` if
    there are no photographs.
    """
    photographs = {}
    if folder.is_dir():
        for place in (folder, *sorted(path for path in folder.iterdir() if path.is_dir())):
            paths = sorted(path for path in place.iterdir() if path.suffix.lower() in _ENDINGS)
            if paths:
                match = _POSE2SIM.fullmatch(place.name)
                photographs[match[1] if match else place.name] = paths
    if not photographs:
        hint = "Name a folder with photographs, or with a folder of photographs for each camera."
        message = "There are no photographs in the folder."
        raise InputError([Problem(IMAGES_MISSING, message, file=folder.name, hint=hint)])
    return photographs


def look_in_photographs(
    camera: str, paths: Sequence[Path], board: Board, on_picture: OnFrame = lambda: None
) -> BoardViews:
    """Look for the board in photographs of one camera, which have no times.

    Raises ``InputError`` with all photographs that can't be read or have another size than the first one.
    """
    problems: list[Problem] = []
    sizes: list[tuple[int, int]] = []

    def pictures() -> Iterator[tuple[float, np.ndarray]]:
        for path in paths:
            image_bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if image_bgr is None or max(image_bgr.shape) > _MAX_SIDE_PX:
                message = "The photograph can't be read, or is too large."
                problems.append(Problem(IMAGE_UNREADABLE, message, file=path.name, camera=camera))
            else:
                sizes.append((image_bgr.shape[1], image_bgr.shape[0]))
                if sizes[-1] != sizes[0]:
                    message = f"The photograph has {sizes[-1][0]} x {sizes[-1][1]} pixels, others {sizes[0]}."
                    hint = "Leave out photographs of another size."
                    problems.append(Problem(IMAGE_SIZE, message, file=path.name, camera=camera, hint=hint))
                yield np.nan, cv2.cvtColor(image_bgr, cv2.COLOR_BGR2RGB)
            on_picture()

    views = _views(camera, (0, 0), pictures(), board)
    if problems:
        raise InputError(problems)
    return replace(views, size_px=sizes[0])


def _views(
    camera: str,
    size_px: tuple[int, int],
    pictures: Iterable[tuple[float, UInt8[np.ndarray, "height width 3"]]],
    board: Board,
) -> BoardViews:
    times_s: list[float] = []
    boards: list[DetectedBoard] = []
    num_pictures = num_mirrored = num_exchanged = num_tried = 0
    prints = board.prints
    for time_s, image_rgb in pictures:
        num_pictures += 1
        if (detected := find_board(image_rgb, *prints)) is None:
            if not boards and num_tried < _TRIED_EXCHANGED:
                num_tried += 1
                num_exchanged += is_exchanged(image_rgb, board)
            continue
        if detected.is_mirrored:
            num_mirrored += 1
        else:
            times_s.append(time_s)
            boards.append(detected)
            if detected.is_sure:
                prints = (detected.board,)
    if len(prints) == 1:
        of_print = [k for k, detected in enumerate(boards) if detected.board == prints[0]]
        times_s, boards = [times_s[k] for k in of_print], [boards[k] for k in of_print]
    return BoardViews(
        camera,
        size_px,
        read_only(np.array(times_s)),
        read_only(np.array([detected.corners_px for detected in boards]).reshape(-1, board.num_corners, 2)),
        read_only(np.array([detected.sharpness_px for detected in boards])),
        num_pictures,
        num_mirrored,
        num_exchanged,
    )
