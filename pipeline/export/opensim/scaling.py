"""Size of OpenSim's model for a person: factors of its bodies from the lengths of bones, mass, places of markers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import SIDES, JointSet
from pipeline.export.opensim.anatomy import (
    ANKLE_IN_FOOT,
    FEET,
    FOOT_M,
    FOREARM_M,
    HALF_HIPS_M,
    HALF_SHOULDERS_M,
    HIPS,
    LUMBAR,
    MARKERS,
    NECK,
    NECK_IN_HEAD,
    SHANK_M,
    SHOULDERS,
    STATURE_M,
    THIGH_M,
    UPPER_ARM_M,
    Place,
    SeenMarker,
)
from pipeline.motion.angles.compute import observed, segments_from
from pipeline.motion.skeleton.model import INDEX, TRUNK, WHOLE_SKELETON, forward_kinematics

SMALLEST, LARGEST = 0.25, 3.0
"""Factors of a body outside of which a person's bone can't be right."""
# Mass in kg over the stature in metres to the power of 2.5: the body mass index 22 of Trefethen's formula,
# 1.3 mass / stature^2.5 (The Economist, 5 January 2013). It suits children, too: 13 kg for 0.9 m.
_MASS = 22.0 / 1.3
_POWER = 2.5
# Rows that places of markers are the median of.
_MAX_ROWS = 2000


@dataclass(frozen=True, slots=True)
class ModelSize:
    """Size of a person's model."""

    stature_m: float  # Stature by the lengths of legs and trunk
    mass_kg: float  # Mass by the stature
    factors: Mapping[str, Place]  # Factors of each body along its axes X, Y and Z
    places_m: Mapping[str, Place]  # Place of each marker in the body of the generic model, before it is scaled

    @property
    def odd_bodies(self) -> tuple[str, ...]:
        """Bodies whose size can't be right."""
        return tuple(
            body
            for body, factors in self.factors.items()
            if not all(SMALLEST <= factor <= LARGEST for factor in factors)
        )


def size_of(motion: SkeletonMotion, track: Track3D, joints: JointSet) -> ModelSize:
    """Size of a person's model.

    Limbs have the lengths of the skeleton's bones. The width of the pelvis is that of the hips, and the width and
    depth of the torso those of the shoulders. Markers of feet and head stand where the person has them: at their median
    place beside the bone. Masses are by stature, shared among bodies as in the generic model.
    """
    stature_m = _stature_m(motion)
    factors = _factors(motion, track, joints, stature_m)
    return ModelSize(stature_m, _MASS * stature_m**_POWER, factors, _places_m(motion, track, joints, factors))


def _length_m(motion: SkeletonMotion, *names: str) -> float:
    """Mean length of bones, which have the name of the joint at their end."""
    return float(np.mean([motion.bone_length_m[INDEX[name]] for name in names]))


def _of_both(motion: SkeletonMotion, joint: str) -> float:
    return _length_m(motion, f"Left{joint}", f"Right{joint}")


def _trunk_m(motion: SkeletonMotion) -> float:
    return sum(_length_m(motion, name) for name in TRUNK)


def _stature_m(motion: SkeletonMotion) -> float:
    """Stature by the lengths of thigh, shank and trunk, which are nearly always measured."""
    share = sum(WHOLE_SKELETON[INDEX[name]].stature_share for name in ("LeftLeg", "LeftFoot", *TRUNK))
    return (_of_both(motion, "Leg") + _of_both(motion, "Foot") + _trunk_m(motion)) / share


