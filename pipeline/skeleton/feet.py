"""Feet on the floor: height of the floor, contacts of feet, and positions of standing feet.

A foot stands while its ankle has about the height of a standing ankle and hardly moves. Height and speed each give a
likelihood. A contact needs a product above 0.5 for at least 0.1 s. A foot that creeps on the floor has several contacts
in a row.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.special import expit

from pipeline.config import Feet
from pipeline.data import Floor, FootContact, Side

SIDES: tuple[Side, Side] = ("left", "right")
ANKLE_HEIGHT_M = 0.065
"""Height of a standing adult's ankle above the floor (0.039 of stature)."""

# Smoothing time of the speed: faster movements are noise.
_SMOOTH_S = 0.03
# Resting foot: largest speed and shortest time.
_REST_M_S, _REST_S = 0.15, 0.2
# Scales of the distance between resting ankles and the floor plane, in order of the iterations; feet farther away do
# not rest on the floor.
_FLOOR_SCALES_M = (0.20, 0.10, 0.05, 0.03, 0.03, 0.03)
# Share of the lowest feet that are assumed to be on the floor. And the prior for a level plane: feet in a small area
# don't determine a slope.
_LOWEST_SHARE = 0.2
_SLOPE_SIGMA, _HEIGHT_SIGMA_M = 0.02, 0.02
# Height and speed of an ankle at which a stance has the likelihood 0.5, and the widths of both transitions.
_HEIGHT_M, _HEIGHT_STEEP_M = 0.08, 0.015
_SPEED_M_S, _SPEED_STEEP_M_S = 0.40, 0.07
# A person's own floor level: quantile of the ankle heights, and the limit on its difference from the floor.
_OWN_SHARE, _OWN_LEVEL_M = 0.1, 0.3
_LIKELY, _SHORTEST_S = 0.5, 0.1
_SURE_AFTER_S = 0.15
_CREEP_M, _ROOM_S = 0.04, 0.2
# Lowest confidence of a contact that ``auto`` pins.
_MIN_CONFIDENCE = 0.5
# Time before and after a contact in which the foot moves to and from its held position.
_EASE_S = 0.2


def estimate_floor(
    ankles_m: Sequence[Float[np.ndarray, "_ 2 3"]],
    known: Sequence[Bool[np.ndarray, "_ 2"]],
    frame_rate_hz: float,
) -> Floor | None:
    """Fit a plane to the lowest resting feet of all people; ``None`` if no foot is known.

    If no foot ever rests, the plane is fitted to the lowest positions of all feet. The fit is robust by iterative
    reweighting (Geman and McClure). A weak prior keeps the plane level.

    Parameters
    ----------
    ankles_m
        Positions of the left and right ankle of each person.
    known
        Frames in which an ankle was located.
    """
    resting = [_resting_m(ankles, seen, frame_rate_hz) for ankles, seen in zip(ankles_m, known, strict=True)]
    points_m = np.concatenate([np.zeros((0, 3)), *resting])
    if not len(points_m):
        points_m = np.concatenate(
            [np.zeros((0, 3)), *(ankles[seen] for ankles, seen in zip(ankles_m, known, strict=True))]
        )
        if not len(points_m):
            return None
        lowest = points_m[:, 2] <= np.quantile(points_m[:, 2], _LOWEST_SHARE)
        points_m = points_m[lowest]
    center_m = points_m.mean(0)
    design = np.column_stack([np.ones(len(points_m)), points_m[:, :2] - center_m[:2]])
    plane = np.array([np.quantile(points_m[:, 2], _LOWEST_SHARE), 0.0, 0.0])
    level = np.diag([0.0, 1.0, 1.0]) * (_HEIGHT_SIGMA_M / _SLOPE_SIGMA) ** 2
    for scale_m in _FLOOR_SCALES_M:
        off_m = points_m[:, 2] - design @ plane
        weight = (scale_m**2 / (scale_m**2 + off_m**2)) ** 2
        plane = np.linalg.solve((design * weight[:, None]).T @ design + level, design.T @ (weight * points_m[:, 2]))
    slope = plane[1:]
    return Floor(float(plane[0] - slope @ center_m[:2]) - ANKLE_HEIGHT_M, float(slope[0]), float(slope[1]))


