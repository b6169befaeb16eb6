"""Places at which tracks expect leaning bodies in the pictures of each camera, and no detection is in agreement.

Detectors learnt from upright people: of bodies that are upside down they miss a quarter to a third, and call left right
in a fifth (docs/lab/detection.md). A body leans if its trunk is far from upright in the world and in the picture.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.limbs import steady_places
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import COCO_17, JointSet
from pipeline.detection.bodies import concatenate
from pipeline.geometry.camera import project
from pipeline.video.timeline import frames_in

LEAN_IN_WORLD_DEG, LEAN_IN_PICTURE_DEG = 30.0, 40.0
"""Angles of a leaning trunk from the vertical of the world, and from the upright direction of the picture."""
# Joints of the body that a picture must show.
_LEAST_INSIDE = 4
# A detection agrees with the expected body if all joints but two are within this share of the body's diagonal.
_AGREED_SHARE, _MOST_ELSEWHERE = 0.08, 2
# Least number of a camera's pictures that are decoded again.
_LEAST_PICTURES = 3

_SHOULDERS, _HIPS = (COCO_17.indices((f"left_{part}", f"right_{part}")) for part in ("shoulder", "hip"))
BODY = slice(COCO_17.index("left_shoulder"), None)
"""Joints of ``COCO_17`` below the head."""


def expected_body_m(track: Track3D, joints: JointSet, frame_rate_hz: float) -> Float[np.ndarray, "frames 17 3"]:
    """Expected places of a person's joints ``COCO_17`` in the world in metres.

    They are medians over time; NaN where a joint is far from any measurement in time.
    """
    columns = joints.indices(COCO_17.names)
    measured = (track.source[:, columns] == Source.MEASURED) & np.isfinite(track.xyz_m[:, columns]).all(-1)
    return steady_places(track.xyz_m[:, columns], measured, frame_rate_hz)


def expect_leaning(
    people: Iterable[tuple[Track3D, Observations]],
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    timebase: Timebase,
    joints: JointSet,
    turns_deg: Mapping[str, float],
) -> tuple[Detections, ...]:
    """Expect the leaning bodies of all tracks in the frames of each camera that show them.

    A body whose detection agrees with its track is not expected: to look again would tell nothing new. See also
    ``enough``.

    ``people``: tracks with at least the joints ``COCO_17``, and their observations by the cameras, read one at a time.
    ``times``: times of each camera's frames, by name. ``turns_deg``: counterclockwise turns that bring the pictures
    upright, by name of the camera. Returns expected joints ``COCO_17`` of each camera, with the score 1 where they are
    known; as many as cameras, in their order.
    """
    found: list[Detections] = []
    for track, observations in people:
        expected_m = expected_body_m(track, joints, timebase.frame_rate_hz)
        trunk_m = _trunk(expected_m)
        upright = trunk_m[:, 2] > np.cos(np.radians(LEAN_IN_WORLD_DEG)) * np.linalg.norm(trunk_m, axis=-1)
        leans = np.asarray(np.isfinite(trunk_m).all(-1) & ~upright)
        if not leans.any():
            continue
        seen_px = observations.points_px[:, :, joints.indices(COCO_17.names)]
        found += [
            _in_pictures(
                track,
                expected_m,
                leans,
                seen_px[:, place],
                camera,
                times[camera.name],
                timebase,
                turns_deg[camera.name],
            )
            for place, camera in enumerate(cameras)
        ]
    joined = concatenate(found, [camera.name for camera in cameras], len(COCO_17.names))
    ordered = (bodies.select(np.argsort(bodies.frame, kind="stable")) for bodies in joined.values())
    return tuple(map(enough, ordered))


def _trunk(body: Float[np.ndarray, "*batch 17 axes"]) -> Float[np.ndarray, "*batch axes"]:
    """Vector from the middle of the hips to the middle of the shoulders."""
    return np.asarray(body[..., _SHOULDERS, :].mean(-2) - body[..., _HIPS, :].mean(-2))


def _in_pictures(
    track: Track3D,
    expected_m: Float[np.ndarray, "frames 17 3"],
    leans: Bool[np.ndarray, " frames"],
    seen_px: Float[np.ndarray, "frames 17 2"],
    camera: Camera,
    times: FrameTimes,
    timebase: Timebase,
    turn_deg: float,
) -> Detections:
    """Joints of a leaning person in the frames of a camera, between the output instants around each frame."""
    first, last = track.start_frame - 0.5, track.start_frame + track.num_frames - 0.5
    within = frames_in(times, timebase.time_s(first), timebase.time_s(last))
    frames = np.arange(within.start, within.stop)
    row = (times.time_s[frames] - timebase.start_time_s) * timebase.frame_rate_hz - track.start_frame
    row = np.clip(row, 0, track.num_frames - 1)
    is_leaning = leans[np.rint(row).astype(np.int64)]
    frames, row = frames[is_leaning], row[is_leaning]
    before = np.floor(row).astype(np.int64)
    after = np.minimum(before + 1, track.num_frames - 1)
    share = (row - before)[:, None, None]
    body_m = expected_m[before] if not share.any() else (1 - share) * expected_m[before] + share * expected_m[after]
    points_px = project(camera, body_m)
    shown = _leans_in_picture(points_px, camera, turn_deg) & ~_agrees(seen_px[np.rint(row).astype(np.int64)], points_px)
    points_px = points_px[shown]
    known = np.isfinite(points_px).all(-1)
    return Detections(camera.name, frames[shown], points_px, known.astype(float), np.full((len(points_px), 4), np.nan))


def _leans_in_picture(
    points_px: Float[np.ndarray, "n 17 2"], camera: Camera, turn_deg: float
) -> Bool[np.ndarray, " n"]:
    """Bodies that lean in the upright picture, and of which it shows enough."""
    trunk_px = _trunk(points_px)
    direction_rad = np.arctan2(trunk_px[:, 0], -trunk_px[:, 1]) - np.radians(turn_deg)
    leans = np.cos(direction_rad) < np.cos(np.radians(LEAN_IN_PICTURE_DEG))
    body_px = points_px[:, BODY]
    inside = ((body_px >= -0.5) & (body_px < np.array(camera.size_px) - 0.5)).all(-1)
    return np.asarray(leans & (inside.sum(-1) >= _LEAST_INSIDE))


def _agrees(seen_px: Float[np.ndarray, "n 17 2"], expected_px: Float[np.ndarray, "n 17 2"]) -> Bool[np.ndarray, " n"]:
    """Bodies whose detections are where they are expected; a joint that was not detected is not."""
    size_px = np.fmax.reduce(expected_px, axis=1) - np.fmin.reduce(expected_px, axis=1)
    limit_px = _AGREED_SHARE * np.linalg.norm(size_px, axis=-1, keepdims=True)
    is_there = np.linalg.norm(seen_px - expected_px, axis=-1)[:, BODY] < limit_px
    return np.asarray((~is_there).sum(-1) <= _MOST_ELSEWHERE)


def enough(bodies: Detections) -> Detections:
    """Expected bodies of a camera; none if they are too few for its pictures to be decoded again."""
    return bodies if len(np.unique(bodies.frame)) >= _LEAST_PICTURES else bodies.within(range(0))
