"""Arms and legs of a joint set: the joints that detectors take for those of the other side."""

from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.core.joints import JointSet

_ARMS = ("shoulder", "elbow", "wrist")
_LEGS = ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")


@dataclass(frozen=True, slots=True)
class LimbPair:
    """Both arms or both legs, as positions on the joint axis: joints from the trunk outwards, in the same order."""

    left: tuple[int, ...]
    right: tuple[int, ...]

    @property
    def both(self) -> list[int]:
        """Joints of the left limb, then those of the right one."""
        return [*self.left, *self.right]

    @property
    def exchanged(self) -> list[int]:
        """Joints of the right limb, then those of the left one."""
        return [*self.right, *self.left]


def arms_and_legs(joints: JointSet) -> tuple[LimbPair, LimbPair] | None:
    """Arms and legs of a joint set; ``None`` if it lacks a shoulder or a hip."""
    arms, legs = (_pair(joints, parts) for parts in (_ARMS, _LEGS))
    has_trunk = {f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "hip")} <= set(joints.names)
    return (arms, legs) if has_trunk else None


def _pair(joints: JointSet, parts: tuple[str, ...]) -> LimbPair:
    names = list(_in_both(joints, parts))
    left, right = (tuple(joints.index(f"{side}_{name}") for name in names) for side in ("left", "right"))
    return LimbPair(left, right)


def _in_both(joints: JointSet, parts: tuple[str, ...]) -> Iterator[str]:
    """Parts that the joint set has on both sides."""
    return (part for part in parts if {f"left_{part}", f"right_{part}"} <= set(joints.names))
