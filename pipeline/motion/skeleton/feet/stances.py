"""Stances of a person's feet: points that stand, their contacts, and feet held in place."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import Floor, FootContact, SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.core.options.config import Feet
from pipeline.core.progress import OnShare
from pipeline.motion.skeleton.feet.contacts import find_contacts, mean_slide_m
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.feet.holding import PARTS, held_parts_m, held_positions_m
from pipeline.motion.skeleton.feet.support import FootMarks, Support, support_of
from pipeline.motion.skeleton.feet.unseen import foot_without_toes
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from pipeline.motion.skeleton.model import joint_pose

_MARKS: Mapping[str, str] = {"heel": "heel", "toe": "big_toe"}
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

    def of(self, contact: FootContact) -> Float[np.ndarray, "rows 3"]:
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
            np.stack([_known(fitted.track, joints, f"{side}_{_MARKS[part]}") for part in PARTS], axis=1)
            for side in SIDES
        ],
        axis=1,
    )
    often = parts_known.all(-1).sum(0) >= np.maximum(_KNOWN_SHARE * ankles_known.sum(0), 1.0)
    parts_known &= often[:, None]
    num_frames = len(ankles_m)
    marks = FootMarks(parts_m.reshape(num_frames, -1, 3), parts_known.reshape(num_frames, -1))
    support = support_of(fitted.track, joints, ankles_m, ankles_known, marks, motion.frame_rate_hz)
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
            offset_m = fitted.offset_m(f"{side}_{_MARKS[part]}")
            if offset_m is not None:
                parts_m[:, foot, number] = ankles_m[:, foot] + world_from_foot.apply(offset_m)
    return ankles_m, parts_m


def _known(track: Track3D, joints: JointSet, name: str) -> Bool[np.ndarray, " frames"]:
    if name not in joints.names:
        return np.zeros(track.num_frames, dtype=bool)
    return np.asarray(np.isfinite(track.xyz_m[:, joints.index(name)]).all(-1))


def contacts_of(points: FootPoints, floor: Floor | None, frame_rate_hz: float, feet: Feet) -> tuple[FootContact, ...]:
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

    The fit's motion is changed in place. ``points`` are those of the feet before they are held; the result has the
    contacts with their slide afterwards.
    """
    places_m = _places_m(points, contacts, motion.frame_rate_hz)
    if any(np.isfinite(place_m).any() for place_m in places_m.values()):
        fitted.pin(places_m, on_share)
        ankles_m, parts_m = _positions_m(fitted, motion)
        points = replace(points, ankles_m=ankles_m, parts_m=parts_m)
    slid = (replace(contact, slide_after_m=mean_slide_m(points.of(contact))) for contact in contacts)
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
        f"{side}_{_MARKS[part]}": parts_m[:, foot, number]
        for foot, side in enumerate(SIDES)
        if points.by_parts[foot]
        for number, part in enumerate(PARTS)
    }
