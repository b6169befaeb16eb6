"""What a task may ask: its session, the detections in it, the outputs of earlier stages, and its executor.

No stage asks what kind of session it has. A session of videos has detections by the stage ``detect``, and a session of
keypoints brings its own: ``Context.detections`` gives both alike.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from pipeline.association.tracking.observations import Detections2D, gather
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession, Session
from pipeline.capture.synchronization.session import largest_shift_s, on_measured_clocks
from pipeline.core.data.cameras import Synchronization
from pipeline.core.data.detections import DamagedVideo, Detections, DetectionsByCamera, PafFields
from pipeline.core.data.heads import HeadRegions
from pipeline.core.errors import PipelineError
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffsets, JointSet, without_hands
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.providers import ProviderName
from pipeline.core.progress import OnShare, in_units
from pipeline.core.runtime.npz import decode_arrays
from pipeline.detection.chunk import concatenate
from pipeline.detection.damage import CheckedPictures, damaged_videos
from pipeline.detection.entries import entry_of
from pipeline.detection.look import CameraLook
from pipeline.detection.profiles.detection import detection_joints, mark_offsets
from pipeline.export.character.source import CharacterSource
from pipeline.run.engine.association import Association
from pipeline.run.engine.codec import decode
from pipeline.run.engine.people import StoredPeople
from pipeline.run.engine.refinement import RefinedCalibration
from pipeline.run.engine.stage import DETECT, HEADS, LOOK, REFINE, SYNCHRONIZE, FrameCut, SessionFacts, Task
from pipeline.video.timeline import frames_in

_Record = TypeVar("_Record")
_Kind = TypeVar("_Kind", CaptureSession, KeypointSession)


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a take, for people."""

    name: str  # Name of the session
    files: Mapping[str, str]  # SHA-256 of its files by name, in hexadecimal digits


