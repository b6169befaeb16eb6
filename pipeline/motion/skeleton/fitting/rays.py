"""Energy of joint positions from the rays of all views in a window of frames."""

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.cameras import Camera
from pipeline.core.joints import JointSet
from pipeline.core.runtime.jit import as_compiled
from pipeline.geometry.camera import center_in_world, rays_in_world
from pipeline.geometry.undistortion import undistort_px
from pipeline.motion.skeleton.fitting.fit_kernels import squared_distances, sum_normal_equations

# Noise of a detector across a ray.
_SIGMA_M = 0.015
_MIN_SCORE = 0.1
# Number of observations that the noise promised by scores counts for.
_NUM_PROMISED = 50
# Parts of limbs that detectors confuse with the other side, and the improvement of the fit (in observations with score
# 1) that an exchange of sides requires.
_EXCHANGEABLE = (
    ("shoulder", "elbow", "wrist"), ("elbow", "wrist"), ("wrist",), ("hip", "knee", "ankle"), ("knee", "ankle"),
    ("ankle",),
)  # fmt: skip
_CLEARLY = 0.5


class Rays:
    """Energy of joint positions. A view with score s contributes ``s^3 / sigma^2 GM(d; c)``.

    d is the distance of the joint to the ray, and GM the function of Geman and McClure. GM hardly increases beyond c,
    so a single wrong view has little influence. Observations are in distorted pixels of the full image, NaN with score
    0 where there is none.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        points_px: Float[np.ndarray, "frames cameras joints 2"],
        score: Float[np.ndarray, "frames cameras joints"],
        joints: JointSet,
    ) -> None:
        rays = np.stack(
            [rays_in_world(camera, undistort_px(camera, points_px[:, k])) for k, camera in enumerate(cameras)], axis=1
        )
        # By joints first: a joint is located from all frames and views at once.
        rays, score = (np.ascontiguousarray(np.moveaxis(values, 2, 0)) for values in (rays, score))
        is_seen = (score > _MIN_SCORE) & np.isfinite(rays).all(-1)
        self._rays = np.where(is_seen[..., None], rays, 0.0)
        self._centers_m = np.array([center_in_world(camera) for camera in cameras])
        self._weight = np.where(is_seen, score**3, 0.0) / _SIGMA_M**2
        self._pairs = tuple(_pairs(joints))

    def normal_equations(
        self, joint: int, xyz_m: Float[np.ndarray, "frames 3"], scale_m: float
    ) -> tuple[Float[np.ndarray, "frames 3 3"], Float[np.ndarray, "frames 3"]]:
        """Matrix and right side of the normal equations of a joint, reweighted at its current position.

        ``scale_m`` is c of the function of Geman and McClure.
        """
        normal, right = np.empty((len(xyz_m), 3, 3)), np.empty((len(xyz_m), 3))
        sum_normal_equations(
            self._rays[joint], self._centers_m, self._weight[joint], as_compiled(xyz_m), scale_m, normal, right
        )
        return normal, right

    def precision(
        self, joint: int, xyz_m: Float[np.ndarray, "frames 3"], scale_m: float
    ) -> Float[np.ndarray, "frames 3 3"]:
        """Inverse covariance of a joint by the rays of each frame, in 1 / m2.

        The noise of the detector follows from the joint's own residuals in frames that two views see, in relation to
        what the scores promise. For joints with few observations, it is closer to the promise.
        """
        weight, off_m2 = self._weight[joint], self._off_m2(joint, xyz_m)
        robust = weight * (scale_m**2 / (off_m2 + scale_m**2)) ** 2
        is_seen = weight > 0
        counted = is_seen & (is_seen.sum(1, keepdims=True) > 1)
        # Of the squared distance to a ray, each of two axes has a half.
        residual = float((robust * off_m2)[counted].sum()) / 2
        noise = (residual + _NUM_PROMISED) / (int(counted.sum()) + _NUM_PROMISED)
        return self.normal_equations(joint, xyz_m, scale_m)[0] / noise

    def disagreement(
        self, joint: int, xyz_m: Float[np.ndarray, "frames 3"], scale_m: float
    ) -> Float[np.ndarray, " frames"]:
        """Share of a joint's views, by their weights, that its position does not explain: the mean of GM(d; c)."""
        weight, off_m2 = self._weight[joint], self._off_m2(joint, xyz_m)
        return np.asarray((weight * off_m2 / (off_m2 + scale_m**2)).sum(1) / np.maximum(weight.sum(1), 1e-9))

    def residuals(
        self, joint: int, xyz_m: Float[np.ndarray, "frames 3"], scale_m: float
    ) -> tuple[Float[np.ndarray, " frames"], Int[np.ndarray, " frames"]]:
        """Weighted sum of the squared distances of a joint to its rays in each frame, and the number of views.

        A distance as large as the scores promise has the expectation 2, one for each coordinate of the view.
        """
        weight, off_m2 = self._weight[joint], self._off_m2(joint, xyz_m)
        robust = weight * (scale_m**2 / (off_m2 + scale_m**2)) ** 2
        return (robust * off_m2).sum(1), (weight > 0).sum(1)

    def exchange_sides(self, xyz_m: Float[np.ndarray, "frames joints 3"], scale_m: float) -> None:
        """Exchange the left and right limb of a view in frames in which they clearly fit better when exchanged."""

        @cache
        def lost(joint: int, ray: int) -> Float[np.ndarray, "frames cameras"]:
            off_m2 = self._off_m2(ray, xyz_m[:, joint])
            return np.nan_to_num(self._weight[ray] * _SIGMA_M**2 * off_m2 / (off_m2 + scale_m**2))

        for left, right in self._pairs:
            both, other_way = [*left, *right], [*right, *left]
            kept, other = (
                np.stack([lost(*pair) for pair in zip(both, seen_as, strict=True)], -1).sum(-1)
                for seen_as in (both, other_way)
            )
            exchanged = kept - other > _CLEARLY
            if not exchanged.any():
                continue
            lost.cache_clear()
            self._rays[both] = np.where(exchanged[..., None], self._rays[other_way], self._rays[both])
            self._weight[both] = np.where(exchanged, self._weight[other_way], self._weight[both])

    def _off_m2(self, joint: int, xyz_m: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames cameras"]:
        """Squared distances of positions to the rays of a joint."""
        off_m2 = np.empty(self._weight.shape[1:])
        squared_distances(self._rays[joint], self._centers_m, as_compiled(xyz_m), off_m2)
        return off_m2


def _pairs(joints: JointSet) -> Iterator[tuple[list[int], list[int]]]:
    for limb in _EXCHANGEABLE:
        left, right = (tuple(f"{side}_{name}" for name in limb) for side in ("left", "right"))
        if {*left, *right} <= set(joints.names):
            yield joints.indices(left), joints.indices(right)
