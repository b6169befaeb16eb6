"""Contacts of a corrected person: contacts that are found again, added or removed, and places where feet are held."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import Floor, FootContact, FootPart
from pipeline.core.options.corrections import LIMBS
from pipeline.core.options.edits import Contact, Correction, frames_of
from pipeline.motion.skeleton.corrections.keys import rows_between
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M, SIDES, find_runs
from pipeline.motion.skeleton.feet.holding import PARTS, at_own_distance, led_m
from pipeline.motion.skeleton.feet.stances import LANDMARKS, SHORTEST_S, FootPoints

_ALL_PARTS: tuple[FootPart, ...] = ("foot", *PARTS)
# Height of standing points above the floor, where the person has no contact that tells it.
_USUAL_HEIGHT_M: Mapping[FootPart, float] = {"foot": ANKLE_HEIGHT_M, "heel": 0.0, "toe": 0.0}


def contacts_between(
    contacts: Sequence[FootContact],
    found: Sequence[FootContact],
    is_found: Bool[np.ndarray, " frames"],
    corrections: Sequence[Correction],
    start_frame: int,
    by_parts: Bool[np.ndarray, " 2"],
    frame_rate_hz: float,
) -> tuple[FootContact, ...]:
    """Contacts of a person, sorted by start, after corrections.

    ``contacts``, ``found``: contacts before, and contacts that count in the frames ``is_found``. Both are counted from
    the motion's start. ``start_frame``: output frame of the motion's start. ``by_parts``: whether the left and the
    right foot stand by heel and toe.
    """
    kept = []
    for side, is_by_parts in zip(SIDES, by_parts, strict=True):
        of_side = [c for c in corrections if isinstance(c, Contact) and c.limb == f"{side}_foot"]
        for part in _ALL_PARTS:
            before, after = ([c for c in some if (c.side, c.part) == (side, part)] for some in (contacts, found))
            confidence, pinned = np.zeros(len(is_found)), np.zeros(len(is_found), bool)
            stands, begins = np.zeros(len(is_found), bool), np.zeros(len(is_found), bool)
            for some, where in ((before, ~is_found), (after, is_found)):
                for contact in some:
                    here = np.flatnonzero(where[contact.rows]) + contact.start_frame
                    stands[here], confidence[here], pinned[here] = True, contact.confidence, contact.pinned
                    # An added contact may touch two stances, which stay two.
                    begins[here[:1]] = contact is not some[0]
            is_added = np.zeros(len(is_found), bool)
            for correction in of_side:
                rows = rows_between(*frames_of(correction), start_frame, len(is_found))
                stands[rows] = is_added[rows] = correction.stands and is_by_parts == (part != "foot")
                confidence[rows], pinned[rows] = 1.0, True
            for start, stop in _cut(find_runs(stands), begins & ~(is_found != np.roll(is_found, 1))):
                same = [c for c in before if (c.start_frame, c.num_frames) == (start, stop - start)]
                run = slice(start, stop)
                if same and not is_found[run].any() and not is_added[run].any():
                    kept.append(same[0])
                elif stop - start >= SHORTEST_S * frame_rate_hz or is_added[run].any():
                    is_pinned = bool(pinned[run].any())
                    kept.append(
                        FootContact(side, start, stop - start, float(confidence[run].mean()), is_pinned, 0.0, 0.0, part)
                    )
    return tuple(sorted(kept, key=lambda contact: (contact.start_frame, contact.side)))


def _cut(runs: Sequence[tuple[int, int]], begins: Bool[np.ndarray, " frames"]) -> Iterator[tuple[int, int]]:
    """Runs of frames, cut where another contact begins."""
    for start, stop in runs:
        borders = [start, *(np.flatnonzero(begins[start + 1 : stop]) + start + 1).tolist(), stop]
        yield from pairwise(borders)


def held_feet_m(
    before: FootPoints,
    points: FootPoints,
    contacts: Sequence[FootContact],
    added: Mapping[str, Bool[np.ndarray, " frames"]],
    is_changed: Bool[np.ndarray, " frames"],
    floor: Floor | None,
    frame_rate_hz: float,
) -> Mapping[str, Float[np.ndarray, "frames 3"]]:
    """Positions at which landmarks of feet are held (metres), NaN in frames and along axes in which they are free.

    A contact stays where it is held in frames that don't change; another one is held at its median. Contacts that were
    added are also put on the floor.

    ``before``, ``points``: feet before corrections, and corrected but not yet held. ``added``: frames in which a limb
    stands as it was told, by limb. ``is_changed``: frames that corrections change.
    """
    places, ground_m = {}, before.support.ground_m
    for foot, side in enumerate(SIDES):
        parts: tuple[FootPart, ...] = PARTS if points.by_parts[foot] else ("foot",)
        points_m = [_on_ground_m(points, foot, part) for part in parts]
        led = []
        for part, point_m in zip(parts, points_m, strict=True):
            before_m, held = _on_ground_m(before, foot, part), []
            of_part = [contact for contact in contacts if (contact.side, contact.part) == (side, part)]
            for contact in of_part:
                rows = contact.rows
                if not contact.pinned:
                    continue
                kept = np.flatnonzero(~is_changed[rows]) + rows.start
                place_m = np.median(before_m[kept] if len(kept) else point_m[rows], axis=0)
                place_m[2] = np.nan
                if floor is not None and added[f"{side}_foot"][rows].any():
                    known = [c for c in of_part if not (added[f"{side}_foot"] | is_changed)[c.rows].any()]
                    heights_m = [float(np.median(floor.height_m(before_m[c.rows]))) for c in known]
                    height_m = float(np.median(heights_m)) if heights_m else _USUAL_HEIGHT_M[part]
                    place_m[2] = height_m - floor.height_m(np.append(place_m[:2], 0.0))
                held.append((rows, place_m))
            led.append(led_m(point_m, held, frame_rate_hz))
        if len(parts) > 1:
            led = list(np.moveaxis(at_own_distance(np.stack(points_m, axis=1), np.stack(led, axis=1)), 1, 0))
        for part, place_m in zip(parts, led, strict=True):
            places[f"{side}_{LANDMARKS[part]}"] = place_m + ground_m
    return places


def _on_ground_m(points: FootPoints, foot: int, part: FootPart) -> Float[np.ndarray, "frames 3"]:
    point_m = points.ankles_m[:, foot] if part == "foot" else points.parts_m[:, foot, PARTS.index(part)]
    return point_m - points.support.ground_m


def held_hands_m(
    wrists_m: Mapping[str, Float[np.ndarray, "frames 3"]],
    added: Mapping[str, Bool[np.ndarray, " frames"]],
    frame_rate_hz: float,
) -> Mapping[str, Float[np.ndarray, "frames 3"]]:
    """Positions at which wrists are held during contacts of hands, each at its median; by landmark, NaN elsewhere."""
    places = {}
    for name, wrist_m in wrists_m.items():
        runs = [slice(*run) for run in find_runs(added[name.replace("wrist", "hand")])]
        held = [(rows, np.median(wrist_m[rows], axis=0)) for rows in runs]
        places[name] = led_m(wrist_m, held, frame_rate_hz)
    return places


def added_contacts(
    corrections: Sequence[Correction], start_frame: int, num_frames: int
) -> Mapping[str, Bool[np.ndarray, " frames"]]:
    """Frames of a track in which a limb stands as it was told, by limb; the last correction of a frame counts."""
    stands: dict[str, np.ndarray] = {limb: np.zeros(num_frames, bool) for limb in LIMBS}
    for correction in corrections:
        if isinstance(correction, Contact):
            rows = rows_between(*frames_of(correction), start_frame, num_frames)
            stands[correction.limb][rows] = correction.stands
    return stands


def clipped(contacts: Sequence[FootContact], rows: slice) -> tuple[FootContact, ...]:
    """Contacts within rows of a motion, counted from the first of them."""
    parts = []
    for contact in contacts:
        start, stop = max(contact.start_frame, rows.start), min(contact.rows.stop, rows.stop)
        if start < stop:
            parts.append(replace(contact, start_frame=start - rows.start, num_frames=stop - start))
    return tuple(parts)
