"""The whole way on one machine: a capture session to people in motion.

The same functions that workers of a service call. The result does not depend on the cut of the frames or on the number
of processes.
"""

import tempfile
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TypeVar

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.config import ReconstructionConfig
from pipeline.data import DamagedVideo, Detections, People, Reconstruction
from pipeline.detect.chunk import concatenate, detect_chunk, detect_fields_chunk
from pipeline.detect.damage import DamagedFrames, damaged_videos
from pipeline.detect.detector import Detector, open_detector
from pipeline.detect.field_files import FieldFiles
from pipeline.errors import ChildError, InputError, Problem
from pipeline.joints import JointSet
from pipeline.progress import OnProgress, OnShare, Progress, Stage, in_units, silent
from pipeline.runtime.child_processes import ProcessPool
from pipeline.skeleton.animate import animate
from pipeline.skeleton.smooth import check_smoothing
from pipeline.stages.association import (
    Found,
    Views,
    clustering_parameters,
    link,
    locate_people,
    measure_bones,
    num_sampled,
    restrict,
    track,
    tracking_parameters,
    uses_fields,
)
from pipeline.stages.records_npz import decode_damaged, encode_fields
from pipeline.video.timeline import chunk_ranges, cut_stretches, frames_in, span_s

_DEFAULTS = ReconstructionConfig()
_BY_MEMBERSHIP = (
    "Clustering takes whole bodies for evidence, not part affinity fields: "
    "two joints are connected where they belong to one detection."
)
_Chunk = tuple[str, range]  # output frames of a camera
_Detected = TypeVar("_Detected")
_Detect = Callable[[CaptureSession, _Chunk, Detector, Callable[[], None]], _Detected]


def reconstruct(
    session: CaptureSession, config: ReconstructionConfig, on_progress: OnProgress = silent
) -> Reconstruction:
    """Reconstruct everybody in a capture session.

    Parameters
    ----------
    session
        Calibrated cameras and their videos, as of ``pipeline.capture.session.open_session``.
    config
        What to do.
    on_progress
        Called after every step, from the calling thread.

    Raises
    ------
    InputError
        If a video can't be decoded or too many of its frames are damaged, or there are no such frames, or no such
        parameter.
    ModelError
        If the detector is not installed.
    PipelineError
        If the folder for temporary files can't be written.
    """
    wanted = restrict(session, config.frames)
    _check(wanted, config)
    detector = open_detector(config.detector)
    ranges = chunk_ranges(_wanted(session, config), config.chunk_frames, session.stretches)
    cameras = [camera.name for camera in session.cameras]
    chunks = [(camera, frames) for frames in ranges for camera in cameras]
    if uses_fields(session, config):
        with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
            files = FieldFiles(Path(folder), cameras)
            damaged_frames: list[DamagedFrames] = []
            with closing(_map(_fields_of, session, chunks, detector, config, on_progress)) as detected_fields:
                for (camera, frames), fields in zip(chunks, detected_fields, strict=True):
                    files.write(camera, frames, fields)
                    damaged_frames.append((camera, decode_damaged(fields)))
            damaged = damaged_videos(wanted, damaged_frames)
            first = ranges[0].start
            of_wanted = [range(one.start - first, one.stop - first) for one in ranges]
            people = _cluster(
                wanted,
                of_wanted,
                lambda frames: files.read(range(frames.start + first, frames.stop + first)),
                detector.joints,
                config,
                on_progress,
            )
        return _finish(wanted, people, detector.joints, config, on_progress, damaged)
    with closing(_map(_bodies_of, session, chunks, detector, config, on_progress)) as detected:
        detections = concatenate(detected, cameras, len(detector.joints.names))
    return _reconstruct_people(wanted, detections, detector.joints, config, on_progress)


def reconstruct_keypoints(
    session: KeypointSession, config: ReconstructionConfig = _DEFAULTS, on_progress: OnProgress = silent
) -> Reconstruction:
    """Reconstruct everybody from 2D joints that another program found.

    Parameters
    ----------
    config
        What to do; there is nothing to detect.
    on_progress
        Called after every step, from the calling thread.

    Raises
    ------
    InputError
        If there is no such parameter.
    """
    wanted = restrict(session, config.frames)
    _check(wanted, config)
    return _reconstruct_people(wanted, wanted.detections, wanted.joints, config, on_progress)


def _check(session: Views, config: ReconstructionConfig) -> None:
    """Find out what is wrong before the work begins."""
    check_smoothing(session.timebase, config)
    tracking_parameters(session, config.tracking)
    clustering_parameters(session, config)
    foreign = config.clustering if config.method == "tracking" else config.tracking
    if foreign:
        problem = f"{', '.join(foreign)}: the method '{config.method}' has no use for the other one's parameters."
        raise InputError([Problem("unknown_parameter", problem, hint="Leave them out, or use the other method.")])


def _reconstruct_people(
    session: Views,
    detections: Mapping[str, Detections],
    joints: JointSet,
    config: ReconstructionConfig,
    on_progress: OnProgress,
) -> Reconstruction:
    damaged = damaged_videos(session, [(camera, one.damaged) for camera, one in detections.items()])
    if config.method == "clustering":
        people = _cluster(
            session,
            cut_stretches(session.stretches, range(session.timebase.num_frames)),
            lambda _: detections,
            joints,
            config,
            on_progress,
        )
    else:
        people = track(session, detections, config, _shares("associate", session, on_progress))
    return _finish(session, people, joints, config, on_progress, damaged)


