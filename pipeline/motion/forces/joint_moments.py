"""Moments and powers of joints by inverse dynamics, from the feet and hands upwards.

The moment that moves the segments beyond a joint is the moment of their inertia and weight, less the moment of the
ground's force on the foot (Winter, "Biomechanics and Motor Control of Human Movement", 2009, chapter 5). Its parts are
about the axes of the joint's angles: the moment of ``knee_flexion`` is positive if it bends the knee. They are then the
generalised forces of the angles, as OpenSim's inverse dynamics computes them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.body_segments import JOINTS, AngleJoint, angle_name
from pipeline.motion.forces.feet import BODY_M, FootForces
from pipeline.motion.forces.whole_body import BodyInMotion

# Joint of the track between two segments, and the segments beyond it.
_PLACES = {
    ("pelvis", "thigh"): ("hip", ("thigh", "shank", "foot")),
    ("thigh", "shank"): ("knee", ("shank", "foot")),
    ("shank", "foot"): ("ankle", ("foot",)),
    ("thorax", "upper_arm"): ("shoulder", ("upper_arm", "forearm", "hand")),
    ("upper_arm", "forearm"): ("elbow", ("forearm", "hand")),
}
_SEQUENCE = (2, 0, 1)
MOMENT_JOINTS: tuple[AngleJoint, ...] = tuple(
    joint for joint in JOINTS if (joint.proximal, joint.distal) in _PLACES and joint.sequence == _SEQUENCE
)
MOMENT_NAMES: tuple[str, ...] = tuple(
    angle_name(angle, side) for joint in MOMENT_JOINTS for side in SIDES for angle in joint.angles
)
"""Angles of joints that have a moment, in the order of columns."""
POWER_NAMES: tuple[str, ...] = tuple(
    f"{side}_{_PLACES[joint.proximal, joint.distal][0]}" for joint in MOMENT_JOINTS for side in SIDES
)
"""Joints that have a power, in the order of columns."""
# Usual error of a joint's centre (Della Croce et al., "Human movement analysis using stereophotogrammetry, part 4",
# Gait & Posture 21, 2005).
_CENTRE_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class JointMoments:
    """Moments and powers of joints, for each kilogram of the body."""

    moment: Float[np.ndarray, "frames moments"]  # Of ``MOMENT_NAMES``
    sigma: Float[np.ndarray, "frames moments"]
    power: Float[np.ndarray, "frames joints"]  # Of ``POWER_NAMES``: positive where muscles do work


def joint_moments(body: BodyInMotion, feet: FootForces, joints: JointSet) -> JointMoments:
    """Compute the moments of the joints of legs and arms."""
    moments, sigmas, powers = [], [], []
    up = np.array([0.0, 0.0, 1.0])
    arms_m = np.nan_to_num(feet.pressure_m - body.body_m[:, None])
    # Moment that the force at places within the soles leaves: one of both is wrong.
    rest = np.linalg.norm((body.moment(body.body_m) - np.cross(arms_m, feet.force).sum(1))[:, :2], axis=1)
    for joint in MOMENT_JOINTS:
        place, beyond = _PLACES[joint.proximal, joint.distal]
        for column, side in enumerate(SIDES):
            centre_m = body.xyz_m[:, joints.index(f"{side}_{place}")]
            chosen = np.isin(body.names, [f"{side}_{name}" for name in beyond])
            moment = body.moment(centre_m, chosen)
            load = body.share[chosen].sum() * np.linalg.norm(body.sigma, axis=1)
            sigma = np.full(len(moment), 0.0) + (load * _reach(body, chosen, centre_m)) ** 2
            if "foot" in beyond:
                ground, arm_m = feet.force[:, column], np.nan_to_num(feet.pressure_m[:, column] - centre_m)
                moment = moment - np.cross(arm_m, ground) - feet.free_moment[:, column, None] * up
                # The error of the force and of its place stem from the same error of the body's acceleration: what it
                # moves is the body above the joint.
                above_m = body.body_m - centre_m
                of_force = np.linalg.norm(above_m, axis=1) * np.linalg.norm(feet.sigma[:, column], axis=1) / np.sqrt(3)
                both, load = feet.stands.all(1), np.linalg.norm(ground, axis=1)
                of_place = np.nan_to_num(feet.pressure_sigma_m[:, column]) * load * both
                of_body = np.where(
                    feet.measured[:, column],
                    0.0,
                    np.hypot(BODY_M * ~both * load, rest * feet.stands[:, column] * ~feet.seated),
                )
                sigma = sigma + of_force**2 + of_place**2 + (_CENTRE_M * load) ** 2 + of_body**2
            proximal = body.turns.get(joint.proximal)
            outer = body.turns[f"{side}_{joint.proximal}"] if proximal is None else proximal
            inner = body.turns[f"{side}_{joint.distal}"]
            first, third = outer[..., 2], inner[..., 1]
            second = np.cross(third, first)
            second /= np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-6)
            axes = (first, second, third)
            mirror = (1.0, -1.0, -1.0) if side == "left" else (1.0, 1.0, 1.0)
            for angle in joint.angles:
                turned = angle.sign * mirror[angle.rotation] * (moment * axes[angle.rotation]).sum(1)
                moments.append(turned)
                sigmas.append(np.sqrt(sigma))
            outer_rate = body.rate_rad_s[joint.proximal if proximal is not None else f"{side}_{joint.proximal}"]
            powers.append((moment * (body.rate_rad_s[f"{side}_{joint.distal}"] - outer_rate)).sum(1))
    unknown = ~body.known[:, None]
    values = (np.where(unknown, np.nan, np.stack(rows, axis=1)) for rows in (moments, sigmas, powers))
    return JointMoments(*values)


def _reach(body: BodyInMotion, chosen: np.ndarray, centre_m: Float[np.ndarray, "frames 3"]) -> np.ndarray:
    """Distance of the centre of mass of segments from a joint."""
    weights = body.share[chosen] / body.share[chosen].sum()
    return np.linalg.norm(np.einsum("s,fsk->fk", weights, body.centre_m[:, chosen]) - centre_m, axis=1)
