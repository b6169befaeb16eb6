"""Masses, centres and radii of gyration of the body's segments, by de Leva and by Dumas, from landmarks.

de Leva 1996, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters" (J. Biomech. 29, table 4): the trunk is
between the middles of shoulders and hips, the shank ends at the ankle's centre, the hand at the third knuckle.

Dumas et al. 2007, "Adjustments to McConville et al. and Young et al. body segment inertial parameters" (J. Biomech. 40,
table 2): torso and pelvis are given there from the joints of neck and lumbar spine, here as shares of the line from the
middle of the shoulders to the middle of the hips, whose length is de Leva's. Products of inertia are left out.

The head's centre is the middle of the ears, from which both tables' centres are within a centimetre. Of people whose
ears are never known it is on the line of the trunk, as far above the shoulders as in standing people (Drillis and
Contini 1966: ears at 0.936 of stature, shoulders at 0.818, hips at 0.530). A hand continues its forearm. Feet without
heel and toe are points at the ankles.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import SIDES, JointSet

Row = tuple[float, float, float, float, float, float, float]
# By segment, of women and of men: mass in percent of the body's; in percent of the segment's length the place of the
# centre from its start, its offset to the front and to the right (of right segments), and the radii of gyration about
# the axes to the front, up and to the right.
_TABLES: Mapping[str, Mapping[str, tuple[Row, Row]]] = {
    "de-leva": {
        "head": ((6.68, 0, 0, 0, 27.1, 26.1, 29.5), (6.94, 0, 0, 0, 30.3, 26.1, 31.5)),
        "trunk": ((42.57, 37.82, 0, 0, 37.9, 18.2, 36.1), (43.46, 43.10, 0, 0, 38.4, 19.7, 35.8)),
        "upper_arm": ((2.55, 57.54, 0, 0, 27.8, 14.8, 26.0), (2.71, 57.72, 0, 0, 28.5, 15.8, 26.9)),
        "forearm": ((1.38, 45.59, 0, 0, 26.1, 9.4, 25.7), (1.62, 45.74, 0, 0, 27.6, 12.1, 26.5)),
        "hand": ((0.56, 74.74, 0, 0, 53.1, 33.5, 45.4), (0.61, 79.00, 0, 0, 62.8, 40.1, 51.3)),
        "thigh": ((14.78, 36.12, 0, 0, 36.9, 16.2, 36.4), (14.16, 40.95, 0, 0, 32.9, 14.9, 32.9)),
        "shank": ((4.81, 43.52, 0, 0, 26.7, 9.2, 26.3), (4.33, 43.95, 0, 0, 25.1, 10.2, 24.6)),
        "foot": ((1.29, 40.14, 0, 0, 13.9, 27.9, 29.9), (1.37, 44.15, 0, 0, 12.4, 24.5, 25.7)),
    },
    "dumas": {
        "head": ((6.7, 0, 0, 0, 32, 27, 34), (6.7, 0, 0, 0, 31, 25, 33)),
        "trunk": ((30.4, 29.9, -1.4, -0.5, 25.0, 23.3, 25.0), (33.3, 28.1, -3.3, -0.2, 25.0, 23.1, 25.9)),
        "pelvis": ((14.6, 83.5, -0.2, 0.0, 19.6, 21.5, 17.0), (14.2, 86.9, 0.5, -0.1, 18.4, 19.3, 17.3)),
        "upper_arm": ((2.2, 45.4, -7.3, -2.8, 33, 17, 33), (2.4, 45.2, 1.7, -2.6, 31, 14, 32)),
        "forearm": ((1.3, 41.1, 2.1, 1.9, 26, 14, 25), (1.7, 41.7, 1.0, 1.4, 28, 11, 27)),
        "hand": ((0.5, 32.7, 3.3, 2.1, 27, 18, 25), (0.6, 35.7, 3.5, 3.2, 26, 16, 24)),
        "thigh": ((14.6, 37.7, -7.7, 0.9, 31, 19, 32), (12.3, 42.9, -4.1, 3.3, 29, 15, 30)),
        "shank": ((4.5, 40.4, -4.9, 3.1, 28, 10, 28), (4.8, 41.0, -4.8, 0.7, 28, 10, 28)),
        "foot": ((1.0, 44.3, 0, 0, 12, 25, 25), (1.2, 43.6, 0, 0, 11, 25, 25)),
    },
}
# Lengths, of women and men, as shares of others: of the head by the trunk, the hand by the forearm, and Dumas's foot
# (ankle to the balls of the toes) by the way from heel to toe.
_LENGTHS = {
    "de-leva": {"head": (0.489, 0.471), "hand": (0.295, 0.321), "foot": (1.0, 1.0)},
    "dumas": {"head": (0.488, 0.539), "hand": (0.676, 0.668), "foot": (0.512, 0.539)},
}
# Shares of the numbers of women and of men.
_OF_SEX = {"female": (1.0, 0.0), "male": (0.0, 1.0), "unstated": (0.5, 0.5)}
_HEAD_OVER_TRUNK = (0.936 - 0.818) / (0.818 - 0.530)
_ORIENTATION = {"trunk": "thorax"}
_SHOULDERS, _HIPS, _EARS = ({f"{side}_{joint}": 0.5 for side in SIDES} for joint in ("shoulder", "hip", "ear"))
_ENDS = {
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
}


@dataclass(frozen=True, slots=True, eq=False)
class SegmentMasses:
    """Segments of a body over the joints of a detector; a row a segment."""

    orientations: tuple[str, ...]  # Names in ``body_segments.SEGMENTS``
    mass: Float[np.ndarray, " segments"]  # Shares of the body's mass, whose sum is 1
    start: Float[np.ndarray, "segments joints"]  # Weights of the joints
    axis: Float[np.ndarray, "segments joints"]  # Weights of the joints: vector from the start to the end
    length: Float[np.ndarray, "segments joints"]  # Weights of the vector that is as long as the segment
    centre: Float[np.ndarray, " segments"]  # Place of the centre along the axis
    aside: Float[np.ndarray, "segments 3"]  # Offset of the centre in the axes of the orientation, in lengths
    radii: Float[np.ndarray, "segments 3"]  # Radii of gyration about the axes of the orientation, in lengths

    @property
    def weights(self) -> Float[np.ndarray, " joints"]:
        """Weights of the joints in the body's centre of mass."""
        return np.asarray(self.mass @ (self.start + self.centre[:, None] * self.axis))


