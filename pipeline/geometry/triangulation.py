"""Triangulation by weighted linear least squares, and its robust form.

A view contributes two rows of the direct linear transform, ``x p3 - p1`` and ``y p3 - p2`` (Chen et al. 2020, eq. 7-9).
Divided by its norm (eq. 11), a row measures the distance in metres to a plane through the viewing ray. So all views
have equal influence at any distance of their cameras. The norm includes only the three spatial entries, so that the
result does not depend on the world's origin. The homogeneous system becomes normal equations in three unknowns.
"""

import numpy as np
from jaxtyping import Bool, Float

# Scales (metres) of the Geman-McClure weights, from forgiving to strict: graduated non-convexity.
SCALES_M = (0.40, 0.20, 0.10, 0.06)
# Distance to the point above which a view, or a guess, disagrees with the point.
DISPUTED_M = SCALES_M[-1]
# Determinant of the normal matrix over its cubed trace, below which rays count as parallel and the depth is unknown.
# Two rays at the angle phi have about phi^2 / 32: the limit is 1 degree.
_MIN_DETERMINANT = 1e-5


def plane_rows(
    image_from_world: Float[np.ndarray, "cameras 3 4"], points_px: Float[np.ndarray, "*batch cameras joints 2"]
) -> Float[np.ndarray, "*batch cameras joints 2 4"]:
    """Normalised rows ``a_i`` of the linear system (eq. 7-9, norm of eq. 11); NaN where a point is NaN.

    Pixels are undistorted.
    """
    first_two = image_from_world[:, None, :2, :]
    third = image_from_world[:, None, 2:, :]
    rows = points_px[..., None] * third - first_two
    return rows / np.linalg.norm(rows[..., :3], axis=-1, keepdims=True)


def _by_joint(
    rows: Float[np.ndarray, "*batch cameras joints 2 4"], used: Bool[np.ndarray, "*batch cameras joints"]
) -> Float[np.ndarray, "*batch joints rows 4"]:
    """Stack the rows of all views for each joint; zeros for unused views."""
    stacked = np.where(used[..., None, None], rows, 0.0).swapaxes(-4, -3)
    return stacked.reshape(*stacked.shape[:-3], stacked.shape[-3] * stacked.shape[-2], 4)


def _solve(
    rows: Float[np.ndarray, "*batch joints rows 4"], weights: Float[np.ndarray, "*batch joints cameras"]
) -> Float[np.ndarray, "*batch joints 3"]:
    """Minimise ``|| (w o A) X~ ||`` (eq. 10); NaN where fewer than two views have weight or all rays are parallel.

    The normal equations of three unknowns are solved by Cramer's rule: the calls of a general solver would cost more
    than the arithmetic.
    """
    weighted = rows * np.repeat(weights, 2, axis=-1)[..., None]
    return np.where(((weights > 0).sum(-1) >= 2)[..., None], solve_normal(weighted.swapaxes(-1, -2) @ weighted), np.nan)


