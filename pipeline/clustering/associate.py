"""From what cameras saw to tracks: bone lengths first, then every instant by itself, then links in time.

The three steps are those of a service's workers: ``first_lengths`` and ``link_people`` see the whole session,
``find_people`` any range of frames, whose cut changes nothing.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.clustering.bone_lengths import LimbLengths, measure_lengths, unknown_lengths, unlimited_lengths
from pipeline.clustering.instant.candidates import BodyEvidence, Instant, ViewEvidence
from pipeline.clustering.instant.clusters import find_joints
from pipeline.clustering.instant.effort import Effort
from pipeline.clustering.instant.parsing import Poses, parse
from pipeline.clustering.linking import link
from pipeline.clustering.parameters import ClusteringParameters
from pipeline.clustering.skeleton import TORSO, Skeleton, skeleton_of
from pipeline.data import Camera, Detections, FrameTimes, Observations, Poses3D, Timebase, Track3D
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.track_assembly import Person, number_people, record_life
from pipeline.joints import JointSet
from pipeline.progress import OnShare, ignore, split


def find_poses(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    instant: Instant,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    effort: Effort,
) -> Poses:
    """Find everybody at one instant (sections 3.2 to 3.4)."""
    found = find_joints(image_from_world, *instant, skeleton, lengths, parameters, effort)
    return parse(found, instant.evidence, skeleton, lengths, parameters)


def sampled_frames(timebase: Timebase, parameters: ClusteringParameters) -> range:
    """Output frames from which bone lengths are taken: all over the session, so that who comes later has theirs."""
    return range(0, timebase.num_frames, max(1, round(timebase.frame_rate_hz / parameters.length_rate_hz)))


def find_people(
    cameras: Sequence[Camera],
    seen: ViewEvidence,
    frames: Iterable[int],
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    on_frame: Callable[[], None] = lambda: None,
) -> Poses3D:
    """Find everybody in some output frames.

    Parameters
    ----------
    seen
        What shows these frames.
    lengths
        Of everybody's bones; ``unknown_lengths`` for the first pass.
    on_frame
        Called after each frame.
    """
    projections = np.array([image_from_world(camera) for camera in cameras])
    if not parameters.use_lengths:
        lengths = unlimited_lengths(skeleton)
    shape = len(skeleton.names), len(cameras)
    number, xyz_m = [np.empty(0, int)], [np.empty((0, shape[0], 3))]
    points_px, score = [np.empty((0, *shape, 2))], [np.empty((0, *shape))]
    approximate: list[int] = []
    for frame in frames:
        instant, effort = seen.at(frame), Effort()
        if len(instant.candidates.joint):
            poses = find_poses(projections, instant, skeleton, lengths, parameters, effort)
            if not effort.is_exact:
                approximate.append(frame)
            number.append(np.full(len(poses.xyz_m), frame))
            xyz_m.append(poses.xyz_m)
            # The entry behind the last candidate stands for no candidate.
            points_px.append(np.append(instant.candidates.seen_px, [[np.nan, np.nan]], axis=0)[poses.candidate])
            score.append(np.append(instant.candidates.score, 0.0)[poses.candidate])
        on_frame()
    return Poses3D(
        np.concatenate(number),
        np.concatenate(xyz_m),
        np.concatenate(points_px),
        np.concatenate(score),
        np.array(approximate, int),
    )


def first_lengths(
    cameras: Sequence[Camera],
    seen: Iterable[tuple[ViewEvidence, Iterable[int]]],
    timebase: Timebase,
    skeleton: Skeleton,
    parameters: ClusteringParameters,
    on_frame: Callable[[], None] = lambda: None,
) -> LimbLengths:
    """Everybody's bone lengths, from a first pass without any (section 3.6).

    Parameters
    ----------
    seen
        Ranges in order of time: what shows them, and the output frames of ``sampled_frames`` in them.
    on_frame
        Called after each frame.
    """
    unknown = unknown_lengths(skeleton)
    first = [find_people(cameras, one, frames, skeleton, unknown, parameters, on_frame) for one, frames in seen]
    poses = join_poses(first)
    return measure_lengths([poses.xyz_m[life] for life in _lives(poses, timebase, skeleton, parameters)], skeleton)


def link_people(
    cameras: Sequence[Camera],
    poses: Poses3D,
    timebase: Timebase,
    joints: JointSet,
    parameters: ClusteringParameters,
    on_share: OnShare = ignore,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Link everybody's poses in time (section 3.5).

    Parameters
    ----------
    poses
        Of all ranges; see ``join_poses``.
    joints
        What the joint axis of the tracks shall hold: the detector's.
    on_share
        Called after every instant, and after every track.

    Returns
    -------
        Tracks on the output frames, in order of first appearance, and the observations behind them.
    """
    skeleton = skeleton_of(joints)
    on_lives, on_people = split(on_share, (1, 1))
    lives = _lives(poses, timebase, skeleton, parameters, on_lives)
    parts = split(on_people, [len(life) for life in lives])
    people = []
    for life, on_person in zip(lives, parts, strict=True):
        people.append(_person(cameras, timebase, skeleton, joints, poses, life))
        on_person(1.0)
    on_share(1.0)
    return number_people([person for person in people if person is not None])


