"""``python -m pipeline.warm_up``: compile every kernel, so that no request has to."""

import numpy as np

from pipeline.config import ReconstructionConfig
from pipeline.data import Camera, Detections, FrameTimes, Timebase, read_only
from pipeline.geometry.camera import project
from pipeline.geometry.fields import connectivity
from pipeline.geometry.rigid import Rigid3
from pipeline.joints import BODY_25, COCO_17, JointSet
from pipeline.skeleton.animate import animate
from pipeline.tracking.associate import reconstruct_tracks
from pipeline.tracking.parameters import derive_parameters

_NUM_FRAMES = 10
_RATE_HZ = 25.0


def warm_up() -> None:
    """Track and fit somebody who stands before three cameras, with every joint set of a size; ask a field."""
    for joints in (COCO_17, BODY_25):
        _reconstruct_somebody(joints)
    ends = np.array([[0.0, 0.0], [1.0, 1.0]])
    connectivity(read_only(np.full((1, 2, 2, 2), 255, np.uint8)), np.zeros(1, int), ends[:1], ends[1:])


def _reconstruct_somebody(joints: JointSet) -> None:
    num_joints = len(joints.names)
    body_m = np.random.default_rng(0).uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (num_joints, 3))
    cameras = [_camera(number) for number in range(3)]
    points_px = {camera.name: np.repeat(project(camera, body_m)[None], _NUM_FRAMES, axis=0) for camera in cameras}
    detections = {
        camera.name: Detections(
            camera=camera.name,
            frame=np.arange(_NUM_FRAMES),
            keypoints_px=read_only(points_px[camera.name]),
            score=read_only(np.ones((_NUM_FRAMES, num_joints))),
            box_px=np.zeros((_NUM_FRAMES, 4)),
        )
        for camera in cameras
    }
    times = {camera.name: FrameTimes(np.arange(_NUM_FRAMES) / _RATE_HZ) for camera in cameras}
    timebase = Timebase(0.0, _RATE_HZ, _NUM_FRAMES)
    found = reconstruct_tracks(cameras, times, detections, timebase, derive_parameters(cameras, _RATE_HZ))
    animate(*found, cameras, timebase, joints, ReconstructionConfig())


def _camera(number: int) -> Camera:
    """A camera 4 m from the origin, a metre above the floor."""
    cos, sin = np.cos(number), np.sin(number)
    rotation = np.array([[-sin, cos, 0.0], [0.0, 0.0, -1.0], [-cos, -sin, 0.0]])
    matrix = np.array([[800.0, 0.0, 639.5], [0.0, 800.0, 359.5], [0.0, 0.0, 1.0]])
    translation_m = np.array([0.0, 1.0, 4.0])
    return Camera(f"cam{number}", (1280, 720), matrix, np.array([-0.1, 0.0, 0.0, 0.0]), Rigid3(rotation, translation_m))


if __name__ == "__main__":
    warm_up()
