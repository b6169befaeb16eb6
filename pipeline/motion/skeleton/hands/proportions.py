"""Lengths of a person's finger bones, constant in time and equal for both hands."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import Side
from pipeline.core.data.people import Track3D
from pipeline.core.joints import FINGERS, JointSet
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import fingers_of
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON

# Fewest frames that say anything about a bone, frames that adult proportions count for, and plausible ratios to them.
_FEWEST, _PRIOR_FRAMES = 5, 20
_RATIOS = (0.6, 1.6)
# Ratio of a person's hand to that of an adult with the same forearm.
_HAND_RATIOS = (0.75, 1.3)
# Median of the squared length of a vector of three standard normal values.
_MEDIAN_CHI2 = 2.366


def whole_lengths_m(
    body_length_m: Float[np.ndarray, " joints"],
    track: Track3D,
    joints: JointSet,
    is_seen: Mapping[Side, Bool[np.ndarray, " frames"]],
) -> Float[np.ndarray, " whole"]:
    """Length of every bone of ``WHOLE_SKELETON``, from the lengths of the body's bones and located fingers.

    A bone's length is the median over the frames of both hands, less the part that is due to noise, drawn to adult
    proportions at the size of the person's hand. Adult proportions at the size of the forearm remain where nothing was
    measured. ``is_seen`` are the frames in which each hand was seen well.
    """
    forearm = INDEX["LeftHand"]
    stature_m = body_length_m[forearm] / SKELETON[forearm].stature_share
    lengths_m = np.array([joint.stature_share for joint in WHOLE_SKELETON]) * stature_m
    lengths_m[: len(SKELETON)] = body_length_m
    names = [(name, number) for name in FINGERS for number in range(len(FINGERS[name]))]
    measured = [_bone_m(name, number, track, joints, is_seen) for name, number in names]
    numbers = [fingers_of("left")[name].joints[number] for name, number in names]
    ratios = [length_m / lengths_m[k] for (length_m, count), k in zip(measured, numbers, strict=True) if count]
    size = float(np.clip(np.median(ratios), *_HAND_RATIOS)) if ratios else 1.0
    for (name, number), (length_m, count), k in zip(names, measured, numbers, strict=True):
        usual_m = size * lengths_m[k]
        own_m = np.clip(length_m, _RATIOS[0] * usual_m, _RATIOS[1] * usual_m) if count else usual_m
        for side in SIDES:
            drawn_m = (count * own_m + _PRIOR_FRAMES * usual_m) / (count + _PRIOR_FRAMES)
            lengths_m[fingers_of(side)[name].joints[number]] = drawn_m
    return lengths_m


def _bone_m(
    name: str,
    number: int,
    track: Track3D,
    joints: JointSet,
    is_seen: Mapping[Side, Bool[np.ndarray, " frames"]],
) -> tuple[float, int]:
    """Length of the bone to a joint of a finger by both hands, and the number of frames; 0 if they are too few."""
    squared_m2, noise_m2 = [np.zeros(0)], [np.zeros(0)]
    for side in SIDES:
        end = f"{side}_{name}_{FINGERS[name][number]}"
        start = f"{side}_{name}_{FINGERS[name][number - 1]}" if number else f"{side}_wrist"
        if not {start, end} <= set(joints.names):
            continue
        bone_m = track.xyz_m[:, joints.index(end)] - track.xyz_m[:, joints.index(start)]
        bone_m = np.where(is_seen[side][:, None], bone_m, np.nan)
        known = np.isfinite(bone_m).all(-1)
        squared_m2.append((bone_m[known] ** 2).sum(-1))
        second_m2 = (np.diff(bone_m, n=2, axis=0) ** 2).sum(-1)
        noise_m2.append(second_m2[np.isfinite(second_m2)])
    lengths_m2, seconds_m2 = np.concatenate(squared_m2), np.concatenate(noise_m2)
    if len(lengths_m2) < _FEWEST:
        return np.nan, 0
    # The second difference of noise has six times its variance. Across the bone, noise of two axes lengthens it.
    variance_m2 = float(np.median(seconds_m2)) / (6 * _MEDIAN_CHI2) if len(seconds_m2) else 0.0
    median_m2 = float(np.median(lengths_m2))
    return float(np.sqrt(max(median_m2 - 2 * variance_m2, median_m2 / 4))), len(lengths_m2)
