"""Landmarks of a track by name, and lengths of bones from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.data.people import Source
from pipeline.joints import JointSet
from pipeline.skeleton.model import SKELETON, TRUNK

# Stature of a person without a measured bone.
_ADULT_STATURE_M = 1.70
# Difference of a person's limbs on both sides, as a share, that bodies and detectors have: legs differ by 1 to 3 %, and
# marks of one side may be off by a sixth of a limb for a whole take.
_MAX_ASYMMETRY = 0.25
# Standard errors by which both sides must differ; error of a median from the median deviation of normal errors.
_SIGNIFICANT, _ERROR_OF_MEDIAN = 3.0, 1.4826 * 1.2533
_MIN_LENGTHS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Positions of a person's joints by name."""

    # World positions in metres, NaN where unknown. All positions of joints that the detector lacks are NaN.
    xyz_m: Float[np.ndarray, "frames joints 3"]
    source: Int[np.ndarray, "frames joints"]  # Source of each position, see ``data.people.Source``
    joints: JointSet  # Joint set of the track

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


def _median_m(*distances_m: Float[np.ndarray, " _"]) -> float:
    """Median of all values that are not NaN; NaN if there are none."""
    pooled = np.concatenate(distances_m)
    known = pooled[np.isfinite(pooled)]
    return float(np.median(known)) if len(known) else np.nan


def lengths_of_sides_m(
    left_m: Float[np.ndarray, " left_frames"], right_m: Float[np.ndarray, " right_frames"]
) -> tuple[float, float]:
    """Length of a limb on the left and on the right: medians of the measured lengths, which may be NaN.

    Both sides are pooled, unless they differ by more than bodies do and by more than the spread of the measurements
    explains: one side is measured wrong then, and would pull the other one. NaN if neither side was measured.
    """
    pooled_m = _median_m(left_m, right_m)
    sides_m = [side_m[np.isfinite(side_m)] for side_m in (left_m, right_m)]
    if not all(map(len, sides_m)):
        return pooled_m, pooled_m
    left, right = (float(np.median(side_m)) for side_m in sides_m)
    apart_m = abs(left - right)
    errors_m = [
        _ERROR_OF_MEDIAN * float(np.median(np.abs(side_m - median_m))) / np.sqrt(len(side_m))
        for side_m, median_m in zip(sides_m, (left, right), strict=True)
    ]
    # A side that was measured once or twice has no spread of its own.
    is_known = all(len(side_m) >= _MIN_LENGTHS for side_m in sides_m)
    if is_known and apart_m > _MAX_ASYMMETRY * min(left, right) and apart_m > _SIGNIFICANT * np.hypot(*errors_m):
        return left, right
    return pooled_m, pooled_m


def bone_lengths_m(landmarks: Landmarks) -> Float[np.ndarray, " joints"]:
    """Length of every bone of ``SKELETON``, constant in time.

    Lengths in metres are medians over the frames in which both ends were measured; left and right are pooled, unless
    they disagree (``lengths_of_sides_m``). Bones that were never measured get adult proportions, scaled to the measured
    bones.
    """

    def distance_m(start: tuple[str, ...], end: tuple[str, ...]) -> Float[np.ndarray, " frames"]:
        measured = np.all([landmarks.is_measured(name) for name in (*start, *end)], axis=0)
        ends = [np.mean([landmarks[name] for name in names], axis=0) for names in (start, end)]
        return np.where(measured, np.linalg.norm(ends[1] - ends[0], axis=-1), np.nan)

    def both_sides_m(start: str, end: str) -> tuple[float, float]:
        left_m, right_m = (distance_m((f"{side}_{start}",), (f"{side}_{end}",)) for side in ("left", "right"))
        return lengths_of_sides_m(left_m, right_m)

    shoulders = ("left_shoulder", "right_shoulder")
    hips = ("left_hip", "right_hip")
    sides_m = {
        "ForeArm": both_sides_m("shoulder", "elbow"),
        "Hand": both_sides_m("elbow", "wrist"),
        "Leg": both_sides_m("hip", "knee"),
        "Foot": both_sides_m("knee", "ankle"),
    }
    measured_m = {
        "Arm": _median_m(distance_m(shoulders[:1], shoulders[1:])) / 2,
        "UpLeg": _median_m(distance_m(hips[:1], hips[1:])) / 2,
        **{kind: (left_m + right_m) / 2 for kind, (left_m, right_m) in sides_m.items()},
        "Head": _median_m(distance_m(shoulders, ("left_ear", "right_ear"))),
    }
    trunk_m = _median_m(distance_m(hips, shoulders))
    shares = {joint.kind: joint.stature_share for joint in SKELETON}
    trunk_share = sum(shares[kind] for kind in TRUNK)
    measured_m |= {kind: trunk_m * shares[kind] / trunk_share for kind in (*TRUNK, "Shoulder")}

    statures_m = np.array([length_m / shares[kind] for kind, length_m in measured_m.items()])
    stature_m = _median_m(statures_m) if np.isfinite(statures_m).any() else _ADULT_STATURE_M
    by_name_m = {
        f"{side}{kind}": of_kind[k] for kind, of_kind in sides_m.items() for k, side in enumerate(("Left", "Right"))
    }
    lengths_m = np.array([by_name_m.get(joint.name, measured_m.get(joint.kind, np.nan)) for joint in SKELETON])
    default_m = np.array([joint.stature_share * stature_m for joint in SKELETON])
    return np.where(np.isfinite(lengths_m), lengths_m, default_m)
