"""Hypothesis clustering of a session: bone lengths, then people at every instant, then tracks.

The three steps are stages of the service: ``first_lengths`` and ``link_people`` take the whole session; ``find_people``
takes any range of frames, and its results do not depend on the cut into ranges.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant.candidates import BodyEvidence, Instant, ViewEvidence
from pipeline.association.clustering.instant.clusters import Joints, find_joints
from pipeline.association.clustering.instant.constraints import length_error, nearly_fits
from pipeline.association.clustering.instant.evidence import NOWHERE, LimbEvidence
from pipeline.association.clustering.instant.people import match_people
from pipeline.association.clustering.instant.work_limits import MAX_DENSE, WorkLimits
from pipeline.association.clustering.linking import link, mean_distance_m
from pipeline.association.clustering.skeleton import (
    LimbLengths,
    Skeleton,
    clustering_skeleton,
    measure_lengths,
    unknown_lengths,
    unlimited_lengths,
)
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Observations, Poses3D, Track3D
from pipeline.core.joints import JointSet
from pipeline.core.progress import OnShare, ignore, split
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.track_assembly import Person, number_people, record_life

# Value of an additional view relative to connectivity: of similar limbs, the one seen in more views is taken.
_VIEW_WORTH = 0.01


class Poses(NamedTuple):
    """Poses of all people at one instant, joints in the skeleton's order."""

    xyz_m: np.ndarray  # World positions, (people, joints, 3); NaN where a joint was not found
    # Row of the candidate behind a joint in each view, (people, joints, cameras); ``NOWHERE`` for no candidate
    candidate: np.ndarray


def parse(
    joints: Joints,
    evidence: LimbEvidence,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    known: Int[np.ndarray, "people joints"] | None = None,
) -> Poses:
    """Assemble poses from the root joints on; a joint belongs to at most one pose.

    Poses with fewer than ``min_joints`` of the paper's joints are left out, unless they are known. Of poses closer than
    ``duplicate_m``, the pose with the most observations is kept. ``known`` are joints of people who were found before,
    ``NOWHERE`` where a joint is missing; only missing joints are added.
    """
    if known is None:
        known = np.empty((0, len(skeleton.names)), int)
    is_free = np.ones(len(joints.points.joint), bool)
    is_free[known[known >= 0]] = False
    is_small = len(joints.points.joint) ** 2 <= MAX_DENSE
    value = _limb_values(joints, joints, evidence, skeleton, lengths, parameters) if is_small else None
    by_joint = [np.flatnonzero(is_free & (joints.points.joint == j)) for j in range(len(skeleton.names))]
    shape = len(known) + len(by_joint[0]), len(by_joint)
    joint_of = np.full(shape, NOWHERE)
    joint_of[: len(known)] = known
    joint_of[len(known) :, 0] = by_joint[0]
    for j in range(1, len(by_joint)):
        holders = np.flatnonzero((joint_of[:, skeleton.parents[j]] >= 0) & (joint_of[:, j] < 0))
        held = joint_of[holders, skeleton.parents[j]]
        of_limb = (
            _limb_values(joints.where(held), joints.where(by_joint[j]), evidence, skeleton, lengths, parameters)
            if value is None
            else value[np.ix_(held, by_joint[j])]
        )
        for holder, joint in _join(of_limb):
            joint_of[holders[holder], j] = by_joint[j][joint]
    has = joint_of >= 0
    xyz_m = np.full((*shape, 3), np.nan)
    candidate = np.full((*shape, joints.candidate.shape[1]), NOWHERE)
    xyz_m[has], candidate[has] = joints.points.xyz_m[joint_of[has]], joints.candidate[joint_of[has]]
    is_known = np.arange(len(has)) < len(known)
    enough = np.flatnonzero(is_known | (has[:, skeleton.core].sum(-1) >= parameters.min_joints))
    distinct = _distinct(xyz_m[enough], (candidate[enough] >= 0).sum((1, 2)), parameters.duplicate_m)
    return Poses(xyz_m[enough[distinct]], candidate[enough[distinct]])


