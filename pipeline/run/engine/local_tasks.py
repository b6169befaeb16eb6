"""Tasks of a job on this machine: their context, the stages that run them, and the pool of processes."""

import contextlib
import json
import shutil
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from queue import SimpleQueue

from filelock import FileLock, Timeout

from pipeline.capture.preflight_npz import record_sha256
from pipeline.capture.session import Session
from pipeline.core.errors import ChildError, PipelineError
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.providers import ProviderName
from pipeline.core.progress import OnProgress, Progress
from pipeline.core.runtime.child_processes import ProcessPool, uninterrupted
from pipeline.core.runtime.packages.storage import file_sha256
from pipeline.detection.providers.find import current_provider
from pipeline.export.character.source import CharacterSource
from pipeline.export.results import not_written
from pipeline.run.engine.output_folder import OutputFolder
from pipeline.run.engine.plan import STAGE_BY_NAME, PlannedStage, interim_readers
from pipeline.run.engine.stage import Context, Origin, ResultFile, SessionFacts, TakeFiles, Task
from pipeline.video.images.files import folder_sha256

# How names of folders begin, beside the results, whose files are not whole, and the file that their processes lock.
_UNFINISHED, _LOCK = ".new-", "lock"
# Units of work from which on a pool of processes is started: frames of detection, tens of frames of a fit.
_UNITS_OF_A_START = 60


@dataclass(frozen=True, slots=True)
class FilesDestination:
    """Destination of result files."""

    folder: Path  # Folder of the files
    # Name of the take, and files beside its videos, for its report
    name: str
    sources: tuple[Path, ...]
    character: CharacterSource | None = None  # Character onto which everybody is retargeted


@dataclass(frozen=True, slots=True)
class LocalJob:
    """A reconstruction under way."""

    session: Session
    config: ReconstructionConfig
    facts: SessionFacts
    stages: Sequence[PlannedStage]  # Stages of the plan
    outputs: OutputFolder  # Folder for outputs of tasks
    # Folder for interim outputs, under the keys of the tasks' outputs. It is removed at the end of the run.
    interim: OutputFolder
    scratch: Path  # Folder for temporary files of the process that runs a task
    files: FilesDestination | None = None  # Destination of result files; ``None``: no task makes any
    pool: "TaskPool | None" = None  # Pool of its processes; ``None`` in these processes

    def stage_tasks(self, stage: str) -> Iterable[Task]:
        """Tasks of a stage; none if it is not planned."""
        return next((planned.tasks for planned in self.stages if planned.name == stage), ())

    def context(self) -> Context:
        """Context of the job after its tasks."""
        return _TaskContext(self)


