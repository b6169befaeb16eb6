"""Percentage of correct parts (PCP) of the Campus and Shelf benchmarks (Belagiannis et al., CVPR 2014).

A part is correct if the mean error of its two ends is at most half of its true length. Each annotated actor is compared
with the prediction of the least mean joint distance. Detectors lack the benchmarks' two head points: published methods
derive them from nose, ears and shoulders by different rules, which change the score by up to one point.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.joints import COCO_17

# Joints in the benchmarks' order; the bottom and the top of the head follow them.
LIMB_JOINTS = (
    "right_ankle",
    "right_knee",
    "right_hip",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_wrist",
    "right_elbow",
    "right_shoulder",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
)
_HEAD_BOTTOM, _HEAD_TOP = 12, 13

PARTS: Mapping[str, tuple[tuple[int, int], ...]] = {
    "head": ((_HEAD_BOTTOM, _HEAD_TOP),),
    "upper_arms": ((7, 8), (9, 10)),
    "lower_arms": ((6, 7), (10, 11)),
    "upper_legs": ((1, 2), (3, 4)),
    "lower_legs": ((0, 1), (4, 5)),
}
"""Ends of the parts, in the benchmarks' order. The tenth part, ``torso``, is from mid-hip to the head's bottom."""

_TORSO = "torso"
_HIPS = [2, 3]
_ALPHA, _PCK_M = 0.5, 0.15

Head = tuple[Float[np.ndarray, "*batch 3"], Float[np.ndarray, "*batch 3"]]


def _crossview(neck: np.ndarray, nose: np.ndarray, _: np.ndarray) -> Head:
    ahead = nose - neck
    return neck + ahead * [0.3, 0.4, 0.6], neck + ahead * [0.78, 0.5, 1.5]


def _mvpose(neck: np.ndarray, nose: np.ndarray, _: np.ndarray) -> Head:
    ahead = nose - neck
    return neck + ahead * 0.5, neck + ahead * [0.75, 0.75, 1.5]


def _ears(neck: np.ndarray, _: np.ndarray, ears: np.ndarray) -> Head:
    bottom = (neck + ears) / 2
    return bottom, bottom + 2 * (ears - bottom)


def _voxelpose(neck: np.ndarray, nose: np.ndarray, ears: np.ndarray) -> Head:
    (bottom, top), (ear_bottom, ear_top) = _mvpose(neck, nose, ears), _ears(neck, nose, ears)
    return 0.75 * bottom + 0.25 * ear_bottom, 0.75 * top + 0.25 * ear_top


HEAD_RULES: Mapping[str, Callable[[np.ndarray, np.ndarray, np.ndarray], Head]] = {
    "crossview": _crossview,
    "mvpose": _mvpose,
    "voxelpose": _voxelpose,
    "ears": _ears,
}
"""Rules of published methods for the head's bottom and top, from the neck, the nose and the centre of the ears."""


def benchmark_joints(
    xyz_m: Float[np.ndarray, "*batch 17 3"], head_rule: str = "crossview"
) -> Float[np.ndarray, "*batch 14 3"]:
    """Convert COCO-17 joints to the benchmarks' 14 joints; NaN stays NaN.

    ``head_rule`` is a name in ``HEAD_RULES``; ``KeyError`` if unknown.
    """

    def centre(*names: str) -> np.ndarray:
        return xyz_m[..., COCO_17.indices(names), :].mean(-2)

    head = HEAD_RULES[head_rule](
        centre("left_shoulder", "right_shoulder"), centre("nose"), centre("left_ear", "right_ear")
    )
    return np.concatenate([xyz_m[..., COCO_17.indices(LIMB_JOINTS), :], np.stack(head, axis=-2)], axis=-2)


@dataclass(frozen=True, slots=True, eq=False)
class PcpScores:
    """PCP of each actor, in the truth's order."""

    actors: Float[np.ndarray, " actors"]  # Percentage over all ten parts, NaN for an actor without annotation
    parts: Mapping[str, Float[np.ndarray, " actors"]]  # Percentage by kind of part
    # Mean distance of the joints that prediction and annotation share, NaN without any
    mpjpe_mm: Float[np.ndarray, " actors"]
    pck150: Float[np.ndarray, " actors"]  # Percentage of the annotated joints within 150 mm
    # Index of the prediction compared with each actor in each frame, -1 for none
    chosen: Int[np.ndarray, "actors frames"]


def _is_right(
    predicted_m: Float[np.ndarray, "14 3"], truth_m: Float[np.ndarray, "14 3"]
) -> dict[str, Bool[np.ndarray, " _"]]:
    """True if each part is correct; a part with an unknown end is not."""

    def right(predicted_ends: np.ndarray, true_ends: np.ndarray) -> np.ndarray:
        error_m = np.linalg.norm(predicted_ends - true_ends, axis=-1).mean(-1)
        return error_m <= _ALPHA * np.linalg.norm(true_ends[:, 0] - true_ends[:, 1], axis=-1)

    limbs = {name: right(predicted_m[list(ends)], truth_m[list(ends)]) for name, ends in PARTS.items()}
    torso = [np.stack([pose[_HIPS].mean(0), pose[_HEAD_BOTTOM]])[None] for pose in (predicted_m, truth_m)]
    return limbs | {_TORSO: right(*torso)}


def score_pcp(
    predicted_m: Sequence[Float[np.ndarray, "_ 14 3"]], truth_m: Float[np.ndarray, "actors frames 14 3"]
) -> PcpScores:
    """Score the predictions of each frame against the annotated actors.

    People are in the benchmarks' joints, NaN where a joint is unknown, or an actor is not annotated.
    """
    num_actors, num_frames = truth_m.shape[:2]
    annotated = np.isfinite(truth_m).all((-2, -1))
    num_right = {name: np.zeros(num_actors) for name in (*PARTS, _TORSO)}
    errors_m: list[list[float]] = [[] for _ in range(num_actors)]
    num_near = np.zeros(num_actors)
    chosen = np.full((num_actors, num_frames), -1)
    for actor, frame in np.argwhere(annotated):
        distance_m = np.linalg.norm(predicted_m[frame] - truth_m[actor, frame], axis=-1)
        known = np.isfinite(distance_m)
        mean_m = np.where(known, distance_m, 0.0).sum(-1) / np.maximum(known.sum(-1), 1)
        mean_m = np.where(known.any(-1), mean_m, np.inf)
        if not np.isfinite(mean_m).any():
            continue
        nearest = int(mean_m.argmin())
        chosen[actor, frame] = nearest
        errors_m[actor].append(float(mean_m[nearest]))
        num_near[actor] += (distance_m[nearest] <= _PCK_M).sum()
        for name, right in _is_right(predicted_m[frame][nearest], truth_m[actor, frame]).items():
            num_right[name][actor] += right.sum()
    counts = annotated.sum(1)
    sizes = {name: len(ends) for name, ends in PARTS.items()} | {_TORSO: 1}

    def percent(right: np.ndarray, parts: int) -> Float[np.ndarray, " actors"]:
        return np.where(counts > 0, 100.0 * right / np.maximum(counts * parts, 1), np.nan)

    return PcpScores(
        actors=percent(np.sum(list(num_right.values()), axis=0), sum(sizes.values())),
        parts={name: percent(right, sizes[name]) for name, right in num_right.items()},
        mpjpe_mm=np.array([1000 * np.mean(errors) if errors else np.nan for errors in errors_m]),
        pck150=percent(num_near, truth_m.shape[2]),
        chosen=chosen,
    )
