"""Skeleton of hypothesis clustering: joints from the root on, the limbs between them, and lengths of people's bones.

Joints and limbs are from section 3 and figure 3. Lengths are measured from poses of a first pass without lengths
(section 3.6).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.joints import JointSet


@dataclass(frozen=True, slots=True)
class Limb:
    """Limb from a joint to its parent."""

    parent: str  # Name of the parent joint, which is found first
    longest_m: float  # Upper limit of the limb's length for any person, the detector's noise included
    is_constant: bool = True  # True if the limb's length does not depend on the pose
    field_share: float = 1.0  # Strength of the limb's part affinity field relative to other limbs


ROOT = "neck"

# First the paper's 13 limbs, the upper body first as in figure 3; the nose stands for the head of the paper's network.
# Further joints of detectors follow as leaves: they do not affect the paper's joints.
_LIMBS: dict[str, Limb] = {
    "nose": Limb(ROOT, 0.45, field_share=0.5),  # weak in both networks of the registry
    **{f"{side}_shoulder": Limb(ROOT, 0.35) for side in ("left", "right")},
    **{f"{side}_elbow": Limb(f"{side}_shoulder", 0.50) for side in ("left", "right")},
    **{f"{side}_wrist": Limb(f"{side}_elbow", 0.45) for side in ("left", "right")},
    **{f"{side}_hip": Limb(ROOT, 0.90, is_constant=False) for side in ("left", "right")},
    **{f"{side}_knee": Limb(f"{side}_hip", 0.70) for side in ("left", "right")},
    **{f"{side}_ankle": Limb(f"{side}_knee", 0.70) for side in ("left", "right")},
    **{f"{side}_eye": Limb("nose", 0.15, is_constant=False) for side in ("left", "right")},
    # Ears are visible from behind, where the nose is not.
    **{f"{side}_ear": Limb(f"{side}_shoulder", 0.35, is_constant=False) for side in ("left", "right")},
    "mid_hip": Limb(ROOT, 0.90, is_constant=False),
    **{f"{side}_{toe}": Limb(f"{side}_ankle", 0.35, is_constant=False)
       for side in ("left", "right") for toe in ("heel", "big_toe", "small_toe")},
}  # fmt: skip

_CORE = tuple(_LIMBS)[:13]

TORSO = (ROOT, "nose", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
# Upper limit of an animal's bones, whose world is enlarged until animals are as large as people.
_LONGEST_OF_ANIMAL_M = 2.0


@dataclass(frozen=True, slots=True)
class Skeleton:
    """Joints of a detector as a tree."""

    # Joint names, the root first and every joint after its parent. If the detector has no neck, the neck is the
    # midpoint of the shoulders.
    names: tuple[str, ...]
    parents: tuple[int, ...]  # Position of each joint's parent in ``names``, -1 for the root
    longest_m: tuple[float, ...]  # See ``Limb``; 0 for the root
    is_constant: tuple[bool, ...]  # See ``Limb``; false for the root
    field_share: tuple[float, ...]  # See ``Limb``; 1 for the root
    sources: tuple[int, ...]  # Position of each joint in the detector's order, -1 for a joint that the detector lacks

    @property
    def levels(self) -> list[list[int]]:
        """Joints by depth in the tree, the root first; joints of a level are found together."""
        depths = [0]
        for parent in self.parents[1:]:
            depths.append(depths[parent] + 1)
        return [[j for j, depth in enumerate(depths) if depth == level] for level in range(max(depths) + 1)]

    @property
    def is_persons(self) -> bool:
        """True for the paper's skeleton, false for the points of an animal."""
        return self.names[0] == ROOT

    @property
    def core(self) -> list[int]:
        """Positions of the paper's 14 joints; all points of an animal."""
        return [j for j, name in enumerate(self.names) if name == ROOT or name in _CORE or not self.is_persons]

    @property
    def torso(self) -> list[int]:
        """Positions of the joints by which poses are linked in time (section 3.5); all points of an animal."""
        return self.indices(TORSO) if self.is_persons else self.core

    @property
    def core_observed(self) -> list[int]:
        """Positions of the paper's joints that the detector finds: a neck between the shoulders is none of its own."""
        return [j for j in self.core if self.sources[j] >= 0]

    @property
    def shoulders(self) -> list[int]:
        """Positions of the two shoulders."""
        return self.indices(("left_shoulder", "right_shoulder"))

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """Positions of joints in ``names``."""
        return [self.names.index(name) for name in names]


