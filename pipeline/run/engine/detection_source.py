"""Detections in the session of a task: of networks, or of the files of another program.

No stage asks what kind of session it has. A session of videos has detections by the stage ``detect``, and a session of
keypoints brings its own: ``detection_source`` gives both alike.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession, Session
from pipeline.capture.synchronization.session_clocks import largest_shift_s
from pipeline.core.data.detections import DamagedVideo, Detections, DetectionsByCamera, PafFields
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffsets, JointSet
from pipeline.core.runtime.npz import decode_arrays
from pipeline.detection.bodies import concatenate
from pipeline.detection.damage import CheckedPictures, damaged_videos
from pipeline.detection.entries import detection_joints, find_entry, mark_offsets
from pipeline.detection.profiles.sizes import CameraLook
from pipeline.run.engine.stage import DETECT, LOOK, Context, FrameCut, Task
from pipeline.run.engine.wanted_frames import require_kind
from pipeline.video.timeline import frames_in


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
        """True if the detections are peaks and fields; else whole bodies."""

    @property
    @abstractmethod
    def measures_colours(self) -> bool:
        """True if the colours of the bodies are measured."""

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
    # The program that marked the joints is unknown.
    offsets = MARKED_AT_CENTERS
    turns_deg: Mapping[str, float] = MappingProxyType({})

    def joints(self, session: Session) -> JointSet:
        return require_kind(session, KeypointSession).joints

    def bodies(self, session: Session, with_colours: bool = False) -> Mapping[str, Detections]:
        return require_kind(session, KeypointSession).detections

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
        return self._joined(require_kind(session, CaptureSession), chunks)

    def in_range(self, task: Task, session: Session, number: int, frames: range) -> DetectionsByCamera:
        context, num_cameras = self._context, len(session.cameras)
        numbers = range(number, number + 1)
        if context.config.sync == "auto":
            numbers = self._ranges_taken_in(task, session, frames)
        tasks = slice(numbers.start * num_cameras, numbers.stop * num_cameras)
        if self.finds_fields:
            return {fields.camera: fields for fields in context.records(DETECT, PafFields, tasks)}
        return self._joined(require_kind(session, CaptureSession), context.records(DETECT, Detections, tasks))

    def near(self, task: Task, session: Session, frames: Sequence[range]) -> list[DetectionsByCamera]:
        return [
            self.in_range(task, session, number, part)
            for number, part in enumerate(task.cut(self._context.facts))
            if any(part.start < some.stop and some.start < part.stop for some in frames)
        ]

    def damaged_videos(self, session: Session, pictures: Iterable[CheckedPictures]) -> tuple[DamagedVideo, ...]:
        return damaged_videos(require_kind(session, CaptureSession), pictures)

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


def detection_source(context: Context) -> DetectionSource:
    """Detections in the session of a task."""
    return _VideoDetections(context) if context.facts.has_videos else _FileDetections(context)


def joint_offsets(context: Context) -> JointOffsets:
    """Offsets by which the fit moves joints from the detector's marks to the centres; other smoothing has none."""
    config = context.config
    if config.smoothing != "fit" or config.joint_centers == "off":
        return MARKED_AT_CENTERS
    if config.joint_centers != "auto":
        return find_entry(config.joint_centers).offsets
    return detection_source(context).offsets
