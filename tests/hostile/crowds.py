"""Sessions of keypoints with the hardest association: crowds whose people look alike in every camera."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from pipeline.capture.keypoints import KeypointSession
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

RATE_HZ = 25.0
_NUM_JOINTS = len(COCO_17.names)
_BODY_M = np.random.default_rng(0).uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (_NUM_JOINTS, 3))

People = Callable[[Camera, int, np.random.Generator], np.ndarray]
"""Keypoints (people, joints, 2) that a camera sees in a frame of so many people."""


def cameras_around(num_cameras: int) -> tuple[Camera, ...]:
    """Cameras in a dome around the scene."""
    rig = Rig(Layout.DOME, num_cameras, (8.0, 8.0), 1.5, (1920, 1080), 1100.0)
    return build_cameras(rig, np.random.default_rng(1))


def _standing_at(places_m: np.ndarray) -> People:
    return lambda camera, num_people, _: project(camera, _BODY_M + np.resize(places_m, (num_people, 1, 3)))


def _jittered(camera: Camera, num_people: int, rng: np.random.Generator) -> np.ndarray:
    return project(camera, _BODY_M + np.zeros((num_people, 1, 1))) + rng.normal(0, 15, (num_people, _NUM_JOINTS, 2))


def _anywhere(camera: Camera, num_people: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, camera.size_px, (num_people, _NUM_JOINTS, 2))


def _walking_randomly(camera: Camera, num_people: int, rng: np.random.Generator) -> np.ndarray:
    places_m = np.random.default_rng(int(rng.integers(2**31))).uniform(-4, 4, (num_people, 1, 3)) * [1, 1, 0]
    return project(camera, _BODY_M + places_m)


def _single_joints(camera: Camera, num_people: int, rng: np.random.Generator) -> np.ndarray:
    points_px = _anywhere(camera, num_people, rng)
    points_px[np.arange(_NUM_JOINTS) != rng.integers(_NUM_JOINTS, size=(num_people, 1))] = np.nan
    return points_px


def _of_size(size_px: float) -> People:
    return lambda _, num_people, rng: rng.uniform(-size_px, size_px, (num_people, _NUM_JOINTS, 2))


def _unknown(camera: Camera, num_people: int, rng: np.random.Generator) -> np.ndarray:
    points_px = _anywhere(camera, num_people, rng)
    return np.where(rng.random((num_people, _NUM_JOINTS, 1)) < 0.9, np.nan, points_px)


def _on_a_ray(cameras: tuple[Camera, ...]) -> People:
    """All people stand behind the first person of the first camera: on one epipolar line of each other camera."""
    start_m = center_in_world(cameras[0])
    share = np.linspace(0.3, 1.5, 200)[:, None]
    return _standing_at((start_m + share * (np.array([0.0, 0.0, 1.0]) - start_m))[:, None])


def _on_a_grid() -> People:
    """People stand half a metre apart: most rays of two views meet near a joint of some person."""
    rows = np.stack(np.meshgrid(np.arange(10), np.arange(20)), -1).reshape(-1, 2) * 0.4 - 3.0
    return _standing_at(np.column_stack([rows, np.zeros(len(rows))])[:, None])


def _session(cameras: tuple[Camera, ...], people: People, num_people: int, num_frames: int) -> KeypointSession:
    times = {camera.name: FrameTimes(np.arange(num_frames) / RATE_HZ) for camera in cameras}
    detections: dict[str, Detections] = {}
    for number, camera in enumerate(cameras):
        rng = np.random.default_rng(number)
        seen = [people(camera, num_people, rng) for _ in range(num_frames)]
        points_px = np.concatenate(seen)
        detections[camera.name] = Detections(
            camera.name,
            np.repeat(np.arange(num_frames), num_people),
            points_px,
            np.where(np.isnan(points_px[..., 0]), 0.0, 0.9),
            np.zeros((len(points_px), 4)),
        )
    folders = {camera.name: camera.name for camera in cameras}
    return KeypointSession(cameras, times, Timebase(0.0, RATE_HZ, num_frames), detections, COCO_17, folders, ())


def hostile_crowds(num_people: int, num_cameras: int, num_frames: int) -> Mapping[str, Callable[[], KeypointSession]]:
    """Sessions by name of their difficulty; each camera shows a number of people in every frame."""
    around = cameras_around(num_cameras)
    same = tuple(replace(around[0], name=camera.name) for camera in around)
    in_one_place = tuple(
        replace(
            camera,
            cam_from_world=Rigid3(
                camera.cam_from_world.rotation, -camera.cam_from_world.rotation @ center_in_world(around[0])
            ),
        )
        for camera in around
    )
    kinds: Mapping[str, tuple[tuple[Camera, ...], People]] = {
        "in one place": (around, _standing_at(np.zeros((1, 1, 3)))),
        "nearly in one place": (around, _jittered),
        "on one ray": (around, _on_a_ray(around)),
        "on a grid": (around, _on_a_grid()),
        "elsewhere in each frame": (around, _walking_randomly),
        "joints anywhere": (around, _anywhere),
        "a joint each": (around, _single_joints),
        "a few joints each": (around, _unknown),
        "enormous": (around, _of_size(1e6)),
        "tiny": (around, _of_size(1e-9)),
        "cameras are the same": (same, _walking_randomly),
        "cameras are the same, people in one place": (same, _standing_at(np.zeros((1, 1, 3)))),
        "cameras are in one place": (in_one_place, _jittered),
    }
    return {
        name: partial(_session, cameras, people, num_people, num_frames) for name, (cameras, people) in kinds.items()
    }
