"""Check of the session of a task by the people at a few instants, with its cameras or with refined ones."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from pipeline.capture.synchronization.session import on_measured_clocks
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import SessionCheck
from pipeline.run.engine.context import Context
from pipeline.run.engine.stage import Task
from pipeline.run.preflight.session import check_bodies, check_detections, with_clocks


def check_session(task: Task, context: Context) -> SessionCheck:
    """Check a session with the calibration as it was given, and its declared times if its clocks were not measured."""
    session, detections = context.session(), context.detections
    checked = _check(task, context, session.cameras)
    if context.clocks() is not None or detections.finds_fields:
        return checked
    near = partial(detections.near, task, session)
    return with_clocks(checked, session, near, detections.joints(session), task.cut(context.facts).parts)


def check_refined(task: Task, context: Context, cameras: Sequence[Camera]) -> SessionCheck:
    """Check a session with refined cameras."""
    return _check(task, context, cameras)


def _check(task: Task, context: Context, cameras: Sequence[Camera]) -> SessionCheck:
    given, clocks, detections = context.session(), context.clocks(), context.detections
    session = replace(given, cameras=tuple(cameras))
    joints, parts = detections.joints(given), task.cut(context.facts).parts
    if clocks is not None:
        return check_bodies(on_measured_clocks(session, clocks), detections.bodies(given), joints, parts)
    return check_detections(session, partial(detections.near, task, given), joints, parts)
