"""Inputs of tasks: access to the session and to outputs, the session on measured clocks, and its detections."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.config import ReconstructionConfig, detected_joints, networks_of
from pipeline.data import DamagedVideo, Detections, PafFields, Synchronization
from pipeline.detect.chunk import bodies_in, concatenate
from pipeline.detect.damage import damaged_videos
from pipeline.detect.entries import entry_of
from pipeline.detect.profiles.detection import joints_of
from pipeline.joints import MARKED_AT_CENTERS, JointOffsets, JointSet
from pipeline.runtime.npz import decode_arrays
from pipeline.stages.association import DetectionsByCamera, Session, restrict
from pipeline.stages.cameras.refinement import RefinedCalibration
from pipeline.stages.cameras.synchronization import largest_shift_s, on_measured_clocks
from pipeline.stages.codec import decode
from pipeline.stages.plan import DETECT, REFINE, SYNCHRONIZE, FrameCut, SessionFacts, Task
from pipeline.tracking.observations import Bodies, gather
from pipeline.video.timeline import frames_in

PEOPLE = "people.npz"
"""Name of an archive of people in the folder for temporary files."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a take, for people.

    Parameters
    ----------
    name
        Name of the session.
    files
        SHA-256 of its files by name, in hexadecimal digits.
    """

    name: str
    files: Mapping[str, str]


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
    def interim(self, stage: str) -> list[bytes]:
        """Interim outputs of all tasks of an earlier stage, in the tasks' order; see ``Stage.leaves_interim``."""

    @abstractmethod
    def found(self) -> bytes | None:
        """Output of this task if an earlier job has left it, and this job lacks only the interim output."""

    @abstractmethod
    def piece(self, key: str) -> bytes | None:
        """Piece of an output that an earlier task of the session has kept; ``None`` if there is none."""

    @abstractmethod
    def on_unit(self) -> None:
        """Count a unit of the task's progress; may raise to end the task."""


def wanted_session(session: Session, config: ReconstructionConfig) -> tuple[Session, JointSet]:
    """Session as if it had the wanted frames alone, numbered from 0, and the joints of its detections."""
    wanted = restrict(session, config.frames)
    return wanted, wanted.joints if isinstance(wanted, KeypointSession) else detection_joints(config)


def detection_joints(config: ReconstructionConfig) -> JointSet:
    """Joints that the networks of a configuration detect in videos."""
    return joints_of(networks_of(config), detected_joints(config))


def wanted_inputs(context: Context, session: Session) -> tuple[Session, JointSet]:
    """Wanted session on measured clocks, with refined cameras, and the joints of its detections."""
    wanted, joints = on_clocks(context, session)
    if (refined := refined_calibration(context)) is None:
        return wanted, joints
    return replace(wanted, cameras=refined.cameras), joints


def on_clocks(context: Context, session: Session) -> tuple[Session, JointSet]:
    """Wanted session on measured clocks, if they were measured, and the joints of its detections."""
    clocks = measured_clocks(context)
    return wanted_session(session if clocks is None else on_measured_clocks(session, clocks), context.config)


def measured_clocks(context: Context) -> Synchronization | None:
    """Measured clocks; ``None`` if the times are as declared."""
    return None if context.config.sync == "declared" else decode(Synchronization, *context.outputs(SYNCHRONIZE))


def refined_calibration(context: Context) -> RefinedCalibration | None:
    """Refined cameras and the report; ``None`` if the calibration stays as it is given."""
    return None if context.config.refine_calibration == "off" else decode(RefinedCalibration, *context.outputs(REFINE))


def from_first(frames: range, first: int) -> range:
    """Frames of the session in the numbering of its wanted frames."""
    return range(frames.start - first, frames.stop - first)


def measured_frames(context: Context, session: Session, frames: range) -> range:
    """Frames of a range of the plan among the wanted ones; the last range has all that measured clocks have added."""
    wanted = context.config.frames
    is_last = wanted is None and frames.stop == context.facts.num_frames
    stop = session.timebase.num_frames if is_last else frames.stop
    return from_first(range(frames.start, stop), 0 if wanted is None else wanted.start)


