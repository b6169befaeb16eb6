"""Figures of a character that follows a person: standing feet (slide, depth), kept contacts, directions of limbs."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import FootContact, SkeletonMotion
from pipeline.export.character.bone_names import HIPS, LIMBS, SIDES
from pipeline.export.character.feet import ScaledFloor, level
from pipeline.export.character.retarget import CharacterMotion, place_of
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from pipeline.motion.skeleton.rotations import times

KEPT_M = 0.005
"""Distance from its place, and from the floor, up to which a standing point keeps its contact."""

_CM_PER_M = 100.0


@dataclass(frozen=True, slots=True)
class RetargetingFigures:
    """Figures of a character's motion; lengths are those of the person's world, NaN without any contact."""

    slide_cm: float  # Largest mean distance of a standing point from its place on the ground
    penetration_cm: float  # Largest depth of a sole below the floor while it stands
    contacts_kept: float  # Share of the frames of contacts in which the point is at its place
    # Angles between limbs of the character and of the person: median, 95th percentile
    direction_deg: tuple[float, float]
    # Angles between the hips of the character and of the person, likewise
    hips_deg: tuple[float, float]


def figures_of(motion: CharacterMotion) -> RetargetingFigures:
    """Measure a character's motion."""
    joints = motion.figure.joints
    places = {
        joint: place_of(motion.figure, motion.hips, motion.turns, joints[joint]) for limb in LIMBS for joint in limb
    }
    slides, depths, kept = [0.0], [0.0], []
    for side in SIDES:
        if motion.floor is None:
            break
        contacts = [c for c in motion.source.contacts if c.pinned and c.side == side.lower()]
        apart_m, heights_m, is_upright = _soles_of(motion, motion.floor, side, places[f"{side}Foot"], contacts)
        for contact, apart in zip(contacts, apart_m, strict=True):
            slides.append(float(apart.mean()))
            heights, upright = heights_m[contact.rows], is_upright[contact.rows]
            depths.append(float(-heights[upright].min(initial=0.0)))
            kept += ((apart <= KEPT_M) & ((np.abs(heights) <= KEPT_M) | ~upright)).tolist()
    person_m = forward_kinematics(_without_fingers(motion.source))
    deg = np.concatenate(
        [
            _angles_deg(places[end] - places[start], person_m[:, INDEX[end]] - person_m[:, INDEX[start]])
            for limb in LIMBS
            for start, end in pairwise(limb)
        ]
    )
    hips = motion.turns[joints[HIPS]] @ motion.figure.upright[joints[HIPS]].T
    person = Rotation.from_quat(motion.source.parent_from_joint[:, INDEX[HIPS]])
    tilt_deg = np.degrees((Rotation.from_matrix(hips, assume_valid=True) * person.inv()).magnitude())
    return RetargetingFigures(
        max(slides) * _CM_PER_M,
        max(depths) * _CM_PER_M,
        float(np.mean(kept)) if kept else np.nan,
        _median_and_high(deg),
        _median_and_high(tilt_deg),
    )


def _soles_of(
    motion: CharacterMotion,
    floor: ScaledFloor,
    side: str,
    ankle: Float[np.ndarray, "frames 3"],
    contacts: list[FootContact],
) -> tuple[list[Float[np.ndarray, " _"]], Float[np.ndarray, " frames"], Bool[np.ndarray, " frames"]]:
    """Distances of the standing point from its place in each contact, heights of the sole, and feet not on their side.

    Lengths are in metres of the person.
    """
    foot, measures = motion.figure.joints[f"{side}Foot"], motion.figure.feet[side]
    turned = times(motion.turns[foot], motion.figure.upright[foot].T)
    ankle = ankle - motion.ground
    points = {"heel": ankle + times(turned, measures.heel), "toe": ankle + times(turned, measures.ball), "foot": ankle}
    heights = np.minimum(floor.height(points["heel"]), floor.height(points["toe"]))
    apart = []
    for contact in contacts:
        level_m = points[contact.part][contact.rows, :2] / motion.scale
        apart.append(np.linalg.norm(level_m - np.median(level_m, axis=0), axis=-1))
    return apart, heights / motion.scale, level(turned, floor)[1]


def _without_fingers(motion: SkeletonMotion) -> SkeletonMotion:
    size = len(SKELETON)
    return replace(
        motion, bone_length_m=motion.bone_length_m[:size], parent_from_joint=motion.parent_from_joint[:, :size]
    )


def angles_deg(motion: CharacterMotion, start: str, end: str) -> Float[np.ndarray, " frames"]:
    """Angles between a bone of the character and the person's, by the joints at its ends."""
    joints = motion.figure.joints
    places = [place_of(motion.figure, motion.hips, motion.turns, joints[name]) for name in (start, end)]
    places_m = forward_kinematics(motion.source)
    return _angles_deg(places[1] - places[0], places_m[:, INDEX[end]] - places_m[:, INDEX[start]])


def _angles_deg(
    first: Float[np.ndarray, "frames 3"], second: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, " frames"]:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), (first * second).sum(-1)))


def _median_and_high(deg: Float[np.ndarray, " angles"]) -> tuple[float, float]:
    return float(np.median(deg)), float(np.quantile(deg, 0.95))
