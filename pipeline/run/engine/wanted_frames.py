"""Wanted frames of a job's session: on measured clocks, with refined cameras."""

from dataclasses import replace
from typing import TypeVar

from pipeline.capture.session import CaptureSession, Session
from pipeline.capture.synchronization.session_clocks import on_measured_clocks
from pipeline.core.data.cameras import RefinedCalibration, Synchronization
from pipeline.core.errors import PipelineError
from pipeline.run.engine.stage import REFINE, SYNCHRONIZE, Context

_Kind = TypeVar("_Kind", bound=Session)


def measured_clocks(context: Context) -> Synchronization | None:
    """Measured clocks; ``None`` if the times are as declared."""
    is_declared = context.config.sync == "declared" or context.facts.has_points
    return None if is_declared else context.record(SYNCHRONIZE, Synchronization)


def refined_calibration(context: Context) -> RefinedCalibration | None:
    """Refined cameras and the report; ``None`` if the calibration stays as it is given."""
    is_given = context.config.refine_calibration == "off" or context.facts.has_points
    return None if is_given else context.record(REFINE, RefinedCalibration)


def wanted_on_clocks(context: Context, session: Session) -> Session:
    """Wanted frames of the whole session or its outline, numbered from 0, on measured clocks if they were measured.

    Raises ``InputError`` if the session has no such frames.
    """
    clocks = measured_clocks(context)
    return (session if clocks is None else on_measured_clocks(session, clocks)).restricted(context.config.frames)


def wanted_frames(context: Context, session: Session) -> Session:
    """Wanted frames as ``wanted_on_clocks`` gives them, with refined cameras if they were refined."""
    refined, on_clocks = refined_calibration(context), wanted_on_clocks(context, session)
    return on_clocks if refined is None else replace(on_clocks, cameras=refined.cameras)


def numbered_from_first(context: Context, frames: range, session: Session) -> range:
    """Frames of a range of the plan among the wanted ones; the last range has all that measured clocks added."""
    wanted = context.config.frames
    is_last = wanted is None and frames.stop == context.facts.num_frames
    return from_first(range(frames.start, session.timebase.num_frames) if is_last else frames, wanted)


def from_first(frames: range, wanted: range | None) -> range:
    """Frames of the session in the numbering of its wanted frames; ``None``: all are wanted."""
    first = 0 if wanted is None else wanted.start
    return range(frames.start - first, frames.stop - first)


def captured_videos(context: Context) -> CaptureSession:
    """The whole session, for stages that are planned for videos alone."""
    return require_kind(context.session(), CaptureSession)


def require_kind(session: Session, kind: type[_Kind]) -> _Kind:
    """Session of the kind that the task was planned for."""
    if not isinstance(session, kind):
        raise PipelineError(f"The task was planned for a {kind.__name__}, not for a {type(session).__name__}.")
    return session
