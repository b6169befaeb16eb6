"""The joints in the order in which they are found, and the limbs between them (section 3, figure 3 of the paper)."""

from dataclasses import dataclass

from pipeline.joints import JointSet


@dataclass(frozen=True, slots=True)
class Limb:
    """How a joint hangs on its parent.

    Parameters
    ----------
    parent
        The joint that is found before.
    longest_m
        No human being's limb is longer, the detector's noise included.
    is_constant
        Whether a person's limb has one length, whatever the pose.
    field_share
        How strong its part affinity field is beside those of other limbs.
    """

    parent: str
    longest_m: float
    is_constant: bool = True
    field_share: float = 1.0


ROOT = "neck"

# The paper's 13 limbs; its network's head is the nose here. Limbs of the upper half come first, as in the paper's
# figure 3. The other joints that detectors know hang on those: the paper has none of them, so that they decide nothing.
_LIMBS: dict[str, Limb] = {
    "nose": Limb(ROOT, 0.45, field_share=0.5),  # weak in both networks of the registry
    **{f"{side}_shoulder": Limb(ROOT, 0.35) for side in ("left", "right")},
    **{f"{side}_elbow": Limb(f"{side}_shoulder", 0.50) for side in ("left", "right")},
    **{f"{side}_wrist": Limb(f"{side}_elbow", 0.45) for side in ("left", "right")},
    **{f"{side}_hip": Limb(ROOT, 0.90, is_constant=False) for side in ("left", "right")},
    **{f"{side}_knee": Limb(f"{side}_hip", 0.70) for side in ("left", "right")},
    **{f"{side}_ankle": Limb(f"{side}_knee", 0.70) for side in ("left", "right")},
    **{f"{side}_eye": Limb("nose", 0.15, is_constant=False) for side in ("left", "right")},
    # From behind nobody's nose is seen, but ears are.
    **{f"{side}_ear": Limb(f"{side}_shoulder", 0.35, is_constant=False) for side in ("left", "right")},
    "mid_hip": Limb(ROOT, 0.90, is_constant=False),
    **{f"{side}_{toe}": Limb(f"{side}_ankle", 0.35, is_constant=False)
       for side in ("left", "right") for toe in ("heel", "big_toe", "small_toe")},
}  # fmt: skip

_CORE = tuple(_LIMBS)[:13]

TORSO = (ROOT, "nose", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
"""What people are linked in time by (section 3.5)."""


@dataclass(frozen=True, slots=True)
class Skeleton:
    """A detector's joints as a tree.

    Parameters
    ----------
    names
        Every joint after its parent, the root first. A neck that the detector does not know is its shoulders' middle.
    parents
        Position of each joint's parent in ``names``, -1 for the root.
    longest_m
        See ``Limb``; 0 for the root.
    is_constant
        Likewise, false for the root.
    field_share
        Likewise.
    sources
        Position of each joint in the detector's order, -1 where it does not know the joint.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    longest_m: tuple[float, ...]
    is_constant: tuple[bool, ...]
    field_share: tuple[float, ...]
    sources: tuple[int, ...]

    @property
    def levels(self) -> list[list[int]]:
        """Joints that are as far from the root as each other, which can be found together."""
        depth = [0]
        for parent in self.parents[1:]:
            depth.append(depth[parent] + 1)
        return [[j for j, mine in enumerate(depth) if mine == level] for level in range(max(depth) + 1)]

    @property
    def core(self) -> list[int]:
        """Positions of the paper's 14 joints."""
        return [j for j, name in enumerate(self.names) if name == ROOT or name in _CORE]

    @property
    def shoulders(self) -> list[int]:
        """Positions of the two shoulders."""
        return self.indices(("left_shoulder", "right_shoulder"))

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """Positions of joints."""
        return [self.names.index(name) for name in names]


def skeleton_of(joints: JointSet) -> Skeleton:
    """Put a detector's joints in order.

    Raises
    ------
    ValueError
        If the detector does not know one of the 13 joints beside the neck.
    """
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
