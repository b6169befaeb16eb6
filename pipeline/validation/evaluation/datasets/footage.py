"""Numbers and times of the pictures of benchmarks, by which poses of the truth are found."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.capture.session import Session
from pipeline.core.errors import Problem
from pipeline.core.problems.finding_codes import DATASET_INCOMPLETE
from pipeline.video.images.files import ENDINGS, SEQUENCE

_NUMBER = re.compile(r"(\d{1,9})$")


def image_numbers(folder: Path) -> list[int]:
    """Numbers at the end of the names of a folder's images, ascending."""
    stems = (path.stem for path in folder.iterdir() if path.suffix.lower() in ENDINGS)
    return sorted(int(match[1]) for stem in stems if (match := _NUMBER.search(stem)))


def first_image(footage: Sequence[Path], problems: list[Problem]) -> int:
    """Number of the image with which all folders of images begin, or 0 for videos."""
    first = {path: image_numbers(path)[0] if path.is_dir() else 0 for path in footage}
    if len(set(first.values())) > 1:
        begins = ", ".join(f"{path.name} with {number}" for path, number in first.items())
        message = f"The cameras' images begin with different frames: {begins}."
        problems.append(Problem(DATASET_INCOMPLETE, message, hint="Extract the same frames of all cameras."))
    return next(iter(first.values()), 0)


def frame_times(session: Session, first_image: int) -> Mapping[int, float]:
    """Time of each frame of a session by its number in the data set: of the first camera's footage, or of keypoints.

    ``first_image``: number of the first image of the footage. File number k of keypoints is frame k.
    """
    if not session.camera_videos:
        timebase = session.timebase
        return {timebase.first_source_frame + frame: timebase.time_s(frame) for frame in range(timebase.num_frames)}
    camera = session.cameras[0].name
    time_s, video = session.times[camera].time_s, session.camera_videos[camera]
    numbers = video.pts if video.codec == SEQUENCE else np.arange(len(time_s))
    return dict(zip((first_image + numbers).tolist(), time_s.tolist(), strict=True))
