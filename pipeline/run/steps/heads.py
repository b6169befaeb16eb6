"""Find heads: the regions of all heads in the frames of each camera, to be blurred. The output are ``HeadRegions``.

Edits of people change nothing: whoever was found or detected once has a head.
"""

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.stage import (
    DETECT,
    HEADS,
    HOLD,
    IDENTIFY,
    REFINE,
    SYNCHRONIZE,
    Context,
    Output,
    SessionFacts,
    Stage,
    Task,
)


def find_heads(task: Task, context: Context) -> Output:
    """Find the heads of everybody who was located or detected, in every camera."""
    from pipeline.core.data.detections import Detections, PafFields
    from pipeline.export.privacy.bodies import seen_heads
    from pipeline.export.privacy.heads import head_regions
    from pipeline.export.privacy.people import head_path
    from pipeline.run.engine.codec import encode
    from pipeline.run.engine.take import animation_of
    from pipeline.video.timeline import frames_in

    session, detections = context.wanted(context.outline()), context.detections
    joints, timebase = detections.joints(session), session.timebase
    tracks = [*context.people(IDENTIFY).people.tracks, *animation_of(context).tracks]
    people = [path for track in tracks if (path := head_path(track, joints, timebase)) is not None]
    seen = seen_heads(context.records(DETECT, PafFields if detections.finds_fields else Detections), joints)
    on_share, regions = context.on_share(task), []
    for number, camera in enumerate(session.cameras):
        times = session.times[camera.name]
        frames = frames_in(times, timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
        time_s = times.time_s[frames.start : frames.stop]
        regions.append(head_regions(camera, frames, time_s, people, seen[camera.name]))
        on_share((number + 1) / len(session.cameras))
    return Output(encode(tuple(regions)))


def blurs_heads(facts: SessionFacts, config: ReconstructionConfig) -> bool:
    """Return whether heads are blurred in the pictures of a job."""
    return config.is_of_people and config.blur_faces and facts.has_videos


STAGE = Stage(
    HEADS,
    "Find heads",
    find_heads,
    cut="whole",
    # It reads the detections too, by whose keys those of the people are made. Colours are not read, so that detection
    # need not run again for them.
    follows=(SYNCHRONIZE, REFINE, IDENTIFY, HOLD),
    choices=("blur_faces",),
    is_planned=blurs_heads,
)
