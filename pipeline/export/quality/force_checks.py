"""Findings about forces that are missing or rest on a guess."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import SIDES
from pipeline.core.problems.finding_codes import FORCES_BESIDE_FEET, FORCES_MISSING, FORCES_WITHOUT_FEET
from pipeline.export.quality.world_checks import failed_check, first_names
from pipeline.motion.forces.person_forces import LEAST_RATE_HZ

# Frames in which feet may not carry all, by their names in figures.
_BESIDE = {
    "num_seated_frames": "on a seat, which carries what is behind the feet",
    "num_undetermined_frames": "on hands or something else, in which forces of feet and moments of legs are empty",
    "num_touching_frames": "so near to others that they may hold each other, which is not determined",
}
_MARKS = tuple(f"{side}_{mark}" for side in SIDES for mark in ("heel", "big_toe"))


def force_checks(take: Reconstruction, figures: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Findings about the forces of a take at the rate of its files.

    ``figures``: figures of the people who have forces at the session's rate (``forces_document``).
    """
    rate_hz, known = take.timebase.frame_rate_hz, {person["id"] for person in figures}
    names = {motion.track_id: motion.name for motion in take.motions}
    if names and rate_hz < LEAST_RATE_HZ:
        yield failed_check(
            FORCES_MISSING,
            f"Tables of forces are empty: they have {rate_hz:g} frames a second, which do not show steps.",
            {"frame_rate_hz": rate_hz},
            hint=f"Record at {LEAST_RATE_HZ:g} frames a second and more, and state no lower output rate.",
        )
    elif missing := [name for number, name in names.items() if number not in known]:
        yield failed_check(
            FORCES_MISSING,
            f"Tables of forces are empty: {first_names(missing)}. Fewer than twelve frames have a position of the head "
            "and of all joints of trunk, arms and legs.",
            hint="Use a detector with ears and the joints of the body, and cameras that see the whole person.",
        )
    columns = [take.joints.index(mark) for mark in _MARKS if mark in take.joints.names]
    guessed = [
        names[track.track_id]
        for track in take.tracks
        if track.track_id in known and not np.isfinite(track.xyz_m[:, columns]).any()
    ]
    if guessed and rate_hz >= LEAST_RATE_HZ:
        yield failed_check(
            FORCES_WITHOUT_FEET,
            f"Heels and toes were never seen: {first_names(guessed)}. Contacts and centres of pressure of these feet "
            "are guesses from the ankles.",
            hint="Use a detector with heels and toes for forces of feet and moments of joints.",
        )
    kinds = {key: [(person["id"], person[key]) for person in figures if person[key]] for key in _BESIDE}
    texts = [
        f"{first_names([f'{names[number]} {num}' for number, num in kinds[key]])} {text}"
        for key, text in _BESIDE.items()
        if kinds[key]
    ]
    if texts:
        yield failed_check(
            FORCES_BESIDE_FEET,
            f"Feet may not carry all. Numbers of frames: {'; '.join(texts)}.",
            hint="The columns is_seated, is_undetermined and may_touch_person of the tables mark these frames.",
        )
