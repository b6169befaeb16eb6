"""Readers of HDF5 files of named points, DeepLabCut's and SLEAP's, which a child process opens.

Rows of the table of formats:

| SLEAP | all frames: its analysis file (`.analysis.h5`) of one video | joints whose names are known, and points of
your own | projects (`.slp`)
are not read: export the analysis file of each video (*Export Analysis HDF5*) |
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.capture.keypoint_files.keypoint_reader import KeypointReader, reader
from pipeline.capture.keypoint_files.people import KeypointsError, People, check_frames
from pipeline.capture.keypoint_files.points import KeypointReading, named_layout
from pipeline.core.layouts import KeypointLayout
from pipeline.core.parsing import UnreadableError
from pipeline.core.runtime.confinement import BeyondLimitsError, ChildLimits, run_confined

MAX_POINTS = 2**24
"""Limit on the points of a file, without points of people of a frame who have no detected point."""

# Far above the second or two of a file of the largest size.
_MAX_CPU_S = 60


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Points of the people in the frames of a file."""

    form: str  # Program, as users know it
    frames: Sequence[int]  # Number of each frame
    points: Float[np.ndarray, "frames people points 3"]  # X, y and score; NaN or 0 where a point was not found
    names: Sequence[str]  # Names of the points
    # Points that stand once in the scene, and their names
    scene: Float[np.ndarray, "frames points 3"] | None = None
    scene_names: Sequence[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PeopleByFrame:
    """Points of the people of each frame, as a child process sends them."""

    form: str  # Program, as users know it
    layout: KeypointLayout  # Layout of the points
    people: Mapping[int, Float[np.ndarray, "people points 3"]]  # People with a detected point, by frame
    # Points that stand once in the scene by frame, and their names
    scene: Mapping[int, Float[np.ndarray, "points 3"]]
    scene_names: tuple[str, ...]


def read_in_child(path: Path) -> PeopleByFrame:
    """Read a file; one that makes HDF5 crash, hang or exhaust memory ends only its child.

    Raises ``KeypointsError`` if the file can't be used, ``UnreadableError`` if it is damaged, and ``ChildError`` if the
    child fails for a reason other than its file.
    """
    program, task = "pipeline.capture.keypoint_files.read_hdf5", f"reading of {path.name}"
    limits, timeout_s = ChildLimits(_MAX_CPU_S), 4.0 * _MAX_CPU_S
    try:
        return decoded(run_confined(program, [str(path.absolute())], limits, task=task, timeout_s=timeout_s))
    except BeyondLimitsError:
        raise KeypointsError("The HDF5 file can't be read within the limits on time and memory.") from None


def split_frames(content: PeopleByFrame) -> Mapping[int, tuple[PeopleByFrame, int]]:
    """Split the people by frame."""
    return {number: (content, number) for number in content.people}


def read_frame(content: tuple[PeopleByFrame, int], reading: KeypointReading) -> People:
    """Read the people of a frame; raises ``KeypointsError`` or ``CrowdError`` if they can't be used."""
    tracks, number = content
    if tracks.scene_names:
        scene = tracks.scene[number][None]
        reading.add_own(tracks.scene_names, scene[:0], scene, scene[:0])
    return reading.people(tracks.people[number], tracks.layout)


def _declared(name: str) -> KeypointReader:
    declare = reader(
        name,
        suffixes=(".h5", ".hdf5"),
        load=read_in_child,
        is_content=lambda content: content.form == name,
        split_frames=split_frames,
    )
    return declare(read_frame)


DEEPLABCUT, SLEAP = map(_declared, ("DeepLabCut", "SLEAP"))


def encoded(tracks: Tracks) -> bytes:
    """Tracks as a line of JSON, and the points of people with a detected point, frame by frame.

    Raises ``KeypointsError`` if a frame is listed twice, or if there are too many frames or points.
    """
    check_frames(len(tracks.frames))
    frames = list(tracks.frames)
    if len(set(frames)) < len(frames):
        twice = next(number for k, number in enumerate(sorted(frames)[1:]) if number == sorted(frames)[k])
        raise KeypointsError(f"Frame {twice} is listed twice.", "frame")
    seen = (np.isfinite(tracks.points).all(-1) & (tracks.points[..., 2] > 0)).any(-1)
    scene = np.empty((len(frames), 0, 3)) if tracks.scene is None else tracks.scene
    if seen.sum() * len(tracks.names) + scene[..., 0].size > MAX_POINTS:
        raise KeypointsError(f"The file has more than {MAX_POINTS:,} points; cut it into several.")
    header = {
        "form": tracks.form,
        "names": list(tracks.names),
        "scene": list(tracks.scene_names),
        "frames": frames,
        "counts": seen.sum(1).tolist(),
    }
    parts = (np.ascontiguousarray(points, "<f8").tobytes() for points in (tracks.points[seen], scene))
    return json.dumps(header).encode() + b"\n" + b"".join(parts)


def decoded(content: bytes) -> PeopleByFrame:
    """Tracks that ``encoded`` wrote.

    Raises ``KeypointsError`` for a problem that was written in their place, ``UnreadableError`` for a file without a
    message.
    """
    header, _, rest = content.partition(b"\n")
    answer = json.loads(header)
    if "problem" in answer:
        if answer["problem"] is None:
            raise UnreadableError
        raise KeypointsError(answer["problem"], answer["field"])
    values, frames, counts = np.frombuffer(rest, "<f8"), answer["frames"], answer["counts"]
    num_of_people = 3 * sum(counts) * len(answer["names"])
    points = values[:num_of_people].reshape(-1, len(answer["names"]), 3)
    people = np.split(points, np.cumsum(counts)[:-1]) if counts else []
    scene = values[num_of_people:].reshape(len(frames), len(answer["scene"]), 3)
    layout = named_layout(answer["names"], "names")
    of_frames = dict(zip(frames, people, strict=True)), dict(zip(frames, scene, strict=True))
    return PeopleByFrame(answer["form"], layout, *of_frames, tuple(answer["scene"]))


def problem(message: str | None, field: str | None = None) -> bytes:
    """Problem in place of tracks; without a message the file is damaged."""
    return json.dumps({"problem": message, "field": field}).encode() + b"\n"