def _cluster(
    session: Views,
    ranges: Sequence[range],
    found_in: Callable[[range], Found],
    joints: JointSet,
    config: ReconstructionConfig,
    on_progress: OnProgress,
) -> People:
    count = _counter("lengths", num_sampled(session, ranges, config), on_progress)
    lengths = measure_bones(session, ((frames, found_in(frames)) for frames in ranges), joints, config, count)
    count = _counter("poses", sum(map(len, ranges)), on_progress)
    poses = [locate_people(session, frames, found_in(frames), lengths, joints, config, count) for frames in ranges]
    return link(session, poses, joints, config, _shares("associate", session, on_progress))


def _finish(
    session: Views,
    people: People,
    joints: JointSet,
    config: ReconstructionConfig,
    on_progress: OnProgress,
    damaged: tuple[DamagedVideo, ...],
) -> Reconstruction:
    located, observations, num_approximate_frames = people
    on_share = _shares("fit", session, on_progress)
    animation = animate(located, observations, session.cameras, session.timebase, joints, config, on_share)
    by_membership = config.method == "clustering" and not uses_fields(session, config)
    return Reconstruction(
        cameras=session.cameras,
        joints=joints,
        timebase=session.timebase,
        located=located,
        observations=observations,
        animation=animation,
        warnings=(*session.warnings, *([_BY_MEMBERSHIP] if by_membership else [])),
        num_approximate_frames=num_approximate_frames,
        damaged=damaged,
    )


def _shares(stage: Stage, session: Views, on_progress: OnProgress) -> OnShare:
    """Report the shares of a stage over all output frames as so many frames."""
    num_frames = sum(map(len, cut_stretches(session.stretches, range(session.timebase.num_frames))))
    return in_units(num_frames, _counter(stage, num_frames, on_progress))


def _counter(stage: Stage, total: int, on_progress: OnProgress) -> Callable[[], None]:
    """Report that a stage begins; what is returned reports one step more at each call."""
    done = -1

    def count() -> None:
        nonlocal done
        done += 1
        on_progress(Progress(stage, done, total))

    count()
    return count


def _bodies_of(session: CaptureSession, chunk: _Chunk, detector: Detector, on_frame: Callable[[], None]) -> Detections:
    camera, frames = chunk
    return detect_chunk(session, camera, span_s(session.timebase, frames.start, frames.stop), detector, on_frame)


def _fields_of(session: CaptureSession, chunk: _Chunk, detector: Detector, on_frame: Callable[[], None]) -> bytes:
    camera, frames = chunk
    span = span_s(session.timebase, frames.start, frames.stop)
    return encode_fields(detect_fields_chunk(session, camera, span, detector, on_frame))


def _map(
    detect: _Detect[_Detected],
    session: CaptureSession,
    chunks: Sequence[_Chunk],
    detector: Detector,
    config: ReconstructionConfig,
    on_progress: OnProgress,
) -> Generator[_Detected, None, None]:
    """Detections of each chunk, in their order; to be closed, or its processes go on."""
    if config.processes == 1:
        count = _counter("detect", _num_frames(session, config), on_progress)
        return (detect(session, chunk, detector, count) for chunk in chunks)
    return _map_in_processes(detect, session, chunks, config, on_progress)


def _wanted(session: CaptureSession, config: ReconstructionConfig) -> range:
    """Output frames that are reconstructed."""
    return range(session.timebase.num_frames) if config.frames is None else config.frames


def _num_frames(session: CaptureSession, config: ReconstructionConfig) -> int:
    """How many of all cameras' frames are looked at."""
    frames = _wanted(session, config)
    span = span_s(session.timebase, frames.start, frames.stop)
    return sum(len(frames_in(times, *span)) for times in session.times.values())


class _Worker:
    """What a process of the pool keeps from one chunk to the next: the session and the loaded network."""

    session: CaptureSession
    detector: Detector

    @classmethod
    def start(cls, session: CaptureSession, detector_name: str) -> None:
        cls.session = session
        cls.detector = open_detector(detector_name)

    @classmethod
    def run(cls, detect: _Detect[_Detected], chunk: _Chunk) -> _Detected:
        return detect(cls.session, chunk, cls.detector, lambda: None)


def _map_in_processes(
    detect: _Detect[_Detected],
    session: CaptureSession,
    chunks: Sequence[_Chunk],
    config: ReconstructionConfig,
    on_progress: OnProgress,
) -> Generator[_Detected, None, None]:
    done, total = 0, len(chunks)
    num_frames = _num_frames(session, config)
    on_progress(Progress("detect", 0, num_frames))
    try:
        with ProcessPool(config.processes, _Worker.start, (session, config.detector)) as pool:
            for detected in pool.map(partial(_Worker.run, detect), chunks):
                done += 1
                on_progress(Progress("detect", num_frames * done // total, num_frames))
                yield detected
    except BrokenProcessPool as error:
        raise ChildError(
            "A detection process was ended from outside, most likely for lack of memory. Try fewer processes."
        ) from error
