"""Reader of 3D JSON: our ``skeletons.json``, and folders of a frame a file of OpenPose, EasyMocap or Panoptic.

A file of a frame is a list of people, or an object with the list ``people`` or ``bodies``. A person has flat numbers or
rows of x, y, z and a score in ``pose_keypoints_3d`` (OpenPose), ``keypoints3d`` (EasyMocap) or ``joints19`` (Panoptic).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError, number_in_name
from pipeline.capture.keypoint_files.points import CANDIDATES
from pipeline.capture.point_files.point_reader import MAX_NUMBERS, PointTable, flattened, point_reader
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.parsing import read_json

_FIELDS = ("pose_keypoints_3d", "keypoints3d", "joints19")
_PANOPTIC = (
    *("neck", "nose", "mid_hip"),
    *(f"left_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")),
    *(f"right_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")),
    *("left_eye", "left_ear", "right_eye", "right_ear"),
)


@point_reader("3D JSON", ".json", "")
def read_3d_json(path: Path) -> PointTable:
    """Read a file of a take, or a folder of a file a frame, whose names end with its number."""
    if path.is_dir():
        numbered = {number_in_name(file.name): file for file in path.glob("*.json")}
        frames = {number: read_json(file.read_bytes()) for number, file in numbered.items() if number is not None}
    else:
        content = read_json(path.read_bytes())
        if isinstance(content, dict) and "tracks" in content:
            return _skeletons(content)
        frames = dict(enumerate(content if isinstance(content, list) else [content]))
    if not frames or max(frames) - min(frames) >= MAX_OUTPUT_FRAMES:
        raise KeypointsError("The folder has no frames, or too many.")
    return _frames(frames)


def _frames(frames: Mapping[int, Any]) -> PointTable:
    found: dict[str, dict[int, np.ndarray]] = {}
    fields = set()
    for number, frame in frames.items():
        people = (
            frame if isinstance(frame, list) else next(iter(frame[key] for key in ("people", "bodies") if key in frame))
        )
        for place, person in enumerate(people):
            field = next(key for key in _FIELDS if key in person)
            fields.add(field)
            name = str(person.get("id", person.get("person_id", [place])))
            found.setdefault(name, {})[number] = np.array(person[field], float).reshape(-1, 4)
    counts = {len(points) for by_frame in found.values() for points in by_frame.values()}
    if len(fields) != 1 or len(counts) != 1:
        raise KeypointsError("The people of the frames have several numbers of points, or there is no person.")
    (field,), (count,) = fields, counts
    if field != "joints19" and count not in CANDIDATES:
        raise KeypointsError(f"A person has {count} points, which is no layout that is read.")
    points = _PANOPTIC if field == "joints19" else CANDIDATES[count][0].points
    first = min(frames)
    num_frames = max(frames) - first + 1
    if num_frames * len(found) * count > MAX_NUMBERS:
        raise KeypointsError(f"The frames have more than {MAX_NUMBERS:,} numbers; cut them into several takes.")
    xyz = np.full((num_frames, len(found), count, 3), np.nan)
    for place, by_frame in enumerate(found.values()):
        for number, rows in by_frame.items():
            xyz[number - first, place] = np.where(rows[:, 3:] > 0, rows[:, :3], np.nan)
    names = tuple(name or f"point_{k}" for k, name in enumerate(points))
    return PointTable(**flattened(found, names, xyz), up="-y" if field == "joints19" else "z")


def _skeletons(content: Mapping[str, Any]) -> PointTable:
    """Positions of ``skeletons.json``."""
    rate_hz, names, tracks = float(content["frame_rate_hz"]), tuple(content["joint_names"]), content["tracks"]
    num_frames = max(track["start_frame"] + len(track["positions_m"]) for track in tracks)
    if num_frames * len(names) * len(tracks) > MAX_NUMBERS:
        raise KeypointsError(f"The file has more than {MAX_NUMBERS:,} numbers.")
    xyz = np.full((num_frames, len(tracks), len(names), 3), np.nan)
    for place, track in enumerate(tracks):
        rows = [[joint or (np.nan,) * 3 for joint in frame] for frame in track["positions_m"]]
        xyz[track["start_frame"] :, place][: len(rows)] = rows
    people = [str(track["id"]) for track in tracks]
    return PointTable(
        **flattened(people, names, xyz), rate_hz=rate_hz, unit="m", start_s=float(content["start_time_s"])
    )
