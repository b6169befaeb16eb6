"""People changed by edits: each is animated by themselves on the take's floor, and corrected, unless it was before."""

import json
from dataclasses import replace

from pipeline.core.data.animation import Animation, Floor
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.options.edits import edit_document
from pipeline.core.progress import OnShare
from pipeline.core.runtime.record_archive import RecordArchive, decode, encode
from pipeline.motion.skeleton.animate import PersonFitter, animate
from pipeline.motion.skeleton.corrections.correct import correct_person
from pipeline.motion.skeleton.corrections.evidence import corrected_evidence
from pipeline.run.engine.detection_source import detection_source, joint_offsets
from pipeline.run.engine.edited_people import applied_edits, renumbered, unchanged_from
from pipeline.run.engine.pieces import Pieces
from pipeline.run.engine.stage import HOLD, IDENTIFY, Context, Task
from pipeline.run.engine.stored_people import found_people
from pipeline.run.engine.take import found_animation
from pipeline.run.engine.wanted_frames import wanted_frames

# Number in the pieces: edits give a person's frames another number.
_ANYBODY = 0


class Refitter:
    """Animations of the people that a task of *Solving edited people* has. Kept ones are in ``pieces``."""

    def __init__(self, task: Task, context: Context) -> None:
        session, joints = wanted_frames(context, context.outline()), detection_source(context).joints
        offsets, self._context = joint_offsets(context), context
        self._fitter = PersonFitter(session.cameras, session.timebase, joints(session), context.config, offsets)
        self._spans = found_people(context, IDENTIFY).spans
        self._edited = {person.id: person for person in applied_edits(context, self._spans).people}
        self._scratch, self.pieces = context.scratch, Pieces(task, context)
        self.floor = RecordArchive(*context.outputs(HOLD, slice(1))).find(Floor, "floor")

    def animation(self, track: Track3D, seen: Observations, on_share: OnShare) -> Animation:
        """Animation of a person, whose ``track`` and observations are without corrections."""
        corrections = [replace(edit, person=_ANYBODY) for edit in self._edited[track.track_id].corrections]
        anybody = replace(track, track_id=_ANYBODY), replace(seen, track_id=_ANYBODY)
        key = self.pieces.key(*anybody, *(json.dumps(edit_document(edit)) for edit in corrections))
        content, fitter = self.pieces.find(key), self._fitter
        if content is None:
            if corrections:
                before = self._before(*anybody, track.track_id, on_share)
                evidence = corrected_evidence(track, seen, corrections, fitter.cameras, fitter.joints)
                person = before.tracks[0], before.motions[0]
                after, motion = correct_person(fitter, *person, evidence, corrections, self.floor)
                content = self._kept(key, Animation((after,), (motion,), self.floor))
            else:
                content = self._kept(key, self._animated(*anybody, on_share))
        on_share(1.0)
        return renumbered(decode(Animation, content), track.track_id)

    def _before(self, track: Track3D, seen: Observations, number: int, on_share: OnShare) -> Animation:
        """A person's animation before corrections."""
        source = unchanged_from(self._edited[number], self._spans)
        if source is not None:
            found, row = found_animation(self._context), [span.id for span in self._spans].index(source)
            return Animation((found.tracks[row],), (found.motions[row],), self.floor)
        key = self.pieces.key(track, seen)
        content = self.pieces.find(key)
        if content is None:
            content = self._kept(key, self._animated(track, seen, on_share))
        return decode(Animation, content)

    def _animated(self, track: Track3D, seen: Observations, on_share: OnShare) -> Animation:
        fitter = self._fitter
        take = fitter.cameras, fitter.timebase, fitter.joints, fitter.config
        return animate([track], [seen], *take, on_share, fitter.offsets, self.floor)

    def _kept(self, key: str, animation: Animation) -> bytes:
        """Animation of a person, encoded and kept under a key."""
        content = encode(renumbered(animation, _ANYBODY))
        path = self._scratch / f"{key}.npz"
        path.write_bytes(content)
        self.pieces.keep(key, path)
        return content
