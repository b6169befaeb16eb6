"""Execution of claimed chunks: the pipeline's tasks on the sessions and outputs of the service.

A worker process keeps the session that it worked on last and the loaded networks: the next chunk is mostly of the same
session.
"""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import uuid_utils

from pipeline.capture.preflight_npz import decode_keypoints, decode_points, decode_session
from pipeline.capture.session import Session as OpenedSession
from pipeline.core.errors import InputError, ModelError, PipelineError, Problem
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.providers import ProviderName, provider_name
from pipeline.core.problems.finding_codes import INPUT_DAMAGED
from pipeline.core.problems.request_codes import VIDEOS_DELETED
from pipeline.core.runtime.kernel_cache import is_complete
from pipeline.detection.entries import detection_joints
from pipeline.detection.profiles.profile_detector import open_detection
from pipeline.export.character.source import CharacterSource
from pipeline.run.engine.plan import STAGE_BY_NAME
from pipeline.run.engine.stage import Context, Origin, Output, SessionFacts, TakeFiles
from pipeline.run.warm_up import JOINT_SETS
from pipeline.run.warm_up import warm_up as compile_kernels
from worker.run.chunk import Work
from worker.run.planning import claimed_task, has_points, has_videos, session_facts
from worker.store.errors import DamagedArtifact, NotFound
from worker.store.files.artifacts import ArtifactStore
from worker.store.files.checksums import require_file
from worker.store.files.file_keys import record_key
from worker.store.model.session_records import Session
from worker.store.spec import JobSpec


def run_chunk(work: Work) -> Output:
    """Run a claimed chunk."""
    return STAGE_BY_NAME[work.claim.stage].function(claimed_task(work.claim), _TaskContext(work, _kept))


def warm_up() -> None:
    """Load the default networks and the kernels for their joints before they are needed; a chunk says what is missing.

    Compiled kernels for other joints are loaded in tenths of a second, by the first chunk that needs them. Without a
    folder for compiled kernels all are compiled.
    """
    with contextlib.suppress(ModelError):
        open_detection(JobSpec().config.networks, JobSpec().config.detected_joints)
    compile_kernels([detection_joints(JobSpec().config)] if is_complete() else JOINT_SETS)


class KeptSession:
    """The session that a worker process has opened last, with its videos under their own names in a folder."""

    def __init__(self) -> None:
        self._files = contextlib.ExitStack()
        self._id: str | None = None
        self._session: OpenedSession | None = None
        self._is_outline = False
        self._folder: Path
        self._names: set[str] = set()

    def whole(self, session: Session, artifacts: ArtifactStore) -> OpenedSession:
        """Open a session, unless it is open."""
        if self._session is None or self._id != session.id or self._is_outline:
            return self._open(session, artifacts)
        return self._session

    def outline(self, session: Session, artifacts: ArtifactStore) -> OpenedSession:
        """Open a session without the detections of keypoint files: they leave the memory, of which they take most."""
        opened = self._session
        if opened is None or self._id != session.id:
            opened = self._open(session, artifacts)
        outline = opened.outline()
        self._session, self._is_outline = outline, outline is not opened or self._is_outline
        return outline

    def _open(self, session: Session, artifacts: ArtifactStore) -> OpenedSession:
        self.close()
        opened: OpenedSession
        with (
            _undamaged("The record of the session's check"),
            artifacts.open(record_key(session.id), session.record_sha256) as content,
        ):
            if has_videos(session):
                opened = decode_session(content, self._new_folder())
            else:
                opened = (decode_points if has_points(session) else decode_keypoints)(content)
        self._session, self._id = opened, session.id
        return opened

    def close(self) -> None:
        """Free the session's memory, and its files on this machine."""
        self._files.close()
        self._names.clear()
        self._session, self._id, self._is_outline = None, None, False

    @contextlib.contextmanager
    def video(self, work: Work, camera: str) -> Iterator[None]:
        """Have the open session's video of a camera at hand, inside the block: it is what was sent, to the block's end.

        A distant store's video is fetched when it is needed, and kept for the next chunk.
        """
        if work.session.videos_deleted_at is not None:
            message, hint = "The videos of the capture were deleted.", "Send them again as a new capture."
            raise InputError([Problem(VIDEOS_DELETED, message, camera=camera, hint=hint)])
        (described,) = (described for described in work.session.preflight.cameras if described.name == camera)
        with contextlib.ExitStack() as files:
            for name in (described.file, *described.more_files):
                files.enter_context(self._file(work, camera, name))
            yield

    @contextlib.contextmanager
    def _file(self, work: Work, camera: str, name: str) -> Iterator[None]:
        """Have a file of a camera's video at hand."""
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


