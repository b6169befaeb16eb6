"""Limbs that were located with another length than the skeleton's: one side was measured wrong for most of the take."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.motion.skeleton.landmarks import MAX_ASYMMETRY, Landmarks, located_limbs_m
from pipeline.motion.skeleton.model import INDEX

_NAMES = {"ForeArm": "upper arm", "Hand": "forearm", "Leg": "thigh", "Foot": "shin"}


@dataclass(frozen=True, slots=True)
class MismeasuredLimb:
    """Limb of a person whose located length the fit does not use."""

    track_id: int  # Number of the person
    name: str  # Name of the limb, such as ``left forearm``
    located_m: float  # Median of the located lengths
    length_m: float  # Length of the skeleton's bone

    @property
    def document(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "id": self.track_id,
            "limb": self.name,
            "located_m": round(self.located_m, 3),
            "length_m": round(self.length_m, 3),
        }


def mismeasured_limbs(take: Reconstruction, people: Sequence[int]) -> list[MismeasuredLimb]:
    """Find the limbs whose located length differs from the skeleton's by more than bodies and marks explain.

    ``people`` are positions of tracks: pictures of people have limbs of any length.
    """
    limbs = []
    for number in people:
        track, motion = take.located[number], take.motions[number]
        located_m = located_limbs_m(Landmarks(track.xyz_m, track.source, take.joints, track.views))
        for (side, kind), median_m in located_m.items():
            length_m = float(motion.bone_length_m[INDEX[f"{side.capitalize()}{kind}"]])
            shorter_m, longer_m = sorted((median_m, length_m))
            if longer_m > (1.0 + MAX_ASYMMETRY) * shorter_m:
                limbs.append(MismeasuredLimb(track.track_id, f"{side} {_NAMES[kind]}", median_m, length_m))
    return limbs
