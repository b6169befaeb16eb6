"""The reconstruction of a job from the outputs of its stages, edited if it was."""

from pipeline.data import Reconstruction
from pipeline.edits import PersonSpan
from pipeline.stages.cameras.checking import decode_check
from pipeline.stages.editing import cut, edited_take, put_together, united
from pipeline.stages.inputs import (
    Context,
    archive_of_people,
    measured_clocks,
    on_clocks,
    refined_cameras,
    used_offsets,
    wanted_inputs,
)
from pipeline.stages.outputs_npz import decode_animation, decode_damaged_videos, open_people, stored_spans
from pipeline.stages.plan import CHECK, EDIT, FIT, IDENTIFY, REFIT

EDITED = "edited.npz"
"""Name of the archive of the people whom edits changed, in the folder for temporary files."""


def assemble(context: Context) -> Reconstruction:
    """Assemble the reconstruction from the outputs of association and fit, edited if it was.

    Tracks and observations are read from a file in ``context.scratch`` whenever they are asked for.
    """
    session, joints = wanted_inputs(context, context.outline())
    archive = archive_of_people(context, IDENTIFY)
    people, animation = open_people(archive), decode_animation(*context.outputs(FIT))
    take = None
    if context.config.edits:
        found = stored_spans(archive)
        take = edited_take(found, context.config, session.timebase)
        changed = open_people(archive_of_people(context, EDIT, EDITED))
        refitted = united([decode_animation(content) for content in context.outputs(REFIT)])
        people, animation = put_together(people, animation, found, changed, refitted, take)
    refined = refined_cameras(context, session.cameras)
    reconstruction = Reconstruction(
        cameras=session.cameras,
        joints=joints,
        timebase=session.timebase,
        located=people.tracks,
        observations=people.observations,
        animation=animation,
        warnings=session.warnings,
        num_approximate_frames=people.num_approximate_frames,
        damaged=decode_damaged_videos(archive),
        doubts=people.doubts,
        offsets=used_offsets(session, context.config),
        refinement=None if refined is None else refined[1],
        synchronization=measured_clocks(context),
        check=decode_check(*context.outputs(CHECK)),
    )
    return reconstruction if take is None or take.frames is None else cut(reconstruction, take.frames)


def kept_frames(context: Context) -> range | None:
    """Frames that edits keep, in the numbering of the reconstruction; ``None``: all."""
    timebase = on_clocks(context, context.outline())[0].timebase
    return edited_take(spans_found(context), context.config, timebase).frames if context.config.edits else None


def spans_found(context: Context) -> tuple[PersonSpan, ...]:
    """Frames of the people who were found, before any edit."""
    return stored_spans(archive_of_people(context, IDENTIFY, "found.npz"))
