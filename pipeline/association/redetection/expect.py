"""Places at which tracks expect leaning and close bodies in the pictures of each camera, and no detection agrees.

Detectors learnt from upright people: of bodies that are upside down they miss a quarter to a third, and call left right
in a fifth. Of people close to each other they mix limbs, or find one body for two (docs/lab/detection.md). A body leans
if its trunk is far from upright in the world and in the picture. It is close if another one is near in the picture.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.identity.limbs import steady_places
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import COCO_17, JointSet
from pipeline.geometry.camera import project
from pipeline.video.timeline import frames_in

LEAN_IN_WORLD_DEG, LEAN_IN_PICTURE_DEG = 30.0, 40.0
"""Angles of a leaning trunk from the vertical of the world, and from the upright direction of the picture."""
# Distance of the middles of two bodies in a picture, at the nearer one's distance, below which they are close.
_CLOSE_M = 1.0
# Joints of the body that a picture must show, and the least distance of a body from the camera.
_LEAST_INSIDE, _LEAST_DEPTH_M = 4, 0.3
# A detection agrees with the expected body if all joints but two are within a share of the body's diagonal.
_AGREED_SHARE_CLOSE, _AGREED_SHARE_LEANING, _MOST_ELSEWHERE = 0.12, 0.08, 2
# Least number of a camera's pictures that are decoded again.
_LEAST_PICTURES = 3

_SHOULDERS, _HIPS = (COCO_17.indices((f"left_{part}", f"right_{part}")) for part in ("shoulder", "hip"))
BODY = slice(COCO_17.index("left_shoulder"), None)
"""Joints of ``COCO_17`` below the head."""


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedBodies:
    """Bodies that are expected in the frames of one camera, sorted by frame."""

    camera: str  # Name of the camera
    frame: Int[np.ndarray, " n"]  # The camera's frame number of each body, ascending
    keypoints_px: Float[np.ndarray, "n 17 2"]  # Joints ``COCO_17`` in full-image pixels, NaN where they are unknown
    px_per_m: Float[np.ndarray, " n"]  # Pixels of a metre across the view at the body
    is_wanted: Bool[np.ndarray, " n"]  # False for bodies that are only close to bodies that are detected again

    def select(self, rows: slice | Int[np.ndarray, " rows"]) -> "ExpectedBodies":
        """Select bodies, in ascending order of their frames."""
        return replace(
            self,
            frame=self.frame[rows],
            keypoints_px=self.keypoints_px[rows],
            px_per_m=self.px_per_m[rows],
            is_wanted=self.is_wanted[rows],
        )

    def within(self, frames: range) -> "ExpectedBodies":
        """Select the bodies in a range of the camera's frame numbers."""
        return self.select(slice(*np.searchsorted(self.frame, [frames.start, frames.stop])))


def expected_body_m(track: Track3D, joints: JointSet, frame_rate_hz: float) -> Float[np.ndarray, "frames 17 3"]:
    """Expected places of a person's joints ``COCO_17`` in the world in metres.

    They are medians over time; NaN where a joint is far from any measurement in time.
    """
    columns = joints.indices(COCO_17.names)
    measured = (track.source[:, columns] == Source.MEASURED) & np.isfinite(track.xyz_m[:, columns]).all(-1)
    return steady_places(track.xyz_m[:, columns], measured, frame_rate_hz)


class _Expected(NamedTuple):
    """A person's expected bodies in the frames of a camera."""

    frame: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 17 2"]
    px_per_m: Float[np.ndarray, " n"]
    leans: Bool[np.ndarray, " n"]  # Bodies that lean, and with which no detection agrees as with a leaning body
    is_doubtful: Bool[np.ndarray, " n"]  # Bodies with which no detection agrees as with a close body


def expect_bodies(
    people: Sequence[tuple[Track3D, Observations]],
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    joints: JointSet,
    turns_deg: Mapping[str, float],
) -> tuple[ExpectedBodies, ...]:
    """Expect the leaning and the close bodies of all tracks in the frames of each camera that show them.

    A body whose detection agrees with its track is not wanted: to look again would tell nothing new. No body is
    expected in a camera that would be decoded for one or two pictures.

    ``people``: tracks with at least the joints ``COCO_17``, and their observations by the cameras. ``times``: times of
    each camera's frames, by name. ``turns_deg``: counterclockwise turns that bring the pictures upright, by name of the
    camera. Returns as many as cameras, in their order.
    """
    columns = joints.indices(COCO_17.names)
    expected_m = [expected_body_m(track, joints, timebase.frame_rate_hz) for track, _ in people]
    chosen = []
    for place, camera in enumerate(cameras):
        of_camera = camera, times[camera.name], timebase, turns_deg[camera.name]
        of_people = [
            _in_pictures(track, body_m, seen.points_px[:, place][:, columns], *of_camera)
            for (track, seen), body_m in zip(people, expected_m, strict=True)
        ]
        chosen.append(_chosen(camera.name, of_people))
    return tuple(chosen)


def _trunk(body: Float[np.ndarray, "*batch 17 axes"]) -> Float[np.ndarray, "*batch axes"]:
    """Vector from the middle of the hips to the middle of the shoulders."""
    return np.asarray(body[..., _SHOULDERS, :].mean(-2) - body[..., _HIPS, :].mean(-2))