def find_contacts(
    ankles_m: Float[np.ndarray, "frames 2 3"],
    known: Bool[np.ndarray, "frames 2"],
    floor: Floor | None,
    frame_rate_hz: float,
    feet: Feet,
) -> tuple[FootContact, ...]:
    """Find the contacts of both feet, sorted by start; none without a floor.

    Parameters
    ----------
    ankles_m
        Positions of the left and right ankle.
    known
        Frames in which an ankle was located.
    feet
        Contacts to pin: none, confident contacts, or all.
    """
    if floor is None:
        return ()
    contacts = []
    height_m = floor.height_m(ankles_m) - ANKLE_HEIGHT_M
    height_m -= _own_level_m(height_m[known])
    for foot, side in enumerate(SIDES):
        ankle_m = ankles_m[:, foot]
        likely = _likelihood(height_m[:, foot], _speed_m_s(ankle_m, frame_rate_hz)) * known[:, foot]
        for start, stop in _runs(likely >= _LIKELY):
            for rows in _split_stance(ankle_m, start, stop, frame_rate_hz):
                duration_s = (rows.stop - rows.start) / frame_rate_hz
                if duration_s < _SHORTEST_S:
                    continue
                confidence = float(likely[rows].mean() * (1.0 - np.exp(-duration_s / _SURE_AFTER_S)))
                pinned = feet == "always" or (feet == "auto" and confidence >= _MIN_CONFIDENCE)
                slide_m = mean_slide_m(ankle_m[rows])
                contacts.append(
                    FootContact(side, rows.start, rows.stop - rows.start, confidence, pinned, slide_m, slide_m)
                )
    return tuple(sorted(contacts, key=lambda contact: (contact.start_frame, contact.side)))


def mean_slide_m(ankle_m: Float[np.ndarray, "frames 3"]) -> float:
    """Mean horizontal distance of an ankle from its median position, in metres."""
    return float(np.linalg.norm(ankle_m[:, :2] - np.median(ankle_m[:, :2], axis=0), axis=-1).mean())


def held_positions_m(
    ankles_m: Float[np.ndarray, "frames 2 3"], contacts: Sequence[FootContact], frame_rate_hz: float
) -> Float[np.ndarray, "frames 2 3"]:
    """Horizontal positions at which ankles are held so that feet stand still.

    The height is free, because a standing foot may lift its heel. A foot moves to and from its held position over 0.2
    s, so that it does not jump.

    Returns
    -------
        Positions in metres; NaN in frames and along axes in which an ankle is free.
    """
    moved_m, is_led = np.zeros_like(ankles_m), np.zeros(ankles_m.shape[:2], dtype=bool)
    longest = round(_EASE_S * frame_rate_hz)
    for foot, side in enumerate(SIDES):
        standing = [contact.rows for contact in contacts if contact.side == side and contact.pinned]
        ankle_m = ankles_m[:, foot]
        for rows in standing:
            moved_m[rows, foot] = np.median(ankle_m[rows], axis=0) - ankle_m[rows]
            is_led[rows, foot] = True
        # Between two contacts, a foot is moved by both.
        for before, after in pairwise([None, *standing, None]):
            start = before.stop if before else 0
            stop = after.start if after else len(ankle_m)
            rising = _rising(min(longest, stop - start))[:, None]
            if before:
                led = slice(start, start + len(rising))
                moved_m[led, foot] += rising[::-1] * moved_m[start - 1, foot]
                is_led[led, foot] = True
            if after:
                led = slice(stop - len(rising), stop)
                moved_m[led, foot] += rising * moved_m[stop, foot]
                is_led[led, foot] = True
    places_m = np.where(is_led[..., None], ankles_m + moved_m, np.nan)
    places_m[..., 2] = np.nan
    return places_m


