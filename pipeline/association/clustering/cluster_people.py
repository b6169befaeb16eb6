"""Hypothesis clustering of a session: bone lengths, then people at every instant, then tracks.

The three steps are stages of the service: ``first_lengths`` and ``link_people`` take the whole session; ``find_people``
takes any range of frames, and its results do not depend on the cut into ranges.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant.candidates import BodyEvidence, Instant, ViewEvidence
from pipeline.association.clustering.instant.clusters import find_joints
from pipeline.association.clustering.instant.parsing import Poses, parse
from pipeline.association.clustering.instant.people import match_people
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.association.clustering.linking import link
from pipeline.association.clustering.skeleton import (
    TORSO,
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
    poses: Poses3D,
    timebase: Timebase,
    skeleton: Skeleton,
    parameters: ClusteringParameters,
    on_share: OnShare = ignore,
) -> list[np.ndarray]:
    """Rows of each person's poses, in order of time."""
    frames = np.unique(poses.frame)
    rows = np.split(np.arange(len(poses.frame)), np.searchsorted(poses.frame, frames[1:]))
    torso_m = poses.xyz_m[:, skeleton.indices(TORSO)]
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
