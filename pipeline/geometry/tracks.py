"""Triangulation and reprojection of many instants at once; ``triangulation`` and ``camera`` define the computation."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.cameras import Camera
from pipeline.core.runtime import large_arrays
from pipeline.core.runtime.jit import as_compiled
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.camera_kernels import make_lenses, reproject_all
from pipeline.geometry.kernels import make_solver, triangulate_all
from pipeline.geometry.triangulation import triangulate_robust
from pipeline.geometry.undistortion import undistort_views


def triangulate_frames(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    weights: Float[np.ndarray, "frames cameras joints"],
    min_weight: float = 0.0,
) -> Float[np.ndarray, "frames joints 3"]:
    """Triangulate consecutive frames robustly: a wrong observation in one view does not pull the point.

    Each frame is computed by ``triangulation.triangulate_robust``; the guess is the running median over two frames on
    each side.

    - ``image_from_world``: projection matrices to undistorted pixels.
    - ``points_px``: undistorted pixels, NaN where a camera does not see the point.
    - ``weights``: factor of a view's rows.
    - ``min_weight``: a view with a smaller weight, or with weight 0, is left out.
    - Returns world coordinates in metres, NaN where fewer than two cameras see the point.
    """
    num_frames, num_cameras, num_joints = weights.shape
    xyz_m, guess_m = np.empty((num_frames, num_joints, 3)), np.empty((num_frames, num_joints, 3))
    disputed = np.empty((num_frames, num_joints), bool)
    solver = make_solver(image_from_world, min_weight)
    flat_px = as_compiled(points_px.reshape(num_frames, num_cameras, 2 * num_joints))
    triangulate_all(solver, flat_px, as_compiled(weights), xyz_m, disputed, guess_m)
    return xyz_m


def triangulate_instants(
    cameras: Sequence[Camera], points_px: Float[np.ndarray, "instants cameras joints 2"]
) -> Float[np.ndarray, "instants joints 3"]:
    """Triangulate robustly what cameras see at unrelated instants, all views with the same weight.

    Pixels are distorted, of the full image, NaN where unseen. World coordinates are in metres, NaN where fewer than two
    cameras see the point, or all rays are parallel.
    """
    ideal_px = undistort_views(cameras, points_px)
    return triangulate_robust(projection_matrices(cameras), ideal_px, np.isfinite(ideal_px).all(-1).astype(float))


def reproject(
    cameras: Sequence[Camera],
    xyz_m: Float[np.ndarray, "frames joints 3"],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    weights: Float[np.ndarray, "frames cameras joints"],
    min_weight: float = 0.0,
) -> tuple[Float[np.ndarray, "frames joints"], Float[np.ndarray, "frames joints"], Int[np.ndarray, "frames joints"]]:
    """Compare joint positions with the observations that they were computed from.

    - ``xyz_m``: world coordinates in metres, NaN where unknown.
    - ``points_px``: distorted pixels of the full image, NaN where unseen.
    - ``weights``: weight of an observation.
    - ``min_weight``: observations with a smaller weight, or with weight 0, were not used.

    The result has:

    - ``error_px``: mean reprojection error in pixels over the cameras that saw a joint; NaN where no camera did, or
      where the joint is unknown.
    - ``mean_weight``, ``views``: mean weight and number of these cameras; 0 where there is no error.
    """
    shape = xyz_m.shape[:2]
    error_px, mean_weight, views = (large_arrays.empty(shape, dtype) for dtype in (float, float, np.int64))
    lenses = make_lenses(cameras, min_weight)
    for rows in large_arrays.blocks(len(xyz_m)):  # arrays that are read-only are copied
        flat_px = as_compiled(points_px[rows].reshape(*weights[rows].shape[:2], 2 * xyz_m.shape[1]))
        results = error_px[rows], mean_weight[rows], views[rows]
        reproject_all(lenses, as_compiled(xyz_m[rows]), flat_px, as_compiled(weights[rows]), *results)
    return error_px, mean_weight, views
