"""Tracks by other methods, to be compared: incremental triangulation, pairwise association, and a live capture."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from enum import Enum

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.tracking.initialization import Unmatched, group_unmatched
from pipeline.association.tracking.observations import UNASSIGNED, gather, undistorted
from pipeline.association.tracking.tracker import make_rig
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.undistortion import undistort_px
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import recorded_frames
from pipeline.run.live.settings import LiveSettings


class Triangulation(Enum):
    """Weights of the cameras' last observations in the triangulation of a joint."""

    CONVENTIONAL = "conventional"  # equal weights, as if all observations had the same time
    TIME_PENALTY = "incremental_without_norm"  # exp(-lambda_t (t - t_i))
    INCREMENTAL = "incremental"  # exp(-lambda_t (t - t_i)) over the norm of the row (eq. 11)


def triangulate_last(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    points_px: Float[np.ndarray, "cameras joints 2"],
    penalty: Float[np.ndarray, " cameras"],
    kind: Triangulation,
) -> Float[np.ndarray, "joints 3"]:
    """Triangulate joints from the cameras' last observations: solve ``(w o A) X~ = 0`` by singular values (eq. 10).

    ``points_px``: last observation of each camera in undistorted pixels, NaN where it has none. ``penalty``:
    ``exp(-lambda_t (t - t_i))`` of each camera. Returns world positions in metres, NaN for joints that fewer than two
    cameras have seen.
    """
    rows = points_px[..., None] * image_from_world[:, None, 2:, :] - image_from_world[:, None, :2, :]
    seen = np.isfinite(rows).all((-1, -2))
    weights = np.ones_like(rows[..., 0])
    if kind is not Triangulation.CONVENTIONAL:
        weights = weights * penalty[:, None, None]
    if kind is Triangulation.INCREMENTAL:
        weights = weights / np.linalg.norm(rows, axis=-1)
    system = np.where(seen[..., None, None], rows * weights[..., None], 0.0)
    stacked = system.swapaxes(0, 1).reshape(points_px.shape[1], -1, 4)
    homogeneous = np.linalg.svd(stacked)[2][:, -1]
    # The last coordinate is zero for parallel rays and without any ray.
    scale = np.where((seen.sum(0) >= 2) & (homogeneous[:, 3] != 0), homogeneous[:, 3], np.nan)
    return homogeneous[:, :3] / scale[:, None]


def locate_incrementally(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    identities: Mapping[str, Int[np.ndarray, " _"]],
    timebase: Timebase,
    parameters: TrackingParameters,
    kind: Triangulation,
) -> tuple[tuple[Track3D, ...], float]:
    """Locate all people at the output instants from the last observation of each camera before the instant.

    ``identities``: identity of each detection by camera name, negative for none. ``kind``: weights of the observations.

    The result has:

    - ``tracks``: tracks with positions; scores and views are 0, errors are NaN.
    - ``age_s``: mean age of the observations at the output instants, 0 without observations.
    """
    projections = projection_matrices(cameras)
    views = []
    for camera in cameras:
        of_camera = detections[camera.name]
        views.append((times[camera.name].time_s[of_camera.frame], undistort_px(camera, of_camera.keypoints_px)))
    num_joints = views[0][1].shape[1]
    tracks: list[Track3D] = []
    ages_s: list[float] = []
    for person in np.unique(np.concatenate(list(identities.values()))):
        if person < 0:
            continue
        xyz_m = np.full((timebase.num_frames, num_joints, 3), np.nan)
        for frame in range(timebase.num_frames):
            now_s = timebase.start_time_s + frame / timebase.frame_rate_hz
            points_px, penalty = np.full((len(cameras), num_joints, 2), np.nan), np.ones(len(cameras))
            for number, (camera, (time_s, seen_px)) in enumerate(zip(cameras, views, strict=True)):
                rows = np.flatnonzero((identities[camera.name] == person) & (time_s <= now_s + 1e-6))
                if not len(rows) or now_s - time_s[rows[-1]] >= 2 / timebase.frame_rate_hz:
                    continue
                used = detections[camera.name].score[rows[-1]] >= parameters.min_score
                points_px[number] = np.where(used[:, None], seen_px[rows[-1]], np.nan)
                penalty[number] = np.exp(-parameters.lambda_t_hz * (now_s - time_s[rows[-1]]))
                ages_s.append(now_s - time_s[rows[-1]])
            xyz_m[frame] = triangulate_last(projections, points_px, penalty, kind)
        tracks.append(unscored_track(len(tracks) + 1, xyz_m))
    return tuple(tracks), float(np.mean(ages_s)) if ages_s else 0.0