_kept = KeptSession()


@dataclass(frozen=True, slots=True)
class _JobFiles(TakeFiles):
    """Files of the job of a claimed chunk."""

    work: Work

    @property
    def has_viewers(self) -> bool:
        return True

    @property
    def keeps_pieces(self) -> bool:
        return True

    def piece(self, key: str) -> bytes | None:
        return self.work.piece(key)

    def origin(self) -> Origin:
        return Origin(self.work.session.name, {file.name: file.sha256 for file in self.work.session.files})

    def character(self) -> CharacterSource:
        moved = self.work.claim.character
        if moved is None:
            raise PipelineError("The job moves no character.")
        path = self.work.scratch / str(uuid_utils.uuid7()) / moved.file.name
        path.parent.mkdir()
        remedy = "Send the character again, and start another job with it."
        with (
            _undamaged(moved.file.name, remedy=remedy),
            self.work.artifacts.open(moved.file.key, moved.file.sha256) as source,
            path.open("xb") as copy,
        ):
            shutil.copyfileobj(source, copy)
        return CharacterSource(path, moved.corrections)


@dataclass(frozen=True, slots=True)
class _TaskContext(Context):
    """Context of a claimed chunk."""

    work: Work
    kept: KeptSession

    @property
    def config(self) -> ReconstructionConfig:
        return self.work.claim.config

    @property
    def facts(self) -> SessionFacts:
        return session_facts(self.work.session)

    @property
    def scratch(self) -> Path:
        return self.work.scratch

    @property
    def provider(self) -> ProviderName:
        return provider_name(self.work.claim.provider)

    @property
    def files(self) -> TakeFiles:
        return _JobFiles(self.work)

    def on_unit(self) -> None:
        self.work.on_unit()

    def session(self) -> OpenedSession:
        return self.kept.whole(self.work.session, self.work.artifacts)

    def outline(self) -> OpenedSession:
        return self.kept.outline(self.work.session, self.work.artifacts)

    def video(self, camera: str) -> contextlib.AbstractContextManager[None]:
        return self.kept.video(self.work, camera)

    def outputs(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        return self.work.outputs(stage, tasks)

    def interim(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        return self.work.interim(stage, tasks)

    def finished(self, stage: str, tasks: slice) -> list[bytes | None]:
        return self.work.finished(stage, tasks)

    def copy_output(self, stage: str, task: int, path: Path, is_interim: bool = False) -> None:
        self.work.copy_output(stage, task, path, is_interim)

    def stored_output(self) -> bytes | None:
        return self.work.found


@contextlib.contextmanager
def _undamaged(file: str, camera: str | None = None, remedy: str = "Send the capture again.") -> Iterator[None]:
    """Report an input whose stored copy differs from the file that was sent: it has to be sent again."""
    try:
        yield
    except (DamagedArtifact, NotFound) as error:
        message = "The service's copy of this file is damaged: it is not what was sent."
        if isinstance(error, NotFound):
            message = "The service's copy of this file is missing."
        hint = f"{remedy} The operator finds the cause on the disk that holds the service's artifacts."
        raise InputError([Problem(INPUT_DAMAGED, message, file=file, camera=camera, hint=hint)]) from error
