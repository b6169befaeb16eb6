"""Whether a capture gave enough to reconstruct people from: somebody was found, by enough cameras.

What fails here is mostly the capture itself: too few cameras, cameras that point elsewhere, or a calibration that
belongs to another set-up, so that no two cameras agree on a person.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from pipeline.data import DamagedVideo, Reconstruction
from pipeline.quality.names import first_names

# With fewer views than this a mistake in one of them can't be told from the truth.
_MIN_VIEWS = 3


def capture_checks(
    reconstruction: Reconstruction, seen: Mapping[int, Bool[np.ndarray, "frames cameras"]]
) -> list[dict[str, str]]:
    """Everything that makes a result poor or empty, as ``code`` and ``message``, one a code; empty if nothing does.

    Parameters
    ----------
    seen
        By track, whether a camera saw anything of the person in a frame.
    """
    names = [camera.name for camera in reconstruction.cameras]
    checks = (
        _check_rig(names),
        _check_videos(reconstruction.damaged),
        _check_people(seen),
        _check_cameras(names, seen),
        _check_views(names, seen),
        _check_association(reconstruction),
    )
    return [{"code": code, "message": message} for check in checks for code, message in check]


def _check_rig(names: list[str]) -> Iterator[tuple[str, str]]:
    if len(names) < _MIN_VIEWS:
        yield (
            "too_few_cameras",
            f"The session has {len(names)} cameras: with fewer than {_MIN_VIEWS}, mistakes of a camera stay unnoticed.",
        )


def _check_videos(damaged: Sequence[DamagedVideo]) -> Iterator[tuple[str, str]]:
    if not damaged:
        return
    described = [
        f"{one.file} ({one.num_damaged} of {one.num_frames} frames, from {one.first_s:.1f} to {one.last_s:.1f} s)"
        for one in damaged
    ]
    videos = "A video is" if len(damaged) == 1 else f"{len(damaged)} videos are"
    yield (
        "damaged_video",
        f"{videos} damaged: {first_names(described)}. People may be wrong or missing there, and up to the video's next "
        "keyframe.",
    )


def _check_people(seen: Mapping[int, np.ndarray]) -> Iterator[tuple[str, str]]:
    if not seen:
        yield (
            "nobody_found",
            "Nobody was found. See that the calibration is of these videos, that they show the same moment, and that "
            "two cameras or more see the same person.",
        )


def _check_cameras(names: list[str], seen: Mapping[int, np.ndarray]) -> Iterator[tuple[str, str]]:
    if not seen:
        return
    used = np.any([frames.any(0) for frames in seen.values()], axis=0)
    unused = [name for name, is_used in zip(names, used, strict=True) if not is_used]
    if len(unused) == 1:
        yield (
            "camera_without_people",
            f"{unused[0]} was matched with nobody: its video, its calibration or its timing may be of something else.",
        )
    elif unused:
        yield (
            "camera_without_people",
            f"{len(unused)} cameras were matched with nobody: {first_names(unused)}. Their videos, their calibrations "
            "or their timing may be of something else.",
        )


def _check_views(names: list[str], seen: Mapping[int, np.ndarray]) -> Iterator[tuple[str, str]]:
    if len(names) < _MIN_VIEWS:
        return
    people = [f"person-{track_id}" for track_id, frames in seen.items() if _has_few_views(frames)]
    if len(people) == 1:
        yield "few_views", f"{people[0]} was seen by fewer than {_MIN_VIEWS} cameras in most frames."
    elif people:
        yield (
            "few_views",
            f"{len(people)} people were seen by fewer than {_MIN_VIEWS} cameras in most frames: {first_names(people)}.",
        )


def _check_association(reconstruction: Reconstruction) -> Iterator[tuple[str, str]]:
    if reconstruction.num_approximate_frames:
        yield (
            "approximate_association",
            f"In {reconstruction.num_approximate_frames} of {reconstruction.timebase.num_frames} frames the cameras "
            "saw more people than can be told apart exactly: they were matched by a simpler rule there.",
        )


def _has_few_views(frames: Bool[np.ndarray, "frames cameras"]) -> bool:
    views = frames.sum(-1)
    views = views[views > 0]
    return bool(2 * np.count_nonzero(views < _MIN_VIEWS) > len(views))
