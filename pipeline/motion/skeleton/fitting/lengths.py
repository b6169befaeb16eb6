"""Lengths of a person's bones as unknowns of the fit, the same in all frames.

Medians of distances between joints are too short for a trunk that is curled, and wrong where marks are: the distance
from hips to shoulders is a chord of the spine. So lengths are solved for together with the pose of each frame (Schur's
complement of the banded system of the poses), from the medians as a start. They are drawn to the medians, and both
sides of the body to each other. A length that differs from its median by less than the evidence tells keeps the median.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.fitting.articulation import Articulation
from pipeline.motion.skeleton.fitting.gauss_newton import Evidence, JointPoses, landmark_positions, linearise, move
from pipeline.motion.skeleton.model import INDEX, TRUNK

_SIDES = ("Left", "Right")
_LIMB_BONES = ("ForeArm", "Hand", "Leg", "Foot")
_PARTS: tuple[tuple[str, ...], ...] = (
    (*TRUNK, "LeftShoulder", "RightShoulder"),
    ("LeftArm", "RightArm"),
    ("LeftUpLeg", "RightUpLeg"),
    *((f"{side}{bone}",) for bone in _LIMB_BONES for side in _SIDES),
)
# Standard deviations of lengths from their start, and of both sides from each other, as shares of the length. And the
# number of frames that count as one: errors of detectors last.
_USUAL_SHARE, _USUAL_ASYMMETRY, _LASTING_FRAMES = 0.05, 0.02, 10.0
# Standard errors by which a length must differ from its start.
_SIGNIFICANT = 3.0
_NUM_STEPS = 5
_DIFFERENCE = 1e-3
# Longest change of a length in a step, as a share.
_LONGEST_STEP = 0.05

Window = tuple[JointPoses, Evidence, Float[np.ndarray, "... landmarks"]]
"""Start of the fit in a window of frames, its evidence, and usual second differences, see ``gauss_newton.refine``."""


def learn_lengths(
    bone_length_m: Float[np.ndarray, " joints"],
    articulated: Callable[[Float[np.ndarray, " joints"]], Articulation],
    windows: Sequence[Window],
    frame_rate_hz: float,
) -> Float[np.ndarray, " joints"]:
    """Lengths of bones in metres that fit the evidence best, where they differ clearly from those at the start.

    ``bone_length_m``: lengths at the start. ``articulated``: returns the person's skeleton with other lengths.
    ``windows``: windows of frames that represent the track; their poses are changed. ``frame_rate_hz``: see
    ``gauss_newton.refine``.
    """
    members = np.zeros((len(_PARTS), len(bone_length_m)), dtype=bool)
    for number, names in enumerate(_PARTS):
        members[number, [INDEX[name] for name in names]] = True
    prior = _prior()
    share = np.ones(len(_PARTS))
    for _ in range(_NUM_STEPS):
        lengths_m = bone_length_m * _factors(share, members)
        skeleton = articulated(lengths_m)
        beside = [
            articulated(lengths_m * np.where(member, 1.0 + _DIFFERENCE / part, 1.0))
            for member, part in zip(members, share, strict=True)
        ]
        normal, right = prior.copy(), -prior @ (share - 1.0)
        solved = []
        for bodies, evidence, usual_m in windows:
            step, coupling, of_window, pull = _eliminated(bodies, skeleton, beside, evidence, usual_m, frame_rate_hz)
            normal += of_window / _LASTING_FRAMES
            right += pull / _LASTING_FRAMES
            solved.append((bodies, step, coupling))
        change = np.clip(np.linalg.solve(normal, right), -_LONGEST_STEP, _LONGEST_STEP)
        share = share + change
        for bodies, step, coupling in solved:
            move(bodies, skeleton, step - coupling @ change)
    error = np.sqrt(np.diag(np.linalg.inv(normal)))
    share = np.where(np.abs(share - 1.0) > _SIGNIFICANT * error, share, 1.0)
    return np.asarray(bone_length_m * _factors(share, members))


def _factors(share: Float[np.ndarray, " parts"], members: np.ndarray) -> Float[np.ndarray, " joints"]:
    """Factor of each bone's length."""
    return np.asarray(1.0 + (share - 1.0) @ members)


def _prior() -> Float[np.ndarray, "parts parts"]:
    """Curvature of the terms that draw lengths to their start and both sides to each other."""
    curvature = np.eye(len(_PARTS)) / _USUAL_SHARE**2
    for first, names in enumerate(_PARTS):
        if len(names) == 1 and names[0].startswith("Left"):
            apart = np.zeros(len(_PARTS))
            apart[first], apart[first + 1] = 1.0, -1.0
            curvature += np.outer(apart, apart) / _USUAL_ASYMMETRY**2
    return curvature


def _eliminated(
    bodies: JointPoses,
    skeleton: Articulation,
    beside: Sequence[Articulation],
    evidence: Evidence,
    usual_m: Float[np.ndarray, "*differences landmarks"],
    frame_rate_hz: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Eliminate the poses of a window.

    ``beside`` are skeletons in which one part each is longer by ``_DIFFERENCE``. Returns the step of the poses at
    unchanged lengths (frames, freedoms), what a change of lengths takes from it (frames, freedoms, parts), and the
    reduced normal equations of the lengths.
    """
    system = linearise(bodies, skeleton, evidence, usual_m, frame_rate_hz)
    here_m = landmark_positions(bodies, skeleton)
    moved = np.stack([landmark_positions(bodies, other) - here_m for other in beside], axis=-1) / _DIFFERENCE
    weighted = system.curvature @ moved
    coupling = np.zeros((*system.right.shape, len(beside)))
    for landmark, count in enumerate(skeleton.num_moved_by.tolist()):
        freedoms = skeleton.moved_by[landmark, :count]
        coupling[:, freedoms] += system.jacobian[:, landmark, :count] @ weighted[:, landmark]
    flat, right = coupling.reshape(-1, len(beside)), system.right.ravel()
    solved = system.solve(np.column_stack([right, flat]))
    normal = np.einsum("flip,fliq->pq", moved, weighted) - flat.T @ solved[:, 1:]
    pull = np.einsum("flip,fli->p", moved, system.pull) - flat.T @ solved[:, 0]
    return solved[:, 0].reshape(system.right.shape), solved[:, 1:].reshape(coupling.shape), normal, pull
