"""The global pass over a finished session: who is who.

Tracks are cut wherever they may have gone over to another person, and the pieces are joined to people by all that the
session tells: motion on both sides of each gap, and body proportions.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import UInt8

from pipeline.association.identity import proportions
from pipeline.association.identity.clothes import tracklet_ratios
from pipeline.association.identity.joining import Chain, TrackletLinks, chain_doubts, join
from pipeline.association.identity.likenesses import find_likenesses, seen_in
from pipeline.association.identity.merging import cut, merge, merge_doubles
from pipeline.association.identity.phantoms import end_phantoms, is_spurious, mean_bodies
from pipeline.association.identity.recover_detections import recover_detections
from pipeline.association.identity.tracklets import (
    DoubtfulMoment,
    Tracklet,
    cut_at_gaps,
    cut_at_moments,
    encounters,
    first_ends,
    last_ends,
    make_path,
    viewed_area_m2,
)
from pipeline.core.data.arrays import no_detections
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Doubt, People
from pipeline.core.joints import JointSet
from pipeline.geometry.track_assembly import Person, number_people


def identify(
    people: People,
    cameras: Sequence[Camera],
    joints: JointSet,
    timebase: Timebase,
    min_score: float,
    most: int | None = None,
    colour: UInt8[np.ndarray, "detections parts bins"] | None = None,
    num_recorded: int | None = None,
) -> People:
    """Find out who is who over a whole session.

    - ``people``: tracks of association, and the observations behind them.
    - ``min_score``: observations with a lower score are not used.
    - ``most``: number of people to keep, those with the most observations, those who never move and mirror images last;
      ``None``: all.
    - ``colour``: colours of all detections, in the order of ``Observations.detection``; ``None`` if they were not
      measured.
    - ``num_recorded``: number of output frames at which a camera took a frame; ``None``: all.
    - Returns one track a person, numbered from 1 in order of first appearance, with the doubts about its identity.
      Tracks that may be chance are left out (``spurious_tracks``).
    """
    tracks: list[Person] = list(zip(people.tracks, people.observations, strict=True))
    recorded = timebase.num_frames if num_recorded is None else num_recorded
    num_bodies = mean_bodies(people.observations, recorded)
    whole = cut_at_gaps([make_path(track, joints) for track, _ in tracks], timebase.frame_rate_hz)
    pieces = [cut(tracks[piece.track], piece.start_frame, piece.stop_frame) for piece in whole]
    pieces = merge_doubles(pieces, cameras, joints, timebase, min_score)
    session = _session(pieces, joints, timebase.frame_rate_hz)
    if colour is not None and all(len(seen.detection) for _, seen in pieces):
        ratios = tracklet_ratios(pieces, session.tracklets, colour, len(cameras))
        session = replace(session, clothes=ratios)
    chains = join(session)
    merged = [_merge(chain, session.tracklets, pieces, cameras, timebase, min_score) for chain in chains]
    kept = [
        (person, number)
        for number, person in enumerate(merged)
        if person is not None and not is_spurious(person, cameras, timebase, num_bodies, recorded)
    ]
    if most is not None:
        first = _most_seen([person for person, _ in kept], cameras, joints, timebase)[:most]
        kept = [kept[place] for place in first]
    kept.sort(key=lambda entry: entry[0][0].start_frame)
    # Rows of detections serve the comparison of clothes only.
    persons = [(track, replace(seen, detection=no_detections())) for (track, seen), _ in kept]
    if people.leftovers is not None:
        persons = recover_detections(persons, people.leftovers, cameras, timebase, min_score)
    ended = end_phantoms(persons, cameras, joints, timebase, min_score)
    left = sorted(
        (
            (person, number)
            for (person, phantoms), (_, number) in zip(ended, kept, strict=True)
            if person is not None and not (phantoms and is_spurious(person, cameras, timebase, num_bodies, recorded))
        ),
        key=lambda entry: entry[0][0].start_frame,
    )
    persons = [person for person, _ in left]
    numbers = {number: k for k, (_, number) in enumerate(left, start=1)}
    losses = [
        phantom._replace(track_id=numbers.get(number, 0))
        for (_, phantoms), (_, number) in zip(ended, kept, strict=True)
        for phantom in phantoms
    ]
    of_chains = chain_doubts(session, chains)
    doubts = [
        [Doubt(doubt.frame, doubt.confidence, numbers.get(doubt.other, 0)) for doubt in of_chains[number]]
        for number in numbers
    ]
    return People(*number_people(persons), people.num_approximate_frames, doubts, losses=losses)


def _most_seen(
    persons: Sequence[Person], cameras: Sequence[Camera], joints: JointSet, timebase: Timebase
) -> Sequence[int]:
    """Places of people by their observations, those with the most first; likenesses of people come last."""
    tracks, observations = [track for track, _ in persons], [seen for _, seen in persons]
    likenesses = find_likenesses(tracks, seen_in(observations), cameras, joints, timebase.frame_rate_hz)
    num_views = [int(track.views.sum()) for track in tracks]
    return sorted(range(len(persons)), key=lambda place: (place in likenesses.numbers, -num_views[place]))


def _session(pieces: Sequence[Person], joints: JointSet, frame_rate_hz: float) -> TrackletLinks:
    """Cut pieces of tracks at all moments of doubt, and measure what links the tracklets."""
    paths = [make_path(track, joints) for track, _ in pieces]
    lengths_m = [proportions.limb_lengths_m(track, joints) for track, _ in pieces]
    spread_m = proportions.spread_of_a_second_m(lengths_m, frame_rate_hz)
    moments = encounters(paths, frame_rate_hz) + [
        DoubtfulMoment(path.start_frame + row, (number,))
        for number, (path, of_piece_m) in enumerate(zip(paths, lengths_m, strict=True))
        for row in proportions.changes(of_piece_m, spread_m, frame_rate_hz)
    ]
    whole = [Tracklet(number, path.start_frame, path.stop_frame) for number, path in enumerate(paths)]
    tracklets = cut_at_moments(whole, sorted(moments))
    measured = [
        proportions.measure(
            lengths_m[tracklet.track][tracklet.start_frame - start : tracklet.stop_frame - start], frame_rate_hz
        )
        for tracklet in tracklets
        for start in [paths[tracklet.track].start_frame]
    ]
    return TrackletLinks(
        tracklets,
        first_ends(tracklets, paths, frame_rate_hz),
        last_ends(tracklets, paths, frame_rate_hz),
        proportions.LimbProportions(measured, spread_m),
        viewed_area_m2(paths) if paths else 0.0,
    )


def _merge(
    chain: Chain,
    tracklets: Sequence[Tracklet],
    pieces: Sequence[Person],
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> Person | None:
    """Make one track of a chain; the track of association itself if it is unchanged."""
    parts: list[Tracklet] = []
    for number in chain:
        following = tracklets[number]
        if parts and (parts[-1].track, parts[-1].stop_frame) == (following.track, following.start_frame):
            parts[-1] = replace(parts[-1], stop_frame=following.stop_frame)
        else:
            parts.append(following)
    return merge(
        [cut(pieces[part.track], part.start_frame, part.stop_frame) for part in parts], cameras, timebase, min_score
    )
