"""Spurious tracks, which may be chance: the expected number of equally good coincidences in a session.

Bodies of different cameras that do not belong together agree by chance now and then. How often follows from geometry
(a-contrario detection, Desolneux, Moisan and Morel 2000): a body of a second camera lies at a ray by chance with the
probability that the band around its epipolar line covers, times the number of bodies in the picture; a body of a third
camera with that of the disc around a point. Moments count once a fifth of a second, because wrong detections last, and
only where there are pictures: chance has no occasion in a pause.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations
from pipeline.geometry.track_assembly import Person

# Expected number of coincidences in a session below which a track is a person.
_MAX_FALSE_ALARMS = 0.1
_MOMENT_S = 0.2
_MIN_JOINTS = 3
# Radius in mean reprojection errors, and least error as a share of the image's shorter side.
_RADIUS, _LEAST_ERROR = 2.0, 0.005


def mean_bodies(observations: Iterable[Observations], num_recorded: int) -> float:
    """Mean number of bodies in a picture, at least 1; ``num_recorded`` frames have pictures."""
    bodies = [_has_body(seen) for seen in observations]
    return float(max(1.0, sum(of_person.sum() / of_person.shape[1] for of_person in bodies) / num_recorded))


def is_spurious(
    person: Person, cameras: Sequence[Camera], timebase: Timebase, num_bodies: float, num_recorded: int
) -> bool:
    """Whether a track may be chance; never if it lasts for half of the session, which may be too short to tell.

    ``num_bodies`` is the mean number of bodies in a picture; ``num_recorded`` output frames have pictures.
    """
    if 2 * person[0].num_frames >= num_recorded:
        return False
    return log_false_alarms(person, cameras, timebase, num_bodies, num_recorded) > math.log(_MAX_FALSE_ALARMS)


def log_false_alarms(
    person: Person, cameras: Sequence[Camera], timebase: Timebase, num_bodies: float, num_recorded: int
) -> float:
    """Logarithm of the expected number of coincidences that are as good as a track; see ``is_spurious``."""
    track, seen = person
    num_views = _has_body(seen).sum(-1)
    size_px = np.median([camera.size_px for camera in cameras], axis=0)
    error_px = _mean(track.error_px)
    radius_px = _RADIUS * np.maximum(error_px, _LEAST_ERROR * size_px.min())
    at_line = np.minimum(1.0, num_bodies * 2 * radius_px / size_px.min())
    at_point = np.minimum(1.0, num_bodies * np.pi * radius_px**2 / size_px.prod())
    log_chance = np.log(at_line) + (num_views - 2) * np.log(at_point)
    agreeing = (num_views >= 2) & np.isfinite(error_px)
    num_pairs = max(1.0, len(cameras) * (len(cameras) - 1) / 2)
    frames_a_moment = max(1.0, _MOMENT_S * timebase.frame_rate_hz)
    num_moments = max(1.0, num_recorded / frames_a_moment)
    return float(np.log(num_moments * num_pairs * num_bodies**2) + log_chance[agreeing].sum() / frames_a_moment)


def _has_body(seen: Observations) -> Bool[np.ndarray, "frames cameras"]:
    return np.asarray((seen.score > 0).sum(-1) >= _MIN_JOINTS)


def _mean(values: Float[np.ndarray, "frames joints"]) -> Float[np.ndarray, " frames"]:
    """Mean of the values that are not NaN, NaN without any."""
    known = np.isfinite(values)
    count = known.sum(-1)
    return np.asarray(np.where(known, values, 0.0).sum(-1) / np.where(count, count, np.nan))