def _limb_values(
    parents: Joints,
    joints: Joints,
    evidence: LimbEvidence,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Float[np.ndarray, "parents joints"]:
    """Value of a limb between each parent and each joint: connectivity and views; minus infinity if not allowed."""
    error = length_error(parents.points, joints.points, skeleton, lengths)
    possible = error <= parameters.leniency * parameters.tau3
    score = evidence.connect(parents.points, joints.points, possible)
    least = evidence.least[joints.points.joint] * parameters.use_connectivity
    measured = lengths.is_measured[joints.points.joint]
    allowed = possible & nearly_fits(score, least, error, parameters.tau3, measured, parameters.leniency)
    value = np.nan_to_num(score, nan=0.0) + _VIEW_WORTH * (joints.candidate >= 0).sum(-1)
    return np.where(allowed, value, -np.inf)


def _join(value: Float[np.ndarray, "holders joints"]) -> list[tuple[int, int]]:
    """Join limbs greedily: pairs of a pose and a joint in order of their value, each pose and joint once."""
    pairs: list[tuple[int, int]] = []
    holders: set[int] = set()
    joints: set[int] = set()
    for flat in np.argsort(-value, axis=None, kind="stable")[: int((value > -np.inf).sum())].tolist():
        holder, joint = divmod(flat, value.shape[1])
        if holder not in holders and joint not in joints:
            holders.add(holder)
            joints.add(joint)
            pairs.append((holder, joint))
    return pairs


def _distinct(
    xyz_m: Float[np.ndarray, "people joints 3"], support: Int[np.ndarray, " people"], duplicate_m: float
) -> list[int]:
    """Positions of the poses that are not duplicates of a pose with more observations, ascending."""
    kept: list[int] = []
    for pose in np.argsort(-support, kind="stable").tolist():
        if not np.any(mean_distance_m(xyz_m[kept], xyz_m[pose]) < duplicate_m):
            kept.append(pose)
    return sorted(kept)


def find_poses(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    instant: Instant,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    limits: WorkLimits,
) -> Poses:
    """Find the poses of all people at one instant (sections 3.2 to 3.4).

    People whose bodies agree in several views come first. The paper's steps find the rest: joints that these people
    lack, and other people.

    - ``image_from_world``: projection matrices of ideal lenses.
    - ``instant``: candidates of joints in undistorted pixels, and the evidence of limbs.
    - ``lengths``: lengths of bones in metres; ``unknown_lengths`` before they are measured.
    - ``limits``: limits of the work at the instant; they note whether the result is exact.
    - Returns poses with joints in metres, NaN where a joint was not found, and the candidates behind them.
    """
    whole = match_people(image_from_world, instant.candidates, skeleton, lengths, parameters, limits)
    joints = find_joints(image_from_world, *instant, skeleton, lengths, parameters, limits, whole.joints)
    return parse(joints, instant.evidence, skeleton, lengths, parameters, whole.joint_of)


def sampled_frames(timebase: Timebase, parameters: ClusteringParameters) -> range:
    """Output frames from which bone lengths are measured: spread over the session, to include people who come late."""
    return range(0, timebase.num_frames, max(1, round(timebase.frame_rate_hz / parameters.length_rate_hz)))


def find_people(
    cameras: Sequence[Camera],
    evidence: ViewEvidence,
    frames: Iterable[int],
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    on_frame: Callable[[], None] = lambda: None,
) -> Poses3D:
    """Find the poses of all people in some output frames; the result does not depend on the other frames.

    ``evidence``: evidence of the cameras at least for these frames. ``frames``: numbers of output frames, ascending.
    ``lengths``: lengths of bones in metres; ``unknown_lengths`` for the first pass. Returns poses with joints (poses,
    joints, 3) in metres, NaN where a joint was not found.
    """
    projections = np.array([image_from_world(camera) for camera in cameras])
    if not parameters.use_lengths:
        lengths = unlimited_lengths(skeleton)
    shape = len(skeleton.names), len(cameras)
    number, xyz_m = [np.empty(0, int)], [np.empty((0, shape[0], 3))]
    points_px, score = [np.empty((0, *shape, 2))], [np.empty((0, *shape))]
    approximate: list[int] = []
    for frame in frames:
        instant, limits = evidence.at(frame), WorkLimits()
        if len(instant.candidates.joint):
            poses = find_poses(projections, instant, skeleton, lengths, parameters, limits)
            if not limits.is_exact:
                approximate.append(frame)
            number.append(np.full(len(poses.xyz_m), frame))
            xyz_m.append(poses.xyz_m)
            # NOWHERE is -1: it selects the entry appended for joints without a candidate.
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
    chunks: Iterable[tuple[ViewEvidence, Iterable[int]]],
    timebase: Timebase,
    skeleton: Skeleton,
    parameters: ClusteringParameters,
    on_frame: Callable[[], None] = lambda: None,
) -> LimbLengths:
    """Measure the people's bone lengths in a first pass without known lengths (section 3.6).

    ``chunks`` have the evidence of each range of output frames, and the frames of ``sampled_frames`` in the range, in
    order of time.
    """
    unknown = unknown_lengths(skeleton)
    poses = join_poses(
        find_people(cameras, evidence, frames, skeleton, unknown, parameters, on_frame) for evidence, frames in chunks
    )
    linked = _linked_rows(poses, timebase, skeleton, parameters)
    return measure_lengths([poses.xyz_m[rows] for rows in linked], skeleton)