def _in_pictures(
    track: Track3D,
    expected_m: Float[np.ndarray, "frames 17 3"],
    seen_px: Float[np.ndarray, "frames 17 2"],
    camera: Camera,
    times: FrameTimes,
    timebase: Timebase,
    turn_deg: float,
) -> _Expected:
    """Body of a person in the frames of a camera that show it, between the output instants around each frame."""
    first, last = track.start_frame - 0.5, track.start_frame + track.num_frames - 0.5
    within = frames_in(times, timebase.time_s(first), timebase.time_s(last))
    frames = np.arange(within.start, within.stop)
    row = (times.time_s[frames] - timebase.start_time_s) * timebase.frame_rate_hz - track.start_frame
    row = np.clip(row, 0, track.num_frames - 1)
    before = np.floor(row).astype(np.int64)
    after = np.minimum(before + 1, track.num_frames - 1)
    share = (row - before)[:, None, None]
    body_m = expected_m[before] if not share.any() else (1 - share) * expected_m[before] + share * expected_m[after]
    points_px, seen_px = project(camera, body_m), seen_px[np.rint(row).astype(np.int64)]
    depth_m = camera.cam_from_world.apply(body_m)[..., 2]
    is_known = np.isfinite(depth_m)
    distance_m = np.where(is_known, depth_m, 0.0).sum(-1) / np.maximum(is_known.sum(-1), 1)
    inside = ((points_px[:, BODY] >= -0.5) & (points_px[:, BODY] < np.array(camera.size_px) - 0.5)).all(-1)
    shown = (inside.sum(-1) >= _LEAST_INSIDE) & (distance_m > _LEAST_DEPTH_M)
    focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    expected = _Expected(
        frames,
        points_px,
        focal_px / np.maximum(distance_m, _LEAST_DEPTH_M),
        _leans(body_m, points_px, turn_deg) & ~_agrees(seen_px, points_px, _AGREED_SHARE_LEANING),
        ~_agrees(seen_px, points_px, _AGREED_SHARE_CLOSE),
    )
    return _Expected(*(values[shown] for values in expected))


def _leans(
    body_m: Float[np.ndarray, "n 17 3"], points_px: Float[np.ndarray, "n 17 2"], turn_deg: float
) -> Bool[np.ndarray, " n"]:
    """Bodies that lean in the world and in the upright picture."""
    trunk_m, trunk_px = _trunk(body_m), _trunk(points_px)
    in_world = trunk_m[:, 2] <= np.cos(np.radians(LEAN_IN_WORLD_DEG)) * np.linalg.norm(trunk_m, axis=-1)
    direction_rad = np.arctan2(trunk_px[:, 0], -trunk_px[:, 1]) - np.radians(turn_deg)
    return np.asarray(in_world & (np.cos(direction_rad) < np.cos(np.radians(LEAN_IN_PICTURE_DEG))))


def _agrees(
    seen_px: Float[np.ndarray, "n 17 2"], expected_px: Float[np.ndarray, "n 17 2"], share: float
) -> Bool[np.ndarray, " n"]:
    """Bodies whose detections are where they are expected; a joint that was not detected is not."""
    size_px = np.fmax.reduce(expected_px, axis=1) - np.fmin.reduce(expected_px, axis=1)
    limit_px = share * np.linalg.norm(size_px, axis=-1, keepdims=True)
    is_there = np.linalg.norm(seen_px - expected_px, axis=-1)[:, BODY] < limit_px
    return np.asarray((~is_there).sum(-1) <= _MOST_ELSEWHERE)


def _chosen(camera: str, people: Sequence[_Expected]) -> ExpectedBodies:
    """Bodies of a camera that are detected again, and the bodies close to these."""
    none = np.empty(0, bool)
    no_body = _Expected(np.empty(0, np.int64), np.empty((0, 17, 2)), np.empty(0), none, none)
    joined = _Expected(*(np.concatenate(values) for values in zip(no_body, *people, strict=True)))
    in_time = _Expected(*(values[np.argsort(joined.frame, kind="stable")] for values in joined))
    is_close = _close(in_time)
    is_wanted = in_time.leans | (is_close & in_time.is_doubtful)
    bodies = ExpectedBodies(camera, in_time.frame, in_time.points_px, in_time.px_per_m, is_wanted)
    wanted = np.unique(bodies.frame[is_wanted])
    if len(wanted) < _LEAST_PICTURES:
        return bodies.within(range(0))
    return bodies.select(np.flatnonzero((is_wanted | is_close) & np.isin(bodies.frame, wanted)))


def _close(bodies: _Expected) -> Bool[np.ndarray, " n"]:
    """Bodies near another body in the same frame."""
    is_known = np.isfinite(bodies.points_px).all(-1, keepdims=True)
    middle_px = np.where(is_known, bodies.points_px, 0.0).sum(1) / np.maximum(is_known.sum(1), 1)
    is_close = np.zeros(len(bodies.frame), bool)
    most = int(np.unique(bodies.frame, return_counts=True)[1].max(initial=0))
    for step in range(1, most):  # the bodies of a frame follow each other
        limit_px = _CLOSE_M * np.maximum(bodies.px_per_m[step:], bodies.px_per_m[:-step])
        near = np.linalg.norm(middle_px[step:] - middle_px[:-step], axis=-1) < limit_px
        near &= bodies.frame[step:] == bodies.frame[:-step]
        is_close[step:] |= near
        is_close[:-step] |= near
    return is_close