def solve_normal(normal: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 3"]:
    """Minimise ``X~^T normal X~`` over points; ``normal`` is the sum of ``a a^T`` over the rows of eq. 10.

    World coordinates are in metres, NaN where all rays are parallel.
    """
    a, b, c, d, e, f = (normal[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    right = -normal[..., :3, 3]
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * ab + c * ac
    over = 1.0 / np.where(determinant > _MIN_DETERMINANT * (a + d + f) ** 3, determinant, np.nan)
    x, y, z = right[..., 0] * over, right[..., 1] * over, right[..., 2] * over
    return np.stack([aa * x + ab * y + ac * z, ab * x + bb * y + bc * z, ac * x + bc * y + cc * z], axis=-1)


def triangulate(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    points_px: Float[np.ndarray, "*batch cameras joints 2"],
    weights: Float[np.ndarray, "*batch cameras joints"],
) -> Float[np.ndarray, "*batch joints 3"]:
    """Triangulate by weighted linear least squares (Chen et al. 2020, eq. 10).

    Parameters
    ----------
    image_from_world
        Projection matrices to undistorted pixels.
    points_px
        Undistorted pixels, NaN where a camera does not see the point.
    weights
        Factor of a view's normalised rows, such as ``exp(-lambda_t (t - t_i))`` of eq. 11; 0 leaves the view out.

    Returns
    -------
        World coordinates in metres, NaN where fewer than two cameras see the point.

    References
    ----------
    L. Chen et al., "Cross-View Tracking for Multi-Human 3D Pose Estimation at over 100 FPS", CVPR 2020.

    Examples
    --------
    Two cameras a metre apart look along the world's z axis, with a focal length of 100 pixels. The second point is seen
    by one of them only.

    >>> import numpy as np
    >>> matrix = np.diag([100.0, 100.0, 1.0])
    >>> image_from_world = np.stack([matrix @ np.column_stack([np.eye(3), [-x_m, 0.0, 0.0]]) for x_m in (0.0, 1.0)])
    >>> points_px = np.array([[[25.0, 20.0], [0.0, 0.0]], [[-25.0, 20.0], [np.nan, np.nan]]])
    >>> triangulate(image_from_world, points_px, np.ones((2, 2))).round(6).tolist()
    [[0.5, 0.4, 2.0], [nan, nan, nan]]
    """
    rows, base = _system(image_from_world, points_px, weights)
    return _solve(rows, base)


def _system(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    points_px: Float[np.ndarray, "*batch cameras joints 2"],
    weights: Float[np.ndarray, "*batch cameras joints"],
) -> tuple[Float[np.ndarray, "*batch joints rows 4"], Float[np.ndarray, "*batch joints cameras"]]:
    used = np.isfinite(points_px).all(-1) & (weights > 0)
    rows = plane_rows(image_from_world, points_px)
    return _by_joint(rows, used), np.where(used, weights, 0.0).swapaxes(-1, -2)


def _ray_distance2_m2(
    rows: Float[np.ndarray, "*batch joints rows 4"], points_m: Float[np.ndarray, "*batch joints 3"]
) -> Float[np.ndarray, "*batch joints cameras"]:
    """Squared distance to both planes of a view, to first order that to its ray; 0 for unused views."""
    residuals = (rows[..., :3] @ points_m[..., None])[..., 0] + rows[..., 3]
    squared = residuals * residuals
    return squared[..., 0::2] + squared[..., 1::2]


def triangulate_robust(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    points_px: Float[np.ndarray, "*batch cameras joints 2"],
    weights: Float[np.ndarray, "*batch cameras joints"],
    guess_m: Float[np.ndarray, "*batch joints 3"] | None = None,
) -> Float[np.ndarray, "*batch joints 3"]:
    """Triangulate robustly: a wrong observation in one view does not pull the point.

    Eq. 10 is reweighted iteratively with Geman-McClure weights ``(c^2 / (c^2 + d^2))^2``, where d is the distance to a
    view's ray. The scale c decreases step by step, beginning with the first scale below the largest d. The cost is
    linear in the number of cameras. If views still disagree and a guess is given, such as a prediction from the past,
    a second run starts from the guess, and the lower robust cost wins.

    ``image_from_world``, ``points_px``, ``weights``: as in ``triangulate``. ``guess_m``: world coordinates of a second
    start, NaN where there is none. Returns world coordinates in metres, NaN where fewer than two cameras see the point.
    """
    rows, base = _system(image_from_world, points_px, weights)
    points_m = _solve(rows, base)
    worst_m = _worst_distance_m(rows, base, points_m)
    for scale_m in SCALES_M[:-1]:
        needed = (worst_m > scale_m)[..., None]
        points_m = np.where(needed, _reweighted(rows, base, points_m, scale_m), points_m)
    for _ in range(2):
        worst_m = _worst_distance_m(rows, base, points_m)
        points_m = _reweighted(rows, base, points_m, SCALES_M[-1])
    if guess_m is None:
        return points_m
    from_guess = guess_m
    for scale_m in (*SCALES_M[-2:], SCALES_M[-1]):
        from_guess = _reweighted(rows, base, from_guess, scale_m)
    better = _robust_cost(rows, base, from_guess) < _robust_cost(rows, base, points_m)
    disputed = (worst_m > DISPUTED_M) & (np.linalg.norm(guess_m - points_m, axis=-1) > DISPUTED_M)
    return np.where((better & disputed)[..., None], from_guess, points_m)


def _reweighted(
    rows: Float[np.ndarray, "*batch joints rows 4"],
    base: Float[np.ndarray, "*batch joints cameras"],
    points_m: Float[np.ndarray, "*batch joints 3"],
    scale_m: float,
) -> Float[np.ndarray, "*batch joints 3"]:
    distance2_m2 = _ray_distance2_m2(rows, points_m)
    distance2_m2[np.isnan(distance2_m2)] = np.inf
    # The normal equations square the factors, so the rows get the root of the Geman-McClure weight.
    return _solve(rows, base * (scale_m**2 / (scale_m**2 + distance2_m2)))


def _worst_distance_m(
    rows: Float[np.ndarray, "*batch joints rows 4"],
    base: Float[np.ndarray, "*batch joints cameras"],
    points_m: Float[np.ndarray, "*batch joints 3"],
) -> Float[np.ndarray, "*batch joints"]:
    """Largest distance over the used views; 0 where the point is unknown."""
    used = (base > 0) & np.isfinite(points_m[..., :1])
    return np.sqrt(np.where(used, _ray_distance2_m2(rows, points_m), 0.0).max(-1, initial=0.0))


def _robust_cost(
    rows: Float[np.ndarray, "*batch joints rows 4"],
    base: Float[np.ndarray, "*batch joints cameras"],
    points_m: Float[np.ndarray, "*batch joints 3"],
) -> Float[np.ndarray, "*batch joints"]:
    """Geman-McClure cost at the smallest scale; infinite for NaN."""
    distance2_m2 = _ray_distance2_m2(rows, points_m)
    cost = (base**2 * distance2_m2 / (distance2_m2 + SCALES_M[-1] ** 2)).sum(-1)
    return np.where(np.isfinite(points_m[..., 0]), cost, np.inf)
