"""People of a range of frames in 3D, located instant by instant, to be looked at while the rest is detected.

Nothing is tracked, and no result depends on it. Entry point: ``first_people``.
"""

import json
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.geometry.triangulation import solve_normal
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.packing import described_camera
from pipeline.run.session_check.consensus import locate_people
from pipeline.run.session_check.sightings import choose_instants, collect_sightings, frames_at

RATE_HZ = 5.0
"""Largest rate of the instants."""
# Two views alone agree by chance; farther from a person's last place is another person.
_MIN_VIEWS, _MAX_STEP_M = 3, 1.0


def first_people(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    detections: Mapping[str, Detections],
    joints: JointSet,
    frames: range,
) -> bytes:
    """Locate people in a range of frames whose detections are there, of every camera.

    Returns JSON for viewers: ``joints``, ``bones`` and ``parents`` of the skeleton, ``rig`` with the cameras, and
    ``instants``, each with ``time_s`` and ``people``. A person has an ``id``, which holds within the range, and
    ``joints_m``: places of the joints in the world one after another, null where fewer than two cameras see one.
    """
    number = max(1, int(len(frames) / timebase.frame_rate_hz * RATE_HZ))
    places = choose_instants([frames], min(number, len(frames)))
    times_s = [timebase.time_s(place) for place in places]
    seen_frames = {name: frames_at(own, timebase, places) for name, own in times.items()}
    sightings = collect_sightings(cameras, detections, seen_frames, joints, times_s)
    located = locate_people(cameras, sightings)
    is_seen = np.isfinite(located.points_px[..., 0])
    poses_m = np.where((is_seen.sum(1) > 1)[..., None], solve_normal(located.normal.sum(1)), np.nan)
    kept = (is_seen.any(-1).sum(1) >= min(_MIN_VIEWS, len(cameras))) & np.isfinite(poses_m[..., 0]).any(-1)
    instants, ids, before = list[dict[str, object]](), list[int](), np.empty((0, 3))
    for place, time_s in enumerate(times_s):
        people_m = poses_m[kept & (located.instant == place)]
        centers_m = np.nanmedian(people_m, axis=1) if len(people_m) else np.empty((0, 3))
        ids, before = _followed(ids, before, centers_m), centers_m
        people = [{"id": one, "joints_m": _values(person_m)} for one, person_m in zip(ids, people_m, strict=True)]
        instants.append({"time_s": round(time_s, 3), "people": people})
    document = {
        "joints": sightings.joints.names,
        "bones": [joint.name for joint in SKELETON],
        "parents": [joint.parent for joint in SKELETON],
        "rig": [described_camera(camera) for camera in cameras],
        "instants": instants,
    }
    return json.dumps(document, separators=(",", ":")).encode()


def _followed(
    ids: Sequence[int], before_m: Float[np.ndarray, "_ 3"], centers_m: Float[np.ndarray, "people 3"]
) -> list[int]:
    """Ids of people by those who stood nearest before; a newcomer has the smallest id that is free."""
    distance_m = np.linalg.norm(centers_m[:, None] - before_m, axis=-1)
    pairs = zip(*linear_sum_assignment(distance_m), strict=True)
    known = {int(row): ids[column] for row, column in pairs if distance_m[row, column] <= _MAX_STEP_M}
    free = (number for number in range(1, len(ids) + len(centers_m) + 1) if number not in known.values())
    return [known[row] if row in known else next(free) for row in range(len(centers_m))]


def _values(person_m: Float[np.ndarray, "joints 3"]) -> list[float | None]:
    return [None if np.isnan(value) else round(float(value), 3) for value in person_m.ravel()]
