"""Check the session: by the people at a few instants. The output is a ``SessionCheck``.

A session with errors is refused here, after its detections are stored and before anybody is associated.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from pipeline.run.engine.stage import CHECK, DETECT, LOOK, SYNCHRONIZE, Context, Output, Task, declared

if TYPE_CHECKING:
    from pipeline.core.data.cameras import Camera
    from pipeline.core.findings import SessionCheck


@declared(
    CHECK, "Checking the capture", cut="whole", follows=(LOOK, DETECT, SYNCHRONIZE), choices=("frame_range", "force")
)
def check(task: Task, context: Context) -> Output:
    """Check the session as it was given, on measured clocks if they were measured."""
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.wanted_frames import measured_clocks
    from pipeline.run.session_check.check_session import hanging_cameras, with_clocks
    from pipeline.run.session_check.verdict import judge

    session, detections = context.session(), detection_source(context)
    checked = check_with(task, context, session.cameras)
    if measured_clocks(context) is None and not detections.finds_fields:
        # The declared times have not been measured.
        near, parts = partial(detections.near, task, session), task.cut(context.facts).parts
        checked = with_clocks(checked, session, near, detections.joints(session), parts)
    checked = replace(checked, findings=(*checked.findings, *hanging_cameras(detections.turns_deg)))
    return Output(encode(judge(checked, session.cameras, context.config)))


def check_with(task: Task, context: Context, cameras: "Sequence[Camera]") -> "SessionCheck":
    """Check the session with its cameras or with refined ones."""
    from pipeline.capture.synchronization.session_clocks import on_measured_clocks
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.wanted_frames import measured_clocks
    from pipeline.run.session_check.check_session import check_bodies, check_detections

    given, clocks, detections = context.session(), measured_clocks(context), detection_source(context)
    session = replace(given, cameras=tuple(cameras))
    joints, parts = detections.joints(given), task.cut(context.facts).parts
    if clocks is not None:
        return check_bodies(on_measured_clocks(session, clocks), detections.bodies(given), joints, parts)
    return check_detections(session, partial(detections.near, task, given), joints, parts)
