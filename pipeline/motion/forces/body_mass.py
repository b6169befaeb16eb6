"""Mass of a person: stated, or estimated from the lengths of the fitted skeleton, with its standard deviation."""

from typing import NamedTuple

import numpy as np

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.reconstruction import Subject
from pipeline.motion.skeleton.model import INDEX, TRUNK, WHOLE_SKELETON

# Mass grows with this power of the stature in the "new BMI" (Trefethen 2013). The factor is chosen for a body mass
# index of 24.7 at 1.75 m.
_MASS, _POWER = 18.7, 2.5
# Deviation of an estimated mass: root mean square of its error for 6,068 soldiers (public table of ANSUR II, 2012), who
# weigh 10 % more on average. Deviation of a stated mass, chosen: clothes and meals of a day.
_ESTIMATED, _STATED = 0.19, 0.01
_MEASURED = ("LeftLeg", "RightLeg", "LeftFoot", "RightFoot")


class BodyMass(NamedTuple):
    """Mass of a person."""

    kg: float
    sigma_kg: float  # Standard deviation
    is_estimated: bool  # True if it is a guess from the stature

    def __str__(self) -> str:
        if not self.is_estimated:
            return f"mass {self.kg:.1f} kg, stated"
        return f"mass {self.kg:.0f} kg, estimated from the stature, deviation {self.sigma_kg:.0f} kg"


def body_mass(subject: Subject, motion: SkeletonMotion) -> BodyMass:
    """Mass of a person: the stated one, or an estimate from the stature."""
    if subject.mass_kg is not None:
        return BodyMass(subject.mass_kg, _STATED * subject.mass_kg, False)
    mass_kg = mass_by_stature_kg(stature_m(motion))
    return BodyMass(mass_kg, _ESTIMATED * mass_kg, True)


def mass_by_stature_kg(stature_m: float) -> float:
    """Usual mass of a person of a stature.

    >>> round(mass_by_stature_kg(1.75), 1)
    75.8
    """
    return float(_MASS * stature_m**_POWER)


def stature_m(motion: SkeletonMotion) -> float:
    """Stature by the lengths of thigh, shank and trunk, which are nearly always measured."""
    share = sum(WHOLE_SKELETON[INDEX[name]].stature_share for name in ("LeftLeg", "LeftFoot", *TRUNK))
    legs_m = sum(motion.bone_length_m[INDEX[name]] for name in _MEASURED) / 2.0
    return float((legs_m + np.sum([motion.bone_length_m[INDEX[name]] for name in TRUNK])) / share)
