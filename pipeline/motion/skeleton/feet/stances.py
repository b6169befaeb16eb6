"""Stances of a person's feet: points that stand, their contacts, and feet held in place."""

from bisect import bisect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import expit

from pipeline.core.data.animation import Floor, FootContact, FootPart, SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.core.options.config import Feet
from pipeline.core.progress import OnShare
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M, SIDES, find_runs, speed_m_s
from pipeline.motion.skeleton.feet.holding import PARTS, held_parts_m, held_positions_m
from pipeline.motion.skeleton.feet.support import FootMarks, Support, find_support, middle_rows
from pipeline.motion.skeleton.feet.unseen import foot_without_toes
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from pipeline.motion.skeleton.model import joint_pose

# Speed at which a stance has the likelihood 0.5, and the width of the transition.
_SPEED_M_S, _SPEED_STEEP_M_S = 0.40, 0.07
# A person's own floor level: quantile of the heights, and limits on its difference from the floor, under feet that
# carry the person, and under others, whose marks are a foot's thickness above the floor.
_OWN_SHARE, _OWN_LEVEL_M, _FOOT_LEVEL_M = 0.1, 0.15, 0.09
_LIKELY = 0.5
SHORTEST_S = 0.1
"""Shortest time of a contact."""

_SURE_AFTER_S = 0.15
_CREEP_M, _ROOM_S = 0.04, 0.2
# Contacts of a stance that are shorter, and so near to one that is not, are of the landing.
_LONG_S, _BESIDE_S = 0.2, 0.2
# Speed at which a foot under an upright shin does not stand, and distance by which it may be wrong besides. Feet behind
# shins that lie are dragged: they stand if their speed, smoothed over this time, is lower.
_DRIFT_M_S, _DRIFT_M = 0.12, 0.02
_STILL_M_S, _PACE_SMOOTH_S = 0.08, 0.08
# Shortest time for which feet carry a person whose own level is measured.
_CARRIES_S = 1.0
# Lowest confidence of a contact that ``auto`` pins.
_MIN_CONFIDENCE = 0.5


@dataclass(frozen=True, slots=True)
class _Standing:
    """Height of a standing point of the foot above its floor."""

    usual_m: float  # Height of the point on a standing foot; the person's own level is measured from here
    # Height at which a stance has the likelihood 0.5, and the width of the transition. An ankle may rise while the ball
    # of the foot stands; a heel or a toe may not.
    likely_m: float
    steep_m: float


_STANDING: dict[FootPart, _Standing] = {
    "foot": _Standing(ANKLE_HEIGHT_M, 0.08, 0.015),
    "heel": _Standing(0.0, 0.04, 0.008),
    "toe": _Standing(0.0, 0.04, 0.008),
}


