"""Places at which all other views expect a person's joints, in frames in which a picture shows a neighbour nearby."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.steady import steady_places
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project, projection_matrices
from pipeline.geometry.track_assembly import Person
from pipeline.geometry.tracks import triangulate_frames

# Distance of the middles of two bodies in a picture at which a limb may be either one's, at the nearer one's distance.
_NEAR_M = 1.2


class Window(NamedTuple):
    """Some frames of everybody who is there."""

    person: list[int]  # Positions of the people in the order of all
    xyz_m: Float[np.ndarray, "people frames joints 3"]  # Joints in the world, NaN where unknown
    # Observations in distorted pixels, NaN where a camera has none, and their scores
    points_px: Float[np.ndarray, "people frames cameras joints 2"]
    score: Float[np.ndarray, "people frames cameras joints"]

    def __len__(self) -> int:
        return len(self.person)


def present(persons: Sequence[Person], frames: range) -> list[int]:
    """Positions of the people who are there in a range of output frames."""
    return [k for k, (track, _) in enumerate(persons) if _life(track.start_frame, track.num_frames, frames)]


def window_of(persons: Sequence[Person], frames: range) -> Window:
    """Cut the output frames of a range out of everybody's tracks and observations."""
    there = present(persons, frames)
    num_cameras, num_joints = persons[0][1].score.shape[1:]
    shape = len(there), len(frames), num_cameras, num_joints
    xyz_m = np.full((*shape[:2], num_joints, 3), np.nan)
    points_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    for row, k in enumerate(there):
        track, seen = persons[k]
        life = _life(track.start_frame, track.num_frames, frames)
        to = slice(life.start - frames.start, life.stop - frames.start)
        rows = slice(life.start - track.start_frame, life.stop - track.start_frame)
        xyz_m[row, to], points_px[row, to], score[row, to] = track.xyz_m[rows], seen.points_px[rows], seen.score[rows]
    return Window(there, xyz_m, points_px, score)


def near_neighbours(window: Window, cameras: Sequence[Camera]) -> Bool[np.ndarray, "people people cameras frames"]:
    """Frames in which a camera sees the middles of two bodies near each other."""
    middle_m = _middles(window.xyz_m)
    near = np.zeros((len(window), len(window), len(cameras), middle_m.shape[1]), bool)
    for k, camera in enumerate(cameras):
        middle_px = project(camera, middle_m)
        px_per_m = scale_px_per_m(camera, middle_m)
        apart_px = np.linalg.norm(middle_px[:, None] - middle_px, axis=-1)
        near[:, :, k] = apart_px < _NEAR_M * np.maximum(px_per_m[:, None], px_per_m)
    near[np.arange(len(window)), np.arange(len(window))] = False
    return near


def expected_without(
    ideal_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    camera: int,
    cameras: Sequence[Camera],
    min_score: float,
    frame_rate_hz: float,
) -> Float[np.ndarray, "frames joints 3"]:
    """Expected places of a person's joints in the world in metres without a camera's observations.

    Observations are undistorted. Places are medians over time; NaN where fewer than two other views see a joint for
    long. Without the camera's own observations its error can't confirm itself.
    """
    others = [k for k in range(len(cameras)) if k != camera]
    projections = projection_matrices([cameras[k] for k in others])
    xyz_m = triangulate_frames(projections, ideal_px[:, others], score[:, others], min_score)
    return steady_places(xyz_m, np.isfinite(xyz_m).all(-1), frame_rate_hz)


def scale_px_per_m(camera: Camera, xyz_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Pixels of a metre across the view at the distance of points."""
    focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    return np.asarray(focal_px / np.maximum(camera.cam_from_world.apply(xyz_m)[..., 2], 1e-3))


def _life(start_frame: int, num_frames: int, frames: range) -> range:
    """Frames of a track in a range of frames."""
    return range(max(start_frame, frames.start), min(start_frame + num_frames, frames.stop))


def _middles(xyz_m: Float[np.ndarray, "people frames joints 3"]) -> Float[np.ndarray, "people frames 3"]:
    """Means of the known joints; NaN without any."""
    known = np.isfinite(xyz_m).all(-1)
    count = known.sum(-1)[..., None]
    total_m = np.where(known[..., None], xyz_m, 0.0).sum(-2)
    return np.where(count > 0, total_m / np.maximum(count, 1), np.nan)
