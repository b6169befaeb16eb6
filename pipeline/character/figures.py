"""Figures of a character that follows a person: standing feet (slide, depth), kept contacts, directions of limbs."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from pipeline.character.feet import level
from pipeline.character.mapping import LIMBS
from pipeline.character.retarget import CharacterMotion, place_of
from pipeline.skeleton.model import INDEX, forward_kinematics

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


def figures_of(motion: CharacterMotion) -> RetargetingFigures:
    """Measure a character's motion."""
    slides, depths, kept = [0.0], [0.0], []
    joints = motion.figure.joints
    places = {
        joint: place_of(motion.figure, motion.hips, motion.turns, joints[joint]) for limb in LIMBS for joint in limb
    }
    person_m = forward_kinematics(motion.source)
    for contact in motion.source.contacts:
        if not contact.pinned or motion.floor is None:
            continue
        side = contact.side.capitalize()
        foot = motion.figure.joints[f"{side}Foot"]
        ankle = (places[f"{side}Foot"] - motion.ground)[contact.rows]
        turned = motion.turns[foot][contact.rows] @ motion.figure.upright[foot].T
        measures = motion.figure.feet[side]
        sole = {part: ankle + turned @ place for part, place in (("heel", measures.heel), ("toe", measures.ball))}
        point = sole.get(contact.part, ankle) / motion.scale
        apart_m = np.linalg.norm(point[:, :2] - np.median(point[:, :2], axis=0), axis=-1)
        slides.append(float(apart_m.mean()))
        _, is_upright = level(turned, motion.floor)
        heights_m = np.min([motion.floor.height(place) for place in sole.values()], axis=0) / motion.scale
        depths += (-heights_m[is_upright]).tolist()
        kept += ((apart_m <= KEPT_M) & ((np.abs(heights_m) <= KEPT_M) | ~is_upright)).tolist()
    deg = np.concatenate(
        [
            _angles_deg(places[end] - places[start], person_m[:, INDEX[end]] - person_m[:, INDEX[start]])
            for limb in LIMBS
            for start, end in pairwise(limb)
        ]
    )
    return RetargetingFigures(
        max(slides) * _CM_PER_M,
        max(depths) * _CM_PER_M,
        float(np.mean(kept)) if kept else np.nan,
        (float(np.median(deg)), float(np.quantile(deg, 0.95))),
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
