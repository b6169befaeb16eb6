"""``keeping PACKETS FOLDER CAMERAS LAYOUT``: packets of a live capture as files of a session.

Writes an archive of each camera that sent frames, in OpenPose's form, and ``timestamps.csv``; prints the archives'
names by camera. ``CAMERAS`` is a list of names in JSON, ``LAYOUT`` the layout of the points. Frames are in the order of
their times, which begin at 0; of frames of a camera with the same time the first one is kept.
"""

import csv
import json
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from pipeline.core.layouts import LAYOUTS
from pipeline.run.live.packets import KeypointsHead, read_message
from pipeline.run.live.packing import unpack_keypoints

TIMESTAMPS = "timestamps.csv"
"""Name of the table of times."""
_DIGITS = 6
# Layouts that readers of OpenPose's form do not know; their points are written in the order of another one.
_WRITTEN_AS = {"body-25b": "halpe-26", "mediapipe-33": "halpe-26"}


def write_session(packets: BinaryIO, folder: Path, cameras: Sequence[str], layout: str) -> dict[str, str]:
    """Write the files of a session from packets; return the names of the archives by camera."""
    places = _places(packets)
    starts_s = [min(times_s) for times_s in places.values()]
    start_s = min(starts_s, default=0.0)
    names = {cameras[camera]: f"camera-{camera}.zip" for camera in sorted(places)}
    with (folder / TIMESTAMPS).open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["camera", "frame", "time_s"])
        for camera in sorted(places):
            times_s = sorted(places[camera])
            rows = enumerate(times_s)
            table.writerows([cameras[camera], frame, repr(time_s - start_s)] for frame, time_s in rows)
            offsets = [places[camera][time_s] for time_s in times_s]
            _write_archive(packets, offsets, layout, folder / names[cameras[camera]])
    return names


def _places(packets: BinaryIO) -> Mapping[int, Mapping[float, int]]:
    places: dict[int, dict[float, int]] = {}
    while True:
        offset = packets.tell()
        if (packet := read_message(packets)) is None:
            return places
        if (head := KeypointsHead.decode(packet)) is not None:
            places.setdefault(head.camera, {}).setdefault(head.time_s, offset)


def _written(people: Float[np.ndarray, "people points 3"], layout: str) -> Float[np.ndarray, "people points_written 3"]:
    """Points as they are written; 0 for points that the layout lacks."""
    if (other := _WRITTEN_AS.get(layout)) is None:
        return people
    points = LAYOUTS[layout].points
    taken = [points.index(name) if name is not None and name in points else -1 for name in LAYOUTS[other].points]
    return np.pad(people, ((0, 0), (0, 1), (0, 0)))[:, taken]


def _write_archive(packets: BinaryIO, offsets: Sequence[int], layout: str, path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for frame, offset in enumerate(offsets):
            packets.seek(offset)
            _, people = unpack_keypoints(read_message(packets) or b"")
            bodies = np.round(_written(people, layout), _DIGITS)
            content = {"people": [{"pose_keypoints_2d": body.ravel().tolist()} for body in bodies]}
            archive.writestr(f"frame_{frame:012d}_keypoints.json", json.dumps(content))


def main(words: Sequence[str]) -> int:
    """Write the session, and return the exit code."""
    packets, folder, cameras, layout = words
    with Path(packets).open("rb") as file:
        names = write_session(file, Path(folder), json.loads(cameras), layout)
    sys.stdout.write(json.dumps(names))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