def link_people(
    cameras: Sequence[Camera],
    poses: Poses3D,
    timebase: Timebase,
    joints: JointSet,
    parameters: ClusteringParameters,
    on_share: OnShare = ignore,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Link poses in time to tracks (section 3.5).

    ``poses``: poses of all ranges; see ``join_poses``. ``on_share``: called with the completed share after every
    instant and after every track. Returns tracks on the output frames, in order of first appearance, and the
    observations behind them.
    """
    skeleton = clustering_skeleton(joints)
    on_links, on_people = split(on_share, (1, 1))
    linked = _linked_rows(poses, timebase, skeleton, parameters, on_links)
    parts = split(on_people, [len(rows) for rows in linked])
    people = []
    for rows, on_person in zip(linked, parts, strict=True):
        people.append(_person(cameras, timebase, skeleton, joints, poses, rows))
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
    """Reconstruct tracks from the bodies that a detector found: all three steps.

    Parameters
    ----------
    times, detections
        Times of the frames in seconds, and bodies in distorted pixels, by name of the camera.
    timebase
        Output frames.
    joints
        Joints of the detections.

    Returns
    -------
        Tracks with joints (frames, joints, 3) in metres, and observations with pixels (frames, cameras, joints, 2), in
        the same order; NaN where unknown.

    Raises
    ------
    ValueError
        If the detector lacks a joint of the paper's skeleton other than the neck.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pipeline.association.clustering.clustering_parameters import derive_parameters
    >>> from pipeline.validation.simulation.scenes import SCENES, record
    >>> take = record(replace(SCENES["room"], duration_s=0.4), seed=0)
    >>> tracks, observations = reconstruct_by_clustering(
    ...     take.cameras, take.times, take.detections, take.timebase, take.joints, derive_parameters(take.cameras)
    ... )
    >>> len(tracks)
    3
    """
    evidence = BodyEvidence(cameras, times, detections, timebase, clustering_skeleton(joints), parameters)
    return reconstruct_evidence(cameras, lambda _: evidence, [range(timebase.num_frames)], timebase, joints, parameters)


def reconstruct_evidence(
    cameras: Sequence[Camera],
    evidence_in: Callable[[range], ViewEvidence],
    ranges: Sequence[range],
    timebase: Timebase,
    joints: JointSet,
    parameters: ClusteringParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Reconstruct tracks, range by range of output frames: all three steps.

    The ranges cover all output frames in order; ``evidence_in`` gives the evidence of one, and is called twice for
    each.
    """
    skeleton = clustering_skeleton(joints)
    sampled = sampled_frames(timebase, parameters)
    chunks = ((evidence_in(frames), [frame for frame in frames if frame in sampled]) for frames in ranges)
    lengths = first_lengths(cameras, chunks, timebase, skeleton, parameters)
    poses = [find_people(cameras, evidence_in(frames), frames, skeleton, lengths, parameters) for frames in ranges]
    return link_people(cameras, join_poses(poses), timebase, joints, parameters)


def join_poses(chunks: Iterable[Poses3D]) -> Poses3D:
    """Concatenate the poses of consecutive ranges; at least one range."""
    joined = list(chunks)
    return Poses3D(
        np.concatenate([poses.frame for poses in joined]),
        np.concatenate([poses.xyz_m for poses in joined]),
        np.concatenate([poses.points_px for poses in joined]),
        np.concatenate([poses.score for poses in joined]),
        np.concatenate([poses.approximate for poses in joined]),
    )


def _linked_rows(
    poses: Poses3D, timebase: Timebase, skeleton: Skeleton, parameters: ClusteringParameters, on_share: OnShare = ignore
) -> list[np.ndarray]:
    """Rows of each person's poses, in order of time."""
    frames = np.unique(poses.frame)
    rows = np.split(np.arange(len(poses.frame)), np.searchsorted(poses.frame, frames[1:]))
    torso_m = poses.xyz_m[:, skeleton.torso]
    instants_s = timebase.start_time_s + frames / timebase.frame_rate_hz
    tracks = link([torso_m[of_frame] for of_frame in rows[: len(frames)]], instants_s, parameters, on_share)
    return [np.array([rows[instant][number] for instant, number in track.members]) for track in tracks]


def _person(
    cameras: Sequence[Camera],
    timebase: Timebase,
    skeleton: Skeleton,
    joints: JointSet,
    poses: Poses3D,
    linked: np.ndarray,
) -> Person | None:
    """Make a person's track in the detector's joints from the rows of the linked poses."""
    start = int(poses.frame[linked[0]])
    rows = poses.frame[linked] - start
    shape = (int(rows[-1]) + 1, len(cameras), len(joints.names))
    xyz_m = np.full((shape[0], shape[2], 3), np.nan)
    seen_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    for j, source in enumerate(skeleton.sources):
        if source >= 0:
            xyz_m[rows, source] = poses.xyz_m[linked, j]
            seen_px[rows, :, source] = poses.points_px[linked, j]
            score[rows, :, source] = poses.score[linked, j]
    return record_life(cameras, timebase, start, xyz_m, seen_px, score, 0.0)
