"""Positions of limbs for each candidate of their sides."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.limbs import LimbPair
from pipeline.association.identity.sides.candidates import SCALE_M, SeenRays

# Scales of the function of Geman and McClure, one a step.
_SCALES_M = (0.3, 0.2, SCALE_M, SCALE_M)
# Least eigenvalue of the normal equations, in views with score 1: below, the rays do not tell the depth.
_LEAST_EIGENVALUE = 0.01
_INERTIA = 1e-9
# Frames that are worked on at once, to bound the memory.
_BLOCK = 512


class LocatedLimbs(NamedTuple):
    """Limbs as candidates locate them."""

    # Joints of the left and right limb in the world in metres, NaN where fewer than two views see one
    xyz_m: Float[np.ndarray, "frames candidates 2 joints 3"]
    residual: Float[np.ndarray, "frames candidates"]  # Disagreement of the views, in observations with score 1


def locate_limbs(
    rays: SeenRays, limbs: LimbPair, exchanged: Bool[np.ndarray, "frames candidates cameras"]
) -> LocatedLimbs:
    """Triangulate the joints of both limbs for each candidate, robustly (iteratively reweighted least squares)."""
    blocks = [slice(start, start + _BLOCK) for start in range(0, len(exchanged), _BLOCK)]
    located = [_locate(rays.within(block), limbs, exchanged[block]) for block in blocks]
    return LocatedLimbs(*(np.concatenate(parts) for parts in zip(*located, strict=True)))


def _locate(rays: SeenRays, limbs: LimbPair, exchanged: Bool[np.ndarray, "frames candidates cameras"]) -> LocatedLimbs:
    here = exchanged[..., None]
    direction = np.where(
        here[..., None], rays.direction[:, None, :, limbs.exchanged], rays.direction[:, None, :, limbs.both]
    )
    weight = np.where(here, rays.weight[:, None, :, limbs.exchanged], rays.weight[:, None, :, limbs.both])
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    is_located = (weight > 0).sum(2) >= 2
    robust = weight
    for scale_m in _SCALES_M:
        normal = (robust[..., None, None] * across).sum(2) + _INERTIA * np.eye(3)
        right = np.einsum("fkcj,fkcjab,cb->fkja", robust, across, rays.center_m)
        xyz_m = np.linalg.solve(normal, right[..., None])[..., 0]
        off_m = np.einsum("fkcjab,fkcjb->fkcja", across, xyz_m[:, :, None] - rays.center_m[:, None])
        off_m2 = (off_m**2).sum(-1)
        robust = weight * (scale_m**2 / (off_m2 + scale_m**2)) ** 2
    residual = np.where(is_located[:, :, None], weight * off_m2 / (off_m2 + SCALE_M**2), 0.0).sum((2, 3))
    is_located &= np.linalg.eigvalsh(normal)[..., 0] > _LEAST_EIGENVALUE
    xyz_m = np.where(is_located[..., None], xyz_m, np.nan)
    return LocatedLimbs(xyz_m.reshape(*xyz_m.shape[:2], 2, len(limbs.left), 3), residual)
