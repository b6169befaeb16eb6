"""Executor of one machine: the tasks of a plan in this process, or in a pool of processes."""

import contextlib
import hashlib
import json
import tempfile
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

from pipeline.capture.preflight_npz import encode_record
from pipeline.capture.session import CaptureSession, Session
from pipeline.core.data.detections import Detections
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import ChildError, PipelineError
from pipeline.core.options.config import FILE_FORMATS, ReconstructionConfig, method_warnings
from pipeline.core.options.job_choices import CalibrationChoices
from pipeline.core.options.providers import ProviderName
from pipeline.core.options.rules import config_problems, require
from pipeline.core.paths import StrPath
from pipeline.core.progress import OnProgress, silent
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.core.runtime.packages.storage import sha256_of
from pipeline.detection.chunk import concatenate
from pipeline.detection.profiles.detection import detection_joints
from pipeline.detection.providers.find import current_provider
from pipeline.export.character.source import CharacterSource
from pipeline.export.results import OnFile, WrittenResults, no_file, not_written
from pipeline.motion.body.installed import load as load_body
from pipeline.run.engine.code import stage_codes
from pipeline.run.engine.codec import output_records
from pipeline.run.engine.counter import UnitCounter
from pipeline.run.engine.methods import clustering_parameters, tracking_parameters
from pipeline.run.engine.output_folder import OutputFolder, output_folder
from pipeline.run.engine.overlapped import overlapped
from pipeline.run.engine.plan import STAGE_BY_NAME, STAGES, PlannedStage, followers, plan
from pipeline.run.engine.scratch_folder import scratch_folder
from pipeline.run.engine.stage import (
    DETECT,
    EXPORT,
    LOOK,
    WRITE,
    Context,
    Origin,
    ResultFile,
    SessionFacts,
    TakeFiles,
    Task,
)
from pipeline.run.engine.take import assemble
from pipeline.run.preflight.verdict import require_cameras
from pipeline.video.frame_rate import measured_rate_hz
from pipeline.video.images.files import folder_sha256

_DEFAULTS = ReconstructionConfig()
# Units of work from which on a pool of processes is started: frames of detection, tens of frames of a fit.
_UNITS_OF_A_START = 60
_STAGES_OF_RECORDS = {stage.name for stage in STAGES if not stage.makes_files} - {WRITE}


def reconstruct(
    session: Session,
    config: ReconstructionConfig = _DEFAULTS,
    on_progress: OnProgress = silent,
    cache: StrPath | None = None,
) -> Reconstruction:
    """Reconstruct everybody in a capture session; write no file.

    The result does not depend on the cut of the frames or on the number of processes.

    Parameters
    ----------
    session
        Calibrated cameras with their videos, or with 2D joints of another program.
    config
        What to do; a session of keypoints has nothing to detect.
    on_progress
        Called after every unit of a stage, from the calling thread.
    cache
        Folder in which outputs of tasks are kept for later runs, see ``pipeline.run.engine.output_folder``; ``None``:
        no output is kept.

    Raises
    ------
    InputError
        If a video can't be decoded or too many of its frames are damaged, if the configuration breaks a rule of
        ``pipeline.core.options.rules``, or there is no such parameter.
    SessionRefused
        If the check of the session finds errors, unless ``config.force``: an ``InputError`` with all of them.
    ModelError
        If the detector is not installed.
    PipelineError
        If the folder for intermediate outputs can't be written.
    """
    _check(session, config)
    cache = None if cache is None else Path(cache)
    facts = session_facts(session, () if cache is None else _inputs(session))
    with _planned(session, config, facts, _STAGES_OF_RECORDS, cache) as job:
        for stage in job.stages:
            _run_stage(job, stage, on_progress)
        reconstruction = assemble(_TaskContext(job))
        return replace(
            reconstruction,
            # The files of the block are gone after it.
            located=tuple(reconstruction.located),
            observations=tuple(reconstruction.observations),
            warnings=(*reconstruction.warnings, *method_warnings(config, facts.has_videos)),
        )