def reconstruct_by_clustering(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    joints: JointSet,
    parameters: ClusteringParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Reconstruct everybody from whole bodies that a detector found: all three steps.

    Parameters
    ----------
    joints
        What the joint axis of the detections holds.

    Returns
    -------
        See ``link_people``.

    Raises
    ------
    ValueError
        If the detector lacks a joint of the paper's skeleton, beside the neck.
    """
    seen = BodyEvidence(cameras, times, detections, timebase, skeleton_of(joints), parameters)
    return reconstruct_evidence(cameras, lambda _: seen, [range(timebase.num_frames)], timebase, joints, parameters)


def reconstruct_evidence(
    cameras: Sequence[Camera],
    evidence_in: Callable[[range], ViewEvidence],
    ranges: Sequence[range],
    timebase: Timebase,
    joints: JointSet,
    parameters: ClusteringParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Reconstruct everybody, range by range of output frames: all three steps.

    Parameters
    ----------
    evidence_in
        What shows a range; asked twice for each.
    ranges
        All output frames, in order.
    joints
        What the joint axis of the detector holds.

    Returns
    -------
        See ``link_people``.
    """
    skeleton = skeleton_of(joints)
    sampled = sampled_frames(timebase, parameters)
    seen = ((evidence_in(frames), [frame for frame in frames if frame in sampled]) for frames in ranges)
    lengths = first_lengths(cameras, seen, timebase, skeleton, parameters)
    poses = [find_people(cameras, evidence_in(frames), frames, skeleton, lengths, parameters) for frames in ranges]
    return link_people(cameras, join_poses(poses), timebase, joints, parameters)


def join_poses(chunks: Iterable[Poses3D]) -> Poses3D:
    """Poses of consecutive ranges, one at least, as one record."""
    joined = list(chunks)
    return Poses3D(
        np.concatenate([one.frame for one in joined]),
        np.concatenate([one.xyz_m for one in joined]),
        np.concatenate([one.points_px for one in joined]),
        np.concatenate([one.score for one in joined]),
        np.concatenate([one.approximate for one in joined]),
    )


def _lives(
    poses: Poses3D,
    timebase: Timebase,
    skeleton: Skeleton,
    parameters: ClusteringParameters,
    on_share: OnShare = ignore,
) -> list[np.ndarray]:
    """Each person's poses, as rows in order of time."""
    frames = np.unique(poses.frame)
    rows = np.split(np.arange(len(poses.frame)), np.searchsorted(poses.frame, frames[1:]))
    torso_m = poses.xyz_m[:, skeleton.indices(TORSO)]
    instants_s = timebase.start_time_s + frames / timebase.frame_rate_hz
    linked = link([torso_m[mine] for mine in rows[: len(frames)]], instants_s, parameters, on_share)
    return [np.array([rows[instant][number] for instant, number in track.members]) for track in linked]


def _person(
    cameras: Sequence[Camera],
    timebase: Timebase,
    skeleton: Skeleton,
    joints: JointSet,
    poses: Poses3D,
    life: np.ndarray,
) -> Person | None:
    """One track's record, in the detector's joints."""
    start = int(poses.frame[life[0]])
    rows = poses.frame[life] - start
    shape = (int(rows[-1]) + 1, len(cameras), len(joints.names))
    xyz_m = np.full((shape[0], shape[2], 3), np.nan)
    seen_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    for j, source in enumerate(skeleton.sources):
        if source >= 0:
            xyz_m[rows, source] = poses.xyz_m[life, j]
            seen_px[rows, :, source] = poses.points_px[life, j]
            score[rows, :, source] = poses.score[life, j]
    return record_life(cameras, timebase, start, xyz_m, seen_px, score, 0.0)
