"""Contract of stages and executors: declarations, tasks on ranges of frames, their context, outputs.

Standard library only. A module of ``pipeline.run.steps`` declares its stages beside their functions. Its head imports
this module and the standard library, so that the plan of a job loads no science; a function imports what it needs when
it runs. A task gets what every task needs from its ``Context``. ``wanted_frames``, ``detections``, ``stored_people``
and ``methods`` derive the rest from it: cameras and clocks, detections, people, and association.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pipeline.core.errors import PipelineError
from pipeline.core.findings import Finding
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import PersonSpan
from pipeline.core.options.providers import ProviderName
from pipeline.core.progress import OnShare, in_units
from pipeline.core.records import Kind
from pipeline.core.runtime.resources import release_pages

if TYPE_CHECKING:
    from pipeline.capture.session import Session
    from pipeline.export.character.source import CharacterSource

LOOK, DETECT, SYNCHRONIZE, REFINE = "look", "detect", "synchronize", "refine"
LENGTHS, POSES, ASSOCIATE = "lengths", "poses", "associate"
EXPECT, REDETECT = "expect_bodies", "redetect"
IDENTIFY, FIT, HOLD = "identify", "fit", "hold_feet"
EDIT, REFIT = "edit", "refit"
WRITE, EXPORT = "write_people", "export"
HEADS, BLUR = "find_heads", "blur_videos"
OVERLAY, REPORT, RECORD = "draw_overlay", "write_report", "write_recording"
RETARGET = "retarget_character"
OPENSIM = "run_opensim"
FIND_BOARD, CALIBRATE, PROXY = "find_board", "make_calibration", "make_proxy"
CHECK = "check_session"
TAKE = CHECK, SYNCHRONIZE, REFINE, IDENTIFY, HOLD, EDIT, REFIT
"""Stages of whose outputs a take is assembled; see ``pipeline.run.engine.take``."""

# Largest number of tasks of a stage that is cut by person.
_MOST_PARTS = 4

VIEWER = "viewer"
"""Kind of the files that viewers read; lists of downloads leave them out."""
MOTION, DESCRIPTION = "motion.bin", "motion.json"
"""Names of these files."""

Cut = Literal["cameras", "camera ranges", "ranges", "people", "whole"]


@dataclass(frozen=True, slots=True)
class SessionFacts:
    """Facts of a session that a plan depends on."""

    inputs: tuple[str, ...]  # Digests of the files, and of all that was found in them or stated about them
    # Output frames of the session, and their rate
    num_frames: int
    frame_rate_hz: float
    stretches: tuple[range, ...]  # Output frames in which a camera took frames, ascending; pauses lie between them
    camera_rates_hz: Mapping[str, float]  # Frame rate of each camera, by name, in the session's order
    has_videos: bool  # True if the session consists of videos; else of keypoints
    has_points: bool = False  # True if the session consists of people in 3D: nothing is detected or associated


@dataclass(frozen=True, slots=True)
class FrameCut:
    """Cut of a session's output frames into ranges."""

    frames: range  # Wanted output frames
    # Output frames of the session that have to be worked on, ascending; ranges without any of them are left out
    stretches: tuple[range, ...]
    chunk_frames: int  # Length of a range. Ranges begin at its multiples; the first and the last one may be shorter.

    def __iter__(self) -> Iterator[range]:
        """Ranges in order, at least one."""
        stop = 0
        for part in self.parts:
            first = max(stop, part.start // self.chunk_frames)
            stop = -(-part.stop // self.chunk_frames)
            for number in range(first, stop):
                start = number * self.chunk_frames
                yield range(max(start, self.frames.start), min(start + self.chunk_frames, self.frames.stop))

    @property
    def num_frames(self) -> int:
        """Number of frames of all parts."""
        return sum(map(len, self.parts))

    @property
    def parts(self) -> list[range]:
        """Stretches within the wanted frames; the first wanted frame if there are none."""
        inside = (
            range(max(stretch.start, self.frames.start), min(stretch.stop, self.frames.stop))
            for stretch in self.stretches
        )
        return [part for part in inside if part] or [self.frames[:1]]


@dataclass(frozen=True, slots=True)
class Task:
    """A task of a stage."""

    stage: str  # Name of the stage
    index: int  # Number within the stage
    camera: str | None  # Camera whose frames it is about; ``None``: all cameras
    frames: range  # Output frames, in the session's numbering
    chunk_frames: int  # Length of the ranges into which the session's frames are cut
    num_units: int  # Number of units that its progress counts, at least 1
    key: str  # Content-addressed key of its output
    # Key of all that pieces of its output depend on but the edits of people, for stages that follow edits; see
    # ``pipeline.run.engine.pieces``
    piece_key: str = ""

    @property
    def one_camera(self) -> str:
        """Camera of a task of a stage that is cut by camera."""
        if self.camera is None:
            raise PipelineError(f"Tasks of the stage {self.stage} are of one camera each.")
        return self.camera

    def cut(self, facts: SessionFacts) -> FrameCut:
        """Cut of the frames of a task on the whole session into the ranges of the plan."""
        return FrameCut(self.frames, facts.stretches, self.chunk_frames)


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a take, for people."""

    name: str  # Name of the session
    files: Mapping[str, str]  # SHA-256 of its files by name, in hexadecimal digits


class TakeFiles(ABC):
    """Files of a take: those that a job takes in or leaves beside its outputs."""

    @property
    @abstractmethod
    def has_viewers(self) -> bool:
        """True if the files for viewers are wanted beside the result files."""

    @property
    @abstractmethod
    def keeps_pieces(self) -> bool:
        """True if pieces of the outputs are kept, so that later edits of people find them."""

    @abstractmethod
    def piece(self, key: str) -> bytes | None:
        """Piece of an output that an earlier task of the session has kept; ``None`` if there is none."""

    @abstractmethod
    def origin(self) -> Origin:
        """Name of the session, and its files."""

    @abstractmethod
    def character(self) -> "CharacterSource":
        """Character onto which everybody is retargeted; ``PipelineError`` if there is none."""


class Context(ABC):
    """Access of a task to its job, to the outputs of earlier stages, and to its executor."""

    @property
    @abstractmethod
    def config(self) -> ReconstructionConfig:
        """Configuration of the reconstruction."""

    @property
    @abstractmethod
    def facts(self) -> SessionFacts:
        """Facts of the session for which the task was planned."""

    @property
    @abstractmethod
    def scratch(self) -> Path:
        """Folder for temporary files and result files of this task."""

    @property
    @abstractmethod
    def provider(self) -> ProviderName:
        """Execution provider of the networks of the reconstruction."""

    @property
    @abstractmethod
    def files(self) -> TakeFiles:
        """Files of the take."""

    @abstractmethod
    def session(self) -> "Session":
        """The whole session."""

    @abstractmethod
    def outline(self) -> "Session":
        """The whole session without the detections of keypoint files, which take most of its memory."""

    @abstractmethod
    def video(self, camera: str) -> AbstractContextManager[None]:
        """Block in which the video of a camera can be read."""

    @abstractmethod
    def outputs(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        """Outputs of tasks of an earlier stage, in the tasks' order; by default of all tasks."""

    def records(self, stage: str, kind: Callable[..., Kind], tasks: slice = slice(None)) -> Iterator[Kind]:
        """Outputs of tasks of an earlier stage as the records that were encoded, in the tasks' order."""
        from pipeline.core.runtime.record_archive import decode

        return (decode(kind, content) for content in self.outputs(stage, tasks))

    def record(self, stage: str, kind: Callable[..., Kind]) -> Kind:
        """Output of the single task of an earlier stage as the record that was encoded."""
        (record,) = self.records(stage, kind)
        return record

    @abstractmethod
    def interim(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        """Interim outputs of tasks of an earlier stage, like ``outputs``; see ``Stage.leaves_interim``."""

    @abstractmethod
    def copy_output(self, stage: str, task: int, path: Path, is_interim: bool = False) -> None:
        """Copy the output, or the interim output, of a task of an earlier stage to a file: it may exceed the memory."""

    def finished(self, stage: str, tasks: slice) -> list[bytes | None]:
        """Outputs of other tasks of a stage that runs, ``None`` of a task that has not ended; none without viewers."""
        return []

    @abstractmethod
    def stored_output(self) -> bytes | None:
        """Output of this task if an earlier job has left it, and this job lacks only the interim output."""

    @abstractmethod
    def on_unit(self) -> None:
        """Count a unit of the task's progress; may raise to end the task."""

    def on_share(self, task: Task) -> OnShare:
        """Function that counts the units of a task by the share of its work that is done, and frees large arrays."""
        on_units = in_units(task.num_units, self.on_unit)

        def on_share(share: float) -> None:
            release_pages()
            on_units(share)

        return on_share


@dataclass(frozen=True, slots=True)
class ResultFile:
    """A result file for the client. The executor may move it away from ``path``.

    ``person`` is the number of a person, ``person_name`` the person's name.
    """

    name: str
    kind: str
    person: int | None
    media_type: str
    path: Path
    person_name: str | None = None


@dataclass(frozen=True, slots=True)
class Output:
    """Output of a task."""

    # Bytes that later stages read, or a file of them; see ``pipeline.core.runtime.record_archive``
    content: bytes | Path
    files: tuple[ResultFile, ...] = ()  # Result files, of the last stage only
    warnings: tuple[Finding, ...] = ()  # Findings about the results, for the last stage only
    # Bytes, or a file, that later stages of the same job read, and that are removed when the job ends; ``None``: none
    interim: bytes | Path | None = None
    # JSON of ``pipeline.run.engine.first_people``, to be looked at until the job ends; ``None``: nothing to see
    first_people: bytes | None = None
    # Calibration that the job has made: ``files``, texts by format, and ``report``
    calibration: Mapping[str, Any] | None = None
    # Files with pieces of the output, by key: kept with the session, so that later tasks find them. See
    # ``pipeline.run.engine.pieces``.
    pieces: Mapping[str, Path] = field(default_factory=dict)
    # People found by the job, before any edit; ``None`` of a task that writes no results
    people: tuple[PersonSpan, ...] | None = None


def indexed(files: Sequence[ResultFile], **figures: Any) -> Output:
    """Result files, and an index of them with figures about them."""
    return Output(json.dumps({"files": [file.name for file in files], **figures}).encode(), tuple(files))


@dataclass(frozen=True, slots=True)
class Stage:
    """Declaration of a stage: its function, its cut into tasks, and what its outputs depend on.

    A module of ``pipeline.run.steps`` holds the declaration; ``plan`` collects all of them. Labels of forms and
    progress bars, keys of outputs and totals of progress are derived from it.

    Parameters
    ----------
    name, label
        Name in the service's API, in keys and in logs, and what forms and progress bars call it.
    function
        Runs a task whose stages before it are done. It raises ``InputError`` if a video can't be decoded or too many of
        its frames are damaged, ``ModelError`` if the detector is not installed, and ``PipelineError`` if a result file
        is not whole when it is read back.
    cut
        How it is cut into tasks: by camera, by camera and range of frames, by range of frames, by person, or not at
        all.
    follows
        Stages whose outputs it reads, as far as they are planned; the others in the plan before it must be done too.
    choices
        Keys of ``effective_choices`` on which its output depends. All stages depend on a choice that no stage names.
    is_planned
        Whether a job has this stage.
    frames_a_part
        Frames for each task of a stage that is cut by person, so that the shortest takes have one.
    unit, frames_a_unit
        What its progress counts; frames of a camera that a unit of a stage on ranges of cameras stands for.
    max_frames
        Largest number of frames of a camera that it looks at; ``None``: all.
    looked_at_hz
        Rate of the frames that a stage on all cameras looks at; ``None``: it works a tenth as long as detection would.
    is_reusable
        Whether its outputs serve other jobs of the session too.
    leaves_interim
        Whether its tasks leave interim outputs beside their outputs: for stages of the same job, removed when the job
        ends. An interim output belongs to no key. A task whose output is reused runs all the same if its interim output
        is missing and a stage that reads it has yet to run.
    interim_of
        Stages whose interim outputs it reads, as far as they leave some.
    reads_videos
        Whether it fails without the session's videos.
    runs_networks
        Whether networks run in it: its output depends on their execution provider, and two tasks overlap
        (``overlapped``).
    makes_files, is_of_edits
        Whether its output are result files, and their index; whether it works for edits of people alone.
    pieces_of
        Stage on whose code and choices pieces of its output depend, which are kept for other edits; empty: there are
        no pieces.

    Examples
    --------
    >>> def count(task: Task, context: Context) -> Output:
    ...     return Output(str(len(task.frames)).encode())
    >>> stage = Stage("count", "Count frames", count, cut="people", follows=(IDENTIFY,), choices=("frame_range",))
    >>> stage.num_parts(range(60))
    2
    """

    name: str
    label: str
    function: Callable[[Task, Context], Output]
    cut: Cut
    follows: tuple[str, ...]
    choices: tuple[str, ...]
    is_planned: Callable[[SessionFacts, ReconstructionConfig], bool] = lambda facts, config: config.is_of_people
    frames_a_part: int = 25
    unit: Literal["frames", "steps"] = "steps"
    frames_a_unit: int = 1
    max_frames: int | None = None
    looked_at_hz: float | None = None
    is_reusable: bool = True
    leaves_interim: Callable[[ReconstructionConfig], bool] = lambda config: False
    interim_of: tuple[str, ...] = ()
    reads_videos: bool = False
    runs_networks: bool = False
    makes_files: bool = False
    is_of_edits: bool = False
    pieces_of: str = ""

    def num_parts(self, frames: range) -> int:
        """Number of its tasks, if it is cut by person: person number k is in task k modulo this number.

        A plan is made before anybody is found.
        """
        return max(1, min(_MOST_PARTS, len(frames) // self.frames_a_part))

    def people(self, task: Task) -> slice:
        """Numbers of the people of one of its tasks, if it is cut by person."""
        return slice(task.index, None, self.num_parts(task.frames))


def declared(name: str, label: str, **options: Any) -> Callable[[Callable[[Task, Context], Output]], Stage]:
    """Declare a function as a stage; options are the parameters of ``Stage``."""
    return lambda function: Stage(name, label, function, **options)
