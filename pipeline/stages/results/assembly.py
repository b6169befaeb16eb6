"""The reconstruction of a job from the outputs of its stages, edited if it was."""

from dataclasses import replace

from pipeline.data import Animation, People, Reconstruction
from pipeline.edits import PersonSpan, without_names
from pipeline.findings import SessionCheck
from pipeline.stages.codec import decode
from pipeline.stages.editing import cut, edited_take, put_together, united
from pipeline.stages.inputs import (
    Context,
    archive_of_people,
    measured_clocks,
    on_clocks,
    refined_calibration,
    used_offsets,
    wanted_inputs,
)
from pipeline.stages.people import StoredPeople
from pipeline.stages.plan import CHECK, EDIT, FIT, IDENTIFY, REFIT

EDITED = "edited.npz"
"""Name of the archive of the people whom edits changed, in the folder for temporary files."""


def assemble(context: Context) -> Reconstruction:
    """Assemble the reconstruction from the outputs of association and fit, edited if it was.

    Tracks and observations are read from a file in ``context.scratch`` whenever they are asked for.
    """
    session, joints = wanted_inputs(context, context.outline())
    found = StoredPeople(archive_of_people(context, IDENTIFY))
    people, animation = found.people, decode(Animation, *context.outputs(FIT))
    take = None
    if context.config.edits:
        take = edited_take(found.spans, context.config, session.timebase)
        changed, refitted = People((), ()), Animation((), (), animation.floor)
        if without_names(context.config.edits):
            changed = StoredPeople(archive_of_people(context, EDIT, EDITED)).people
            refitted = united([decode(Animation, content) for content in context.outputs(REFIT)])
        people, animation = put_together(people, animation, found.spans, changed, refitted, take)
    refined = refined_calibration(context)
    reconstruction = Reconstruction(
        cameras=session.cameras,
        joints=joints,
        timebase=session.timebase,
        located=people.tracks,
        observations=people.observations,
        animation=animation,
        warnings=session.warnings,
        num_approximate_frames=people.num_approximate_frames,
        damaged=found.damaged,
        doubts=people.doubts,
        offsets=used_offsets(session, context.config),
        refinement=None if refined is None else refined.report,
        synchronization=measured_clocks(context),
        check=decode(SessionCheck, *context.outputs(CHECK)),
    )
    if take is None:
        return reconstruction
    edited = reconstruction if take.frames is None else cut(reconstruction, take.frames)
    return replace(edited, is_emptied=bool(found.spans) and not edited.tracks)


def kept_frames(context: Context) -> range | None:
    """Frames that edits keep, in the numbering of the reconstruction; ``None``: all."""
    timebase = on_clocks(context, context.outline())[0].timebase
    return edited_take(spans_found(context), context.config, timebase).frames if context.config.edits else None


def spans_found(context: Context) -> tuple[PersonSpan, ...]:
    """Frames of the people who were found, before any edit."""
    return StoredPeople(archive_of_people(context, IDENTIFY, "found.npz")).spans
