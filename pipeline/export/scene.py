"""Scene of a take, for files that hold everybody: people with their presence, cameras, and the floor.

Places are in world coordinates, metres; each format turns and scales them to its own axes and unit.
"""

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from math import atan
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.own_points.rigid import RigidMotion, poses
from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.data.cameras import Camera
from pipeline.core.data.own_points import RigidShape
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.export.timelines import presence, unknown_outside
from pipeline.geometry.camera import center_in_world
from pipeline.motion.skeleton.time_series import filled_linearly

Rgb = tuple[int, int, int]

# The golden ratio spreads hues evenly however many people there are.
_HUE_STEP = 0.618034


def color_rgb(track_id: int) -> Rgb:
    """Bright colour of a person, different from the colours of the next numbers."""
    red, green, blue = colorsys.hsv_to_rgb(track_id * _HUE_STEP % 1.0, 0.85, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)


# Within this distance numbers of single precision are less than 0.04 mm off.
_NEAR_M = 1000.0


def file_origin_m(cameras: Sequence[Camera], near_m: float = _NEAR_M) -> Float[np.ndarray, " 3"]:
    """World position that is the origin of files of single precision, in whole metres.

    The world's origin, unless a camera is farther than ``near_m`` from it, by default a kilometre, as in survey
    coordinates: then the median of the cameras' positions. Numbers of single precision at 5,000 km would be off by up
    to 25 cm.
    """
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    if np.abs(centers_m).max(initial=0.0) <= near_m:
        return np.zeros(3)
    return np.round(np.median(centers_m, axis=0))


FLOOR = "floor"
"""Name of the floor in a scene."""

# Distance from the paths of people's hips to the edge of the floor.
_MARGIN_M = 1.0
_LEVEL = Floor(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class ScenePerson:
    """Person of a scene; before and after the motion's own frames the nearest pose holds."""

    motion: SkeletonMotion
    track: Track3D  # Joints of the person in the same frames
    frames: range  # Output frames of the scene
    points: tuple["ScenePoint", ...] = ()  # Points of the user's own

    @property
    def is_present(self) -> Bool[np.ndarray, " frames"]:
        """Frames of the scene in which the person is there."""
        return presence(self.track, self.frames)


class ScenePoint(NamedTuple):
    """Point of the user's own in the frames of a scene, or a rigid object."""

    name: str
    xyz_m: Float[np.ndarray, "frames 3"]  # Positions; between known frames on a line, before and after them the nearest
    is_known: Bool[np.ndarray, " frames"]
    turn_xyzw: Float[np.ndarray, "frames 4"] | None = None  # Rotations of an object
    parts: tuple[tuple[str, Float[np.ndarray, " 3"]], ...] = ()  # Points of an object, and their places in its axes


def scene_points(
    names: Sequence[str], points: Track3D | None, frames: range, shapes: Sequence[RigidShape] = ()
) -> tuple[ScenePoint, ...]:
    """Points of the user's own in the frames of a scene, without those that are known in no frame.

    Points of rigid objects are parts of these.
    """
    if points is None:
        return ()
    rigid = poses(shapes, names, points)
    held = {name for motion in rigid for name in motion.shape.points}
    xyz_m = unknown_outside(points.xyz_m, points.frames, frames)
    is_known = np.isfinite(xyz_m).all(-1)
    return tuple(
        ScenePoint(name, filled_linearly(xyz_m[:, k], np.zeros(3)), is_known[:, k])
        for k, name in enumerate(names)
        if is_known[:, k].any() and name not in held
    ) + tuple(_rigid_point(motion, frames) for motion in rigid)


def _rigid_point(motion: RigidMotion, frames: range) -> ScenePoint:
    place_m, turn = (unknown_outside(v, motion.frames, frames) for v in (motion.place_m, motion.quat_xyzw))
    filled = filled_linearly(turn, np.array([0.0, 0.0, 0.0, 1.0]))
    return ScenePoint(
        motion.shape.name,
        filled_linearly(place_m, np.zeros(3)),
        np.isfinite(place_m).all(-1),
        filled / np.linalg.norm(filled, axis=1, keepdims=True),
        tuple(zip(motion.shape.points, motion.shape.xyz_m, strict=True)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class SceneCamera:
    """Camera of a scene: a pinhole in the middle of its picture, without distortion, as scenes have it."""

    camera: Camera

    @property
    def world_from_cam(self) -> Rigid3:
        """Place and orientation of the camera: x right, y down, z forward."""
        return self.camera.cam_from_world.inverse()

    @property
    def fov_rad(self) -> tuple[float, float]:
        """Angles of view across and upright, of a picture of the camera's size with its focal lengths."""
        (width, height), matrix = self.camera.size_px, self.camera.matrix
        return 2 * atan(width / (2 * matrix[0, 0])), 2 * atan(height / (2 * matrix[1, 1]))

    @property
    def facts(self) -> dict[str, object]:
        """Properties that a scene's camera can't have, as JSON: the calibration of the lens."""
        camera = self.camera
        return {
            "size_px": list(camera.size_px),
            "focal_length_px": camera.matrix[[0, 1], [0, 1]].tolist(),
            "principal_point_px": camera.matrix[:2, 2].tolist(),
            "lens": camera.lens,
            "distortion": camera.distortion.tolist(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class TakeScene:
    """Scene of a take."""

    people: tuple[ScenePerson, ...]
    cameras: tuple[SceneCamera, ...]
    floor: Floor | None  # Floor under the people; ``None``: there is none
    floor_m: Float[np.ndarray, "4 3"]  # Corners of the floor, counterclockwise from above
    frames: range  # Output frames of the take
    frame_rate_hz: float
    origin_m: Float[np.ndarray, " 3"]  # World position that is the origin of files of single precision
    objects: tuple[ScenePoint, ...] = ()  # Points of objects


def take_scene(take: Reconstruction) -> TakeScene:
    """Scene of a take with its people, in its order, its cameras and the floor under the people."""
    frames, own = range(take.timebase.num_frames), take.own
    points = [scene_points(own.names, own.of_person(number), frames, own.shapes) for number in range(len(take.tracks))]
    return TakeScene(
        people=tuple(
            ScenePerson(motion, track, frames, of_person)
            for motion, track, of_person in zip(take.motions, take.tracks, points, strict=True)
        ),
        cameras=tuple(map(SceneCamera, take.cameras)),
        floor=take.animation.floor,
        floor_m=_corners_m(take.animation.floor or _LEVEL, take.motions),
        frames=frames,
        frame_rate_hz=take.timebase.frame_rate_hz,
        origin_m=file_origin_m(take.cameras),
        objects=() if own.scene is None else scene_points(own.scene[0].names, own.scene[1], frames, own.shapes),
    )


def _corners_m(floor: Floor, motions: Sequence[SkeletonMotion]) -> Float[np.ndarray, "4 3"]:
    """Corners of the part of the floor on which people were; around the world's origin without people."""
    low_m = np.min([motion.root_m[:, :2].min(0) for motion in motions] or [np.zeros(2)], axis=0) - _MARGIN_M
    high_m = np.max([motion.root_m[:, :2].max(0) for motion in motions] or [np.zeros(2)], axis=0) + _MARGIN_M
    flat_m = np.array([(low_m[0], low_m[1]), (high_m[0], low_m[1]), (high_m[0], high_m[1]), (low_m[0], high_m[1])])
    heights_m = -floor.height_m(np.column_stack([flat_m, np.zeros(4)]))
    return np.column_stack([flat_m, heights_m])
