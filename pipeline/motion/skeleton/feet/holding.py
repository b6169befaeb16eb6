"""Positions at which standing feet are held: ankles, or heels and toes where they are known."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import FootContact, FootPart, Side
from pipeline.motion.skeleton.feet.floor import SIDES

PARTS: tuple[FootPart, FootPart] = ("heel", "toe")
"""Parts of a foot that stand by themselves."""

# Time before and after a contact in which the foot moves to and from its held position.
_EASE_S = 0.2


def held_positions_m(
    ankles_m: Float[np.ndarray, "frames 2 3"], contacts: Sequence[FootContact], frame_rate_hz: float
) -> Float[np.ndarray, "frames 2 3"]:
    """Horizontal positions at which ankles are held so that feet stand still.

    The height is free, because a standing foot may lift its heel. A foot moves to and from its held position over 0.2
    s, so that it does not jump. Returns positions in metres; NaN in frames and along axes in which an ankle is free.
    """
    places_m = np.empty_like(ankles_m)
    for foot, side in enumerate(SIDES):
        standing = [
            contact.rows for contact in contacts if contact.side == side and contact.part == "foot" and contact.pinned
        ]
        places_m[:, foot] = _led_m(ankles_m[:, foot], standing, frame_rate_hz)
    return places_m


def held_parts_m(
    parts_m: Float[np.ndarray, "frames 2 2 3"], contacts: Sequence[FootContact], frame_rate_hz: float
) -> Float[np.ndarray, "frames 2 2 3"]:
    """Horizontal positions at which heels and toes are held, each during its own contacts.

    The places of heel and toe, if both are held, keep the distance that they have in the frame. Otherwise a place that
    is too near or too far by millimetres would tilt the foot. Positions are by foot (left, right) and part (heel, toe).
    Positions of the result are in metres, NaN in frames and along axes in which a part is free.
    """
    places_m = np.empty_like(parts_m)
    for foot, side in enumerate(SIDES):
        for number, part in enumerate(PARTS):
            standing = [
                contact.rows for contact in contacts if contact.side == side and contact.part == part and contact.pinned
            ]
            places_m[:, foot, number] = _led_m(parts_m[:, foot, number], standing, frame_rate_hz)
        places_m[:, foot] = at_own_distance(parts_m[:, foot], places_m[:, foot])
    return places_m


def at_own_distance(
    parts_m: Float[np.ndarray, "frames 2 3"], places_m: Float[np.ndarray, "frames 2 3"]
) -> Float[np.ndarray, "frames 2 3"]:
    """Places of heel and toe, moved along their line to the horizontal distance that heel and toe have."""
    now_m = np.linalg.norm(parts_m[:, 1, :2] - parts_m[:, 0, :2], axis=-1, keepdims=True)
    line_m = places_m[:, 1, :2] - places_m[:, 0, :2]
    held_m = np.linalg.norm(line_m, axis=-1, keepdims=True)
    # NaN where a part is free.
    half_m = line_m / np.maximum(held_m, 1e-6) * (now_m - held_m) / 2
    half_m = np.where(np.isfinite(half_m), half_m, 0.0)
    moved_m = np.array(places_m)
    moved_m[:, 0, :2] -= half_m
    moved_m[:, 1, :2] += half_m
    return moved_m


def _led_m(
    point_m: Float[np.ndarray, "frames 3"], standing: Sequence[slice], frame_rate_hz: float
) -> Float[np.ndarray, "frames 3"]:
    """Positions of a point that stands at its horizontal median in ranges of frames, see ``led_m``."""
    return led_m(point_m, [(rows, _horizontal_median_m(point_m[rows])) for rows in standing], frame_rate_hz)


def _horizontal_median_m(point_m: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, " 3"]:
    return np.append(np.median(point_m[:, :2], axis=0), np.nan)


def led_m(
    point_m: Float[np.ndarray, "frames 3"],
    held: Sequence[tuple[slice, Float[np.ndarray, " 3"]]],
    frame_rate_hz: float,
) -> Float[np.ndarray, "frames 3"]:
    """Positions of a point that is held at places in ranges of frames, in their order; NaN where it is free.

    Places are NaN along axes in which the point is free.
    """
    moved_m = np.zeros_like(point_m)
    for rows, place_m in held:
        moved_m[rows] = np.nan_to_num(place_m - point_m[rows])
    is_led = eased(moved_m, [rows for rows, _ in held], frame_rate_hz)
    places_m = np.where(is_led[:, None], point_m + moved_m, np.nan)
    # Floats: a height that is held is hardly ever exactly where it was.
    places_m[:, 2] = np.where(moved_m[:, 2] != 0.0, places_m[:, 2], np.nan)
    return places_m


def eased(
    corrections: Float[np.ndarray, "frames columns"], rows_of: Sequence[slice], frame_rate_hz: float
) -> Bool[np.ndarray, " frames"]:
    """Let corrections in ranges of frames begin and end over 0.2 s; between two ranges both count.

    ``corrections``, 0 outside of the ranges, are changed in place; ``rows_of`` are the ranges, in order. Returns the
    frames with a correction.
    """
    is_led = np.zeros(len(corrections), dtype=bool)
    longest = round(_EASE_S * frame_rate_hz)
    for rows in rows_of:
        is_led[rows] = True
    # Between two contacts, a foot is moved by both.
    for before, after in pairwise([None, *rows_of, None]):
        start = before.stop if before else 0
        stop = after.start if after else len(corrections)
        rising = _rising(min(longest, stop - start))[:, None]
        if before:
            led = slice(start, start + len(rising))
            corrections[led] += rising[::-1] * corrections[start - 1]
            is_led[led] = True
        if after:
            led = slice(stop - len(rising), stop)
            corrections[led] += rising * corrections[stop]
            is_led[led] = True
    return is_led


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