def unscored_track(track_id: int, xyz_m: Float[np.ndarray, "frames joints 3"], start_frame: int = 0) -> Track3D:
    """Track of positions in metres, NaN where a joint is unknown; scores and views are 0, errors are NaN."""
    shape = xyz_m.shape[:2]
    known = np.isfinite(xyz_m[..., 0])
    return Track3D(
        track_id=track_id,
        start_frame=start_frame,
        xyz_m=xyz_m,
        score=np.zeros(shape),
        source=np.where(known, Source.MEASURED, Source.ABSENT).astype(np.int8),
        error_px=np.full(shape, np.nan),
        views=np.zeros(shape, int),
    )


def live_tracks(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    joints: JointSet,
) -> tuple[Track3D, ...]:
    """Play detections to a live capture; return what it says of each person, NaN where it says nothing."""
    capture = LiveCapture(cameras, joints, LiveSettings(timebase.frame_rate_hz))
    instants = [instant for frame in recorded_frames(cameras, times, detections) for instant in capture.push(*frame)]
    instants += capture.flush()
    said: dict[int, dict[int, Float[np.ndarray, "joints 3"]]] = defaultdict(dict)
    for instant in instants:
        frame = round((instant.time_s - timebase.start_time_s) * timebase.frame_rate_hz)
        for person in instant.people:
            said[person.id][frame] = person.xyz_m
    return tuple(_track(number, xyz_m) for number, xyz_m in sorted(said.items()))


def _track(number: int, said: Mapping[int, Float[np.ndarray, "joints 3"]]) -> Track3D:
    first, last = min(said), max(said)
    num_joints = len(said[first])
    xyz_m = np.full((last - first + 1, num_joints, 3), np.nan)
    for frame, joints_m in said.items():
        xyz_m[frame - first] = joints_m
    return unscored_track(number, xyz_m, first)


def associate_pairwise(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    parameters: TrackingParameters,
) -> dict[str, Int[np.ndarray, " _"]]:
    """Group the detections of each frame number across views by epipolar affinity and graph partitioning.

    Frames are independent: a group is a person of a single frame. Returns the identity of each detection by camera
    name, see ``associate.associate``; each group has a new one.
    """
    bodies = gather(cameras, times, detections)
    ideal_px = undistorted(cameras, bodies)
    score = np.where(bodies.score >= parameters.min_score, bodies.score, 0.0)
    fundamental = make_rig(cameras).fundamental
    identity = np.full(len(bodies.frame), UNASSIGNED)
    num_groups = 0
    for frame in np.unique(bodies.frame):
        pool = [
            Unmatched(
                int(bodies.camera[row]),
                row,
                float(bodies.time_s[row]),
                np.where(score[row][:, None] > 0, ideal_px[row], np.nan),
                score[row],
            )
            for row in np.flatnonzero(bodies.frame == frame).tolist()
        ]
        for group in group_unmatched(pool, fundamental, parameters.alpha_epipolar_px).people:
            identity[[body.row for body in group]] = num_groups
            num_groups += 1
    return {camera.name: identity[bodies.camera == number] for number, camera in enumerate(cameras)}
