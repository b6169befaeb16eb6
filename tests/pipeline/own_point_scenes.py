"""Sessions of keypoints with points of the user's own, and where these points truly are."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.capture.keypoints import KeypointSession
from pipeline.geometry.camera import project
from pipeline.validation.simulation.scenes import Simulation, find_scene, record

REACH_M = 0.5
NOISE_PX = 1.0


class OwnScene(NamedTuple):
    """A session, and the true positions of its points in the frames of the truth."""

    session: KeypointSession
    simulation: Simulation
    truth_m: Mapping[str, np.ndarray]  # Of a person's point (people, frames, 3); of the ball (frames, 3)


def own_scene(duration_s: float = 3.0, seed: int = 3, num_views: int = 4) -> OwnScene:
    """Everybody holds a racket, and one of the rows of each picture, or none, has the ball."""
    simulation = record(replace(find_scene("room"), duration_s=duration_s), seed=seed, num_views=num_views)
    wrist, elbow = (simulation.truth_m[:, :, simulation.joints.index(f"right_{part}")] for part in ("wrist", "elbow"))
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
    frames = np.arange(simulation.timebase.num_frames)
    time_s = simulation.timebase.start_time_s + frames / simulation.timebase.frame_rate_hz
    ball_m = np.stack([np.sin(time_s), np.cos(1.3 * time_s), 1.5 + np.sin(2.0 * time_s)], axis=-1) * [2.5, 2.5, 1.0]
    truth_m = {"racket_tip": wrist + REACH_M * along, "ball": ball_m}
    rng = np.random.default_rng(seed)
    points_px, scores = {}, {}
    for camera in simulation.cameras:
        seen, identity = simulation.detections[camera.name], simulation.identities[camera.name]
        at_s = simulation.times[camera.name].time_s

        def at(values_m: np.ndarray, at_s: np.ndarray = at_s) -> np.ndarray:
            return np.column_stack([np.interp(at_s, time_s, values_m[:, axis]) for axis in range(3)])

        tips_px = [project(camera, at(tip_m)) for tip_m in truth_m["racket_tip"]]
        ball_px = project(camera, at(ball_m))
        most = int(np.bincount(seen.frame, minlength=len(at_s)).max()) + 1
        points_px[camera.name] = np.full((len(at_s), most, len(simulation.joints.names) + 2, 2), np.nan)
        scores[camera.name] = np.zeros((len(at_s), most, len(simulation.joints.names) + 2))
        num_rows = np.zeros(len(at_s), int)
        for row, frame in enumerate(seen.frame):
            place = frame, num_rows[frame]
            num_rows[frame] += 1
            points_px[camera.name][place][:-2] = seen.keypoints_px[row]
            scores[camera.name][place][:-2] = seen.score[row]
            if identity[row] >= 0:
                points_px[camera.name][place][-2] = tips_px[identity[row]][frame] + rng.normal(0.0, NOISE_PX, 2)
                scores[camera.name][place][-2] = 0.9
        for frame in range(len(at_s)):
            place = frame, rng.integers(num_rows[frame] + 1)
            points_px[camera.name][place][-1] = ball_px[frame] + rng.normal(0.0, NOISE_PX, 2)
            scores[camera.name][place][-1] = 0.9
    names = (*simulation.joints.names, "racket tip", "ball")
    times_s = {name: times.time_s for name, times in simulation.times.items()}
    session = from_arrays(points_px, scores, simulation.cameras, times_s=times_s, joints=names)
    return OwnScene(session, simulation, truth_m)
