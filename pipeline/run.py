"""The whole way on one machine: a capture session to people in motion.

The same functions that workers of a service call: ``detect_chunk`` is the map over frame ranges, ``associate`` and
``fit`` are the reduce. The result does not depend on how the frames are cut or how many processes work on them.
"""

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from types import MappingProxyType

from pipeline.clustering.associate import reconstruct_by_clustering
from pipeline.clustering.parameters import derive_parameters as clustering_parameters
from pipeline.config import ReconstructionConfig
from pipeline.data import Detections, Observations, Reconstruction, SkeletonMotion, Track3D
from pipeline.detect.chunk import concatenate, detect_chunk
from pipeline.detect.detector import Detector, open_detector
from pipeline.errors import InputError, PipelineError, Problem
from pipeline.joints import JointSet
from pipeline.keypoints import KeypointSession
from pipeline.progress import OnProgress, Progress, silent
from pipeline.session import CaptureSession
from pipeline.skeleton.solve import motion_from_track
from pipeline.tracking.associate import reconstruct_tracks
from pipeline.tracking.parameters import TrackingParameters, change_parameters, derive_parameters
from pipeline.video.timeline import chunk_ranges

Span = tuple[float, float]
Views = CaptureSession | KeypointSession
_DEFAULTS = ReconstructionConfig()
_BY_MEMBERSHIP = (
    "Clustering takes whole bodies for evidence, not part affinity fields: "
    "two joints are connected where they belong to one detection."
)
Chunk = tuple[str, Span]  # of a camera


def reconstruct(
    session: CaptureSession, config: ReconstructionConfig, on_progress: OnProgress = silent
) -> Reconstruction:
    """Reconstruct everybody in a capture session.

    Parameters
    ----------
    session
        Calibrated cameras and their videos, as of ``pipeline.session.open_session``.
    config
        What to do.
    on_progress
        Called after every step, from the calling thread.

    Raises
    ------
    InputError
        If a video can't be decoded, or there is no such parameter.
    ModelError
        If the detector is not installed.
    """
    _check(session, config)
    detector = open_detector(config.detector)
    cameras = [camera.name for camera in session.cameras]
    chunks = [(camera, span) for span in chunk_ranges(session.timebase, config.chunk_frames) for camera in cameras]
    detected = (
        _map_here(session, chunks, detector, on_progress)
        if config.processes == 1
        else _map_in_processes(session, chunks, config, on_progress)
    )
    detections = concatenate(detected, cameras, len(detector.joints.names))
    return _reconstruct_people(session, detections, detector.joints, config, on_progress)


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
    _check(session, config)
    return _reconstruct_people(session, session.detections, session.joints, config, on_progress)


def _reconstruct_people(
    session: Views,
    detections: Mapping[str, Detections],
    joints: JointSet,
    config: ReconstructionConfig,
    on_progress: OnProgress,
) -> Reconstruction:
    done, total = 0, session.timebase.num_frames if config.method == "clustering" else 1
    on_progress(Progress("associate", done, total))

    def on_frame() -> None:
        nonlocal done
        done += 1
        on_progress(Progress("associate", done, total))

    tracks, observations = associate(session, detections, joints, config, on_frame)
    on_progress(Progress("associate", total, total))
    on_progress(Progress("fit", 0, 1))
    motions = fit(session, tracks, joints)
    on_progress(Progress("fit", 1, 1))
    return Reconstruction(
        cameras=session.cameras,
        joints=joints,
        timebase=session.timebase,
        tracks=tracks,
        observations=observations,
        motions=motions,
        warnings=(*session.warnings, *([_BY_MEMBERSHIP] if config.method == "clustering" else [])),
    )


def tracking_parameters(session: Views, changes: Mapping[str, float] = MappingProxyType({})) -> TrackingParameters:
    """Those derived from the session, but for what was asked to be otherwise.

    Raises
    ------
    InputError
        If a parameter does not exist, or can't have that value.
    """
    return change_parameters(derive_parameters(session.cameras, session.timebase.frame_rate_hz), changes)


def _check(session: Views, config: ReconstructionConfig) -> None:
    """Find out what is wrong before the work begins."""
    tracking_parameters(session, config.tracking)
    if config.tracking and config.method != "tracking":
        problem = f"Parameters of the tracker are of no use to the method '{config.method}'."
        raise InputError([Problem("unknown_parameter", problem, hint="Leave them out, or use the method 'tracking'.")])


def associate(
    session: Views,
    detections: Mapping[str, Detections],
    joints: JointSet,
    config: ReconstructionConfig = _DEFAULTS,
    on_frame: Callable[[], None] = lambda: None,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Turn all cameras' detections into tracks: the sequential reduce, one pass in time order.

    Clustering calls ``on_frame`` after each output frame; tracking takes no time worth counting.
    """
    views = session.cameras, session.times, detections, session.timebase
    if config.method == "clustering":
        return reconstruct_by_clustering(*views, joints, clustering_parameters(session.cameras), on_frame)
    return reconstruct_tracks(*views, tracking_parameters(session, config.tracking))


def fit(session: Views, tracks: Sequence[Track3D], joints: JointSet) -> tuple[SkeletonMotion, ...]:
    """Animate one skeleton a person."""
    return tuple(motion_from_track(track, joints, session.timebase, f"person-{track.track_id}") for track in tracks)


def _num_frames(session: CaptureSession) -> int:
    return sum(len(times.time_s) for times in session.times.values())


def _map_here(
    session: CaptureSession, chunks: Sequence[Chunk], detector: Detector, on_progress: OnProgress
) -> Iterator[Detections]:
    total, done = _num_frames(session), 0
    on_progress(Progress("detect", 0, total))

    def on_frame() -> None:
        nonlocal done
        done += 1
        on_progress(Progress("detect", done, total))

    for camera, span_s in chunks:
        yield detect_chunk(session, camera, span_s, detector, on_frame)


class _Worker:
    """What a process of the pool keeps from one chunk to the next: the session and the loaded network."""

    session: CaptureSession
    detector: Detector

    @classmethod
    def start(cls, session: CaptureSession, detector_name: str) -> None:
        cls.session = session
        cls.detector = open_detector(detector_name)

    @classmethod
    def run(cls, chunk: Chunk) -> Detections:
        return detect_chunk(cls.session, *chunk, cls.detector)


def _map_in_processes(
    session: CaptureSession, chunks: Sequence[Chunk], config: ReconstructionConfig, on_progress: OnProgress
) -> Iterator[Detections]:
    done, total = 0, len(chunks)
    on_progress(Progress("detect", 0, _num_frames(session)))
    pool = ProcessPoolExecutor(
        config.processes,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_Worker.start,
        initargs=(session, config.detector),
    )
    try:
        for detections in pool.map(_Worker.run, chunks):
            done += 1
            on_progress(Progress("detect", _num_frames(session) * done // total, _num_frames(session)))
            yield detections
    except BrokenProcessPool as error:
        raise PipelineError(
            "A detection process was ended from outside, most likely for lack of memory. Try fewer processes."
        ) from error
    finally:
        # An error in one chunk must not wait for all the others.
        pool.shutdown(wait=True, cancel_futures=True)
