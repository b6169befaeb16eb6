"""People who move, pictures of them and their mirror images, as tracks with noise."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import COCO_17, other_side
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.motion.script import Cue, Gesture, Role, Stay, Turn, Walk

RATE_HZ = 30.0
OTHERS = COCO_17.indices(tuple(other_side(name) for name in COCO_17.names))
Motion = Float[np.ndarray, "frames joints 3"]
WALK: Sequence[Cue] = (Walk((1.2, 0.6), 1.1), Turn(2.0), Stay(2.0, Gesture.WAVE), Walk((-1.0, -0.5), 1.1), Turn(0.0))


def moving(seed: int, duration_s: float = 8.0, cues: Sequence[Cue] = WALK) -> Motion:
    """Joints of somebody who moves about within 1.5 m of the origin."""
    person = perform(Role((-1.0, 0.2), 0.0, tuple(cues)), duration_s, np.random.default_rng(seed))
    return joints_at(person, np.arange(round(duration_s * RATE_HZ)) / RATE_HZ)


def poster(seed: int, duration_s: float = 8.0) -> Motion:
    """Flat picture of somebody on a wall."""
    pose_m = moving(seed, 1.0)[15] * [0.0, 0.9, 0.9] + [1.8, 0.0, 0.4]
    return np.repeat(pose_m[None], round(duration_s * RATE_HZ), axis=0)


def mirrored(motion_m: Motion, normal: Sequence[float], offset_m: float) -> Motion:
    """Mirror image of somebody, with the names that a detector gives to its joints."""
    direction = np.array(normal) / np.linalg.norm(normal)
    return np.asarray(motion_m - 2 * (motion_m @ direction - offset_m)[..., None] * direction)[:, OTHERS]


def track(xyz_m: Motion, seed: int = 0, noise_m: float = 0.01, start_frame: int = 0) -> Track3D:
    """Track of joints with noise."""
    xyz_m = xyz_m + np.random.default_rng(seed).normal(0.0, noise_m, xyz_m.shape)
    known = np.isfinite(xyz_m[..., 0])
    source = np.where(known, Source.MEASURED, Source.ABSENT)
    return Track3D(1, start_frame, xyz_m, known * 0.9, source, np.where(known, 1.0, np.nan), 3 * known)
