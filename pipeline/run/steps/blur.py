"""Blur heads: find them in the frames of each camera, and make a small blurred copy of its video for browsers.

The output of *Finding heads* are ``HeadRegions``, and the output of *Blurring videos* is the index of its files. Edits
of people change nothing: whoever was found or detected once has a head, and the copies of a job are made once.
"""

from typing import TYPE_CHECKING

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import BLURRED_KIND, blurred_name
from pipeline.run.engine import stage

if TYPE_CHECKING:
    from pipeline.core.data.detections import HeadRegions


def _blurs_heads(facts: stage.SessionFacts, config: ReconstructionConfig) -> bool:
    """Return whether heads are blurred in the pictures of a job."""
    return config.is_of_people and config.blur_faces and facts.has_videos


@stage.declared(
    stage.HEADS,
    "Finding heads",
    cut="whole",
    # It reads the detections too, whose keys are part of the people's keys. Colours are not read, so that detection
    # need not run again for them.
    follows=(stage.SYNCHRONIZE, stage.REFINE, stage.IDENTIFY, stage.HOLD),
    choices=("blur_faces",),
    is_planned=_blurs_heads,
)
def find_heads(task: stage.Task, context: stage.Context) -> stage.Output:
    """Find the heads of everybody who was located or detected, in every camera."""
    from pipeline.core.data.detections import Detections, PafFields
    from pipeline.core.runtime.record_archive import encode
    from pipeline.export.privacy.heads import head_path, head_regions, seen_heads
    from pipeline.run.engine.detection_source import detection_source
    from pipeline.run.engine.stored_people import found_people
    from pipeline.run.engine.take import found_animation
    from pipeline.run.engine.wanted_frames import wanted_frames
    from pipeline.video.timeline import frames_in

    session, detections = wanted_frames(context, context.outline()), detection_source(context)
    joints, timebase = detections.joints(session), session.timebase
    tracks = [*found_people(context, stage.IDENTIFY).people.tracks, *found_animation(context).tracks]
    people = [path for track in tracks if (path := head_path(track, joints, timebase)) is not None]
    seen = seen_heads(context.records(stage.DETECT, PafFields if detections.finds_fields else Detections), joints)
    on_share, regions = context.on_share(task), []
    for number, camera in enumerate(session.cameras):
        times = session.times[camera.name]
        frames = frames_in(times, timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
        time_s = times.time_s[frames.start : frames.stop]
        regions.append(head_regions(camera, frames, time_s, people, seen[camera.name]))
        on_share((number + 1) / len(session.cameras))
    return stage.Output(encode(tuple(regions)))


@stage.declared(
    stage.BLUR,
    "Blurring videos",
    cut="cameras",
    follows=(stage.SYNCHRONIZE, stage.HEADS),
    choices=("blurs_videos", "frame_range"),
    is_planned=lambda facts, config: config.blurs_videos and _blurs_heads(facts, config),
    unit="frames",
    is_reusable=False,
    reads_videos=True,
    makes_files=True,
)
def blur_videos(task: stage.Task, context: stage.Context) -> stage.Output:
    """Make the blurred video of a camera."""
    from pipeline.core.errors import PipelineError
    from pipeline.export.privacy.blur import write_blurred
    from pipeline.run.engine.wanted_frames import captured_videos, wanted_on_clocks
    from pipeline.video.timeline import frames_in

    camera, heads = task.one_camera, head_regions_in(context, task.one_camera)
    if heads is None:
        raise PipelineError("Heads are not to be blurred in the pictures of this job.")
    session, take = captured_videos(context), wanted_on_clocks(context, context.outline())
    timebase = take.timebase
    frames = frames_in(take.times[camera], timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
    path = context.scratch / blurred_name(list(session.camera_videos).index(camera))
    with context.video(camera):
        write_blurred(session.camera_videos[camera], session.times[camera].time_s, frames, heads, path, context.on_unit)
    return stage.indexed([stage.ResultFile(path.name, BLURRED_KIND, None, "video/mp4", path)])


def head_regions_in(context: stage.Context, camera: str) -> "HeadRegions | None":
    """Heads to be blurred in the pictures of a camera; ``None`` if none are."""
    from pipeline.core.data.detections import HeadRegions

    if not (context.config.blur_faces and context.facts.has_videos):
        return None
    regions = context.record(stage.HEADS, tuple[HeadRegions, ...])
    return next(known for known in regions if known.camera == camera)
