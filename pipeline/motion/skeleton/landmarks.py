"""Landmarks of a track by name, and lengths of bones from them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.people import Source
from pipeline.core.joints import JointSet
from pipeline.motion.skeleton.model import SKELETON, TRUNK

# Stature of a person without a measured bone.
_ADULT_STATURE_M = 1.70
MAX_ASYMMETRY = 0.25
"""Difference of lengths of a limb, as a share, that bodies and detectors have: legs differ by 1 to 3 %, and marks of
one side may be off by a sixth of a limb for a whole take."""

# Standard errors by which both sides must differ; error of a median from the median deviation of normal errors.
_SIGNIFICANT, _ERROR_OF_MEDIAN = 3.0, 1.4826 * 1.2533
_MIN_LENGTHS = 3
# Deviation of a limb's length from the length by the body's other bones: usual one, of bodies and marks, and largest
# one of bodies, as logarithms of the ratio.
_USUAL_DISPROPORTION, _MAX_DISPROPORTION = 0.12, 0.5
# Least spread of lengths, as a share: more exact lengths are no more credible.
_LEAST_SPREAD = 0.03
_SIDES = ("left", "right")
_ENDS = {
    "ForeArm": ("shoulder", "elbow"),
    "Hand": ("elbow", "wrist"),
    "Leg": ("hip", "knee"),
    "Foot": ("knee", "ankle"),
}
_SHARES = {joint.kind: joint.stature_share for joint in SKELETON}
_TRUNK_SHARE = sum(_SHARES[kind] for kind in TRUNK)


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Positions of a person's joints by name."""

    # World positions in metres, NaN where unknown. All positions of joints that the detector lacks are NaN.
    xyz_m: Float[np.ndarray, "frames joints 3"]
    source: Int[np.ndarray, "frames joints"]  # Source of each position, see ``data.people.Source``
    joints: JointSet  # Joint set of the track
    # Number of cameras with an observation of each joint; ``None``: unknown, all positions count alike
    views: Int[np.ndarray, "frames joints"] | None = None

    def __getitem__(self, name: str) -> Float[np.ndarray, "frames 3"]:
        if name not in self.joints.names:
            return np.full((len(self.xyz_m), 3), np.nan)
        return self.xyz_m[:, self.joints.index(name)]

    def middle(self, kind: str) -> Float[np.ndarray, "frames 3"]:
        """Centre between the left and the right joint of a kind; NaN where one of them is unknown."""
        return (self[f"left_{kind}"] + self[f"right_{kind}"]) / 2

    def is_measured(self, name: str) -> np.ndarray:
        """Frames in which a joint was measured, and not interpolated, predicted or absent."""
        if name not in self.joints.names:
            return np.zeros(len(self.xyz_m), dtype=bool)
        return self.source[:, self.joints.index(name)] == Source.MEASURED


@dataclass(frozen=True, slots=True, eq=False)
class _Lengths:
    """Distances of two joints in the frames in which both were measured."""

    length_m: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]  # Degrees of freedom by which the views check each other: two a view, less three

    @classmethod
    def between(cls, landmarks: Landmarks, start: Sequence[str], end: Sequence[str]) -> "_Lengths":
        """Distances from the centre of some joints to the centre of others."""
        names = (*start, *end)
        measured = np.all([landmarks.is_measured(name) for name in names], axis=0)
        ends_m = [np.mean([landmarks[name][measured] for name in some], axis=0) for some in (start, end)]
        length_m = np.linalg.norm(ends_m[1] - ends_m[0], axis=-1)
        weight = np.ones(len(length_m))
        if landmarks.views is not None and measured.any():
            views = landmarks.views[:, landmarks.joints.indices(names)][measured].min(-1)
            weight = np.maximum(2.0 * views - 3.0, 1.0)
        is_apart = length_m > 0.0  # coincident joints are no measured bone
        return cls(length_m[is_apart], weight[is_apart])

    def joined(self, other: "_Lengths") -> "_Lengths":
        return _Lengths(np.append(self.length_m, other.length_m), np.append(self.weight, other.weight))

    @property
    def median_m(self) -> float:
        """Weighted median; NaN without any length."""
        if not len(self.length_m):
            return np.nan
        order = np.argsort(self.length_m, kind="stable")
        below = np.cumsum(self.weight[order]) / self.weight.sum()
        # The mean of both neighbours where the halves are equal.
        halves = np.minimum(np.searchsorted(below, [0.5 - 1e-9, 0.5 + 1e-9]), len(order) - 1)
        return float(self.length_m[order[halves]].mean())

    @property
    def spread_m(self) -> float:
        """Median deviation from the median."""
        return _Lengths(np.abs(self.length_m - self.median_m), self.weight).median_m

    def support(self, expected_m: float) -> float:
        """Logarithm of how well these lengths are supported: by views, frames, their spread and an expected length."""
        spread = max(self.spread_m / self.median_m, _LEAST_SPREAD)
        off = np.log(self.median_m / expected_m) / _USUAL_DISPROPORTION if np.isfinite(expected_m) else 0.0
        return float(np.log(self.weight.sum()) - np.log(spread) - off**2 / 2)


