"""Plan of a rig: where the cameras of a room see people, and how exactly.

A person stands at each place of a grid. A camera sees a joint if it is in the picture, and with the probability that no
other person hides it: the others are upright cylinders, anywhere in the room. Pixels have an error in proportion to the
size of the person in the picture. The covariance of a joint is the inverse of the sum of the views' information
(Hartley and Zisserman 2004, section 5.2), with each view weighted by its probability.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, look_at, project
from pipeline.geometry.undistortion import undistort_px

_CELL_M, _MAX_CELLS = 0.25, 60
# Heights of ankles, knees, hips, shoulders and head, and of a person; radius of a person as others hide behind it.
_HEIGHTS_M = np.array([0.1, 0.5, 0.95, 1.45, 1.7])
_PERSON_M, _RADIUS_M = 1.8, 0.25
_STEP_M = 1e-3
# Fewest expected views of a joint that is located, and largest standard deviation that counts as located.
_MIN_VIEWS, _MAX_SIGMA_M = 2.0, 1.0
# A pixel that leads back to another ray is of a lens that folds outside the picture.
_FOLDED_PX = 1.0
_CLASSES_MM = ((10.0, "#1b7837"), (20.0, "#7fbf7b"), (40.0, "#fdb863"), (np.inf, "#b35806"))
_NONE, _WIDTH = "#d9d9d9", 640


@dataclass(frozen=True, slots=True, eq=False)
class RoomPlan:
    """Views and errors at the places of a room, whose middle is the world's origin."""

    x_m: Float[np.ndarray, " columns"]
    y_m: Float[np.ndarray, " rows"]
    views: Float[np.ndarray, "rows columns"]  # Expected views of a joint: mean over the joints of a person
    # Expected distance of a joint from its true place (root mean square over the joints); NaN where a joint has fewer
    # than two expected views
    error_mm: Float[np.ndarray, "rows columns"]

    @property
    def covered(self) -> float:
        """Share of the floor at which all joints of a person are located."""
        return float(np.isfinite(self.error_mm).mean())


def planned_cameras(
    room_m: tuple[float, float], num_cameras: int, height_m: float, size_px: tuple[int, int], field_deg: float
) -> tuple[Camera, ...]:
    """Cameras evenly along the walls of a room, which look at the middle at a height of 1 m.

    ``room_m`` are the sides along X and Y, ``field_deg`` is the horizontal field of view.
    """
    width, height = size_px
    focal_px = width / 2 / np.tan(np.radians(field_deg / 2))
    matrix = np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])
    corners_m = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * np.array(room_m) / 2
    along_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners_m, axis=0), axis=1))])
    # Four cameras stand in the corners.
    places_m = np.arange(num_cameras) / num_cameras * along_m[-1]
    x_m, y_m = (np.interp(places_m, along_m, corners_m[:, axis]) for axis in (0, 1))
    target_m = np.array([0.0, 0.0, 1.0])
    return tuple(
        Camera(f"cam_{number}", size_px, read_only(matrix), read_only(np.zeros(0)), look_at(center_m, target_m))
        for number, center_m in enumerate(np.column_stack([x_m, y_m, np.full(num_cameras, height_m)]))
    )


def plan_room(
    cameras: Sequence[Camera], room_m: tuple[float, float], num_people: int, error_share: float = 0.01
) -> RoomPlan:
    """Expected views and errors at the places of a room.

    ``cameras``: cameras with sizes of pictures; world in metres, Z up, the middle of the floor at the origin.
    ``num_people``: people in the room: all but one of them hide joints of the one. ``error_share``: standard deviation
    of a pixel coordinate, as a share of the height of a person in the picture.
    """
    x_m, y_m = (
        (np.arange(count) + 0.5) * side_m / count - side_m / 2
        for side_m in room_m
        for count in [int(np.clip(round(side_m / _CELL_M), 4, _MAX_CELLS))]
    )
    points_m = np.stack(np.meshgrid(y_m, x_m, _HEIGHTS_M, indexing="ij"), axis=-1)[..., [1, 0, 2]]
    views, information = np.zeros(points_m.shape[:-1]), np.zeros((*points_m.shape, 3))
    for camera in cameras:
        seen = _probability(camera, points_m, room_m, num_people)
        depth_m = camera.cam_from_world.apply(points_m)[..., 2]
        size_px = camera.matrix[1, 1] * _PERSON_M / np.maximum(depth_m, _STEP_M)
        columns = [
            (project(camera, points_m + step) - project(camera, points_m - step)) / (2 * _STEP_M)
            for step in _STEP_M * np.eye(3)
        ]
        gradient = np.nan_to_num(np.stack(columns, axis=-1)) / (error_share * size_px)[..., None, None]
        views += seen
        information += seen[..., None, None] * (gradient.swapaxes(-1, -2) @ gradient)
    # Parallel rays leave the variance of the prior.
    covariance = np.linalg.inv(information + np.eye(3) / _MAX_SIGMA_M**2)
    variance_m2 = np.trace(covariance, axis1=-2, axis2=-1)
    located = ((views >= _MIN_VIEWS) & (variance_m2 < _MAX_SIGMA_M**2)).all(-1)
    error_mm = np.where(located, 1000 * np.sqrt(variance_m2.mean(-1)), np.nan)
    return RoomPlan(x_m, y_m, views.mean(-1), error_mm)


