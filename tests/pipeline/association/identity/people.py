"""Tracks of people who walk on straight lines, as association leaves them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.association.identity.identify import identify
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Leftovers, Observations, People, Source, Track3D
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person
from pipeline.validation.simulation.motion.body import Pose, pose_joints, random_proportions

RATE_HZ = 25.0
NOISE_M = 0.005


def walker(start_m: Sequence[float], end_m: Sequence[float], num_frames: int, build: int) -> np.ndarray:
    """World positions (frames, joints, 3) of somebody who glides from one point of the floor to another.

    Parameters
    ----------
    build
        Seed of the body's proportions.
    """
    body = random_proportions(np.random.default_rng(build))
    path_m = np.linspace(start_m, end_m, num_frames)
    zero = np.zeros(num_frames)
    hips_m = np.column_stack([path_m, np.full(num_frames, body.ankle_height_m + 0.97 * body.leg_m)])
    ankles_m = path_m[:, None] + np.array([[0.0, 0.1], [0.0, -0.1]])
    pose = Pose(
        hips_m=hips_m,
        yaw_rad=zero,
        lean_rad=zero,
        twist_rad=zero,
        gaze_rad=np.zeros((num_frames, 2)),
        ankles_m=np.concatenate([ankles_m, np.full((num_frames, 2, 1), body.ankle_height_m)], axis=-1),
        wrists=np.tile([[0.3, 0.16, -0.7], [0.3, -0.16, -0.7]], (num_frames, 1, 1)),
    )
    return pose_joints(body, pose)


def person(
    xyz_m: np.ndarray, cameras: Sequence[Camera], start_frame: int = 0, seen_by: Sequence[int] | None = None
) -> Person:
    """Track of somebody with some noise, and observations in some cameras (all by default)."""
    rng = np.random.default_rng(start_frame)
    xyz_m = xyz_m + rng.normal(0, NOISE_M, xyz_m.shape)
    shape = xyz_m.shape[:2]
    points_px = np.full((shape[0], len(cameras), shape[1], 2), np.nan)
    for number in range(len(cameras)) if seen_by is None else seen_by:
        points_px[:, number] = project(cameras[number], xyz_m)
    seen = np.isfinite(points_px[..., 0])
    track = Track3D(
        1,
        start_frame,
        xyz_m,
        np.full(shape, 0.9),
        np.full(shape, Source.MEASURED),
        np.full(shape, 1.0),
        np.asarray(seen.sum(1)),
    )
    return track, Observations(1, points_px, np.where(seen, 0.9, 0.0))


def part(of: Person, start: int, stop: int) -> Person:
    """Some rows of a track."""
    track, seen = of
    rows = slice(start, stop)
    names = ("xyz_m", "score", "source", "error_px", "views")
    return (
        replace(track, start_frame=track.start_frame + start, **{name: getattr(track, name)[rows] for name in names}),
        replace(seen, points_px=seen.points_px[rows], score=seen.score[rows]),
    )


def spliced(one: Person, other: Person) -> Person:
    """Track that goes over from one person to another one, without a gap."""
    names = ("xyz_m", "score", "source", "error_px", "views")
    joined: dict[str, Any] = {name: np.concatenate([getattr(one[0], name), getattr(other[0], name)]) for name in names}
    seen: dict[str, Any] = {
        name: np.concatenate([getattr(one[1], name), getattr(other[1], name)]) for name in ("points_px", "score")
    }
    return replace(one[0], **joined), replace(one[1], **seen)


def told_apart(
    people: Sequence[Person],
    cameras: Sequence[Camera],
    num_frames: int,
    most: int | None = None,
    leftovers: Leftovers | None = None,
    num_recorded: int | None = None,
) -> People:
    tracks, observations = zip(*people, strict=True) if people else ((), ())
    found = People(tracks, observations, leftovers=leftovers)
    return identify(found, cameras, COCO_17, Timebase(0.0, RATE_HZ, num_frames), 0.1, most, None, num_recorded)
