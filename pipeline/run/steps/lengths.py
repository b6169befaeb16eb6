"""Measure bones: everybody's lengths, in frames all over the session. The output is a ``MeasuredBones``."""

from collections.abc import Iterator
from typing import Any

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.requests import FRAME_RANGE
from pipeline.run.engine.stage import DETECT, LENGTHS, REFINE, SYNCHRONIZE, Context, Output, SessionFacts, Stage, Task

# Rate of the frames in which clustering measures bones.
_MEASURED_HZ = 5.0


def measure_lengths(task: Task, context: Context) -> Output:
    """Measure everybody's bones, a range of frames at a time; and list the damaged videos."""
    from pipeline.run.engine.association import MeasuredBones
    from pipeline.run.engine.codec import encode

    session = context.wanted(context.session())
    pictures: list[Any] = []

    def ranges() -> Iterator[tuple[range, Any]]:
        for number, frames in enumerate(task.cut(context.facts)):
            detected = context.detections.in_range(task, session, number, frames)
            pictures.extend((camera, seen.damaged, seen.changes) for camera, seen in detected.items())
            yield context.numbered_from_first(frames, session), detected

    lengths = context.association(session).measure_bones(ranges(), context.on_unit)
    return Output(encode(MeasuredBones(lengths, context.detections.damaged_videos(session, pictures))))


def is_clustering(_: SessionFacts, config: ReconstructionConfig) -> bool:
    """Whether a job finds people by clustering."""
    return config.is_of_people and config.method == "clustering"


STAGE = Stage(
    LENGTHS,
    "Measure bones",
    measure_lengths,
    cut="whole",
    follows=(DETECT, SYNCHRONIZE, REFINE),
    choices=(FRAME_RANGE, "clustering"),
    is_planned=is_clustering,
    looked_at_hz=_MEASURED_HZ,
)