class Context(ABC):
    """Access of a task to its session, to the outputs of earlier stages, and to its executor."""

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
    def has_viewers(self) -> bool:
        """Whether the files for viewers are wanted beside the result files."""

    @property
    @abstractmethod
    def keeps_pieces(self) -> bool:
        """Whether pieces of the outputs are kept, so that later edits of people find them."""

    @abstractmethod
    def session(self) -> Session:
        """The whole session."""

    @abstractmethod
    def origin(self) -> Origin:
        """Name of the session, and its files."""

    def character(self) -> CharacterSource:
        """Character onto which everybody is retargeted; ``PipelineError`` if there is none."""
        raise PipelineError("This executor has no characters.")

    @abstractmethod
    def outline(self) -> Session:
        """The whole session without the detections of keypoint files, which take most of its memory."""

    @abstractmethod
    def video(self, camera: str) -> AbstractContextManager[None]:
        """Block in which the video of a camera can be read."""

    @abstractmethod
    def outputs(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        """Outputs of tasks of an earlier stage, in the tasks' order; by default of all tasks."""

    @abstractmethod
    def interim(self, stage: str, tasks: slice = slice(None)) -> list[bytes]:
        """Interim outputs of tasks of an earlier stage, as of ``outputs``; see ``Stage.leaves_interim``."""

    @abstractmethod
    def stored_output(self) -> bytes | None:
        """Output of this task if an earlier job has left it, and this job lacks only the interim output."""

    @abstractmethod
    def piece(self, key: str) -> bytes | None:
        """Piece of an output that an earlier task of the session has kept; ``None`` if there is none."""

    @abstractmethod
    def on_unit(self) -> None:
        """Count a unit of the task's progress; may raise to end the task."""

    def on_share(self, task: Task) -> OnShare:
        """Function that counts the units of a task by the share of its work that is done."""
        return in_units(task.num_units, self.on_unit)

    def records(self, stage: str, kind: Callable[..., _Record], tasks: slice = slice(None)) -> Iterator[_Record]:
        """Outputs of tasks of an earlier stage as the records that were encoded, in the tasks' order."""
        return (decode(kind, content) for content in self.outputs(stage, tasks))

    def record(self, stage: str, kind: Callable[..., _Record]) -> _Record:
        """Output of the single task of an earlier stage as the record that was encoded."""
        (record,) = self.records(stage, kind)
        return record

    def people(self, stage: str) -> StoredPeople:
        """People that a stage found, in a file: in memory they would be a fifth of what a stage takes."""
        path = self.scratch / f"of-{stage}.npz"
        path.write_bytes(*self.outputs(stage))
        return StoredPeople(path)

    def videos(self) -> CaptureSession:
        """The whole session, for stages that are planned for videos alone."""
        return _of_kind(self.session(), CaptureSession)

    def clocks(self) -> Synchronization | None:
        """Measured clocks; ``None`` if the times are as declared."""
        return None if self.config.sync == "declared" else self.record(SYNCHRONIZE, Synchronization)

    def refined(self) -> RefinedCalibration | None:
        """Refined cameras and the report; ``None`` if the calibration stays as it is given."""
        return None if self.config.refine_calibration == "off" else self.record(REFINE, RefinedCalibration)

    def heads(self, camera: str) -> HeadRegions | None:
        """Heads to be blurred in the pictures of a camera; ``None`` if none are."""
        if not (self.config.blur_faces and self.facts.has_videos):
            return None
        regions = self.record(HEADS, tuple[HeadRegions, ...])
        return next(known for known in regions if known.camera == camera)

    def on_clocks(self, session: Session) -> Session:
        """Wanted frames of the whole session or its outline, numbered from 0, on measured clocks if they were measured.

        Raises ``InputError`` if the session has no such frames.
        """
        clocks = self.clocks()
        return (session if clocks is None else on_measured_clocks(session, clocks)).restricted(self.config.frames)

    def wanted(self, session: Session) -> Session:
        """Wanted frames as of ``on_clocks``, with refined cameras if they were refined."""
        refined, on_clocks = self.refined(), self.on_clocks(session)
        return on_clocks if refined is None else replace(on_clocks, cameras=refined.cameras)

    def numbered_from_first(self, frames: range, session: Session) -> range:
        """Frames of a range of the plan among the wanted ones; the last range has all that measured clocks added."""
        wanted = self.config.frames
        is_last = wanted is None and frames.stop == self.facts.num_frames
        return from_first(range(frames.start, session.timebase.num_frames) if is_last else frames, wanted)

    @property
    def detections(self) -> "DetectionSource":
        """Detections in the session."""
        return _VideoDetections(self) if self.facts.has_videos else _FileDetections(self)

    def association(self, session: Session) -> Association:
        """Association of the detections in a session, whole or wanted, to people."""
        joints, fields = without_hands(self.detections.joints(session)), self.detections.finds_fields
        return Association(session.cameras, session.times, session.timebase, joints, self.config, fields)

    def gathered_bodies(self) -> tuple[Detections2D, tuple[DamagedVideo, ...]]:
        """Bodies of all cameras as tracking takes them, and the damaged videos among those that show them."""
        session, source = self.wanted(self.session()), self.detections
        bodies = source.bodies(session, with_colours=source.measures_colours)
        damaged = source.damaged_videos(session, [(name, seen.damaged, seen.changes) for name, seen in bodies.items()])
        return gather(session.cameras, session.times, bodies), damaged

    def offsets(self) -> JointOffsets:
        """Offsets by which the fit moves joints from the detector's marks to the centres; other smoothing has none."""
        if self.config.smoothing != "fit" or self.config.joint_centers == "off":
            return MARKED_AT_CENTERS
        if self.config.joint_centers != "auto":
            return entry_of(self.config.joint_centers).offsets
        return self.detections.offsets


class DetectionSource(ABC):
    """Detections in the session of a task: of networks, or of the files of another program."""

    def __init__(self, context: Context) -> None:
        self._context = context

    @property
    @abstractmethod
    def networks(self) -> tuple[str, ...]:
        """Names of the networks that find the joints."""

    @property
    @abstractmethod
    def finds_fields(self) -> bool:
        """Whether the detections are peaks and fields; else whole bodies."""

    @property
    @abstractmethod
    def measures_colours(self) -> bool:
        """Whether the colours of the bodies are measured."""

    @property
    @abstractmethod
    def offsets(self) -> JointOffsets:
        """Offsets of the marks from the joints' centres."""

    @property
    @abstractmethod
    def turns_deg(self) -> Mapping[str, float]:
        """Counterclockwise turns that brought the pictures upright, by camera, in degrees."""

    @abstractmethod
    def joints(self, session: Session) -> JointSet:
        """Joints of the detections in a session."""

    @abstractmethod
    def bodies(self, session: Session, with_colours: bool = False) -> Mapping[str, Detections]:
        """Bodies of all cameras in the frames of a session, whole or wanted."""

    @abstractmethod
    def in_range(self, task: Task, session: Session, number: int, frames: range) -> DetectionsByCamera:
        """Detections in a range of the plan, and maybe others.

        ``frames`` are its output frames in the numbering of the whole session.
        """

    @abstractmethod
    def near(self, task: Task, session: Session, frames: Sequence[range]) -> list[DetectionsByCamera]:
        """Detections in the ranges of the plan that have some of given output frames, each once, and maybe others."""

    @abstractmethod
    def damaged_videos(self, session: Session, pictures: Iterable[CheckedPictures]) -> tuple[DamagedVideo, ...]:
        """Damaged and doubled frames of each video; see ``pipeline.detection.damage``."""


class _FileDetections(DetectionSource):
    """Bodies in files of another program: they came with the session."""

    networks = ()
    finds_fields = False
    measures_colours = False
    # Nobody knows which program marked the joints.
    offsets = MARKED_AT_CENTERS
    turns_deg: Mapping[str, float] = MappingProxyType({})

    def joints(self, session: Session) -> JointSet:
        return _of_kind(session, KeypointSession).joints

    def bodies(self, session: Session, with_colours: bool = False) -> Mapping[str, Detections]:
        return _of_kind(session, KeypointSession).detections

    def in_range(self, task: Task, session: Session, number: int, frames: range) -> DetectionsByCamera:
        return self.bodies(session)

    def near(self, task: Task, session: Session, frames: Sequence[range]) -> list[DetectionsByCamera]:
        return [self.bodies(session)]

    def damaged_videos(self, session: Session, pictures: Iterable[CheckedPictures]) -> tuple[DamagedVideo, ...]:
        return ()


class _VideoDetections(DetectionSource):
    """Bodies, or peaks and fields, that the stage ``detect`` found in videos."""

    @property
    def networks(self) -> tuple[str, ...]:
        return self._context.config.networks.names

    @property
    def finds_fields(self) -> bool:
        return self._context.config.uses_fields

    @property
    def measures_colours(self) -> bool:
        return self._context.config.uses_colours

    @property
    def offsets(self) -> JointOffsets:
        return mark_offsets(self._context.config)

    @property
    def turns_deg(self) -> Mapping[str, float]:
        looks = self._context.records(LOOK, CameraLook)
        return {name: look.turn_deg for name, look in zip(self._context.facts.camera_rates_hz, looks, strict=True)}

    def joints(self, session: Session) -> JointSet:
        return detection_joints(self._context.config)

    def bodies(self, session: Session, with_colours: bool = False) -> Mapping[str, Detections]:
        chunks = self._context.records(DETECT, Detections)
        if with_colours:
            colours = map(decode_arrays, self._context.interim(DETECT))
            chunks = (replace(chunk, colour=arrays["colour"]) for chunk, arrays in zip(chunks, colours, strict=True))
        return self._joined(_of_kind(session, CaptureSession), chunks)

    def in_range(self, task: Task, session: Session, number: int, frames: range) -> DetectionsByCamera:
        context, num_cameras = self._context, len(session.cameras)
        numbers = range(number, number + 1)
        if context.config.sync == "auto":
            numbers = self._ranges_taken_in(task, session, frames)
        tasks = slice(numbers.start * num_cameras, numbers.stop * num_cameras)
        if self.finds_fields:
            return {fields.camera: fields for fields in context.records(DETECT, PafFields, tasks)}
        return self._joined(_of_kind(session, CaptureSession), context.records(DETECT, Detections, tasks))

    def near(self, task: Task, session: Session, frames: Sequence[range]) -> list[DetectionsByCamera]:
        return [
            self.in_range(task, session, number, part)
            for number, part in enumerate(task.cut(self._context.facts))
            if any(part.start < some.stop and some.start < part.stop for some in frames)
        ]

    def damaged_videos(self, session: Session, pictures: Iterable[CheckedPictures]) -> tuple[DamagedVideo, ...]:
        return damaged_videos(_of_kind(session, CaptureSession), pictures)

    def _joined(self, session: CaptureSession, chunks: Iterable[Detections]) -> dict[str, Detections]:
        """Bodies of the tasks of detection by camera, in the frames of a session."""
        joined = concatenate(chunks, [camera.name for camera in session.cameras], len(self.joints(session).names))
        if self._context.config.sync == "declared" or session.frames is None:
            return joined
        # More frames than wanted were detected, see `plan`.
        half_s = 0.5 / session.timebase.frame_rate_hz
        ends_s = session.timebase.time_s(0) - half_s, session.timebase.time_s(session.timebase.num_frames - 1) + half_s
        return {name: bodies.within(frames_in(session.times[name], *ends_s)) for name, bodies in joined.items()}

    def _ranges_taken_in(self, task: Task, session: Session, frames: range) -> range:
        """Numbers of the ranges of detection with frames that may have been taken in a range of output frames."""
        facts = self._context.facts
        reach = int(largest_shift_s(self._context.outline(), session) * facts.frame_rate_hz) + 2
        cut = FrameCut(range(facts.num_frames), facts.stretches, task.chunk_frames)
        near = [
            number
            for number, part in enumerate(cut)
            if part.start < frames.stop + reach and part.stop > frames.start - reach
        ]
        return range(near[0], near[-1] + 1) if near else range(0)


def from_first(frames: range, wanted: range | None) -> range:
    """Frames of the session in the numbering of its wanted frames; ``None``: all are wanted."""
    first = 0 if wanted is None else wanted.start
    return range(frames.start - first, frames.stop - first)


def _of_kind(session: Session, kind: type[_Kind]) -> _Kind:
    """Session of the kind that the task was planned for."""
    if not isinstance(session, kind):
        raise PipelineError(f"The task was planned for a {kind.__name__}, not for a {type(session).__name__}.")
    return session