def all_bodies(
    context: Context, session: Session, joints: JointSet, chunks: Iterable[Detections]
) -> Mapping[str, Detections]:
    """All cameras' bodies from those of the tasks of detection, in the wanted frames."""
    found = concatenate(chunks, [camera.name for camera in session.cameras], len(joints.names))
    if context.config.sync == "declared" or not isinstance(session, CaptureSession) or session.frames is None:
        return found
    # More frames than wanted were detected, see `plan`.
    half_s = 0.5 / session.timebase.frame_rate_hz
    ends_s = session.timebase.time_s(0) - half_s, session.timebase.time_s(session.timebase.num_frames - 1) + half_s
    return {name: bodies_in(of, frames_in(session.times[name], *ends_s)) for name, of in found.items()}


def detected_bodies(context: Context) -> Iterator[Detections]:
    """Bodies of the tasks of detection, without their colours."""
    return (decode(Detections, content) for content in context.outputs(DETECT))


def detected_in(
    task: Task, context: Context, session: Session, joints: JointSet, number: int, frames: range
) -> DetectionsByCamera:
    """Detections in a range of the plan: consecutive tasks, one of each camera.

    Parameters
    ----------
    number, frames
        Number of the range, and its output frames.
    """
    if isinstance(session, KeypointSession):
        return session.detections
    num_cameras = len(session.cameras)
    numbers = range(number, number + 1)
    if context.config.sync == "auto":
        numbers = _ranges_near(task, context, session, frames)
    outputs = context.outputs(DETECT, slice(numbers.start * num_cameras, numbers.stop * num_cameras))
    if context.config.uses_fields:
        return {fields.camera: fields for fields in (decode(PafFields, content) for content in outputs)}
    return all_bodies(context, session, joints, (decode(Detections, content) for content in outputs))


def _ranges_near(task: Task, context: Context, session: Session, frames: range) -> range:
    """Numbers of the ranges of detection with frames that may have been taken in a range of output frames."""
    facts = context.facts
    reach = int(largest_shift_s(context.outline(), session) * facts.frame_rate_hz) + 2
    cut = FrameCut(range(facts.num_frames), facts.stretches, task.chunk_frames)
    near = [
        number for number, one in enumerate(cut) if one.start < frames.stop + reach and one.stop > frames.start - reach
    ]
    return range(near[0], near[-1] + 1) if near else range(0)


def gathered_bodies(context: Context) -> tuple[Bodies, tuple[DamagedVideo, ...]]:
    """All cameras' bodies as tracking takes them, and the damaged videos among those that show them."""
    session, joints = wanted_inputs(context, context.session())
    detections = (
        session.detections
        if isinstance(session, KeypointSession)
        else all_bodies(context, session, joints, _coloured(context, detected_bodies(context)))
    )
    damaged = damaged_videos(
        session,
        [(camera, of_camera.damaged) for camera, of_camera in detections.items()],
        [(camera, of_camera.changes) for camera, of_camera in detections.items()],
    )
    return gather(session.cameras, session.times, detections), damaged


def _coloured(context: Context, chunks: Iterable[Detections]) -> Iterable[Detections]:
    """Detections with their colours, if colours are measured."""
    if not context.config.uses_colours:
        return chunks
    colours = map(decode_arrays, context.interim(DETECT))
    return (replace(chunk, colour=arrays["colour"]) for chunk, arrays in zip(chunks, colours, strict=True))


def archive_of_people(context: Context, stage: str, name: str = PEOPLE) -> Path:
    """Write the people that a stage found to a file: in memory they would be a fifth of what a stage takes."""
    archive = context.scratch / name
    archive.write_bytes(*context.outputs(stage))
    return archive


def used_offsets(session: Session, config: ReconstructionConfig) -> JointOffsets:
    """Offsets by which the fit moves joints from the detector's marks to their centres; none for other smoothing."""
    if config.smoothing != "fit" or config.joint_centers == "off":
        return MARKED_AT_CENTERS
    if config.joint_centers != "auto":
        return entry_of(config.joint_centers).offsets
    # Nobody knows which program marked the joints of keypoint files.
    if isinstance(session, KeypointSession):
        return MARKED_AT_CENTERS
    networks = networks_of(config)
    if networks.near is not None and networks.refines_body:
        return entry_of(networks.near).offsets
    return entry_of(networks.body).offsets