def segment_masses(
    subject: Subject, joints: JointSet, xyz_m: Float[np.ndarray, "frames joints 3"] | None = None
) -> SegmentMasses | None:
    """Segments of a person; ``None`` where the joints of the detector lack one of a limb.

    ``xyz_m``: positions of the person's joints, NaN where unknown; ``None``: all joints are known.

    >>> from pipeline.core.joints import BODY_FEET
    >>> masses = segment_masses(Subject("de-leva", "male"), BODY_FEET)
    >>> round(float(masses.weights.sum()), 9)
    1.0
    """
    names, shares = set(joints.names), np.array(_OF_SEX[subject.sex])
    if not {f"{side}_{joint}" for side in SIDES for ends in _ENDS.values() for joint in ends} <= names:
        return None
    if xyz_m is not None:
        names = {joints.names[k] for k in np.flatnonzero(np.isfinite(xyz_m).all(-1).any(0))}

    def vector(weights: Mapping[str, float]) -> np.ndarray:
        return np.array([weights.get(name, 0.0) for name in joints.names])

    rows = []
    trunk = vector(_HIPS) - vector(_SHOULDERS)
    head = vector(_EARS) if _EARS.keys() <= names else vector(_SHOULDERS) - _HEAD_OVER_TRUNK * trunk
    lengths = {name: float(shares @ np.array(values)) for name, values in _LENGTHS[subject.table].items()}
    for name, (women, men) in _TABLES[subject.table].items():
        mass, centre, ahead, right, *radii = shares @ np.array([women, men]) / 100.0
        for side in SIDES if name not in {"head", "trunk", "pelvis"} else (None,):
            orientation = _ORIENTATION.get(name, name if side is None else f"{side}_{name}")
            if side is None:
                start, axis = (head, 0.0 * trunk) if name == "head" else (vector(_SHOULDERS), trunk)
                length = lengths["head"] * trunk if name == "head" else trunk
            elif name in _ENDS:
                start, end = (vector({f"{side}_{joint}": 1.0}) for joint in _ENDS[name])
                axis = length = end - start
            elif name == "hand":
                start = vector({f"{side}_wrist": 1.0})
                axis = length = lengths["hand"] * (start - vector({f"{side}_elbow": 1.0}))
            else:
                has_marks = {f"{side}_heel", f"{side}_big_toe"} <= names
                start = vector({f"{side}_{'heel' if has_marks and subject.table == 'de-leva' else 'ankle'}": 1.0})
                axis = length = lengths["foot"] * vector({f"{side}_big_toe": 1.0, f"{side}_heel": -1.0}) * has_marks
            aside = ahead, 0.0, -right if side == "left" else right
            rows.append((orientation, mass, start, axis, length, centre, aside, radii))
    orientations, mass, *others = zip(*rows, strict=True)
    shares_of_mass = np.array(mass) / sum(mass)
    return SegmentMasses(orientations, shares_of_mass, *(np.array(values) for values in others))