def _factors(motion: SkeletonMotion, track: Track3D, joints: JointSet, stature_m: float) -> dict[str, Place]:
    whole = stature_m / STATURE_M
    hips, shoulders = _of_both(motion, "UpLeg") / HALF_HIPS_M, _of_both(motion, "Arm") / HALF_SHOULDERS_M
    limbs = {
        ("femur",): _of_both(motion, "Leg") / THIGH_M,
        ("tibia",): _of_both(motion, "Foot") / SHANK_M,
        ("humerus",): _of_both(motion, "ForeArm") / UPPER_ARM_M,
        ("ulna", "radius", "hand"): _of_both(motion, "Hand") / FOREARM_M,
    }
    foot = _foot_factor(track, joints, whole)
    # The trunk is as long as the pelvis, up to the lumbar joint, and the torso from there.
    back_m = whole * (LUMBAR[0] - HIPS[0]) + shoulders * SHOULDERS[0]
    up_m = np.sqrt(max(_trunk_m(motion) ** 2 - back_m**2, 0.0)) - whole * (LUMBAR[1] - HIPS[1])
    return {
        **dict.fromkeys(("pelvis", "sacrum"), (whole, whole, hips)),
        "torso": (shoulders, float(up_m / SHOULDERS[1]), shoulders),
        "head": (whole, whole, whole),
        **{
            f"{body}_{side[0]}": (factor, factor, factor)
            for side in SIDES
            for bodies, factor in limbs.items()
            for body in bodies
        },
        **{body: (foot, foot, foot) for side in SIDES for body in FEET[side]},
    }


def _foot_factor(track: Track3D, joints: JointSet, otherwise: float) -> float:
    """Factor of the feet by the distance of heel and big toe, where both are known."""
    apart_m = []
    for side in SIDES:
        ends = (f"{side}_heel", f"{side}_big_toe")
        if set(ends) <= set(joints.names):
            heel_m, toe_m = (track.xyz_m[:, joints.index(name)] for name in ends)
            apart_m.append(np.linalg.norm(toe_m - heel_m, axis=-1))
    known_m = np.concatenate(apart_m) if apart_m else np.empty(0)
    known_m = known_m[np.isfinite(known_m)]
    return float(np.median(known_m)) / FOOT_M if len(known_m) else otherwise


def _places_m(
    motion: SkeletonMotion, track: Track3D, joints: JointSet, factors: Mapping[str, Place]
) -> dict[str, Place]:
    rows = np.unique(np.linspace(0, track.num_frames - 1, min(track.num_frames, _MAX_ROWS)).astype(int))
    motion = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    part = replace(track, xyz_m=track.xyz_m[rows], source=track.source[rows], uncertainty_m=None)
    positions_m, world_from_segment, known = forward_kinematics(motion), segments_from(motion), observed(part, joints)
    places = {}
    for name, marker in MARKERS.items():
        places[name] = marker.place_m
        if isinstance(marker, SeenMarker) and marker.landmark in joints.names and not marker.segment.endswith("_hand"):
            joint = "Head" if marker.segment == "head" else f"{marker.segment.partition('_')[0].capitalize()}Foot"
            away_m = part.xyz_m[:, joints.index(marker.landmark)] - positions_m[:, INDEX[joint]]
            beside_m = np.einsum("fji,fj->fi", world_from_segment[marker.segment], away_m)
            beside_m = beside_m[known[marker.segment] & np.isfinite(beside_m).all(1)]
            if len(beside_m):
                origin_m = _head_m(motion, factors) if joint == "Head" else _ankle_m(marker.segment, factors)
                place_m = (np.median(beside_m, axis=0) + origin_m) / factors[marker.body]
                places[name] = (float(place_m[0]), float(place_m[1]), float(place_m[2]))
    return places


def _head_m(motion: SkeletonMotion, factors: Mapping[str, Place]) -> Float[np.ndarray, " 3"]:
    """Place of the skeleton's head in the scaled model's head, of a person who looks straight ahead."""
    neck_m = (np.array(NECK) - SHOULDERS) * factors["torso"]
    return np.array([0.0, _length_m(motion, "Head"), 0.0]) - neck_m + np.array(NECK_IN_HEAD) * factors["head"]


def _ankle_m(segment: str, factors: Mapping[str, Place]) -> Float[np.ndarray, " 3"]:
    """Place of the ankle in the heel bone of the scaled model."""
    side = segment.partition("_")[0]
    mirror = [1.0, 1.0, 1.0 if side == "right" else -1.0]
    return np.array(ANKLE_IN_FOOT) * mirror * factors[f"calcn_{side[0]}"]
