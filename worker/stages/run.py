"""The four stages on the pipeline: what a claimed chunk runs.

A worker process keeps the session it worked on last and the loaded networks, for the next chunk is mostly of the same.
"""

import contextlib
import functools
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.capture.keypoints import KeypointSession
from pipeline.config import FILE_FORMATS, ReconstructionConfig
from pipeline.data import Animation, DamagedVideo, Detections, Reconstruction
from pipeline.detect.chunk import concatenate, detect_chunk, detect_fields_chunk
from pipeline.detect.damage import DamagedFrames, damaged_videos
from pipeline.detect.detector import open_detector
from pipeline.errors import InputError, ModelError, PipelineError, Problem
from pipeline.export.results import METRICS, write_results
from pipeline.joints import JointSet
from pipeline.progress import in_units
from pipeline.quality.report import all_checks
from pipeline.runtime.warm_up import warm_up as compile_kernels
from pipeline.skeleton.animate import animate
from pipeline.stages.association import Found, Views, link, locate_people, measure_bones, restrict, track_gathered
from pipeline.stages.records_npz import (
    decode_animation,
    decode_damaged_videos,
    decode_detections,
    decode_fields,
    decode_keypoints,
    decode_lengths,
    decode_poses,
    decode_session,
    encode_animation,
    encode_detections,
    encode_fields,
    encode_lengths,
    encode_poses,
    open_people,
    write_people,
)
from pipeline.tracking.observations import Bodies, gather
from pipeline.video.timeline import span_s
from worker.jobs.errors import DamagedArtifact, NotFound
from worker.jobs.files.artifacts import ArtifactStore, read_artifact, record_key
from worker.jobs.files.checksums import require_file
from worker.jobs.model import ResultWarning, Session
from worker.jobs.spec import JobSpec
from worker.stages.code import ASSOCIATE, DETECT, EXPORT, FIT, LENGTHS, POSES
from worker.stages.execution import Outcome, ResultFile, Stages, Work
from worker.stages.plan import FrameCut, is_of_keypoints

_detector = functools.cache(open_detector)

_PEOPLE = "people.npz"
_MEDIA_TYPES = {".json": "application/json"} | {f".{name}": one.media_type for name, one in FILE_FORMATS.items()}


@contextlib.contextmanager
def _undamaged(file: str, camera: str | None = None) -> Iterator[None]:
    """Say of an input that is not what was stored that it has to be sent again."""
    try:
        yield
    except (DamagedArtifact, NotFound) as error:
        message = "The service's copy of this file is damaged: it is not what was sent."
        if isinstance(error, NotFound):
            message = "The service's copy of this file is missing."
        hint = "Send the session again. The operator finds the cause on the disk that holds the service's artifacts."
        raise InputError([Problem("input_damaged", message, file=file, camera=camera, hint=hint)]) from error


class _OpenSession:
    """The session at hand, its videos under their own names in a folder for as long as it is."""

    def __init__(self) -> None:
        self._files = contextlib.ExitStack()
        self._id: str | None = None
        self._views: Views | None = None
        self._is_outline = False
        self._folder: Path
        self._names: set[str] = set()

    def views(self, session: Session, artifacts: ArtifactStore) -> Views:
        """Open a session, unless it is open."""
        if self._views is None or self._id != session.id or self._is_outline:
            return self._open(session, artifacts)
        return self._views

    def outline(self, session: Session, artifacts: ArtifactStore) -> Views:
        """Open a session without the detections of keypoint files: they leave the memory, of which they take most."""
        views = self._views
        if views is None or self._id != session.id:
            views = self._open(session, artifacts)
        if isinstance(views, KeypointSession):
            self._views, self._is_outline = replace(views, detections={}), True
            return self._views
        return views

    def _open(self, session: Session, artifacts: ArtifactStore) -> Views:
        self._files.close()
        self._names.clear()
        # Before the next session is in memory.
        self._views, self._id, self._is_outline = None, None, False
        with _undamaged("The record of the session's check"):
            content = read_artifact(artifacts, record_key(session.id), session.record_sha256)
        views = decode_keypoints(content) if is_of_keypoints(session) else decode_session(content, self._new_folder())
        self._views, self._id = views, session.id
        return views

    @contextlib.contextmanager
    def video(self, work: Work, camera: str) -> Iterator[None]:
        """Have the open session's video of a camera at hand, inside the block: it is what was sent, to the block's end.

        A distant store's video is fetched when it is needed, and kept for the next chunk.
        """
        (name,) = (one.file for one in work.session.preflight.cameras if one.name == camera)
        (file,) = (file for file in work.session.files if file.name == name)
        sent = file.key, file.sha256, work.check
        with _undamaged(name, camera):
            if name not in self._names:
                stored = self._files.enter_context(work.artifacts.local_path(*sent))
                (self._folder / name).symlink_to(stored.absolute())
                self._names.add(name)
            with work.artifacts.local_path(*sent) as stored:
                try:
                    yield
                finally:
                    require_file(stored, *sent)

    def _new_folder(self) -> Path:
        self._folder = Path(self._files.enter_context(tempfile.TemporaryDirectory(prefix="multicap-")))
        return self._folder


