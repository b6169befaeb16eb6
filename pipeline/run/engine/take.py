"""The take of a job from the outputs of its stages: a reconstruction, edited if it was, and its files for viewers."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.association.own_points.locate import locate_own_points
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import Session
from pipeline.core.data.animation import Animation
from pipeline.core.data.people import People
from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.errors import listed_names
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.options.edited_take import EditedPerson
from pipeline.core.problems.finding_codes import KEYPOINTS_FORM
from pipeline.export.quality.views import PersonViews
from pipeline.export.viewer.description import ViewerMotion, session_footage
from pipeline.export.viewer.frames import Arrows
from pipeline.motion.body.installed import find as find_body
from pipeline.run.engine import stage
from pipeline.run.engine.detection_source import detection_source, joint_offsets
from pipeline.run.engine.edited_people import applied_edits, cut, put_together, united
from pipeline.run.engine.stored_people import found_people
from pipeline.run.engine.wanted_frames import measured_clocks, refined_calibration, require_kind, wanted_frames


def assemble(context: stage.Context) -> Reconstruction:
    """Assemble the reconstruction from the outputs of association and fit, edited if it was.

    Tracks and observations are read from a file in ``context.scratch`` whenever they are asked for.
    """
    outline = context.outline()
    session = wanted_frames(context, outline)
    identified = found_people(context, stage.IDENTIFY)
    people, animation = identified.people, found_animation(context)
    take = None
    if context.config.edits:
        take = applied_edits(context, identified.spans)
        changed, refitted = People((), ()), Animation((), (), animation.floor)
        if context.config.people_edits:
            changed = found_people(context, stage.EDIT).people
            refitted = united(list(context.records(stage.REFIT, Animation)))
        of_people = people, animation, identified.spans, changed, refitted, take
        people, animation = put_together(*of_people, session.cameras, detection_source(context).joints(session))
    refined = refined_calibration(context)
    reconstruction = Reconstruction(
        cameras=session.cameras,
        joints=detection_source(context).joints(session),
        timebase=session.timebase,
        located=people.tracks,
        observations=people.observations,
        animation=animation,
        warnings=tuple(session.findings),
        num_approximate_frames=people.num_approximate_frames,
        damaged=identified.damaged,
        doubts=people.doubts,
        losses=people.losses,
        offsets=joint_offsets(context),
        refinement=None if refined is None else refined.report,
        synchronization=measured_clocks(context),
        check=SessionCheck() if context.facts.has_points else context.record(stage.CHECK, SessionCheck),
        provider=context.provider if context.facts.has_videos else None,
        layout=None if session.layout is None else asdict(session.layout),
        subject=Subject(context.config.segments, context.config.sex, context.config.mass_kg),
    )
    if session.laboratory is not None:
        # Its libraries take tenths of a second to load, and it is seldom needed.
        from pipeline.motion.laboratory.alignment import in_world_of, placed_in_time  # noqa: PLC0415

        laboratory = in_world_of(session.cameras, outline.cameras, session.laboratory)
        joints, subject = reconstruction.joints, reconstruction.subject
        placed = placed_in_time(laboratory, animation, joints, session.timebase, subject)
        reconstruction = replace(reconstruction, laboratory=placed)
    if take is None:
        return _with_own_points(context, reconstruction, None)
    accepted = {0: take.accepted} | {person.id: person.accepted for person in take.people}
    subjects = {person.id: _subject(reconstruction.subject, person) for person in take.people if person.described}
    reconstruction = replace(reconstruction, accepted=accepted, subjects=subjects)
    edited = reconstruction if take.frames is None else cut(reconstruction, take.frames)
    edited = replace(edited, is_emptied=bool(identified.spans) and not edited.tracks)
    return _with_own_points(context, edited, take.frames)


def _with_own_points(context: stage.Context, take: Reconstruction, frames: range | None) -> Reconstruction:
    """Take with the points of the user's own, if its files have some; ``frames`` are kept by an edit."""
    outline = context.outline()
    if not isinstance(outline, KeypointSession) or not outline.own.names:
        return take
    session = require_kind(wanted_frames(context, context.session()), KeypointSession).restricted(frames)
    own = locate_own_points(
        session.cameras,
        session.times,
        session.timebase,
        session.detections,
        session.own,
        session.joints,
        take.tracks,
        take.observations,
        derive_parameters(session.cameras, session.timebase.frame_rate_hz),
        context.config.method,
    )
    located = {*own.names, *(name for thing in own.objects for name in thing.points)}
    animals = [thing.name for thing in own.objects if thing.points[0] not in session.own.names]
    parts = {
        "are animals": animals,
        "belong to people": own.names,
        "are objects": [thing.name for thing in own.objects if thing.name not in animals],
        "were not located": [name for name in session.own.names if name not in located and not animals],
    }
    shown = "; ".join(f"{listed_names(names)} {what}" for what, names in parts.items() if names)
    finding = Finding(KEYPOINTS_FORM, f"Points of your own: {shown}.", severity="info")
    if animals and context.config.method == "clustering" and not session.own.bones:
        tracked = "Animals were tracked: clustering needs bones, by a file about your own points."
        own = replace(own, doubts=(*own.doubts, tracked))
    return replace(take, own=own, warnings=(*take.warnings, finding))


def _subject(usual: Subject, person: EditedPerson) -> Subject:
    stated = person.described
    return usual if stated is None else Subject(usual.table, stated.sex or usual.sex, stated.mass_kg or usual.mass_kg)


def found_animation(context: stage.Context) -> Animation:
    """Animation of everybody who was found, before any edit."""
    return united(list(context.records(stage.HOLD, Animation)))


def viewer_files(
    take: Reconstruction,
    views: Sequence[PersonViews],
    session: Session,
    report: Mapping[str, Any],
    folder: Path,
    first_frame: int = 0,
    arrows_m: Arrows = MappingProxyType({}),
) -> Sequence[stage.ResultFile]:
    """Write the files for viewers into a folder.

    ``take`` is at the session's frame rate, ``report`` the content of ``metrics.json``, ``first_frame`` the number of
    the first frame before the take was cut, ``arrows_m`` has the arrows of people who have forces.
    """
    motion = ViewerMotion(take, views, session_footage(session), report, first_frame, find_body(), arrows_m)
    with (folder / stage.MOTION).open("wb") as file:
        file.writelines(motion.encode())
    (folder / stage.DESCRIPTION).write_bytes(motion.describe())
    return viewer_files_in(folder)


def viewer_files_in(folder: Path) -> Sequence[stage.ResultFile]:
    """Files for viewers that were written into a folder."""
    return [
        stage.ResultFile(stage.MOTION, stage.VIEWER, None, "application/octet-stream", folder / stage.MOTION),
        stage.ResultFile(stage.DESCRIPTION, stage.VIEWER, None, "application/json", folder / stage.DESCRIPTION),
    ]
