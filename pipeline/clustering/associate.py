"""From detections to tracks by clustering: bone lengths first, then every instant, then links in time."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.clustering.bone_lengths import LimbLengths, measure_lengths, unknown_lengths
from pipeline.clustering.candidates import Seen
from pipeline.clustering.clusters import find_joints
from pipeline.clustering.hypotheses import Candidates
from pipeline.clustering.linking import link
from pipeline.clustering.parameters import ClusteringParameters
from pipeline.clustering.parsing import Poses, parse
from pipeline.clustering.skeleton import TORSO, Skeleton, skeleton_of
from pipeline.data import Camera, Detections, FrameTimes, Observations, Timebase, Track3D
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.life import Person, number_people, record_life
from pipeline.joints import JointSet


def find_poses(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    candidates: Candidates,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Poses:
    """Find everybody at one instant (sections 3.2 to 3.4)."""
    found = find_joints(image_from_world, candidates, skeleton, lengths, parameters)
    return parse(found, skeleton, lengths, parameters)


def reconstruct_by_clustering(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    joints: JointSet,
    parameters: ClusteringParameters,
    on_frame: Callable[[], None] = lambda: None,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Reconstruct everybody from whole bodies that a detector found.

    Detections take the place of part affinity fields: two joints are connected where they belong to one detection.

    Parameters
    ----------
    joints
        What the joint axis of the detections holds.
    on_frame
        Called after each output frame.

    Returns
    -------
        Tracks on the output frames, in order of first appearance, and the observations behind them.

    Raises
    ------
    ValueError
        If the detector lacks a joint of the paper's skeleton, beside the neck.
    """
    skeleton = skeleton_of(joints)
    projections = np.array([image_from_world(camera) for camera in cameras])
    seen = Seen(cameras, times, detections, skeleton, parameters.min_score)
    instants_s = timebase.start_time_s + np.arange(timebase.num_frames) / timebase.frame_rate_hz
    half_s = 0.5 / timebase.frame_rate_hz

    def poses_at(frame: int, lengths: LimbLengths) -> Poses:
        candidates = seen.at(float(instants_s[frame]), half_s)
        return find_poses(projections, candidates, skeleton, lengths, parameters)

    def tracks_of(poses: Sequence[Poses], frames: Sequence[int]) -> list[list[tuple[int, int]]]:
        torso = skeleton.indices(TORSO)
        linked = link([one.xyz_m[:, torso] for one in poses], instants_s[list(frames)], parameters)
        return [track.members for track in linked]

    sampled = range(0, timebase.num_frames, max(1, round(timebase.frame_rate_hz / parameters.length_rate_hz)))
    first = [poses_at(frame, unknown_lengths(skeleton)) for frame in sampled]
    lives = tracks_of(first, sampled)
    lengths = measure_lengths([np.array([first[at].xyz_m[k] for at, k in life]) for life in lives], skeleton)

    frames = range(timebase.num_frames)
    poses = []
    for frame in frames:
        poses.append(poses_at(frame, lengths))
        on_frame()
    people = (_person(cameras, timebase, seen, skeleton, joints, poses, life) for life in tracks_of(poses, frames))
    return number_people([person for person in people if person is not None])


def _person(
    cameras: Sequence[Camera],
    timebase: Timebase,
    seen: Seen,
    skeleton: Skeleton,
    joints: JointSet,
    poses: Sequence[Poses],
    life: Sequence[tuple[int, int]],
) -> Person | None:
    """One track's record, in the detector's joints."""
    start, stop = life[0][0], life[-1][0] + 1
    shape = (stop - start, len(cameras), len(joints.names))
    xyz_m = np.full((shape[0], shape[2], 3), np.nan)
    seen_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    known = [j for j, source in enumerate(skeleton.sources) if source >= 0]
    sources = [skeleton.sources[j] for j in known]
    for frame, number in life:
        xyz_m[frame - start, sources] = poses[frame].xyz_m[number, known]
        for j, source in zip(known, sources, strict=True):
            for view in np.flatnonzero(poses[frame].body[number, j] >= 0):
                row = poses[frame].body[number, j, view]
                seen_px[frame - start, view, source] = seen.seen_px[view][row, j]
                score[frame - start, view, source] = seen.score[view][row, j]
    return record_life(cameras, timebase, start, xyz_m, seen_px, score, 0.0)