@dataclass(frozen=True, slots=True)
class _JobFiles(TakeFiles):
    """Files on this machine."""

    job: LocalJob

    @property
    def has_viewers(self) -> bool:
        return False

    @property
    def keeps_pieces(self) -> bool:
        return bool(self.job.config.edits)  # without edits they are not asked for again

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

    job: LocalJob
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
        return [_read(self.job.outputs, task) for task in islice(self.job.stage_tasks(stage), tasks.start, tasks.stop)]

    def interim(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        if self.task is not None and stage not in STAGE_BY_NAME[self.task.stage].interim_of:
            raise ValueError(f"The stage {self.task.stage} does not declare interim outputs of {stage}.")
        return [_read(self.job.interim, task) for task in islice(self.job.stage_tasks(stage), tasks.start, tasks.stop)]

    def copy_output(self, stage: str, task: int, path: Path, is_interim: bool = False) -> None:
        folder = self.job.interim if is_interim else self.job.outputs
        (copied,) = islice(self.job.stage_tasks(stage), task, task + 1)
        if not folder.copy(copied.key, path):
            raise _removed(folder, copied)

    def stored_output(self) -> bytes | None:
        return None if self.task is None else self.job.outputs.read(self.task.key)


def run_stage(job: LocalJob, stage: PlannedStage, on_progress: OnProgress) -> list[Path]:
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


def _needs_interim(job: LocalJob, stage: PlannedStage) -> bool:
    """True if a later stage will read the stage's interim outputs: not if its own output is there already."""
    following = (task for name in interim_readers(stage.name) for task in job.stage_tasks(name))
    return STAGE_BY_NAME[stage.name].leaves_interim(job.config) and any(
        not STAGE_BY_NAME[task.stage].is_reusable or job.outputs.read(task.key) is None for task in following
    )


def _finished(job: LocalJob, tasks: Sequence[Task], on_unit: Callable[[Task], None]) -> Generator[Task, None, None]:
    """Run tasks; yields each one when it is done."""
    if len(tasks) > 1 and job.config.processes > 1 and job.pool is not None and job.pool.is_worth(tasks):
        return _finished_in_processes(job, tasks, job.pool)
    if len(tasks) > 1 and STAGE_BY_NAME[tasks[0].stage].runs_networks:
        return overlapped(tasks, partial(_run, job), on_unit)
    return (_run(job, task, partial(on_unit, task)) for task in tasks)


def _run(job: LocalJob, task: Task, on_unit: Callable[[], None] = lambda: None) -> Task:
    try:
        output = STAGE_BY_NAME[task.stage].function(task, _TaskContext(job, task, on_unit))
    except OSError as error:
        if job.files is None:
            raise
        raise not_written(job.files.folder, error) from error
    if output.interim is not None:
        job.interim.write(task.key, output.interim)
    for key, path in output.pieces.items():
        job.outputs.write(key, path)
    if job.files is not None:
        for file in output.files:
            _keep(file, job.files.folder)
    job.outputs.write(task.key, output.content)
    return task


def _keep(file: ResultFile, folder: Path) -> None:
    try:
        file.path.replace(folder / file.name)
    except OSError as error:
        raise not_written(folder, error) from error


def _finished_in_processes(job: LocalJob, tasks: Sequence[Task], pool: "TaskPool") -> Generator[Task, None, None]:
    try:
        yield from pool.start(job).map(_Worker.run, tasks)
    except BrokenProcessPool as error:
        raise ChildError(
            "A process was ended from outside, most likely for lack of memory. Try fewer processes."
        ) from error


class TaskPool:
    """Pool of a job's processes. It starts with the first stage of several tasks, and ends with ``stack``.

    Each process starts when it is first needed: that takes seconds.
    """

    def __init__(self, stack: contextlib.ExitStack) -> None:
        self._stack = stack
        self._started: ProcessPool | None = None

    def is_worth(self, tasks: Sequence[Task]) -> bool:
        """Return whether the pool has started, or its start takes less time than it will save."""
        return self._started is not None or sum(task.num_units for task in tasks) >= _UNITS_OF_A_START

    def start(self, job: LocalJob) -> ProcessPool:
        """Pool for the job."""
        if self._started is None:
            pool = ProcessPool(job.config.processes, _Worker.start, (replace(job, pool=None),))
            self._started = self._stack.enter_context(pool)
        return self._started


class _Worker:
    """State of a process of the pool from one task to the next."""

    job: LocalJob

    @classmethod
    def start(cls, job: LocalJob) -> None:
        scratch = tempfile.mkdtemp(prefix=f"{Path(job.scratch).name}-", dir=job.scratch)
        cls.job = replace(job, scratch=Path(scratch))

    @classmethod
    def run(cls, task: Task) -> Task:
        return _run(cls.job, task)


def _read(folder: OutputFolder, task: Task) -> bytes:
    content = folder.read(task.key)
    if content is None:
        raise _removed(folder, task)
    return content


def _removed(folder: OutputFolder, task: Task) -> PipelineError:
    message = f"An output of the stage {task.stage} was removed or changed in {folder.path} meanwhile."
    return PipelineError(f"{message} Run the command again.")


def _digests(session: Session, sources: Sequence[Path]) -> dict[str, str]:
    """SHA-256 of the files of a session by name: its videos, or its keypoints as they were read, and further files."""
    digests = {path.name: file_digest(path) for video in session.camera_videos.values() for path in video.paths}
    if not digests:
        digests["keypoints as they were read"] = record_sha256(session)
    return digests | {path.name: file_digest(path) for path in sources}


def file_digest(path: Path) -> str:
    """SHA-256 of a file, or of a folder of images."""
    try:
        return folder_sha256(path) if path.is_dir() else file_sha256(path)
    except OSError as error:
        raise PipelineError(f"The file {error.filename} can't be read: {error.strerror}.") from error


class UnitCounter:
    """Counter of the units of a stage that are done; it reports each of them."""

    def __init__(self, stage: PlannedStage, on_progress: OnProgress) -> None:
        self._stage, self._on_progress = stage.name, on_progress
        self._total = stage.num_units
        self._reused = self._whole = 0
        self._units = dict[int, int]()  # Units of each task at hand
        self._report()

    def on_unit(self, task: Task) -> None:
        """Count a unit of a task at hand. The number of units of a task is a good guess before it has run."""
        self._units[task.index] = min(self._units.get(task.index, 0) + 1, task.num_units)
        self._report()

    def finish(self, task: Task, is_reused: bool) -> None:
        """Count a whole task."""
        self._units.pop(task.index, None)
        self._whole += task.num_units
        self._reused += task.num_units if is_reused else 0
        self._report()

    def _report(self) -> None:
        done = self._whole + sum(self._units.values())
        self._on_progress(Progress(self._stage, done, self._total, self._reused))


@contextlib.contextmanager
def scratch_folder(results: Path | None) -> Iterator[Path]:
    """Folder for temporary files during the block; inside the folder of the results, if there is one: files are moved.

    Removes what killed processes left there. Raises ``PipelineError`` if the folder of the results can't be written.
    """
    if results is None:
        with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
            yield Path(folder)
        return
    is_new = not results.exists()
    with contextlib.ExitStack() as stack:
        try:
            results.mkdir(parents=True, exist_ok=True)
            if is_new:
                stack.callback(_remove_empty, results)
            scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=results)))
            stack.enter_context(FileLock(scratch / _LOCK, timeout=0))
        except OSError as error:
            raise not_written(results, error) from error
        for left in results.glob(f"{_UNFINISHED}*"):
            with contextlib.suppress(Timeout, OSError), FileLock(left / _LOCK, timeout=0):
                shutil.rmtree(left, ignore_errors=True)
        yield scratch


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):  # it is not empty
        folder.rmdir()


