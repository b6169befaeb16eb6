"""Sessions of keypoints with points of the user's own, and where these points truly are."""

import itertools
import json
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.own_points_file import with_own_points
from pipeline.geometry.camera import project
from pipeline.validation.simulation.scenes import Simulation, find_scene, record

REACH_M = 0.5
NOISE_PX = 1.0


# Rigid objects: points of a racket in its own plane, from the grip to the tip, and corners of a box.
RACKET = {"tip": (0.0, 0.0, 0.5), "left": (-0.12, 0.0, 0.35), "right": (0.12, 0.0, 0.35), "grip": (0.0, 0.0, 0.0)}
BOX = {"box_a": (0.0, 0.0, 0.0), "box_b": (0.5, 0.0, 0.0), "box_c": (0.0, 0.4, 0.0), "box_d": (0.0, 0.0, 0.3)}


class OwnScene(NamedTuple):
    """A session, and the true positions of its points in the frames of the truth."""

    session: KeypointSession
    simulation: Simulation
    truth_m: Mapping[str, np.ndarray]  # Of a person's point (people, frames, 3); of a point of the scene (frames, 3)
    world_from_box: Rotation | None = None
    box_m: np.ndarray | None = None
    world_from_racket: np.ndarray | None = None  # (people, frames, 3, 3)


def own_scene(duration_s: float = 3.0, seed: int = 3, num_views: int = 4) -> OwnScene:
    """Everybody holds a racket, and one of the rows of each picture, or none, has the ball."""
    simulation = record(replace(find_scene("room"), duration_s=duration_s), seed=seed, num_views=num_views)
    wrist, along, time_s = _held(simulation)
    ball_m = np.stack([np.sin(time_s), np.cos(1.3 * time_s), 1.5 + np.sin(2.0 * time_s)], axis=-1) * [2.5, 2.5, 1.0]
    return _scene(simulation, seed, {"racket tip": wrist + REACH_M * along}, {"ball": ball_m})


def rigid_scene(duration_s: float = 3.0, seed: int = 3, num_views: int = 4) -> OwnScene:
    """Everybody holds a racket of four points, and a box of four corners turns about a tilted axis as it flies."""
    simulation = record(replace(find_scene("room"), duration_s=duration_s), seed=seed, num_views=num_views)
    wrist, along, time_s = _held(simulation)
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    axes = np.stack([side, np.cross(along, side), along], axis=-1)
    of_people = {name: wrist + np.einsum("pfij,j->pfi", axes, place) for name, place in RACKET.items()}
    turn = Rotation.from_rotvec(np.outer(1.5 * time_s, [0.6, 0.0, 0.8]))
    box_m = np.stack([np.sin(time_s), np.cos(1.3 * time_s), 1.2 + 0.4 * np.sin(2.0 * time_s)], axis=-1) * [
        2.0,
        2.0,
        1.0,
    ]
    of_scene = {name: box_m + turn.apply(place) for name, place in BOX.items()}
    return _scene(simulation, seed, of_people, of_scene)._replace(
        world_from_box=turn, box_m=box_m, world_from_racket=axes
    )


def with_shapes(session: KeypointSession, *, by_distances: bool = True) -> KeypointSession:
    """Session whose rackets have places, and whose box has distances or places, with a bone in each."""
    pairs = itertools.combinations(BOX, 2)
    rows = [[a, b, float(np.linalg.norm(np.subtract(BOX[a], BOX[b])))] for a, b in pairs]
    box = {"distances": rows} if by_distances else {"points": BOX}
    document = {"objects": {"racket": {"points": RACKET}, "box": box}, "bones": [["grip", "tip"], ["box_a", "box_b"]]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "own.json"
        path.write_text(json.dumps(document))
        return with_own_points(session, path)


def _held(simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right wrists, directions of the forearms, and the times of the frames."""
    wrist, elbow = (simulation.truth_m[:, :, simulation.joints.index(f"right_{part}")] for part in ("wrist", "elbow"))
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
    frames = np.arange(simulation.timebase.num_frames)
    return wrist, along, simulation.timebase.start_time_s + frames / simulation.timebase.frame_rate_hz


def _scene(
    simulation: Simulation, seed: int, of_people: Mapping[str, np.ndarray], of_scene: Mapping[str, np.ndarray]
) -> OwnScene:
    """Session in which points are seen with noise, in the rows of their people, or in any row or none."""
    _, _, time_s = _held(simulation)
    rng = np.random.default_rng(seed)
    points_px, scores = {}, {}
    num_joints, num_people = len(simulation.joints.names), len(of_people)
    for camera in simulation.cameras:
        seen, identity = simulation.detections[camera.name], simulation.identities[camera.name]
        at_s = simulation.times[camera.name].time_s

        def at(values_m: np.ndarray, at_s: np.ndarray = at_s) -> np.ndarray:
            return np.column_stack([np.interp(at_s, time_s, values_m[:, axis]) for axis in range(3)])

        held_px = [[project(camera, at(of_person)) for of_person in point_m] for point_m in of_people.values()]
        flying_px = [project(camera, at(point_m)) for point_m in of_scene.values()]
        most = int(np.bincount(seen.frame, minlength=len(at_s)).max()) + 1
        shape = len(at_s), most, num_joints + num_people + len(of_scene)
        points_px[camera.name], scores[camera.name] = np.full((*shape, 2), np.nan), np.zeros(shape)
        num_rows = np.zeros(len(at_s), int)
        for row, frame in enumerate(seen.frame):
            place = frame, num_rows[frame]
            num_rows[frame] += 1
            points_px[camera.name][place][:num_joints] = seen.keypoints_px[row]
            scores[camera.name][place][:num_joints] = seen.score[row]
            for k, of_people_px in enumerate(held_px if identity[row] >= 0 else (), num_joints):
                points_px[camera.name][place][k] = of_people_px[identity[row]][frame] + rng.normal(0.0, NOISE_PX, 2)
                scores[camera.name][place][k] = 0.9
        for frame in range(len(at_s)):
            place = frame, rng.integers(num_rows[frame] + 1)
            for k, point_px in enumerate(flying_px, num_joints + num_people):
                points_px[camera.name][place][k] = point_px[frame] + rng.normal(0.0, NOISE_PX, 2)
                scores[camera.name][place][k] = 0.9
    names = (*simulation.joints.names, *of_people, *of_scene)
    times_s = {name: times.time_s for name, times in simulation.times.items()}
    session = from_arrays(points_px, scores, simulation.cameras, times_s=times_s, joints=names)
    truth_m = {name.replace(" ", "_"): values for name, values in {**of_people, **of_scene}.items()}
    return OwnScene(session, simulation, truth_m)
