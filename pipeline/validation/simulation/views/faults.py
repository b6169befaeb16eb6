"""Faults of a simulated 2D pose detector: misses, swapped sides, mixed people and false positives.

A confusion selects sources: joint ``j`` of body ``p`` in frame ``f`` shows joint ``which[p, f, j]`` of person
``who[p, f, j]``. Without faults these are ``j`` and ``p``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.signal import lfilter
from scipy.stats import norm

from pipeline.core.joints import COCO_17


def lasting_noise(
    rng: np.random.Generator, shape: tuple[int, ...], memory_frames: float
) -> Float[np.ndarray, "*batch frames"]:
    """Gaussian noise of unit variance along the last axis: a stationary autoregressive process of first order.

    Frames are the last axis of ``shape``. In ``memory_frames`` the correlation falls to 1 / e; 0 for independent
    frames.
    """
    white = rng.standard_normal(shape)
    if memory_frames <= 0 or shape[-1] == 0:
        return white
    rho = np.exp(-1 / memory_frames)
    gain = np.sqrt(1 - rho**2)
    # The state before the first frame has the stationary distribution, too.
    before = rho * rng.standard_normal((*shape[:-1], 1))
    noise, _ = lfilter([gain], [1.0, -rho], white, axis=-1, zi=before)
    return np.asarray(noise)


def lasting_events(
    rng: np.random.Generator, shape: tuple[int, ...], rate: float, memory_frames: float
) -> Bool[np.ndarray, "*batch frames"]:
    """Draw events that are true in a share ``rate`` of all frames, in runs; see ``lasting_noise``."""
    return lasting_noise(rng, shape, memory_frames) > norm.isf(rate)


def heavy_tailed(
    rng: np.random.Generator, shape: tuple[int, ...], degrees_of_freedom: float
) -> Float[np.ndarray, "*batch"]:
    """Independent Student's t noise, scaled to unit variance."""
    return rng.standard_t(degrees_of_freedom, shape) / np.sqrt(degrees_of_freedom / (degrees_of_freedom - 2))


_ARMS = (("left_shoulder", "left_elbow", "left_wrist"), ("right_shoulder", "right_elbow", "right_wrist"))
_LEGS = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))
# Limbs that a body can take from another body: arms and legs without the joint at the trunk.
_LIMBS = tuple(COCO_17.indices(names[1:]) for names in (*_ARMS, *_LEGS))
_SHOULDERS = COCO_17.indices(("left_shoulder", "right_shoulder"))
_HIPS = COCO_17.indices(("left_hip", "right_hip"))
_MIN_SEEN_JOINTS = 4
# Number of objects in a camera's view that may be detected as people.
_NUM_GHOSTS = 3
_NOT_NEAR = -1


@dataclass(frozen=True, slots=True)
class Faults:
    """Rates of a detector's faults, as fractions of 1."""

    # Share of visible joints and of visible bodies that are not found. A body with fewer than four visible joints is
    # never found.
    miss_joint: float = 0.02
    miss_body: float = 0.03
    swap: float = 0.02  # Share of bodies whose left and right arms, legs or both are swapped
    # Share of bodies near another body in the image that take an arm or a leg from it. In half of the cases the other
    # body is not found.
    mix: float = 0.05
    duplicate: float = 0.01  # Share of bodies that are found twice
    false_positives: float = 0.02  # Mean number of false bodies in a frame, at most 3
    memory_s: float = 0.1  # Correlation time of misses, confusions and false positives, which last over several frames
    # Share of visible hands that are not found, and of bodies whose left and right fingers are exchanged
    miss_hand: float = 0.1
    swap_hands: float = 0.02


NO_FAULTS = Faults(
    miss_joint=0.0,
    miss_body=0.0,
    swap=0.0,
    mix=0.0,
    duplicate=0.0,
    false_positives=0.0,
    miss_hand=0.0,
    swap_hands=0.0,
)


@dataclass(frozen=True, slots=True, eq=False)
class Confusion:
    """Found bodies, and the sources of their joints: person (``who``) and joint (``which``)."""

    found: Bool[np.ndarray, "people frames"]
    who: Int[np.ndarray, "people frames joints"]
    which: Int[np.ndarray, "people frames joints"]


