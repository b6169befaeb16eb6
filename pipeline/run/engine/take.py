"""The take of a job from the outputs of its stages: a reconstruction, edited if it was, and its files for viewers."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pipeline.capture.session import Session
from pipeline.core.data.animation import Animation
from pipeline.core.data.people import People
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.findings import SessionCheck
from pipeline.export.quality.views import PersonViews
from pipeline.export.viewer.description import ViewerMotion, footage_of
from pipeline.motion.body.installed import find as find_body
from pipeline.run.engine.context import Context
from pipeline.run.engine.editing import cut, edited_take, put_together, united
from pipeline.run.engine.stage import CHECK, DESCRIPTION, EDIT, HOLD, IDENTIFY, MOTION, REFIT, VIEWER, ResultFile


def assemble(context: Context) -> Reconstruction:
    """Assemble the reconstruction from the outputs of association and fit, edited if it was.

    Tracks and observations are read from a file in ``context.scratch`` whenever they are asked for.
    """
    session = context.wanted(context.outline())
    identified = context.people(IDENTIFY)
    people, animation = identified.people, animation_of(context)
    take = None
    if context.config.edits:
        take = edited_take(identified.spans, context.config, session.timebase)
        changed, refitted = People((), ()), Animation((), (), animation.floor)
        if context.config.people_edits:
            changed, refitted = context.people(EDIT).people, united(list(context.records(REFIT, Animation)))
        people, animation = put_together(people, animation, identified.spans, changed, refitted, take)
    refined = context.refined()
    reconstruction = Reconstruction(
        cameras=session.cameras,
        joints=context.detections.joints(session),
        timebase=session.timebase,
        located=people.tracks,
        observations=people.observations,
        animation=animation,
        warnings=session.warnings,
        num_approximate_frames=people.num_approximate_frames,
        damaged=identified.damaged,
        doubts=people.doubts,
        losses=people.losses,
        offsets=context.offsets(),
        refinement=None if refined is None else refined.report,
        synchronization=context.clocks(),
        check=context.record(CHECK, SessionCheck),
        provider=context.provider if context.facts.has_videos else None,
        layout=None if session.layout is None else asdict(session.layout),
    )
    if take is None:
        return reconstruction
    edited = reconstruction if take.frames is None else cut(reconstruction, take.frames)
    return replace(edited, is_emptied=bool(identified.spans) and not edited.tracks)


def animation_of(context: Context) -> Animation:
    """Animation of everybody who was found, before any edit."""
    return united(list(context.records(HOLD, Animation)))


def kept_frames(context: Context) -> range | None:
    """Frames that edits keep, in the numbering of the reconstruction; ``None``: all."""
    if not context.config.edits:
        return None
    timebase = context.on_clocks(context.outline()).timebase
    return edited_take(context.people(IDENTIFY).spans, context.config, timebase).frames


def viewer_files(
    take: Reconstruction,
    views: Sequence[PersonViews],
    session: Session,
    report: Mapping[str, Any],
    folder: Path,
    first_frame: int = 0,
) -> Sequence[ResultFile]:
    """Write the files for viewers into a folder.

    ``take`` is at the session's frame rate, ``report`` the content of ``metrics.json``, ``first_frame`` the number of
    the first frame before the take was cut.
    """
    motion = ViewerMotion(take, views, footage_of(session), report, first_frame, find_body())
    with (folder / MOTION).open("wb") as file:
        file.writelines(motion.encode())
    (folder / DESCRIPTION).write_bytes(motion.describe())
    return viewer_files_in(folder)


def viewer_files_in(folder: Path) -> Sequence[ResultFile]:
    """Files for viewers that were written into a folder."""
    return [
        ResultFile(MOTION, VIEWER, None, "application/octet-stream", folder / MOTION),
        ResultFile(DESCRIPTION, VIEWER, None, "application/json", folder / DESCRIPTION),
    ]