def reconstruct_to_files(
    session: Session,
    folder: StrPath,
    config: ReconstructionConfig = _DEFAULTS,
    on_progress: OnProgress = silent,
    cache: StrPath | None = None,
    name: str = "",
    sources: Sequence[StrPath] = (),
    on_file: OnFile = no_file,
    character: CharacterSource | None = None,
) -> WrittenResults:
    """Reconstruct everybody in a capture session, and write the result files as the service does, by its stages.

    Parameters
    ----------
    session, config, on_progress, cache
        See ``reconstruct``. ``config`` names the files.
    folder
        Folder of the result files, made if it is missing.
    name
        Name of the take in its report; by default that of the folder.
    sources
        Files that the report names with their digests beside the videos, such as the calibration.
    on_file
        Called with the path of each file when it is whole and has its name.
    character
        Character onto which everybody is retargeted as well, see ``docs/characters.md``; ``None``: there is none.

    Raises
    ------
    InputError
        See ``reconstruct``; and if the character can't be used.
    ModelError
        If the detector, or a human body that files shall have, is not installed.
    PipelineError
        If a folder can't be written to, the disk is full, or the content of a file differs from the written content.
    """
    _check(session, config)
    if config.body == "human" and any(FILE_FORMATS[export].has_body for export in config.exports):
        load_body()
    if character is not None:
        character.open()
        config = replace(config, character=character.sha256)
    folder, cache = Path(folder), None if cache is None else Path(cache)
    facts = session_facts(session, () if cache is None else _inputs(session))
    files = _Destination(folder, name or folder.resolve().name or "take", tuple(map(Path, sources)), character)
    paths: list[Path] = []
    with _planned(session, config, facts, STAGE_BY_NAME.keys(), cache, files) as job:
        for stage in job.stages:
            for path in _run_stage(job, stage, on_progress):
                paths.append(path)
                on_file(path)
        (exported,) = _TaskContext(job).outputs(EXPORT)
        return WrittenResults(tuple(paths), json.loads(exported)["metrics"])


def detect_people(
    session: CaptureSession,
    config: ReconstructionConfig = _DEFAULTS,
    on_progress: OnProgress = silent,
    has_poses: bool = True,
) -> Mapping[str, Detections]:
    """Detect bodies in all videos of a session.

    Parameters
    ----------
    session
        Cameras with their videos.
    has_poses
        Whether the cameras have poses in a world with Z up, which tell how they hang; else people alone do.

    Raises
    ------
    InputError
        If a video can't be decoded or too many of its frames are damaged.
    ModelError
        If the detector is not installed.

    Returns
    -------
        Bodies by camera, with the joints of ``detection_joints``.
    """
    making = None if has_poses else CalibrationChoices(board=None)
    config = replace(config, method="tracking", appearance="off", making=making)
    with _planned(session, config, session_facts(session), {LOOK, DETECT}, None) as job:
        for stage in job.stages:
            _run_stage(job, stage, on_progress)
        chunks = output_records(_TaskContext(job), DETECT, Detections)
        names = [camera.name for camera in session.cameras]
        return concatenate(chunks, names, len(detection_joints(config).names))


@contextlib.contextmanager
def _planned(
    session: Session,
    config: ReconstructionConfig,
    facts: SessionFacts,
    wanted: Collection[str],
    cache: Path | None,
    files: "_Destination | None" = None,
) -> Iterator["_Job"]:
    """Plan the wanted stages of a job, with the folders of their outputs for the block."""
    with contextlib.ExitStack() as stack:
        outputs = stack.enter_context(output_folder(cache))
        interim = stack.enter_context(tempfile.TemporaryDirectory(prefix="multicap-"))
        scratch = stack.enter_context(scratch_folder(None if files is None else files.folder))
        codes = dict.fromkeys(STAGE_BY_NAME, "") if cache is None else stage_codes(current_provider().identity)
        stages = [stage for stage in plan(facts, config, codes, config.chunk_frames) if stage.name in wanted]
        yield _Job(session, config, facts, stages, outputs, OutputFolder(Path(interim)), scratch, files, _Pool(stack))


def session_facts(session: Session, inputs: tuple[str, ...] = ()) -> SessionFacts:
    """Facts of an opened session that a plan depends on."""
    timebase = session.timebase
    return SessionFacts(
        inputs=inputs,
        num_frames=timebase.num_frames,
        frame_rate_hz=timebase.frame_rate_hz,
        stretches=session.stretches,
        camera_rates_hz={
            name: measured_rate_hz(times.time_s) if len(times.time_s) > 1 else timebase.frame_rate_hz
            for name, times in session.times.items()
        },
        has_videos=bool(session.video_of),
    )


def _inputs(session: Session) -> tuple[str, ...]:
    """Digests of all that the result depends on: the opened session, and the videos' files."""
    opened = hashlib.sha256(encode_record(session)).hexdigest()
    return (opened, *(_digest(path) for video in session.video_of.values() for path in video.paths))


