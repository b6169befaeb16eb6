"""The four stages on the pipeline: what a claimed chunk runs.

A worker process keeps the session it worked on last and the loaded networks, for the next chunk is mostly of the same.
"""

import contextlib
import functools
import json
import tempfile
from pathlib import Path

from pipeline.config import ReconstructionConfig
from pipeline.data import Reconstruction, SkeletonMotion
from pipeline.detect.chunk import concatenate, detect_chunk
from pipeline.detect.detector import open_detector
from pipeline.errors import ModelError, PipelineError
from pipeline.export.results import result_files
from pipeline.joints import JointSet
from pipeline.keypoints import KeypointSession
from pipeline.records_npz import (
    decode_detections,
    decode_keypoints,
    decode_motions,
    decode_session,
    decode_tracks,
    encode_detections,
    encode_motions,
    encode_tracks,
)
from pipeline.run import Views, associate, fit
from pipeline.session import CaptureSession
from pipeline.tracking.warm_up import warm_up as warm_up_tracking
from pipeline.video.timeline import span_s
from worker.execution import Outcome, ResultFile, Stages, Work
from worker.jobs.artifacts import ArtifactStore, record_key
from worker.jobs.model import Session
from worker.jobs.spec import JobSpec
from worker.plan import ASSOCIATE, DETECT, EXPORT, FIT, is_of_keypoints

_detector = functools.cache(open_detector)

_MEDIA_TYPES = {".json": "application/json", ".bvh": "text/plain; charset=utf-8"}


class _OpenSession:
    """The session at hand, its files under their own names in a folder for as long as it is."""

    def __init__(self) -> None:
        self._files = contextlib.ExitStack()
        self._id: str | None = None
        self._views: Views

    def views(self, session: Session, artifacts: ArtifactStore) -> Views:
        """Open a session, unless it is open."""
        if self._id == session.id:
            return self._views
        self._files.close()
        self._id = None
        with artifacts.open(record_key(session.id)) as record:
            content = record.read()
        self._views = (
            decode_keypoints(content) if is_of_keypoints(session) else self._capture(session, artifacts, content)
        )
        self._id = session.id
        return self._views

    def _capture(self, session: Session, artifacts: ArtifactStore, record: bytes) -> CaptureSession:
        folder = Path(self._files.enter_context(tempfile.TemporaryDirectory(prefix="multicap-")))
        for file in session.files:
            stored = self._files.enter_context(artifacts.local_path(file.key))
            (folder / file.name).symlink_to(stored.absolute())
        return decode_session(record, folder)


_open = _OpenSession()


def warm_up() -> None:
    """Load the default network and the compiled kernels before they are needed; a chunk says what is missing."""
    with contextlib.suppress(ModelError):
        _detector(JobSpec().detector)
    warm_up_tracking()


def _views_of(work: Work) -> tuple[Views, JointSet]:
    """The session, and what its detections' joints are."""
    views = _open.views(work.session, work.artifacts)
    return views, views.joints if isinstance(views, KeypointSession) else _detector(work.claim.spec.detector).joints


def detect(work: Work) -> Outcome:
    """Find all bodies in a range of a camera's frames."""
    session, _ = _views_of(work)
    if isinstance(session, KeypointSession):
        raise PipelineError("A session of keypoints has no videos.")
    chunk = work.claim.payload
    span = span_s(session.timebase, chunk["start_frame"], chunk["stop_frame"])
    detector = _detector(work.claim.spec.detector)
    return Outcome(encode_detections(detect_chunk(session, chunk["camera"], span, detector, work.on_unit)))


def associate_people(work: Work) -> Outcome:
    """Turn the detections of all chunks into tracks: one pass in time order."""
    session, joints = _views_of(work)
    if isinstance(session, KeypointSession):
        detections = session.detections
    else:
        chunks = (decode_detections(content) for content in work.outputs(DETECT))
        detections = concatenate(chunks, [camera.name for camera in session.cameras], len(joints.names))
    config = ReconstructionConfig(method=work.claim.spec.method)
    return Outcome(encode_tracks(*associate(session, detections, joints, config, work.on_unit)))


def fit_skeletons(work: Work) -> Outcome:
    """Animate one skeleton a person."""
    session, joints = _views_of(work)
    tracks, _ = decode_tracks(*work.outputs(ASSOCIATE))
    motions: list[SkeletonMotion] = []
    for track in tracks:
        motions.extend(fit(session, [track], joints))
        work.on_unit()
    return Outcome(encode_motions(motions))


def export(work: Work) -> Outcome:
    """Write the client's files, and an index of them."""
    session, joints = _views_of(work)
    tracks, observations = decode_tracks(*work.outputs(ASSOCIATE))
    reconstruction = Reconstruction(
        cameras=session.cameras,
        joints=joints,
        timebase=session.timebase,
        tracks=tracks,
        observations=observations,
        motions=decode_motions(*work.outputs(FIT)),
        warnings=session.warnings,
    )
    files = []
    for name, content in result_files(reconstruction):
        files.append(_result_file(name, content))
        work.on_unit()
    index = json.dumps({"files": [file.name for file in files]}).encode()
    return Outcome(index, tuple(files))


def _result_file(name: str, content: bytes) -> ResultFile:
    path = Path(name)
    kind = path.stem if path.suffix == ".json" else path.suffix.removeprefix(".")
    person = None if path.suffix == ".json" else path.stem
    return ResultFile(name, kind, person, _MEDIA_TYPES[path.suffix], content)


STAGES: Stages = {DETECT: detect, ASSOCIATE: associate_people, FIT: fit_skeletons, EXPORT: export}