_open = _OpenSession()


def warm_up() -> None:
    """Load the default network and the compiled kernels before they are needed; a chunk says what is missing."""
    with contextlib.suppress(ModelError):
        _detector(JobSpec().detector)
    compile_kernels()


def _views_of(work: Work) -> tuple[Views, JointSet]:
    """The session, as if it had the frames alone that are wanted, and what its detections' joints are."""
    return _wanted(_open.views(work.session, work.artifacts), work)


def _outline_of(work: Work) -> tuple[Views, JointSet]:
    """As ``_views_of``, of a session without the detections of keypoint files."""
    return _wanted(_open.outline(work.session, work.artifacts), work)


def _wanted(session: Views, work: Work) -> tuple[Views, JointSet]:
    views = restrict(session, work.claim.spec.frames)
    return views, views.joints if isinstance(views, KeypointSession) else _detector(work.claim.spec.detector).joints


def _config(work: Work) -> ReconstructionConfig:
    spec = work.claim.spec
    return ReconstructionConfig(
        method=spec.method,
        detector=spec.detector,
        smoothing=spec.smoothing,
        cutoff_hz=spec.cutoff_hz,
        feet=spec.feet,
        people=None if spec.people == "auto" else spec.people,
    )


def detect(work: Work) -> Outcome:
    """Find all bodies in a range of a camera's frames, or what they could be made of."""
    session = _open.views(work.session, work.artifacts)
    if isinstance(session, KeypointSession):
        raise PipelineError("A session of keypoints has no videos.")
    chunk = work.claim.payload
    span = span_s(session.timebase, chunk["start_frame"], chunk["stop_frame"])
    seen = session, chunk["camera"], span, _detector(work.claim.spec.detector), work.on_unit
    with _open.video(work, chunk["camera"]):
        if work.claim.spec.uses_fields:
            return Outcome(encode_fields(detect_fields_chunk(*seen)))
        return Outcome(encode_detections(detect_chunk(*seen)))


def _bodies(session: Views, joints: JointSet, outputs: Iterable[bytes]) -> Mapping[str, Detections]:
    """All cameras' bodies out of chunks of the map."""
    cameras = [camera.name for camera in session.cameras]
    return concatenate(map(decode_detections, outputs), cameras, len(joints.names))


def _found(work: Work, session: Views, joints: JointSet, number: int) -> Found:
    """What was detected in a range of output frames: a chunk of every camera, which follow each other."""
    if isinstance(session, KeypointSession):
        return session.detections
    num_cameras = len(session.cameras)
    outputs = work.outputs(DETECT, slice(number * num_cameras, (number + 1) * num_cameras))
    if work.claim.spec.uses_fields:
        return {one.camera: one for one in map(decode_fields, outputs)}
    return _bodies(session, joints, outputs)


def measure_lengths(work: Work) -> Outcome:
    """Measure everybody's bones in frames all over the session, a chunk of the map at a time."""
    session, joints = _views_of(work)
    cut = FrameCut.of(work.session, work.claim.spec, work.claim.payload["chunk_frames"])
    first = cut.frames.start
    damaged: list[DamagedFrames] = []

    def chunks() -> Iterator[tuple[range, Found]]:
        for number, frames in enumerate(cut):
            found = _found(work, session, joints, number)
            damaged.extend((camera, one.damaged) for camera, one in found.items())
            yield range(frames.start - first, frames.stop - first), found

    lengths = measure_bones(session, chunks(), joints, _config(work), work.on_unit)
    return Outcome(encode_lengths(lengths, damaged_videos(session, damaged)))