def confuse(
    points_px: Float[np.ndarray, "people frames joints 2"],
    seen: Bool[np.ndarray, "people frames joints"],
    faults: Faults,
    memory_frames: float,
    rng: np.random.Generator,
) -> Confusion:
    """Draw misses, swaps and mixtures.

    True joints are in pixels, NaN for people who are absent or behind the camera, and ``seen`` if they are in the image
    and not hidden. ``memory_frames`` is ``Faults.memory_s`` in frames.
    """
    num_people, num_frames, num_joints = seen.shape
    bodies = (num_people, num_frames)
    in_sight = seen.sum(-1) >= _MIN_SEEN_JOINTS
    found = in_sight & ~lasting_events(rng, bodies, faults.miss_body, memory_frames)
    who = np.broadcast_to(np.arange(num_people)[:, None, None], seen.shape).copy()
    which = np.broadcast_to(np.arange(num_joints), seen.shape).copy()

    swapped = lasting_events(rng, bodies, faults.swap, memory_frames)
    extent = rng.integers(3, size=(num_people, 1))
    for limbs, others in ((_ARMS, 1), (_LEGS, 2)):
        exchanged = swapped & (extent != others)
        left, right = (COCO_17.indices(names) for names in limbs)
        which[..., left] = np.where(exchanged[..., None], right, left)
        which[..., right] = np.where(exchanged[..., None], left, right)

    near = neighbours(points_px, in_sight)
    mixed = found & (near != _NOT_NEAR) & lasting_events(rng, bodies, faults.mix, memory_frames)
    limb = rng.integers(len(_LIMBS), size=(num_people, 1))
    for number, joints in enumerate(_LIMBS):
        taking = (mixed & (limb == number))[..., None]
        who[..., joints] = np.where(taking, near[..., None], who[..., joints])
    merged = mixed & (rng.random((num_people, 1)) < 0.5)
    people, frames = np.nonzero(merged)
    lost = np.zeros_like(found)
    lost[near[people, frames], frames] = True
    # Two bodies that take limbs from each other are both found.
    return Confusion(found & ~(lost & ~mixed), who, which)


def neighbours(
    points_px: Float[np.ndarray, "people frames joints 2"], in_sight: Bool[np.ndarray, "people frames"]
) -> Int[np.ndarray, "people frames"]:
    """Nearest body of each body in the image, -1 if no other trunk is within the height of the body's trunk."""
    shoulders_px, hips_px = points_px[:, :, _SHOULDERS].mean(2), points_px[:, :, _HIPS].mean(2)
    trunk_px = np.linalg.norm(shoulders_px - hips_px, axis=-1)
    middle_px = np.where(in_sight[..., None], (shoulders_px + hips_px) / 2, np.nan)
    distance_px = np.linalg.norm(middle_px[:, None] - middle_px, axis=-1)
    distance_px = np.where(np.eye(len(points_px), dtype=bool)[..., None] | np.isnan(distance_px), np.inf, distance_px)
    closest = np.argmin(distance_px, axis=1)
    return np.where(distance_px.min(1) < trunk_px, closest, _NOT_NEAR)


def false_positives(
    size_px: tuple[int, int], num_frames: int, faults: Faults, memory_frames: float, rng: np.random.Generator
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n joints 2"], Float[np.ndarray, "n joints"]]:
    """Draw false positives: objects that are detected as a body over several frames.

    Returns frames, joints in pixels (NaN where missing), and scores (0 where missing).
    """
    shape = (_NUM_GHOSTS, num_frames)
    there = lasting_events(rng, shape, faults.false_positives / _NUM_GHOSTS, memory_frames)
    # Each run of frames is a different object at a different position.
    run = np.cumsum(np.diff(there, axis=1, prepend=False) & there, axis=1)
    things, frames = np.nonzero(there)
    number = things * (num_frames + 1) + run[things, frames]
    _, thing = np.unique(number, return_inverse=True)
    num_things = int(thing.max(initial=-1)) + 1
    height_px = size_px[1] * rng.uniform(0.15, 0.6, num_things)
    corner_px = rng.uniform(0, 1, (num_things, 2)) * np.maximum(
        np.array(size_px) - height_px[:, None] * np.array([0.5, 1.0]), 1.0
    )
    shape_px = _STANDING + rng.normal(0, 0.05, (num_things, *_STANDING.shape))
    keypoints_px = corner_px[thing, None] + height_px[thing, None, None] * (
        shape_px[thing] + 0.01 * rng.standard_normal((len(thing), *_STANDING.shape))
    )
    lacking = rng.random((num_things, len(_STANDING))) < 0.3
    score = np.where(lacking[thing], 0.0, rng.uniform(0.15, 0.5, lacking.shape)[thing])
    in_image = ((keypoints_px >= 0) & (keypoints_px <= np.array(size_px) - 1)).all(-1)
    score = np.where(in_image, score, 0.0)
    return frames, np.where(score[..., None] > 0, keypoints_px, np.nan), score


# Joints of a standing person from the front, relative to the upper left corner of the bounding box, with height 1.
_STANDING = np.array(
    [
        [0.25, 0.07], [0.27, 0.05], [0.23, 0.05], [0.30, 0.06], [0.20, 0.06], [0.36, 0.19], [0.14, 0.19], [0.40, 0.35],
        [0.10, 0.35], [0.42, 0.50], [0.08, 0.50], [0.32, 0.50], [0.18, 0.50], [0.32, 0.73], [0.18, 0.73], [0.32, 0.96],
        [0.18, 0.96],
    ]
)  # fmt: skip
