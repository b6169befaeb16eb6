"""Regions of heads in the pictures of a camera, from the people of a take and from all bodies that were detected.

Both see what the other misses. The head of a tracked person is projected into every camera and frame, also where the
person is hidden or no detector found a body. A detected body counts whether a track took it or not: bystanders, people
beyond a largest number of people, people whom edits remove, and everybody where a calibration is wrong.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.heads import HeadRegions, SeenHeads
from pipeline.export.privacy.people import HeadPath
from pipeline.geometry.camera import project

NEAR_S = 0.2
"""Time around a frame in which a detected head counts where the frame itself has no region: detectors miss frames."""

# Heads at most so far from the centre of a camera, in radii of their sphere, cover the whole picture.
_AT_CAMERA = 1.2
_GROWTH_OF_NEAR = 1.3
# Ellipses of peaks of heatmaps, which have no size: a share of the longer side of the picture if nobody is tracked.
_MIN_OF_PICTURE = 0.05
# Pixels beyond the picture at which projections of points are cut, in sides of the picture.
_MAX_BEYOND = 4.0
# Factor by which a sphere is larger than the convex hull of its points in all ``_DIRECTIONS``.
_OVER_HULL = 1.06

_STEPS = np.linspace(-1.0, 1.0, 5)
# Unit vectors to points on the surface of a cube.
_DIRECTIONS = np.array([point for point in itertools.product(_STEPS, repeat=3) if np.abs(point).max() == 1.0])
_DIRECTIONS = read_only(_DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True))


def head_regions(
    camera: Camera, frames: range, time_s: Float[np.ndarray, " frames"], people: Sequence[HeadPath], seen: SeenHeads
) -> HeadRegions:
    """Ellipses around all heads in each frame of a camera, also of heads that are hidden or out of the picture.

    Parameters
    ----------
    frames, time_s
        Numbers of the frames, and their times on the session's clock.
    people
        Heads of the take's people over time.
    seen
        Heads that a detector saw. One of a neighbouring frame counts where no other region is.
    """
    projected = [_projected(camera, people, float(now_s)) for now_s in time_s]
    seen_px = _sized(camera, seen.ellipse_px, [ellipse_px for ellipse_px in projected if len(ellipse_px)])
    first = np.searchsorted(seen.frame, np.arange(frames.start, frames.stop))
    last = np.searchsorted(seen.frame, np.arange(frames.start, frames.stop), side="right")
    found: list[Float[np.ndarray, "here 4"]] = []
    for number, now_s in enumerate(time_s):
        here_px = np.concatenate([projected[number], seen_px[first[number] : last[number]]])
        near = slice(*np.searchsorted(time_s, [now_s - NEAR_S, now_s + NEAR_S]))
        around_px = seen_px[first[near][0] : last[near][-1]]
        missed_px = around_px[~_is_covered(around_px[:, :2], here_px)]
        missed_px[:, 2:] *= _GROWTH_OF_NEAR
        found.append(np.concatenate([here_px, missed_px]))
    numbers = np.repeat(np.arange(frames.start, frames.stop), [len(ellipse_px) for ellipse_px in found])
    ellipse_px = np.concatenate([np.empty((0, 4)), *found]).astype(np.float32)
    return HeadRegions(
        camera.name, camera.size_px, frames.start, frames.stop, read_only(numbers), read_only(ellipse_px)
    )


def sphere_ellipse(
    camera: Camera, center_m: Float[np.ndarray, " 3"], radius_m: float
) -> Float[np.ndarray, " 4"] | None:
    """Ellipse around the picture of a sphere, through the lens; ``None`` if the sphere is behind the camera.

    The axes are those of the picture: the ellipse has the shape of the box around the projected points of the sphere,
    and is large enough for each of them. A sphere at the camera covers the whole picture.
    """
    size_px = np.array(camera.size_px, float)
    center_in_cam = camera.cam_from_world.apply(center_m)
    if np.linalg.norm(center_in_cam) < _AT_CAMERA * radius_m:
        return np.concatenate([(size_px - 1) / 2, size_px])
    points_px = project(camera, center_m + radius_m * _DIRECTIONS)
    points_px = points_px[np.isfinite(points_px).all(axis=1)]
    if not len(points_px):
        return None
    points_px = np.clip(points_px, -_MAX_BEYOND * size_px, (1 + _MAX_BEYOND) * size_px)
    low_px, high_px = points_px.min(axis=0), points_px.max(axis=0)
    middle_px, half_px = (low_px + high_px) / 2, np.maximum((high_px - low_px) / 2, 1.0)
    reach = float(np.linalg.norm((points_px - middle_px) / half_px, axis=1).max())
    return np.concatenate([middle_px, half_px * reach * _OVER_HULL])


def _projected(camera: Camera, people: Sequence[HeadPath], time_s: float) -> Float[np.ndarray, "here 4"]:
    """Ellipses of the people's heads at a time."""
    spheres = [sphere for path in people if (sphere := path.at(time_s)) is not None]
    ellipses = [ellipse_px for sphere in spheres if (ellipse_px := sphere_ellipse(camera, *sphere)) is not None]
    return np.array(ellipses).reshape(-1, 4)


def _sized(
    camera: Camera, ellipse_px: Float[np.ndarray, "n 4"], projected: Sequence[Float[np.ndarray, "here 4"]]
) -> Float[np.ndarray, "n 4"]:
    """Ellipses of which those without a size are as large as the heads of people in this camera mostly are."""
    least_px = _MIN_OF_PICTURE * max(camera.size_px)
    usual_px = float(np.median(np.concatenate(projected)[:, 2:])) if projected else 0.0
    return np.where(np.isnan(ellipse_px), max(least_px, usual_px), ellipse_px)


def _is_covered(points_px: Float[np.ndarray, "n 2"], ellipse_px: Float[np.ndarray, "here 4"]) -> np.ndarray:
    """Points that are in the inner half of one of the ellipses."""
    from_center = (points_px[:, None] - ellipse_px[None, :, :2]) / ellipse_px[None, :, 2:]
    return np.asarray((np.linalg.norm(from_center, axis=2) < 0.5).any(axis=1))