def clustering_skeleton(joints: JointSet) -> Skeleton:
    """Make the skeleton of a detector's joints, or of the points and bones of an animal.

    Raises ``ValueError`` if a detector lacks any of the paper's 13 joints other than the neck.
    """
    if joints.bones and not {ROOT, *_CORE} & {*joints.names}:
        return _animal_skeleton(joints)
    names = (ROOT, *(name for name in _LIMBS if name in joints.names))
    missing = [name for name in _CORE if name not in names]
    if missing:
        raise ValueError(f"Clustering needs the joints {', '.join(missing)}.")
    limbs = [_LIMBS[name] for name in names[1:]]
    return Skeleton(
        names=names,
        parents=(-1, *(names.index(limb.parent) for limb in limbs)),
        longest_m=(0.0, *(limb.longest_m for limb in limbs)),
        is_constant=(False, *(limb.is_constant for limb in limbs)),
        field_share=(1.0, *(limb.field_share for limb in limbs)),
        sources=tuple(joints.names.index(name) if name in joints.names else -1 for name in names),
    )


def _animal_skeleton(joints: JointSet) -> Skeleton:
    """Tree of bones from the point with the most bones on; points without a bone to it hang on it at any distance."""
    ends = [end for bone in joints.bones for end in bone]
    root = max(joints.names, key=ends.count)
    parent_of, is_bone = {root: ""}, {root: False}
    for start in (root, *joints.names):
        if start not in parent_of:
            parent_of[start], is_bone[start] = root, False
        reached = [start]
        for parent in reached:
            for child in (end for bone in joints.bones if parent in bone for end in bone):
                if child not in parent_of:
                    parent_of[child], is_bone[child] = parent, True
                    reached.append(child)
    names = tuple(parent_of)
    return Skeleton(
        names=names,
        parents=(-1, *(names.index(parent) for parent in list(parent_of.values())[1:])),
        longest_m=(0.0, *[_LONGEST_OF_ANIMAL_M] * (len(names) - 1)),
        is_constant=tuple(is_bone.values()),
        field_share=(1.0,) * len(names),
        sources=tuple(map(joints.names.index, names)),
    )


class LimbLengths(NamedTuple):
    """Lengths of the limbs from each joint to its parent."""

    # Length sets L of eq. 3, (joints, people); NaN for a limb that was not measured or whose length is not constant
    known_m: np.ndarray
    longest_m: np.ndarray  # Upper limit of each limb's length, (joints,)

    @property
    def is_measured(self) -> Bool[np.ndarray, " joints"]:
        """Return whether the length of the joint's limb is known for any person."""
        return ~np.isnan(self.known_m).all(-1)


def unknown_lengths(skeleton: Skeleton) -> LimbLengths:
    """Make lengths for the first pass: upper limits only."""
    return LimbLengths(np.empty((len(skeleton.names), 0)), np.array(skeleton.longest_m))


def unlimited_lengths(skeleton: Skeleton) -> LimbLengths:
    """Make lengths for the paper's ablation without bone lengths: no upper limits either."""
    return LimbLengths(np.empty((len(skeleton.names), 0)), np.full(len(skeleton.names), np.inf))


def measure_lengths(people_m: Sequence[Float[np.ndarray, "_ joints 3"]], skeleton: Skeleton) -> LimbLengths:
    """Measure each person's limbs of constant length by the median over the person's poses.

    Poses are in metres, NaN where a joint was not found.
    """
    known_m = np.full((len(skeleton.names), len(people_m)), np.nan)
    for j in np.flatnonzero(skeleton.is_constant):
        for person, poses_m in enumerate(people_m):
            lengths_m = np.linalg.norm(poses_m[:, j] - poses_m[:, skeleton.parents[j]], axis=-1)
            if np.isfinite(lengths_m).any():
                known_m[j, person] = np.nanmedian(lengths_m)
    return LimbLengths(known_m, np.array(skeleton.longest_m))
