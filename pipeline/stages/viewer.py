"""Files for viewers, from a reconstruction and its session."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.capture.keypoints import KeypointSession
from pipeline.data import FrameTimes, Reconstruction
from pipeline.export.viewer.description import Footage, ViewerMotion
from pipeline.quality.views import PersonViews
from pipeline.stages.association import Session
from pipeline.stages.output import DESCRIPTION, MOTION, VIEWER, ResultFile


def viewer_files(
    reconstruction: Reconstruction,
    views: Sequence[PersonViews],
    session: Session,
    report: Mapping[str, Any],
    folder: Path,
    first_frame: int = 0,
) -> Sequence[ResultFile]:
    """Write the files for viewers into a folder.

    Parameters
    ----------
    reconstruction
        At the session's frame rate.
    views
        Its ``views_of``.
    report
        Content of ``metrics.json``.
    first_frame
        Number of the first frame before the take was cut.
    """
    motion = ViewerMotion(reconstruction, views, footage_of(session), report, first_frame)
    with (folder / MOTION).open("wb") as file:
        file.writelines(motion.encode())
    (folder / DESCRIPTION).write_bytes(motion.describe())
    return files_in(folder)


def files_in(folder: Path) -> Sequence[ResultFile]:
    """Files for viewers that were written into a folder."""
    return [
        ResultFile(MOTION, VIEWER, None, "application/octet-stream", folder / MOTION),
        ResultFile(DESCRIPTION, VIEWER, None, "application/json", folder / DESCRIPTION),
    ]


def footage_of(session: Session) -> Mapping[str, Footage]:
    """Frames of each camera of a session, by the camera's name."""
    if isinstance(session, KeypointSession):
        return {name: Footage(times) for name, times in session.times.items()}
    return {
        camera.name: Footage(session.times[camera.name], video.path.name, FrameTimes(video.time_s))
        for camera, video in zip(session.cameras, session.videos, strict=True)
    }
