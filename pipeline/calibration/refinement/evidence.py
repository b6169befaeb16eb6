"""Evidence that given cameras are off: how far people move them, beside how far errors of a detector do.

Cameras that are fitted to people follow the errors of the detector too, and are hardly determined by people who stand
still. Errors of given cameras are random effects: rotations, positions and focal lengths have a standard deviation
each, which the fitted cameras tell (empirical Bayes; Laird and Ware 1982, "Random-effects models for longitudinal
data"). It is 0 unless the marginal likelihood says otherwise. Each camera moves as far as its people outweigh it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.calibration.adjustment.bundle import Adjustment
from pipeline.calibration.adjustment.lasting_errors import lasting_covariance
from pipeline.calibration.adjustment.parameters import FOCAL, POSITION, ROTATION, Parameters, offsets, world_moves
from pipeline.calibration.adjustment.problem import AdjustmentProblem, FreePoints
from pipeline.calibration.refinement.sightings import JointSightings

# Least rise of the logarithm of the marginal likelihood: e^4 is 55 times; chosen.
_MIN_GAIN = 4.0
# First standard deviations: radians, metres, and of logarithms of focal lengths. Focal lengths come last: they move
# cameras along their axes by centimetres.
_KINDS = ((ROTATION, np.radians(0.3)), (POSITION, 0.01), (FOCAL, 0.01))
_LEVELS = ((0, 1), (2,))
_NUM_STEPS = 100
# Degrees of freedom of Student's t: one camera may be off by far more than the others.
_FREEDOM = 3.0
# Standard deviations by which a detector marks a joint beside its place: of any person in all pictures of a camera, and
# in pictures of a person in one place. Cameras absorb these errors, so residuals don't tell them: chosen on three
# rendered clips, so that exact cameras stay and others come back (docs/lab/calibration-notes.md).
_JOINT_BIAS_M, _SUBJECT_BIAS_M = 0.03, 0.02
# Time for which other errors of a detector last; chosen.
_LASTING_S = 1.0
# Largest standard deviation of a rotation that people determine; chosen.
_MAX_SIGMA_RAD = np.radians(0.5)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationEvidence:
    """Evidence on given cameras."""

    steps: Parameters  # Expected steps from the given cameras, whether these are off or not
    is_off: bool  # True if the likelihood says that the cameras are off
    is_determined: bool  # True if people determine the rotation of a camera


def weigh_evidence(problem: AdjustmentProblem, adjusted: Adjustment, sightings: JointSightings) -> CalibrationEvidence:
    """Weigh the evidence that the given cameras of a problem are off.

    ``problem``, ``adjusted``: an adjustment of rotations, positions and focal lengths of all cameras, with priors, to
    the points of ``sightings``.
    """
    free = problem.free
    scale = problem.prior_sigma[free]
    reduced, spread = (scale[:, None] * part * scale for part in _normal_and_spread(problem, adjusted, sightings))
    # Directions in which the world moves are left out.
    left, values, _ = np.linalg.svd(world_moves(adjusted.cameras)[free] / scale[:, None])
    basis = left[:, int((values > 1e-9 * values.max()).sum()) :]
    inverse = np.linalg.inv(basis.T @ reduced @ basis)
    # The wide priors of the adjustment are one more observation.
    noise = inverse @ (basis.T @ spread @ basis + np.eye(basis.shape[1])) @ inverse
    fitted = basis.T @ (offsets(problem.cameras, adjusted.cameras)[free] / scale)
    kind, group = np.full(free.shape, -1), np.zeros(free.shape, int)
    for number, (parameters, _) in enumerate(_KINDS):
        kind[:, parameters] = number
        group[:, parameters] = len(_KINDS) * np.arange(len(free))[:, None] + number
    effects = _Effects(fitted, noise, basis, kind[free], group[free])
    variance, steps, is_off = np.zeros(len(_KINDS)), np.zeros(len(scale)), False
    best = effects.log_likelihood(noise)
    for level in _LEVELS:
        start = variance.copy()
        for number in level:
            parameters, first = _KINDS[number]
            start[number] = (first / problem.prior_sigma[0, parameters][0]) ** 2
        estimated, moved, likelihood = effects.estimate(start)
        is_better = likelihood - best > _MIN_GAIN
        if is_better or not steps.any():
            steps = moved
        if is_better:
            variance, best, is_off = estimated, likelihood, True
    sigma, all_steps = np.zeros(free.shape), np.zeros(free.shape)
    sigma[free] = scale * np.sqrt(np.einsum("pn,nm,pm->p", basis, noise, basis))
    all_steps[free] = scale * steps
    return CalibrationEvidence(all_steps, is_off, bool((sigma[:, ROTATION].max(-1) <= _MAX_SIGMA_RAD).any()))


def _normal_and_spread(
    problem: AdjustmentProblem, adjusted: Adjustment, sightings: JointSightings
) -> tuple[Float[np.ndarray, "parameters parameters"], Float[np.ndarray, "parameters parameters"]]:
    """Reduced normal matrix of the cameras, and the covariance of its right side."""
    if not isinstance(adjusted.structure, FreePoints):
        raise TypeError("Sightings are free points.")
    camera, point = problem.observations.camera, problem.observations.block
    depth_m = np.stack([own.cam_from_world.apply(adjusted.structure.xyz_m)[:, 2] for own in adjusted.cameras])
    focal_px = np.array([own.matrix[0, 0] for own in adjusted.cameras])
    px_per_m = focal_px[camera] / depth_m[camera, point]
    joint = sightings.joint[point]
    subject = joint + (joint.max() + 1) * sightings.square[point]
    part = ((sightings.time_s[point] - sightings.time_s.min()) // _LASTING_S).astype(int)
    levels = [joint, subject, subject * (part.max() + 1) + part]
    biases = [(joint, _JOINT_BIAS_M * px_per_m), (subject, _SUBJECT_BIAS_M * px_per_m)]
    return lasting_covariance(problem, adjusted, levels, biases)


@dataclass(frozen=True, slots=True, eq=False)
class _Effects:
    """Errors of given cameras as random effects of fitted ones."""

    fitted: Float[np.ndarray, " n"]  # Steps to the fitted cameras, in directions in which the world does not move
    noise: Float[np.ndarray, "n n"]  # Covariance of the fitted cameras
    basis: Float[np.ndarray, "parameters n"]  # Directions
    kind: Int[np.ndarray, " parameters"]  # Kind of each parameter
    group: Int[np.ndarray, " parameters"]  # Number of the kind and the camera

    def log_likelihood(self, covariance: Float[np.ndarray, "n n"]) -> float:
        """Logarithm of the likelihood of the fitted cameras, less a constant."""
        squares = self.fitted @ np.linalg.solve(covariance, self.fitted)
        return float(-0.5 * (np.linalg.slogdet(covariance)[1] + squares))

    def estimate(
        self, variance: Float[np.ndarray, " kinds"]
    ) -> tuple[Float[np.ndarray, " kinds"], Float[np.ndarray, " parameters"], float]:
        """Variances of the kinds by expectation maximisation, expected steps, and the logarithm of the likelihood.

        Kinds that begin with 0 keep it.
        """
        size = np.bincount(self.group)
        weight = np.ones(len(size))
        for _ in range(_NUM_STEPS):
            prior = variance[self.kind] / weight[self.group]
            gain = np.linalg.solve(self._spread(prior) + self.noise, self.basis.T * prior).T
            steps = gain @ self.fitted
            squares = steps**2 + prior - np.einsum("pn,np->p", gain, self.basis.T * prior)
            over = np.bincount(self.group, squares / np.maximum(variance[self.kind], np.finfo(float).tiny))
            weight = (_FREEDOM + size) / (_FREEDOM + over)
            variance = np.bincount(self.kind, weight[self.group] * squares) / np.bincount(self.kind)
        prior = variance[self.kind] / weight[self.group]
        # The weights are unknowns too: Gamma distributed.
        is_free: Bool[np.ndarray, " groups"] = np.bincount(self.group, prior) > 0
        of_weights = 0.5 * _FREEDOM * float((np.log(weight) - weight + 1.0)[is_free].sum())
        return variance, steps, self.log_likelihood(self._spread(prior) + self.noise) + of_weights

    def _spread(self, prior: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, "n n"]:
        return self.basis.T @ (prior[:, None] * self.basis)
