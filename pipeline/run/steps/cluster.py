"""Find people by clustering: everybody's bones first, then the people at each instant by itself.

The output of *Measuring bones* is a ``MeasuredBones``, from frames all over the session, and the output of *Grouping
joints into people* a ``Poses3D`` for a range of output frames.
"""

from collections.abc import Iterator
from typing import Any

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.request_codes import FRAME_RANGE
from pipeline.run.engine import stage

# Rate of the frames in which clustering measures bones.
_MEASURED_HZ = 5.0


def _is_clustering(_: stage.SessionFacts, config: ReconstructionConfig) -> bool:
    """True if a job finds people by clustering."""
    return config.is_of_people and config.method == "clustering"


@stage.declared(
    stage.LENGTHS,
    "Measuring bones",
    cut="whole",
    follows=(stage.DETECT, stage.SYNCHRONIZE, stage.REFINE),
    choices=(FRAME_RANGE, "clustering"),
    is_planned=_is_clustering,
    looked_at_hz=_MEASURED_HZ,
)
def measure_lengths(task: stage.Task, context: stage.Context) -> stage.Output:
    """Measure everybody's bones, a range of frames at a time; and list the damaged videos."""
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.methods import MeasuredBones, association_in
    from pipeline.run.engine.wanted_frames import numbered_from_first, wanted_frames

    session, detections = wanted_frames(context, context.session()), detection_source(context)
    pictures: list[Any] = []

    def ranges() -> Iterator[tuple[range, Any]]:
        for number, frames in enumerate(task.cut(context.facts)):
            detected = detections.in_range(task, session, number, frames)
            pictures.extend((camera, seen.damaged, seen.changes) for camera, seen in detected.items())
            yield numbered_from_first(context, frames, session), detected

    lengths = association_in(context, session).measure_bones(ranges(), context.on_unit)
    return stage.Output(encode(MeasuredBones(lengths, detections.damaged_videos(session, pictures))))


@stage.declared(
    stage.POSES,
    "Grouping joints into people",
    cut="ranges",
    follows=(stage.DETECT, stage.SYNCHRONIZE, stage.REFINE, stage.LENGTHS),
    choices=(FRAME_RANGE, "clustering"),
    is_planned=_is_clustering,
)
def find_poses(task: stage.Task, context: stage.Context) -> stage.Output:
    """Find all people in a range of output frames."""
    from pipeline.core.runtime.record_archive import encode
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.methods import MeasuredBones, association_in
    from pipeline.run.engine.wanted_frames import numbered_from_first, wanted_frames

    session = wanted_frames(context, context.session())
    detected = detection_source(context).in_range(task, session, task.index, task.frames)
    lengths = context.record(stage.LENGTHS, MeasuredBones).lengths
    frames = numbered_from_first(context, task.frames, session)
    return stage.Output(
        encode(association_in(context, session).locate_people(frames, detected, lengths, context.on_unit))
    )