def find_contacts(
    points_m: Float[np.ndarray, "frames 2 3"],
    known: Bool[np.ndarray, "frames 2"],
    floor: Floor | None,
    frame_rate_hz: float,
    feet: Feet,
    part: FootPart = "foot",
    support: Support | None = None,
) -> tuple[FootContact, ...]:
    """Find the contacts of both feet by one point on each, sorted by start; none without a floor.

    - ``points_m``: positions of the left and right ankle, heel or toe.
    - ``known``: frames in which a point was located.
    - ``feet``: contacts to pin: none, confident contacts, or all.
    - ``part``: part of the foot that the points belong to; the ankle stands for the whole foot.
    - ``support``: support of the body; ``None``: all feet may carry it.
    """
    if floor is None:
        return ()
    contacts: list[FootContact] = []
    standing = _STANDING[part]
    height_m = floor.height_m(points_m) - standing.usual_m
    carries = known if support is None else known & support.carries
    pace_m_s = speed_m_s(points_m, frame_rate_hz, _PACE_SMOOTH_S)
    if carries.sum() >= _CARRIES_S * frame_rate_hz:
        height_m -= _own_level_m(height_m[carries], _OWN_LEVEL_M)
    else:
        height_m -= _own_level_m(height_m[known], _FOOT_LEVEL_M)
    for foot, side in enumerate(SIDES):
        point_m = points_m[:, foot]
        of_foot: list[FootContact] = []
        likely = _likelihood(height_m[:, foot], speed_m_s(point_m, frame_rate_hz), standing) * known[:, foot]
        for start, stop in find_runs(likely >= _LIKELY):
            for rows in _split_stance(point_m, start, stop, frame_rate_hz):
                duration_s = (rows.stop - rows.start) / frame_rate_hz
                if duration_s < SHORTEST_S or (support is not None and support.rides(rows, foot)):
                    continue
                stands_up = support is None or 2 * support.shin_stands[rows, foot].sum() >= rows.stop - rows.start
                if stands_up and _drift_m_s(point_m[rows], frame_rate_hz) > _DRIFT_M_S + _DRIFT_M / duration_s:
                    continue
                if not stands_up and np.median(pace_m_s[middle_rows(rows), foot]) > _STILL_M_S:
                    continue
                confidence = float(likely[rows].mean() * (1.0 - np.exp(-duration_s / _SURE_AFTER_S)))
                pinned = feet == "always" or (feet == "auto" and confidence >= _MIN_CONFIDENCE)
                slide_m = mean_slide_m(point_m[rows])
                of_foot.append(
                    FootContact(side, rows.start, rows.stop - rows.start, confidence, pinned, slide_m, slide_m, part)
                )
        contacts += _without_brief(of_foot, frame_rate_hz)
    return tuple(sorted(contacts, key=lambda contact: (contact.start_frame, contact.side)))