def find_poses(work: Work) -> Outcome:
    """Find everybody in a range of output frames, each instant by itself."""
    session, joints = _views_of(work)
    chunk = work.claim.payload
    found = _found(work, session, joints, work.claim.index)
    lengths = decode_lengths(*work.outputs(LENGTHS))
    frames = range(chunk["start_frame"], chunk["stop_frame"])
    return Outcome(encode_poses(locate_people(session, frames, found, lengths, joints, _config(work), work.on_unit)))


def associate_people(work: Work) -> Outcome:
    """Turn what was found in all chunks into tracks: one pass in time order."""
    on_share = in_units(work.claim.unit_count, work.on_unit)
    if work.claim.spec.method == "clustering":
        session, joints = _outline_of(work)
        people = link(session, map(decode_poses, work.outputs(POSES)), joints, _config(work), on_share)
        damaged = decode_damaged_videos(*work.outputs(LENGTHS))
    else:
        bodies, damaged = _gathered(work)
        session, _ = _outline_of(work)
        people = track_gathered(session, bodies, _config(work), on_share)
        del bodies
    archive = work.scratch / _PEOPLE
    write_people(archive, people, damaged)
    del people
    return Outcome(archive.read_bytes())


def _gathered(work: Work) -> tuple[Bodies, tuple[DamagedVideo, ...]]:
    """All cameras' bodies as tracking takes them, and the damaged videos among those that show them."""
    session, joints = _views_of(work)
    detections = (
        session.detections
        if isinstance(session, KeypointSession)
        else _bodies(session, joints, iter(work.outputs(DETECT)))
    )
    damaged = damaged_videos(session, [(camera, one.damaged) for camera, one in detections.items()])
    return gather(session.cameras, session.times, detections), damaged


def fit_skeletons(work: Work) -> Outcome:
    """Animate one skeleton a person."""
    return Outcome(encode_animation(_animation(work)))


def _animation(work: Work) -> Animation:
    session, joints = _outline_of(work)
    located, observations, _ = open_people(_archive_of_people(work))
    on_share = in_units(work.claim.unit_count, work.on_unit)
    # Windows of all observations are asked for again and again, a track but once.
    seen = tuple(observations)
    return animate(located, seen, session.cameras, session.timebase, joints, _config(work), on_share)


def _archive_of_people(work: Work) -> Path:
    """The output of association, in a file: in memory it would be a fifth of what a stage takes."""
    archive = work.scratch / _PEOPLE
    archive.write_bytes(*work.outputs(ASSOCIATE))
    return archive


def export(work: Work) -> Outcome:
    """Write the client's files, and an index of them."""
    session, joints = _outline_of(work)
    archive = _archive_of_people(work)
    animation = decode_animation(*work.outputs(FIT))
    located, observations, num_approximate_frames = open_people(archive)
    reconstruction = Reconstruction(
        cameras=session.cameras,
        joints=joints,
        timebase=session.timebase,
        located=located,
        observations=observations,
        animation=animation,
        warnings=session.warnings,
        num_approximate_frames=num_approximate_frames,
        damaged=decode_damaged_videos(archive),
    )
    spec = work.claim.spec
    on_share = in_units(work.claim.unit_count, work.on_unit)
    paths = write_results(reconstruction, work.scratch, spec.exports, spec.bvh, spec.output_rate_hz, on_share)
    files = [_result_file(path) for path in paths]
    index = json.dumps({"files": [file.name for file in files]}).encode()
    report = json.loads((work.scratch / METRICS).read_bytes())
    return Outcome(index, tuple(files), tuple(ResultWarning(**check) for check in all_checks(report)))


def _result_file(path: Path) -> ResultFile:
    kind = path.stem if path.suffix == ".json" else path.suffix.removeprefix(".")
    person = None if path.suffix == ".json" else path.stem
    return ResultFile(path.name, kind, person, _MEDIA_TYPES[path.suffix], path)


STAGES: Stages = {
    DETECT: detect,
    LENGTHS: measure_lengths,
    POSES: find_poses,
    ASSOCIATE: associate_people,
    FIT: fit_skeletons,
    EXPORT: export,
}