def _probability(
    camera: Camera, points_m: Float[np.ndarray, "*batch 3"], room_m: tuple[float, float], num_people: int
) -> Float[np.ndarray, "*batch"]:
    seen_px = project(camera, points_m)
    ideal_px = project(Camera(camera.name, camera.size_px, camera.matrix, np.zeros(0), camera.cam_from_world), points_m)
    with np.errstate(invalid="ignore"):
        inside = ((seen_px >= 0) & (seen_px <= np.array(camera.size_px) - 1)).all(-1)
        inside &= np.linalg.norm(undistort_px(camera, seen_px) - ideal_px, axis=-1) < _FOLDED_PX
    center_m = center_in_world(camera)
    distance_m = np.linalg.norm(points_m[..., :2] - center_m[:2], axis=-1)
    # Part of the ray, from the person on, that is lower than a head.
    rise_m = np.maximum(center_m[2] - points_m[..., 2], 1e-9)
    low = np.clip((_PERSON_M - points_m[..., 2]) / rise_m, 0.0, 1.0)
    hidden = np.clip(2 * _RADIUS_M * low * distance_m / (room_m[0] * room_m[1]), 0.0, 1.0)
    return np.asarray(inside * (1.0 - hidden) ** (num_people - 1))


def plan_document(plan: RoomPlan) -> dict[str, Any]:
    """Plan as JSON: covered share of the floor, and views and errors in the middles of nine parts of the floor."""
    rows, columns = (np.array([1, 3, 5]) * len(places) // 6 for places in (plan.y_m, plan.x_m))
    return {
        "covered": round(plan.covered, 3),
        "places": [
            {
                "x_m": round(float(plan.x_m[column]), 2),
                "y_m": round(float(plan.y_m[row]), 2),
                "views": round(float(plan.views[row, column]), 1),
                "error_mm": None if np.isnan(error_mm := plan.error_mm[row, column]) else round(float(error_mm), 1),
            }
            for row in rows
            for column in columns
        ],
    }


def plan_svg(plan: RoomPlan, cameras: Sequence[Camera], room_m: tuple[float, float]) -> str:
    """Draw the room from above: expected errors as colours, and the cameras."""
    scale = _WIDTH / room_m[0]
    width, height = (side_m / len(places) * scale for side_m, places in zip(room_m, (plan.x_m, plan.y_m), strict=True))

    def place(x_m: float, y_m: float) -> tuple[float, float]:
        return (x_m + room_m[0] / 2) * scale, (room_m[1] / 2 - y_m) * scale

    cells, dots = [], []
    for row, column in np.ndindex(plan.error_mm.shape):
        error_mm = float(plan.error_mm[row, column])
        colour = next((colour for limit_mm, colour in _CLASSES_MM if error_mm < limit_mm), _NONE)
        x, y = place(float(plan.x_m[column]), float(plan.y_m[row]))
        box = f'x="{x - width / 2:.1f}" y="{y - height / 2:.1f}" width="{width:.1f}" height="{height:.1f}"'
        cells.append(f'<rect {box} fill="{colour}"/>')
    for camera in cameras:
        x, y = place(*center_in_world(camera)[:2].tolist())
        ahead = (
            camera.cam_from_world.rotation[2, :2]
            * 24
            / max(np.linalg.norm(camera.cam_from_world.rotation[2, :2]), 1e-9)
        )
        dots.append(
            f'<path d="M{x:.1f} {y:.1f}l{ahead[0]:.1f} {-ahead[1]:.1f}"/><circle cx="{x:.1f}" cy="{y:.1f}" r="6"/>'
        )
    bottom = room_m[1] * scale
    keys = [(f"under {limit:.0f} mm" if np.isfinite(limit) else "more", colour) for limit, colour in _CLASSES_MM]
    legend = "".join(
        f'<rect x="{number * 128}" y="{bottom + 24:.0f}" width="16" height="16" fill="{colour}"/>'
        f'<text x="{number * 128 + 22}" y="{bottom + 37:.0f}">{text}</text>'
        for number, (text, colour) in enumerate([*keys, ("not located", _NONE)])
    )
    title = f"Expected error of joints: {100 * plan.covered:.0f} % of the floor is covered by {len(cameras)} cameras"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-16 -16 {_WIDTH + 32} {bottom + 72:.0f}" role="img" '
        f'font-family="sans-serif" font-size="14"><title>{title}</title>{"".join(cells)}'
        f'<g fill="#222" stroke="#222" stroke-width="2">{"".join(dots)}</g>{legend}</svg>\n'
    )