def _drift_m_s(point_m: Float[np.ndarray, "frames 3"], frame_rate_hz: float) -> float:
    """Horizontal speed of a point from the first to the last third of some frames."""
    third = max(1, len(point_m) // 3)
    way_m = point_m[-third:, :2].mean(0) - point_m[:third, :2].mean(0)
    return float(np.linalg.norm(way_m)) * frame_rate_hz / max(1, len(point_m) - third)


def mean_slide_m(point_m: Float[np.ndarray, "frames 3"]) -> float:
    """Mean horizontal distance of a point from its median position, in metres."""
    return float(np.linalg.norm(point_m[:, :2] - np.median(point_m[:, :2], axis=0), axis=-1).mean())


def _own_level_m(height_m: Float[np.ndarray, " n"], most_m: float) -> float:
    """Height of a person's own floor above the plane; 0 if it is off by more than a limit.

    It is centimetres if the calibration is tilted by a degree, or if feet lie on their insteps.
    """
    if not len(height_m):
        return 0.0
    level_m = float(np.quantile(height_m, _OWN_SHARE))
    return level_m if abs(level_m) <= most_m else 0.0


def _likelihood(
    height_m: Float[np.ndarray, " frames"], speed: Float[np.ndarray, " frames"], standing: _Standing
) -> Float[np.ndarray, " frames"]:
    """Likelihood of a stance, from height and speed of a point."""
    by_height = expit((standing.likely_m - np.abs(height_m)) / standing.steep_m)
    return np.asarray(by_height * expit((_SPEED_M_S - speed) / _SPEED_STEEP_M_S))


def _without_brief(contacts: Sequence[FootContact], frame_rate_hz: float) -> Sequence[FootContact]:
    """Contacts of one foot, in order, without brief ones beside long ones: feet slip as they land."""
    brief, room = _LONG_S * frame_rate_hz, _BESIDE_S * frame_rate_hz
    long = [contact.rows for contact in contacts if contact.num_frames >= brief]
    starts = [rows.start for rows in long]

    def is_beside(contact: FootContact) -> bool:
        number = bisect(starts, contact.start_frame)
        neighbours = long[max(number - 1, 0) : number + 1]
        return any(max(rows.start - contact.rows.stop, contact.start_frame - rows.stop) <= room for rows in neighbours)

    return [contact for contact in contacts if contact.num_frames >= brief or not is_beside(contact)]


def _split_stance(
    point_m: Float[np.ndarray, "frames 3"], start: int, stop: int, frame_rate_hz: float
) -> Iterator[slice]:
    """Cut a stance where the foot has moved away from its mean position so far; leave frames for the movement."""
    margin = round(_ROOM_S / 2 * frame_rate_hz)
    begun, total = start, np.zeros(2)
    for frame in range(start, stop):
        here = point_m[frame, :2]
        if frame > begun and np.linalg.norm(here - total / (frame - begun)) > _CREEP_M:
            yield slice(begun, frame - margin)
            begun, total = frame + margin, np.zeros(2)
        if frame >= begun:
            total += here
    yield slice(begun, stop)


LANDMARKS: Mapping[str, str] = {"foot": "ankle", "heel": "heel", "toe": "big_toe"}
"""Landmark of each part of a foot."""

# Share of the frames with a known ankle in which heel and toe must be known, so that a foot stands by its parts.
_KNOWN_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class FootPoints:
    """Points of both feet (left, right) in a person's motion, and the frames in which they were located."""

    # Ankles
    ankles_m: Float[np.ndarray, "frames 2 3"]
    ankles_known: Bool[np.ndarray, "frames 2"]
    # Heel and toe of each foot. All frames are unknown for a foot whose parts were not known often enough: it stands as
    # a whole.
    parts_m: Float[np.ndarray, "frames 2 2 3"]
    parts_known: Bool[np.ndarray, "frames 2 2"]
    support: Support

    @property
    def by_parts(self) -> Bool[np.ndarray, " 2"]:
        """Feet that stand by heel and toe."""
        return np.asarray(self.parts_known.any(axis=(0, 2)))

    def point_m(self, contact: FootContact) -> Float[np.ndarray, "rows 3"]:
        """Positions of the point of a contact on its ground during the contact (metres)."""
        foot = SIDES.index(contact.side)
        point_m = self.ankles_m[:, foot] if contact.part == "foot" else self.parts_m[:, foot, PARTS.index(contact.part)]
        return point_m[contact.rows] - self.support.ground_m[contact.rows]


def foot_points(fitted: SkeletonFit, motion: SkeletonMotion, joints: JointSet) -> FootPoints:
    """Points of a person's feet, from the current motion."""
    ankles_m, parts_m = _positions_m(fitted, motion)
    ankles_known = np.stack([_known(fitted.track, joints, f"{side}_ankle") for side in SIDES], axis=1)
    parts_known = np.stack(
        [
            np.stack([_known(fitted.track, joints, f"{side}_{LANDMARKS[part]}") for part in PARTS], axis=1)
            for side in SIDES
        ],
        axis=1,
    )
    often = parts_known.all(-1).sum(0) >= np.maximum(_KNOWN_SHARE * ankles_known.sum(0), 1.0)
    parts_known &= often[:, None]
    num_frames = len(ankles_m)
    marks = FootMarks(parts_m.reshape(num_frames, -1, 3), parts_known.reshape(num_frames, -1))
    support = find_support(fitted.track, joints, ankles_m, ankles_known, marks, motion.frame_rate_hz)
    return FootPoints(ankles_m, ankles_known, parts_m, parts_known, support)


def _positions_m(
    fitted: SkeletonFit, motion: SkeletonMotion
) -> tuple[Float[np.ndarray, "frames 2 3"], Float[np.ndarray, "frames 2 2 3"]]:
    """Positions of ankles, and of heels and toes; NaN for parts without an offset from the ankle."""
    ankles_m = np.empty((len(motion.root_m), len(SIDES), 3))
    parts_m = np.full((len(motion.root_m), len(SIDES), len(PARTS), 3), np.nan)
    for foot, side in enumerate(SIDES):
        ankles_m[:, foot], world_from_foot = joint_pose(motion, f"{side.capitalize()}Foot")
        for number, part in enumerate(PARTS):
            offset_m = fitted.offset_m(f"{side}_{LANDMARKS[part]}")
            if offset_m is not None:
                parts_m[:, foot, number] = ankles_m[:, foot] + world_from_foot.apply(offset_m)
    return ankles_m, parts_m


def _known(track: Track3D, joints: JointSet, name: str) -> Bool[np.ndarray, " frames"]:
    if name not in joints.names:
        return np.zeros(track.num_frames, dtype=bool)
    return np.asarray(np.isfinite(track.xyz_m[:, joints.index(name)]).all(-1))


def foot_contacts(points: FootPoints, floor: Floor | None, frame_rate_hz: float, feet: Feet) -> tuple[FootContact, ...]:
    """Find the contacts of both feet, by heel and toe where they are known, sorted by start.

    Feet stand where their ground does, and do not ride along with the body.
    """
    support, ground_m = points.support, points.support.ground_m[:, None]
    whole = points.ankles_known & ~points.by_parts
    contacts = [*find_contacts(points.ankles_m - ground_m, whole, floor, frame_rate_hz, feet, "foot", support)]
    for number, part in enumerate(PARTS):
        known = points.parts_known[:, :, number]
        if known.any():
            here_m = np.nan_to_num(points.parts_m[:, :, number]) - ground_m
            contacts += find_contacts(here_m, known, floor, frame_rate_hz, feet, part, support)
    return tuple(sorted(contacts, key=lambda contact: (contact.start_frame, contact.side)))


def hold_feet(
    fitted: SkeletonFit,
    motion: SkeletonMotion,
    points: FootPoints,
    contacts: tuple[FootContact, ...],
    floor: Floor | None,
    on_share: OnShare,
) -> SkeletonMotion:
    """Hold standing feet in place; turn them by ``feet.unseen`` if neither toes nor heels are known.

    The fit's motion is changed in place. ``points`` are of the feet before they are held; the result has the
    contacts with their slide afterwards.
    """
    places_m = _places_m(points, contacts, motion.frame_rate_hz)
    if any(np.isfinite(place_m).any() for place_m in places_m.values()):
        fitted.pin(places_m, on_share)
        ankles_m, parts_m = _positions_m(fitted, motion)
        points = replace(points, ankles_m=ankles_m, parts_m=parts_m)
    slid = (replace(contact, slide_after_m=mean_slide_m(points.point_m(contact))) for contact in contacts)
    motion = replace(motion, contacts=tuple(slid))
    if not fitted.sees_feet:
        for side in SIDES:
            fitted.turn(f"{side.capitalize()}Foot", foot_without_toes(motion, side, points.support, floor))
    return motion


def _places_m(
    points: FootPoints, contacts: tuple[FootContact, ...], frame_rate_hz: float
) -> Mapping[str, Float[np.ndarray, "frames 3"]]:
    """Positions at which landmarks of the feet are held, NaN where and along which they are free."""
    ground_m = points.support.ground_m
    on_ground_m = points.ankles_m - ground_m[:, None], points.parts_m - ground_m[:, None, None]
    ankles_m = held_positions_m(on_ground_m[0], contacts, frame_rate_hz) + ground_m[:, None]
    parts_m = held_parts_m(on_ground_m[1], contacts, frame_rate_hz) + ground_m[:, None, None]
    places_m = {f"{side}_ankle": ankles_m[:, foot] for foot, side in enumerate(SIDES) if not points.by_parts[foot]}
    return places_m | {
        f"{side}_{LANDMARKS[part]}": parts_m[:, foot, number]
        for foot, side in enumerate(SIDES)
        if points.by_parts[foot]
        for number, part in enumerate(PARTS)
    }