def _digests(session: Session, sources: Sequence[Path]) -> dict[str, str]:
    """SHA-256 of the files of a session by name: its videos, or its keypoints as they were read, and further files."""
    digests = {path.name: _digest(path) for video in session.video_of.values() for path in video.paths}
    if not digests:
        digests["keypoints as they were read"] = hashlib.sha256(encode_record(session)).hexdigest()
    return digests | {path.name: _digest(path) for path in sources}


def _digest(path: Path) -> str:
    """SHA-256 of a file, or of a folder of images."""
    try:
        return folder_sha256(path) if path.is_dir() else sha256_of(path)
    except OSError as error:
        raise PipelineError(f"The file {error.filename} can't be read: {error.strerror}.") from error


def _check(session: Session, config: ReconstructionConfig) -> None:
    """Find out what is wrong before the work begins."""
    require(config_problems(config, session.timebase.num_frames, session.timebase.frame_rate_hz))
    require_cameras(session.cameras, config)
    wanted = session.restricted(config.frames)
    tracking_parameters(wanted.cameras, wanted.timebase, config.tracking)
    clustering_parameters(wanted.cameras, config, config.uses_fields and bool(wanted.video_of))


@dataclass(frozen=True, slots=True)
class _Destination:
    """Destination of result files."""

    folder: Path  # Folder of the files
    # Name of the take, and files beside its videos, for its report
    name: str
    sources: tuple[Path, ...]
    character: CharacterSource | None = None  # Character onto which everybody is retargeted


@dataclass(frozen=True, slots=True)
class _Job:
    """A reconstruction under way."""

    session: Session
    config: ReconstructionConfig
    facts: SessionFacts
    stages: Sequence[PlannedStage]  # Stages of the plan
    outputs: OutputFolder  # Folder for outputs of tasks
    # Folder for interim outputs, under the keys of the tasks' outputs. It is removed at the end of the run.
    interim: OutputFolder
    scratch: Path  # Folder for temporary files of the process that runs a task
    files: _Destination | None = None  # Destination of result files; ``None``: no task makes any
    pool: "_Pool | None" = None  # Pool of its processes; ``None`` in these processes

    def tasks_of(self, stage: str) -> Iterable[Task]:
        """Tasks of a stage; none if it is not planned."""
        return next((planned.tasks for planned in self.stages if planned.name == stage), ())


@dataclass(frozen=True, slots=True)
class _JobFiles(TakeFiles):
    """Files on this machine."""

    job: _Job

    @property
    def has_viewers(self) -> bool:
        return False

    @property
    def keeps_pieces(self) -> bool:
        return bool(self.job.config.edits)  # without edits nobody asks for them again

    def piece(self, key: str) -> bytes | None:
        return self.job.outputs.read(key)

    def origin(self) -> Origin:
        files = self.job.files
        if files is None:
            raise PipelineError("No files are wanted of this reconstruction.")
        return Origin(files.name, _digests(self.job.session, files.sources))

    def character(self) -> CharacterSource:
        files = self.job.files
        if files is None or files.character is None:
            raise PipelineError("This executor has no characters.")
        return files.character


