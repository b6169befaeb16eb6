"""Edited people of a take: pieces of tracks put together, fits of those who changed, and the cut."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from pipeline.core.data.animation import Animation
from pipeline.core.data.arrays import no_detections, read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Doubt, Observations, People, Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.corrections import PARTS
from pipeline.core.options.edited_take import EditedPerson, EditedTake, Known, apply_edits
from pipeline.core.options.edits import PersonSpan
from pipeline.motion.skeleton.corrections.evidence import CorrectedEvidence, corrected_evidence
from pipeline.motion.skeleton.corrections.poses import rows_of
from pipeline.motion.skeleton.corrections.stances import clipped
from pipeline.run.engine.detection_source import detection_source
from pipeline.run.engine.stage import Context
from pipeline.run.engine.stored_people import StoredSequence
from pipeline.run.engine.wanted_frames import wanted_on_clocks
from pipeline.video.timeline import cut_timebase


def edited_take(
    spans: Sequence[PersonSpan], config: ReconstructionConfig, timebase: Timebase, known: Known = MappingProxyType({})
) -> EditedTake:
    """People after the edits of a configuration; without edits as they were found. ``known``: see ``apply_edits``."""
    first = 0 if config.frames is None else config.frames.start
    return apply_edits(spans, config.edits, range(first, first + timebase.num_frames), known)


def applied_edits(context: Context, spans: Sequence[PersonSpan]) -> EditedTake:
    """People after the edits of a job, the frames that they keep, and the outcomes of the edits."""
    session = wanted_on_clocks(context, context.outline())
    joints = detection_source(context).joints(session).names
    cameras = [camera.name for camera in session.cameras]
    known = {"camera": cameras, "joint": joints, "part": (*PARTS, *joints)}
    return edited_take(spans, context.config, session.timebase, known)


def changed_people(people: People, spans: Sequence[PersonSpan], take: EditedTake) -> People:
    """Tracks and observations of people changed by the edits, from the tracks and observations of found people.

    Corrections are not applied to them yet. Frames between two pieces are absent. People without a single known joint
    are left out. ``spans`` are the frames of ``people``, who were found, in the same order.
    """
    number_of = {span.id: number for number, span in enumerate(spans)}
    tracks, observations = [], []
    for person in take.people:
        source = unchanged_from(person, spans)
        if source is not None and not person.corrections:
            continue
        if source is not None:
            tracks.append(replace(people.tracks[number_of[source]], track_id=person.id))
            observations.append(replace(people.observations[number_of[source]], track_id=person.id))
            continue
        parts = [people.tracks[number_of[piece.person]] for piece in person.pieces]
        track = _track(person, parts)
        known = np.flatnonzero(np.isfinite(track.xyz_m).all(-1).any(-1))
        if not len(known):
            continue
        kept = slice(int(known[0]), int(known[-1]) + 1)
        seen = _observations(person, parts, [people.observations[number_of[piece.person]] for piece in person.pieces])
        tracks.append(track.part(kept))
        observations.append(seen.part(kept))
    return People(tracks, observations)


def unchanged_from(person: EditedPerson, spans: Sequence[PersonSpan]) -> int | None:
    """Number of the person who was found with the same frames; ``None`` if the edits changed them."""
    if len(person.pieces) == 1:
        (piece,) = person.pieces
        for span in spans:
            frames = range(span.start_frame, span.start_frame + span.num_frames)
            if (span.id, frames) == (piece.person, range(piece.start_frame, piece.stop_frame)):
                return span.id
    return None


def put_together(
    people: People,
    fitted: Animation,
    spans: Sequence[PersonSpan],
    changed: People,
    refitted: Animation,
    take: EditedTake,
    cameras: Sequence[Camera],
    joints: JointSet,
) -> tuple[People, Animation]:
    """People of an edited take and their animation: the changed ones, and the others as they were found.

    The floor of the found people stays: it does not depend on who is who. Doubts and losses remain of people
    whose frames did not change: others were decided by hand. ``people``, ``fitted`` and ``spans`` are those who were
    found, in the same order; ``changed`` are of ``changed_people``, ``refitted`` their animation.
    """
    number_of = {span.id: number for number, span in enumerate(spans)}
    changed_number_of = {track.track_id: number for number, track in enumerate(refitted.tracks)}
    sources: list[tuple[EditedPerson, People, int]] = []
    tracks, motions, doubts = [], [], []
    holders: dict[int, EditedPerson] = {}  # by the number before any edit
    for person in take.people:
        source = unchanged_from(person, spans)
        if source is None and person.id not in changed_number_of:
            continue
        if source is not None:
            holders[source] = person
        is_changed = person.id in changed_number_of
        number = changed_number_of[person.id] if is_changed else number_of[source or 0]
        sources.append((person, changed if is_changed else people, number))
        animation = refitted if is_changed else fitted
        tracks.append(replace(animation.tracks[number], track_id=person.id))
        name = person.name or f"person-{person.id}"
        motions.append(replace(animation.motions[number], track_id=person.id, name=name))
        is_doubted = people.doubts and source is not None
        of_person = _doubts(people, take, number_of[source or 0]) if is_doubted else []
        doubts.append([doubt for doubt in of_person if not _accepts(person, doubt.frame, doubt.frame + 1)])

    def evidence(k: int) -> CorrectedEvidence:
        person, kept, row = sources[k]
        return corrected_evidence(kept.tracks[row], kept.observations[row], person.corrections, cameras, joints)

    def track(k: int) -> Track3D:
        person, kept, row = sources[k]
        return replace(evidence(k).located if person.corrections else kept.tracks[row], track_id=person.id)

    def observations(k: int) -> Observations:
        person, kept, row = sources[k]
        return replace(evidence(k).seen if person.corrections else kept.observations[row], track_id=person.id)

    edited = People(
        StoredSequence(len(sources), track),
        StoredSequence(len(sources), observations),
        people.num_approximate_frames,
        doubts if people.doubts else (),
        losses=[
            loss._replace(track_id=holders[loss.track_id].id if loss.track_id else 0)
            for loss in people.losses
            if not loss.track_id
            or ((holder := holders.get(loss.track_id)) and not _accepts(holder, loss.start_frame, loss.stop_frame))
        ],
    )
    return edited, Animation(tuple(tracks), tuple(motions), fitted.floor)


def renumbered(animation: Animation, number: int) -> Animation:
    """Animation of one person with another number, and with the name of people who have none."""
    (track,), (motion,) = animation.tracks, animation.motions
    named = replace(motion, track_id=number, name=f"person-{number}")
    return replace(animation, tracks=(replace(track, track_id=number),), motions=(named,))


def united(parts: Sequence[Animation]) -> Animation:
    """Animation of everybody from parts: person number k is in part k modulo the number of parts."""
    numbers = range(sum(len(part.tracks) for part in parts))
    places = [(parts[number % len(parts)], number // len(parts)) for number in numbers]
    tracks, motions = [part.tracks[row] for part, row in places], [part.motions[row] for part, row in places]
    return Animation(tuple(tracks), tuple(motions), parts[0].floor)


def cut(reconstruction: Reconstruction, frames: range) -> Reconstruction:
    """Keep some frames of a reconstruction, numbered from 0; people who are not there are left out."""
    kept, tracks, motions = [], [], []
    for number, (track, motion) in enumerate(zip(reconstruction.tracks, reconstruction.motions, strict=True)):
        rows = _rows(track, frames)
        if rows.start < rows.stop:
            kept.append((number, rows))
            tracks.append(_moved(track.part(rows), frames.start))
            part = replace(rows_of(motion, rows), start_frame=tracks[-1].start_frame)
            motions.append(replace(part, contacts=clipped(motion.contacts, rows)))
    located, observations, doubts = reconstruction.located, reconstruction.observations, reconstruction.doubts
    first, stop = frames.start, frames.stop
    return replace(
        reconstruction,
        timebase=cut_timebase(reconstruction.timebase, frames),
        located=StoredSequence(len(kept), lambda k: _moved(located[kept[k][0]].part(kept[k][1]), frames.start)),
        observations=StoredSequence(len(kept), lambda k: observations[kept[k][0]].part(kept[k][1])),
        doubts=[
            [doubt._replace(frame=doubt.frame - first) for doubt in doubts[number] if first <= doubt.frame < stop]
            for number, _ in (kept if doubts else ())
        ],
        losses=[
            loss._replace(
                start_frame=max(loss.start_frame, first) - first, stop_frame=min(loss.stop_frame, stop) - first
            )
            for loss in reconstruction.losses
            if loss.start_frame < stop and loss.stop_frame > first
        ],
        animation=Animation(tuple(tracks), tuple(motions), reconstruction.animation.floor),
        accepted={
            number: [replace(e, start_frame=e.start_frame - first, stop_frame=e.stop_frame - first) for e in edits]
            for number, edits in reconstruction.accepted.items()
        },
    )


def _rows(track: Track3D, frames: range) -> slice:
    """Rows of a track within frames; empty without any."""
    start, stop = max(frames.start, track.start_frame), min(frames.stop, track.start_frame + track.num_frames)
    return slice(start - track.start_frame, max(start, stop) - track.start_frame)


def _moved(track: Track3D, frames: int) -> Track3D:
    return replace(track, start_frame=track.start_frame - frames)


def _track(person: EditedPerson, parts: Sequence[Track3D]) -> Track3D:
    (num_joints,) = {part.xyz_m.shape[1] for part in parts}
    num_frames = person.stop_frame - person.start_frame
    shape = num_frames, num_joints
    arrays: dict[str, np.ndarray] = {
        "xyz_m": np.full((*shape, 3), np.nan),
        "score": np.zeros(shape),
        "source": np.full(shape, Source.ABSENT, parts[0].source.dtype),
        "error_px": np.full(shape, np.nan),
        "views": np.zeros(shape, parts[0].views.dtype),
    }
    for name in ("uncertainty_m", "world_from_segment"):
        stated = next((values for part in parts if (values := getattr(part, name)) is not None), None)
        if stated is not None:
            arrays[name] = np.full((num_frames, *stated.shape[1:]), np.nan)
    for rows, own_rows, part in _places(person, parts):
        for name, array in arrays.items():
            values = getattr(part, name)
            if values is not None:
                array[rows] = values[own_rows]
    return Track3D(person.id, person.start_frame, **{name: read_only(array) for name, array in arrays.items()})


def _observations(person: EditedPerson, parts: Sequence[Track3D], seen: Sequence[Observations]) -> Observations:
    num_frames = person.stop_frame - person.start_frame
    points_px = np.full((num_frames, *seen[0].points_px.shape[1:]), np.nan)
    score = np.zeros((num_frames, *seen[0].score.shape[1:]))
    for (rows, own_rows, _), observations in zip(_places(person, parts), seen, strict=True):
        points_px[rows] = observations.points_px[own_rows]
        score[rows] = observations.score[own_rows]
    # Identities are decided: the rows of the detections are needed for nothing else.
    return Observations(person.id, read_only(points_px), read_only(score), no_detections())


def _places(person: EditedPerson, parts: Sequence[Track3D]) -> Iterator[tuple[slice, slice, Track3D]]:
    for piece, part in zip(person.pieces, parts, strict=True):
        num_frames = piece.stop_frame - piece.start_frame
        row, own_row = piece.start_frame - person.start_frame, piece.start_frame - part.start_frame
        yield slice(row, row + num_frames), slice(own_row, own_row + num_frames), part


def _doubts(people: People, take: EditedTake, number: int) -> list[Doubt]:
    """Doubts about a person who did not change, with the other person's present number; 0 if there is none."""
    return [doubt._replace(other=_present(take, doubt)) for doubt in people.doubts[number]]


def _accepts(person: EditedPerson, start_frame: int, stop_frame: int) -> bool:
    return any(
        edit.kind == "identity" and edit.start_frame < stop_frame and start_frame < edit.stop_frame
        for edit in person.accepted
    )


def _present(take: EditedTake, doubt: Doubt) -> int:
    holders: Mapping[int, int] = {
        piece.person: person.id
        for person in take.people
        for piece in person.pieces
        if piece.start_frame <= doubt.frame < piece.stop_frame
    }
    return holders.get(doubt.other, 0)
