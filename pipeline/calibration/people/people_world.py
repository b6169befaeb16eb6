"""World of cameras that people calibrated: scale from stature, gravity from upright standing, floor from feet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.calibration.people.bodies import MatchedBodies
from pipeline.calibration.people.following import JOINTS
from pipeline.calibration.people.stature import match_statures, others_at_once, statures
from pipeline.calibration.vertical import turn_upright, upright_direction
from pipeline.core.data.animation import Floor
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world
from pipeline.motion.skeleton.feet.floor import estimate_floor

# Feet that reach less far than this along some direction don't determine the slope of the floor.
_MIN_REACH_M = 0.4
_ANKLES = [JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]
_SHOULDERS = [JOINTS.index("left_shoulder"), JOINTS.index("right_shoulder")]


@dataclass(frozen=True, slots=True, eq=False)
class PeopleWorld:
    """Cameras in a world with Z up."""

    # Cameras; the floor is z = 0, the origin lies under the middle of the people, and y points away from the first
    # camera
    cameras: tuple[Camera, ...]
    scale: float  # Metres of this world to the unit of the cameras before
    has_floor: bool  # True if feet determine the floor; else z = 0 is only at the height of the lowest feet
    # Estimated stature of each group of bodies in metres, and the number of the known stature that it was given, -1
    # where none was left
    estimates_m: tuple[float, ...]
    statures: tuple[int, ...]


def find_people_world(
    cameras: Sequence[Camera], bodies: MatchedBodies, stature_m: Sequence[float], rate_hz: float
) -> PeopleWorld | None:
    """Put cameras into the world of the people; ``None`` if no person is seen from shoulders to ankles.

    The cameras are adjusted, in any frame and scale; statures are in any order. ``rate_hz`` is the instants' rate.
    """
    xyz = bodies.triangulated(cameras)
    found = statures(xyz, bodies.group)
    up = upright_direction(xyz[:, _SHOULDERS], xyz[:, _ANKLES])
    if up is None or not len(found):
        return None
    are_others = others_at_once(found, xyz, bodies.group, bodies.instant)
    scale, stature = match_statures(found, are_others, stature_m)
    rotation = turn_upright(up)
    floor = _floor(bodies, scale * xyz @ rotation.T, rate_hz)
    if floor is not None:
        rotation = turn_upright(np.array([-floor.slope_x, -floor.slope_y, 1.0])) @ rotation
        floor = _floor(bodies, scale * xyz @ rotation.T, rate_hz)
    centers_m = scale * np.array([center_in_world(camera) for camera in cameras]) @ rotation.T
    xyz_m = scale * xyz @ rotation.T
    middle_m = np.nanmedian(xyz_m[..., :2], axis=(0, 1))
    origin_m = np.append(middle_m, np.nanmin(xyz_m[..., 2]) if floor is None else _ground_m(floor, middle_m))
    turn = _away_from(middle_m - centers_m[0, :2])
    world_from_root = Rigid3(read_only(turn @ rotation), read_only(-turn @ origin_m))
    moved = tuple(_moved(camera, world_from_root, scale) for camera in cameras)
    return PeopleWorld(
        moved,
        scale,
        floor is not None and _reach_m(xyz_m) > _MIN_REACH_M,
        tuple((scale * found.estimates).tolist()),
        tuple(stature.tolist()),
    )


def _ground_m(floor: Floor, place_m: Float[np.ndarray, " 2"]) -> float:
    return floor.z_m + floor.slope_x * float(place_m[0]) + floor.slope_y * float(place_m[1])


def _away_from(ahead: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "3 3"]:
    """Rotation about the vertical that turns a horizontal direction to y."""
    cosine, sine = ahead[::-1] / max(float(np.linalg.norm(ahead)), 1e-9)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _moved(camera: Camera, world_from_root: Rigid3, scale: float) -> Camera:
    """Camera in the world: the unit is scaled first."""
    pose = camera.cam_from_world
    scaled = Rigid3(pose.rotation, read_only(scale * pose.translation_m))
    return replace(camera, cam_from_world=scaled @ world_from_root.inverse())


def _reach_m(xyz_m: Float[np.ndarray, "n joints 3"]) -> float:
    """Standard deviation of the feet's places along the direction in which they reach least far."""
    ankles_m = xyz_m[:, _ANKLES, :2].reshape(-1, 2)
    ankles_m = ankles_m[np.isfinite(ankles_m).all(-1)]
    if len(ankles_m) < 2:
        return 0.0
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(np.cov(ankles_m.T))[0])))


def _floor(bodies: MatchedBodies, xyz_m: Float[np.ndarray, "n joints 3"], rate_hz: float) -> Floor | None:
    ankles_m: list[np.ndarray] = []
    known: list[np.ndarray] = []
    for group in np.unique(bodies.group):
        own = bodies.group == group
        instant = bodies.instant[own] - bodies.instant[own][0]
        of_group = np.full((instant[-1] + 1, 2, 3), np.nan)
        of_group[instant] = xyz_m[own][:, _ANKLES]
        ankles_m.append(of_group)
        known.append(np.asarray(np.isfinite(of_group).all(-1)))
    return estimate_floor(ankles_m, known, rate_hz)
