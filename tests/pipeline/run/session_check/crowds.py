"""Random sessions at twelve instants: crowds, pictures of many sizes, narrow and wide views, shelves, detector faults.

Only the instants are simulated, half a second apart: a session of 20 people and 40 cameras takes two seconds.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import center_in_world
from pipeline.run.session_check.sightings import NUM_INSTANTS, SimultaneousPeople, collect_sightings
from pipeline.validation.simulation.motion.director import Cast, improvise
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from pipeline.validation.simulation.views.detector import DetectorAccuracy, detect
from pipeline.validation.simulation.views.faults import Faults
from pipeline.validation.simulation.views.occlusion import Box

# Pictures from security cameras to phones.
_SIZES_PX = ((320, 240), (292, 240), (640, 360), (640, 480), (1280, 720), (1920, 1080))
_STEP_S = 0.5


@dataclass(frozen=True, slots=True)
class CrowdedSession:
    """Session with a right calibration."""

    cameras: tuple[Camera, ...]
    sightings: SimultaneousPeople
    num_people: int


def crowded_session(seed: int) -> CrowdedSession:
    """Simulate a random session: 4 to 40 cameras, 4 to 20 people, and shelves in half of the sessions."""
    rng = np.random.default_rng([68, seed])
    num_cameras, num_people = int(np.round(np.exp(rng.uniform(np.log(4), np.log(40))))), int(rng.integers(4, 21))
    width_m, depth_m = rng.uniform(4.0, 9.0, 2) + 0.3 * num_people
    boxes = _shelves(width_m, depth_m, rng) if rng.random() < 0.5 else ()
    layout = Layout(rng.choice([layout.value for layout in Layout]))
    extent_m = (max(width_m, depth_m) / 2 + rng.uniform(0.5, 2.0),) * 2
    rig = Rig(layout, num_cameras, extent_m, rng.uniform(2.2, 3.5) if layout is not Layout.DOME else 1.0)
    cameras = tuple(_with_picture(camera, rng) for camera in build_cameras(rig, rng))
    cast = Cast(num_people, (width_m, depth_m), gap_m=rng.uniform(0.4, 0.8), walking=rng.uniform(0.2, 0.8))
    duration_s = NUM_INSTANTS * _STEP_S
    time_s = (np.arange(NUM_INSTANTS) + 0.5) * _STEP_S
    people = [perform(role, duration_s, rng) for role in improvise(cast, boxes, duration_s, rng)]
    people_m = np.stack([joints_at(person, time_s) for person in people])
    faults = Faults(
        miss_joint=rng.uniform(0.0, 0.1),
        miss_body=rng.uniform(0.0, 0.2),
        swap=rng.uniform(0.0, 0.05),
        mix=rng.uniform(0.0, 0.15),
        duplicate=rng.uniform(0.0, 0.05),
        false_positives=rng.uniform(0.0, 0.3),
    )
    detector = DetectorAccuracy(
        noise_m=rng.uniform(0.008, 0.025), noise_px=rng.uniform(0.0, 2.0), tail=rng.uniform(3.0, 6.0), faults=faults
    )
    detections = {camera.name: detect(camera, _STEP_S, people_m, boxes, detector, rng)[0] for camera in cameras}
    frames = {camera.name: range(NUM_INSTANTS) for camera in cameras}
    return CrowdedSession(cameras, collect_sightings(cameras, detections, frames, COCO_17, time_s.tolist()), num_people)


def disturbed(session: CrowdedSession, seed: int, degrees: float = 0.5, shift_m: float = 0.01) -> tuple[Camera, ...]:
    """Turn and shift one camera that sees people along random axes; the others stay."""
    rng = np.random.default_rng([69, seed])
    seeing = [number for number in range(len(session.cameras)) if session.sightings.num_people(number) >= NUM_INSTANTS]
    number = int(rng.choice(seeing))
    axis, way = rng.normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    camera = session.cameras[number]
    rotation = turn @ camera.cam_from_world.rotation
    center_m = center_in_world(camera) + shift_m * way / np.linalg.norm(way)
    moved = replace(camera, cam_from_world=Rigid3(read_only(rotation), read_only(-rotation @ center_m)))
    return (*session.cameras[:number], moved, *session.cameras[number + 1 :])


def _with_picture(camera: Camera, rng: np.random.Generator) -> Camera:
    """Camera with a random size of its pictures and a horizontal field of view of 45 to 95 degrees."""
    size_px = _SIZES_PX[rng.integers(len(_SIZES_PX))]
    focal_px = size_px[0] / 2 / np.tan(np.radians(rng.uniform(45.0, 95.0)) / 2)
    center_px = (np.array(size_px) - 1) / 2 * rng.uniform(0.98, 1.02, 2)
    matrix = np.array([[focal_px, 0.0, center_px[0]], [0.0, focal_px, center_px[1]], [0.0, 0.0, 1.0]])
    distortion = rng.uniform(0.0, 1.0) * np.array([-0.1, 0.03, 0.0005, -0.0004, 0.0])
    return replace(camera, size_px=size_px, matrix=read_only(matrix), distortion=read_only(distortion))


def _shelves(width_m: float, depth_m: float, rng: np.random.Generator) -> tuple[Box, ...]:
    """Two to five shelves of 1.2 to 2 m, along X or Y."""
    boxes = []
    for _ in range(rng.integers(2, 6)):
        half_m = np.array([rng.uniform(0.8, 2.0), 0.25])[:: rng.choice([1, -1])]
        middle_m = rng.uniform(-0.4, 0.4, 2) * [width_m, depth_m]
        low_m, high_m = middle_m - half_m, middle_m + half_m
        boxes.append(Box((*low_m, 0.0), (*high_m, rng.uniform(1.2, 2.0))))
    return tuple(boxes)