def _is_disputed(left: _Lengths, right: _Lengths) -> bool:
    """True if both sides differ by more than bodies do, and by more than the spread of the measurements explains."""
    # A side that was measured once or twice has no spread of its own.
    if min(len(left.length_m), len(right.length_m)) < _MIN_LENGTHS:
        return False
    errors_m = [_ERROR_OF_MEDIAN * side.spread_m / np.sqrt(len(side.length_m)) for side in (left, right)]
    shorter_m, longer_m = sorted((left.median_m, right.median_m))
    apart_m = longer_m - shorter_m
    return bool(apart_m > MAX_ASYMMETRY * shorter_m and apart_m > _SIGNIFICANT * np.hypot(*errors_m))


def limb_lengths_m(landmarks: Landmarks) -> dict[str, float]:
    """Lengths of limbs in metres by the joint at their lower end, ``elbow``, ``wrist``, ``knee`` or ``ankle``.

    Bodies are symmetric within a few percent, so that both sides have one length: the median of all frames, in which
    positions from more views count for more. If the sides differ by more than bodies do, one side was measured wrong,
    such as a hand that is hidden by a table, and the length is taken of the side which views, frames, spread and the
    proportions of the other bones support. A length that no body has beside these bones is replaced by the one that
    they tell. NaN for a limb that was never measured.
    """
    sides = {kind: [_limb(landmarks, side, kind) for side in _SIDES] for kind in _ENDS}
    disputed = {kind for kind, of_kind in sides.items() if _is_disputed(*of_kind)}
    trunk = _Lengths.between(landmarks, _both("hip"), _both("shoulder"))
    lengths_m = {}
    for kind, (left, right) in sides.items():
        of_others_m = [trunk.median_m / _TRUNK_SHARE]
        for other in sides.keys() - disputed - {kind}:
            of_others_m += [side.median_m / _SHARES[other] for side in sides[other]]
        known_m = np.array(of_others_m)[np.isfinite(of_others_m)]
        expected_m = _SHARES[kind] * float(np.median(known_m)) if len(known_m) else np.nan
        if kind in disputed:
            length_m = max(left, right, key=lambda side: side.support(expected_m)).median_m
        else:
            length_m = left.joined(right).median_m
        is_body = not abs(np.log(length_m / expected_m)) > _MAX_DISPROPORTION
        lengths_m[_ENDS[kind][1]] = length_m if is_body else expected_m
    return lengths_m


def located_limbs_m(landmarks: Landmarks) -> dict[tuple[str, str], float]:
    """Median length of each limb by its side and bone, such as ``("left", "Hand")``, where it was measured often."""
    limbs = {(side, kind): _limb(landmarks, side, kind) for side in _SIDES for kind in _ENDS}
    return {name: limb.median_m for name, limb in limbs.items() if len(limb.length_m) >= _MIN_LENGTHS}


def _limb(landmarks: Landmarks, side: str, kind: str) -> _Lengths:
    start, end = _ENDS[kind]
    return _Lengths.between(landmarks, [f"{side}_{start}"], [f"{side}_{end}"])


def _both(kind: str) -> tuple[str, str]:
    return f"left_{kind}", f"right_{kind}"


def bone_lengths_m(landmarks: Landmarks) -> Float[np.ndarray, " joints"]:
    """Length of every bone of ``SKELETON``, constant in time.

    Lengths in metres are medians over the frames in which both ends were measured; lengths of limbs are
    ``limb_lengths_m``. Bones that were never measured get adult proportions, scaled to the measured bones.
    """
    shoulders, hips = _both("shoulder"), _both("hip")
    of_limbs_m = limb_lengths_m(landmarks)
    measured_m = {
        "Arm": _Lengths.between(landmarks, shoulders[:1], shoulders[1:]).median_m / 2,
        "UpLeg": _Lengths.between(landmarks, hips[:1], hips[1:]).median_m / 2,
        **{kind: of_limbs_m[lower] for kind, (_, lower) in _ENDS.items()},
        "Head": _Lengths.between(landmarks, shoulders, _both("ear")).median_m,
    }
    trunk_m = _Lengths.between(landmarks, hips, shoulders).median_m
    measured_m |= {kind: trunk_m * _SHARES[kind] / _TRUNK_SHARE for kind in (*TRUNK, "Shoulder")}
    statures_m = np.array([length_m / _SHARES[kind] for kind, length_m in measured_m.items()])
    known_m = statures_m[np.isfinite(statures_m)]
    stature_m = float(np.median(known_m)) if len(known_m) else _ADULT_STATURE_M
    lengths_m = np.array([measured_m.get(joint.kind, np.nan) for joint in SKELETON])
    default_m = np.array([joint.stature_share * stature_m for joint in SKELETON])
    return np.where(np.isfinite(lengths_m), lengths_m, default_m)