# Tasks of a stage in two threads of a process: while one is in a network, the other decodes and prepares pictures. One
# network runs at a time (`pipeline.detection.network`), so that a process still computes networks on one core. In one
# thread decoding and Python would add half of the networks' time.

# With a third, two would wait for the network; each has a decoder and a picture in memory.
_AT_ONCE = 2


class _UnwantedError(Exception):
    """End of a task whose output is not wanted any more."""


def overlapped(
    tasks: Sequence[Task], run: Callable[[Task, Callable[[], None]], object], on_unit: Callable[[Task], None]
) -> Generator[Task, None, None]:
    """Run tasks, two at a time; yields each one when it is done.

    Close the generator if it is not read to its end: that ends the tasks at their next unit, and waits for them.

    ``run``: runs a task in a thread, and calls a function after each of its units. ``on_unit``: called with the task
    after each unit, in the thread that reads the generator. Raises ``Exception``: error of the first of the tasks that
    fails, as if they ran one after the other. Later ones are ended.
    """
    events = SimpleQueue[tuple[int, Future[object] | None]]()
    num_wanted = len(tasks)
    error: BaseException | None = None

    def start(number: int) -> None:
        def count() -> None:
            if number >= num_wanted:
                raise _UnwantedError
            events.put((number, None))

        with uninterrupted():  # signals are for the thread that reads the generator
            future = pool.submit(run, tasks[number], count)
        future.add_done_callback(lambda future: events.put((number, future)))

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        try:
            num_started = min(_AT_ONCE, len(tasks))
            for number in range(num_started):
                start(number)
            num_running = num_started
            while num_running:
                number, future = events.get()
                if future is None:
                    on_unit(tasks[number])
                    continue
                num_running -= 1
                if (failure := future.exception()) is not None:
                    if number < num_wanted:
                        num_wanted, error = number, failure
                    continue
                if num_started < num_wanted:
                    start(num_started)
                    num_started, num_running = num_started + 1, num_running + 1
                if error is None:
                    yield tasks[number]
        finally:
            num_wanted = 0
    if error is not None:
        raise error
