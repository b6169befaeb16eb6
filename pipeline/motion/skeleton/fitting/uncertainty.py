"""Uncertainty of joint positions, from the curvature of the fit's energy at the solution.

An exact marginal of the whole system over time needs more arithmetic than a step of the fit. Instead, the information
about each landmark in the frames around an instant is summed, with weights that fall with the distance in time as the
term of acceleration lets them, and the skeleton's degrees of freedom combine the landmarks of the instant. In
simulation, this agrees with the errors as well as the exact marginal does. The sum leaves out
errors that last over frames, bodies that are not exactly the skeleton, and views that show another joint. Constants
stand for them, which were set in simulation and by rendered people with real networks (docs/lab/fit-notes.md).
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.ndimage import convolve1d

from pipeline.motion.skeleton.fitting.articulation import NUM_ROOT, Articulation
from pipeline.motion.skeleton.fitting.fit_kernels import factorise, spread
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, Posed

# Time in which the weight of evidence from other frames falls to 1 / e, and the time beyond which it is ignored.
_MEMORY_S, _REACH_S = 0.04, 0.20
# Ratio of the errors in simulation to errors that independent noise would cause, and error without any noise.
SIMULATED_LASTING, _FLOOR_M = 1.25, 0.0015
NETWORK_LASTING = 2.7
"""The same ratio for networks with offsets of marks, which are means of people: all views share what is left."""
# Error of a joint that no view supports, and the power of the share of views that disagree with it.
_WRONG_M, _WRONG_POWER = 0.2, 1.5
# Weight that keeps rotations determined that nothing else determines.
_INERTIA = 1.0


@runtime_checkable
class Precise(Protocol):
    """Evidence whose precision is known."""

    def precision(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> Float[np.ndarray, "frames landmarks 3 3"]:
        """Inverse of the covariance of each landmark by its own evidence, in 1 / m2."""
        ...


def uncertainty_m(
    bodies: JointPoses,
    skeleton: Articulation,
    evidence: Precise,
    frame_rate_hz: float,
    lasting: float = SIMULATED_LASTING,
) -> Float[np.ndarray, "frames landmarks"]:
    """Standard deviation of each landmark's position in metres: root mean square over the three axes.

    ``lasting`` is the ratio of errors to errors that independent noise would cause.
    """
    posed = Posed(bodies, skeleton)
    precision = convolve1d(evidence.precision(posed.landmark_m), _weights(frame_rate_hz), axis=0, mode="constant")
    num_frames, num_freedoms = len(bodies.root_m), skeleton.num_freedoms
    moving = posed.jacobian(), skeleton.moved_by, skeleton.num_moved_by
    factor = np.empty((num_frames, num_freedoms, num_freedoms))
    factorise(*moving, precision, _priors(skeleton), factor)
    variance_m2 = np.empty(posed.landmark_m.shape[:2])
    spread(*moving, factor, np.empty((num_freedoms, 3)), variance_m2)
    return np.asarray(np.sqrt(lasting**2 * variance_m2 + _FLOOR_M**2))


def disagreement_m(share: Float[np.ndarray, "frames landmarks"]) -> Float[np.ndarray, "frames landmarks"]:
    """Standard deviation in metres that views add which disagree with a landmark, by their share."""
    return np.asarray(_WRONG_M * share**_WRONG_POWER)


def _weights(frame_rate_hz: float) -> Float[np.ndarray, " weights"]:
    """Weights of the evidence in the frames around an instant; 1 in the middle."""
    reach = max(1, round(_REACH_S * frame_rate_hz))
    return np.asarray(np.exp(-np.abs(np.arange(-reach, reach + 1)) / (_MEMORY_S * frame_rate_hz)))


def _priors(skeleton: Articulation) -> Float[np.ndarray, " freedoms"]:
    """Curvature of each degree of freedom by itself: the rest pose, or the inertia of the fit."""
    usual_rad = np.array([freedom.usual_rad for freedom in skeleton.freedoms])
    return np.concatenate([np.full(NUM_ROOT, _INERTIA), _INERTIA + 1.0 / usual_rad**2])
