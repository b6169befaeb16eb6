"""Refinement of a session's calibration: a first association, sightings of people, refined cameras, and a report."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.association.clustering.skeleton import clustering_skeleton, unknown_lengths
from pipeline.association.hands.attach import without_fingers
from pipeline.association.identity.likenesses import without_likenesses
from pipeline.association.tracking.observations import gather
from pipeline.calibration.refinement.bumps import Step
from pipeline.calibration.refinement.level import Level, find_level
from pipeline.calibration.refinement.refine_cameras import RefinedCameras, refine
from pipeline.calibration.refinement.sightings import choose_sightings, sampled_frames, sampled_poses
from pipeline.calibration.similarity import move_world
from pipeline.core.data.cameras import Camera, CameraBump, CameraMove, RefinedCalibration, Refinement, WorldMove
from pipeline.core.data.detections import Detections, DetectionsByCamera
from pipeline.core.data.people import Poses3D
from pipeline.core.joints import JointSet
from pipeline.core.progress import OnShare, ignore, split
from pipeline.run.engine.methods import Association

# Differences from the given camera below which a refined camera is not reported as moved.
_MOVED_DEG, _MOVED_M, _MOVED_FOCAL = 0.05, 0.005, 0.001

_Associate = Callable[[Association, OnShare], Iterable[Poses3D]]


def refine_from_bodies(
    association: Association, detections: Mapping[str, Detections], joints: JointSet, on_share: OnShare = ignore
) -> RefinedCalibration:
    """Refine a session's calibration from whole bodies with ``joints``, which tracking associates."""

    def associate(current: Association, on_round: OnShare) -> Iterable[Poses3D]:
        bodies = without_fingers(gather(current.cameras, current.times, detections), joints)
        return sampled_poses(current.track(bodies, on_round), current.timebase)

    return _refine(association, associate, on_share)


def refine_from_fields(
    association: Association,
    chunks: Callable[[], Iterable[tuple[range, DetectionsByCamera]]],
    on_share: OnShare = ignore,
) -> RefinedCalibration:
    """Refine a session's calibration from peaks and fields, which clustering associates instant by instant.

    ``chunks`` gives ranges of output frames in order of time, with their detections.
    """
    frames = sampled_frames(association.timebase)
    lengths = unknown_lengths(clustering_skeleton(association.joints))

    def associate(current: Association, on_round: OnShare) -> Iterable[Poses3D]:
        numbers = itertools.count(1)
        for chunk, detections in chunks():
            wanted = range(chunk.start + -chunk.start % frames.step, chunk.stop, frames.step)
            yield current.locate_people(wanted, detections, lengths, lambda: on_round(next(numbers) / len(frames)))

    return _refine(association, associate, on_share)


def _refine(association: Association, associate: _Associate, on_share: OnShare) -> RefinedCalibration:
    given, joints, timebase = association.cameras, association.joints, association.timebase

    def refine_from(start: tuple[Camera, ...], on_round: OnShare) -> tuple[RefinedCameras, list[Poses3D]]:
        poses = without_likenesses(
            list(associate(replace(association, cameras=start), on_round)),
            start,
            joints,
            timebase,
            sampled_frames(timebase).step,
        )
        return refine(given, start, choose_sightings(poses, joints, timebase)), poses

    on_first, on_second = split(on_share, (1, 1))
    refined, poses = refine_from(given, on_first)
    if refined.is_refined:
        # Association with refined cameras matches people that the given ones missed.
        again, poses = refine_from(refined.cameras, on_second)
        refined = again if again.is_refined else refined
    level = find_level(refined.cameras, poses, joints)
    on_share(1.0)
    cameras = refined.cameras if level is None else move_world(refined.cameras, level.level_from_given)
    return RefinedCalibration(cameras, _report(given, refined, level))


def _report(given: Sequence[Camera], refined: RefinedCameras, level: Level | None) -> Refinement:
    return Refinement(
        refined=refined.is_refined,
        error_before_px=refined.error_before_px,
        error_after_px=refined.error_after_px,
        num_points=refined.num_points,
        moved=tuple(move for move in refined.moves if _is_moved(move)) if refined.is_refined else (),
        bumped=tuple(_bump(given, step) for step in sorted(refined.steps, key=lambda step: step.time_s)),
        world=None if level is None else WorldMove(level.tilt_deg, level.height_m),
        refusal=refined.refusal,
        most_moved=next(iter(refined.moves), None),
    )


def _is_moved(move: CameraMove) -> bool:
    return (
        move.rotation_deg >= _MOVED_DEG or move.translation_m >= _MOVED_M or abs(move.focal_ratio - 1.0) >= _MOVED_FOCAL
    )


def _bump(given: Sequence[Camera], step: Step) -> CameraBump:
    return CameraBump(given[step.camera].name, step.time_s, float(np.degrees(step.turn_rad)))