def stance_weight(
    contacts: Sequence[FootContact], side: Side, num_frames: int, frame_rate_hz: float
) -> Float[np.ndarray, " frames"]:
    """Weight of a stance in each frame: 1 during contacts, decreasing smoothly to 0 before and after."""
    share = np.zeros(num_frames)
    rising = _rising(round(_EASE_S * frame_rate_hz))
    for contact in contacts:
        if contact.side == side:
            start, stop = contact.rows.start, contact.rows.stop
            share[start:stop] = 1.0
            before, after = share[max(start - len(rising), 0) : start], share[stop : stop + len(rising)]
            np.maximum(before, rising[len(rising) - len(before) :], out=before)
            np.maximum(after, rising[::-1][: len(after)], out=after)
    return share


def _rising(num_frames: int) -> Float[np.ndarray, " frames"]:
    """Smooth ramp from nearly 0 to nearly 1."""
    share = np.arange(1, num_frames + 1) / (num_frames + 1)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _resting_m(
    ankles_m: Float[np.ndarray, "frames 2 3"], known: Bool[np.ndarray, "frames 2"], frame_rate_hz: float
) -> Float[np.ndarray, "_ 3"]:
    """Ankle positions of resting feet: one point for each 0.2 s of a rest."""
    points = [np.zeros((0, 3))]
    step = max(1, round(_REST_S * frame_rate_hz))
    for foot in range(2):
        slow = (_speed_m_s(ankles_m[:, foot], frame_rate_hz) < _REST_M_S) & known[:, foot]
        for start, stop in _runs(slow):
            count = (stop - start) // step
            points.append(ankles_m[start : start + count * step, foot].reshape(count, step, 3).mean(1))
    return np.concatenate(points)


def _speed_m_s(ankle_m: Float[np.ndarray, "frames 3"], frame_rate_hz: float) -> Float[np.ndarray, " frames"]:
    if len(ankle_m) < 2:
        return np.zeros(len(ankle_m))
    smooth_m = gaussian_filter1d(ankle_m, _SMOOTH_S * frame_rate_hz, axis=0, mode="nearest")
    return np.asarray(np.linalg.norm(np.gradient(smooth_m, axis=0), axis=-1) * frame_rate_hz)


def _own_level_m(height_m: Float[np.ndarray, " n"]) -> float:
    """Height of a person's own floor above the plane: centimetres, if the calibration is tilted by a degree."""
    if not len(height_m):
        return 0.0
    level_m = float(np.quantile(height_m, _OWN_SHARE))
    return level_m if abs(level_m) <= _OWN_LEVEL_M else 0.0


def _likelihood(
    height_m: Float[np.ndarray, " frames"], speed_m_s: Float[np.ndarray, " frames"]
) -> Float[np.ndarray, " frames"]:
    """Likelihood of a stance, from height and speed of the ankle."""
    by_height = expit((_HEIGHT_M - np.abs(height_m)) / _HEIGHT_STEEP_M)
    return np.asarray(by_height * expit((_SPEED_M_S - speed_m_s) / _SPEED_STEEP_M_S))


def _runs(mask: Bool[np.ndarray, " frames"]) -> list[tuple[int, int]]:
    borders = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(start), int(stop)) for start, stop in borders.reshape(-1, 2)]


def _split_stance(
    ankle_m: Float[np.ndarray, "frames 3"], start: int, stop: int, frame_rate_hz: float
) -> Iterator[slice]:
    """Cut a stance where the foot has moved away from its mean position so far; leave frames for the movement."""
    margin = round(_ROOM_S / 2 * frame_rate_hz)
    begun, total = start, np.zeros(2)
    for frame in range(start, stop):
        here = ankle_m[frame, :2]
        if frame > begun and np.linalg.norm(here - total / (frame - begun)) > _CREEP_M:
            yield slice(begun, frame - margin)
            begun, total = frame + margin, np.zeros(2)
        if frame >= begun:
            total += here
    yield slice(begun, stop)