@dataclass(frozen=True, slots=True)
class _TaskContext(Context):
    """Context on a folder of this machine."""

    job: _Job
    task: Task | None = None
    count: Callable[[], None] = lambda: None

    @property
    def config(self) -> ReconstructionConfig:
        return self.job.config

    @property
    def facts(self) -> SessionFacts:
        return self.job.facts

    @property
    def scratch(self) -> Path:
        return self.job.scratch

    @property
    def provider(self) -> ProviderName:
        return current_provider().name

    @property
    def files(self) -> TakeFiles:
        return _JobFiles(self.job)

    def session(self) -> Session:
        return self.job.session

    def outline(self) -> Session:
        return self.job.session  # the caller holds the detections anyway

    def on_unit(self) -> None:
        self.count()

    def video(self, camera: str) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def outputs(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        return [_read(self.job.outputs, task) for task in islice(self.job.tasks_of(stage), tasks.start, tasks.stop)]

    def interim(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        return [_read(self.job.interim, task) for task in islice(self.job.tasks_of(stage), tasks.start, tasks.stop)]

    def stored_output(self) -> bytes | None:
        return None if self.task is None else self.job.outputs.read(self.task.key)


def _read(folder: OutputFolder, task: Task) -> bytes:
    content = folder.read(task.key)
    if content is None:
        message = f"An output of the stage {task.stage} was removed or changed in {folder.path} meanwhile."
        raise PipelineError(f"{message} Run the command again.")
    return content


def _run_stage(job: _Job, stage: PlannedStage, on_progress: OnProgress) -> list[Path]:
    """Run the tasks of a stage that have no outputs yet, and list the result files that they made."""
    counter = UnitCounter(stage, on_progress)
    needs_interim = _needs_interim(job, stage)
    missing = []
    for task in stage.tasks:
        if needs_interim or not STAGE_BY_NAME[stage.name].is_reusable or job.outputs.read(task.key) is None:
            missing.append(task)
        else:
            counter.finish(task, is_reused=True)
    with contextlib.closing(_finished(job, missing, counter.on_unit)) as finished:
        for task in finished:
            counter.finish(task, is_reused=False)
    if job.files is None or STAGE_BY_NAME[stage.name].is_reusable:
        return []
    return [job.files.folder / name for task in stage.tasks for name in json.loads(_read(job.outputs, task))["files"]]


def _needs_interim(job: _Job, stage: PlannedStage) -> bool:
    """Whether a later stage will read the stage's interim outputs: not if its own output is there already."""
    following = (task for name in followers(stage.name) for task in job.tasks_of(name))
    return STAGE_BY_NAME[stage.name].leaves_interim(job.config) and any(
        job.outputs.read(task.key) is None for task in following
    )


def _finished(job: _Job, tasks: Sequence[Task], on_unit: Callable[[Task], None]) -> Generator[Task, None, None]:
    """Run tasks; yields each one when it is done."""
    if len(tasks) > 1 and job.config.processes > 1 and job.pool is not None and job.pool.is_worth(tasks):
        return _finished_in_processes(job, tasks, job.pool)
    if len(tasks) > 1 and STAGE_BY_NAME[tasks[0].stage].runs_networks:
        return overlapped(tasks, partial(_run, job), on_unit)
    return (_run(job, task, partial(on_unit, task)) for task in tasks)


def _run(job: _Job, task: Task, on_unit: Callable[[], None] = lambda: None) -> Task:
    try:
        output = STAGE_BY_NAME[task.stage].function(task, _TaskContext(job, task, on_unit))
    except OSError as error:
        if job.files is None:
            raise
        raise not_written(job.files.folder, error) from error
    if output.interim is not None:
        job.interim.write(task.key, output.interim)
    for key, path in output.pieces.items():
        job.outputs.write(key, path.read_bytes())
    if job.files is not None:
        for file in output.files:
            _keep(file, job.files.folder)
    job.outputs.write(task.key, output.content)
    return task


def _keep(file: ResultFile, folder: Path) -> None:
    """Move a result file to its folder."""
    try:
        file.path.replace(folder / file.name)
    except OSError as error:
        raise not_written(folder, error) from error


def _finished_in_processes(job: _Job, tasks: Sequence[Task], pool: "_Pool") -> Generator[Task, None, None]:
    try:
        yield from pool.of(job).map(_Worker.run, tasks)
    except BrokenProcessPool as error:
        raise ChildError(
            "A process was ended from outside, most likely for lack of memory. Try fewer processes."
        ) from error


class _Pool:
    """Pool of a job's processes. It starts with the first stage of several tasks, and ends with ``stack``.

    Each process starts when it is first needed: that takes seconds.
    """

    def __init__(self, stack: contextlib.ExitStack) -> None:
        self._stack = stack
        self._started: ProcessPool | None = None

    def is_worth(self, tasks: Sequence[Task]) -> bool:
        """Return whether the pool has started, or its start takes less time than it will save."""
        return self._started is not None or sum(task.num_units for task in tasks) >= _UNITS_OF_A_START

    def of(self, job: _Job) -> ProcessPool:
        """Pool for the job."""
        if self._started is None:
            pool = ProcessPool(job.config.processes, _Worker.start, (replace(job, pool=None),))
            self._started = self._stack.enter_context(pool)
        return self._started


class _Worker:
    """State of a process of the pool from one task to the next."""

    job: _Job

    @classmethod
    def start(cls, job: _Job) -> None:
        scratch = tempfile.mkdtemp(prefix=f"{Path(job.scratch).name}-", dir=job.scratch)
        cls.job = replace(job, scratch=Path(scratch))

    @classmethod
    def run(cls, task: Task) -> Task:
        return _run(cls.job, task)
