"""Space that a reconstruction on this machine is foreseen to need: stated before it starts, required of the disks."""

import shutil
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from api.cli.console import console
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import Session
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.request_codes import SPACE_MISSING
from pipeline.run.space import CameraFrames, ForeseenSpace, estimate_space, shown_bytes


def session_space(session: Session, config: ReconstructionConfig, character: Path | None = None) -> ForeseenSpace:
    """Space that the reconstruction of an opened session needs; ``character`` is the file that moves as each person."""
    detected = session.detections if isinstance(session, KeypointSession) else {}
    cameras = [
        CameraFrames(
            camera.size_px,
            len(session.times[camera.name].time_s),
            len(detected[camera.name].frame) if camera.name in detected else None,
            len(session.joints.names) if isinstance(session, KeypointSession) else None,
        )
        for camera in session.cameras
    ]
    timebase = session.timebase
    frames = timebase.num_frames, timebase.frame_rate_hz, session.stretches
    character_bytes = 0 if character is None else character.stat().st_size
    return estimate_space(cameras, *frames, config, has_viewers=False, character_bytes=character_bytes)


def sentence(space: ForeseenSpace) -> str:
    """Space in words."""
    return (
        f"Space on disks, of {space.num_people} people: results about {shown_bytes(space.result_bytes)}, intermediate "
        f"outputs {shown_bytes(space.output_bytes)}, temporary files {shown_bytes(space.scratch_bytes)}."
    )


def document(space: ForeseenSpace) -> dict[str, Any]:
    """Space as ``--json`` has it."""
    return {
        "result_bytes": space.result_bytes,
        "output_bytes": space.output_bytes,
        "scratch_bytes": space.scratch_bytes,
        "num_people": space.num_people,
    }


def require_space(space: ForeseenSpace, out: Path, cache: Path | None) -> None:
    """State the space on stderr; raise ``InputError`` unless the disks of results and intermediate outputs have it.

    ``cache`` is the folder of intermediate outputs; ``None``: they are in a temporary folder.
    """
    console.print(sentence(space))
    needed_bytes: defaultdict[int, int] = defaultdict(int)
    folders: dict[int, Path] = {}
    for folder, num_bytes in (
        (out, space.result_bytes + space.scratch_bytes),
        (cache or Path(tempfile.gettempdir()), space.output_bytes),
    ):
        existing = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
        disk = existing.stat().st_dev
        needed_bytes[disk] += num_bytes
        folders.setdefault(disk, existing)
    problems = [
        Problem(
            SPACE_MISSING,
            f"The disk of {folders[disk]} has {shown_bytes(free)} left, and about {shown_bytes(num_bytes)} are needed.",
            hint="Free space, choose other folders by --out and --cache, ask for fewer files, or reconstruct fewer "
            "frames at a time by --frames.",
        )
        for disk, num_bytes in needed_bytes.items()
        if (free := shutil.disk_usage(folders[disk]).free) < num_bytes
    ]
    if problems:
        raise InputError(problems)
