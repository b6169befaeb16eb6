"""Additions of a laboratory's file to a person's C3D file: analog samples as they are, force plates, and events.

Samples are floats in the file, which hold every integer of 16 bits: each number is the laboratory's, and scales and
offsets stay. Corners of force plates are in the world of the points; all else of a plate is along its own axes.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.laboratory import Laboratory, LaboratoryEvent
from pipeline.export.timelines import frame_blocks
from pipeline.motion.laboratory.plates import UNITS_M, plate_corners_m

_SECONDS_PER_MINUTE = 60.0
# Events that the blocks of parameters hold beside the rest, and their bytes.
_MAX_EVENTS, _MAX_EVENT_BYTES = 2000, 64_000


def per_frame(laboratory: Laboratory) -> tuple[int, int]:
    """Analog numbers of a frame, and samples of a channel in it."""
    return laboratory.samples_per_frame * laboratory.samples.shape[1], laboratory.samples_per_frame


def with_samples(points: Iterator[bytes], laboratory: Laboratory) -> Iterator[bytes]:
    """Blocks of points, each frame with its samples after it."""
    samples = laboratory.samples.reshape(laboratory.num_frames, -1)
    for block, part in zip(points, frame_blocks(len(samples)), strict=True):
        rows = np.frombuffer(block, "<f4").reshape(part.stop - part.start, -1)
        yield np.concatenate([rows, samples[part].astype("<f4")], axis=1).tobytes()


def with_groups(
    groups: Mapping[str, Mapping[str, Any]],
    events: Sequence[LaboratoryEvent],
    laboratory: Laboratory | None,
    origin_m: Float[np.ndarray, " 3"],
) -> dict[str, Mapping[str, Any]]:
    """Groups of a file with the events, and with channels, force plates and events of a laboratory."""
    added: dict[str, Mapping[str, Any]] = {}
    if laboratory is not None:
        events = sorted((*events, *laboratory.events), key=lambda event: event.time_s)
        added["ANALOG"] = {**laboratory.groups["ANALOG"], "RATE": [laboratory.sample_rate_hz]}
        if plates := laboratory.groups["FORCE_PLATFORM"]:
            corners = (plate_corners_m(laboratory) - origin_m) / UNITS_M[laboratory.unit]
            added["FORCE_PLATFORM"] = {**plates, "CORNERS": corners} if len(corners) else plates
    if events:
        widths = [max(map(len, texts)) for texts in zip(*(event[:3] for event in events), strict=True)]
        events = events[: min(_MAX_EVENTS, _MAX_EVENT_BYTES // (8 + sum(widths)))]
        times = np.stack(np.divmod([event.time_s for event in events], _SECONDS_PER_MINUTE), axis=1)
        added["EVENT"] = {
            "USED": [len(events)],
            "CONTEXTS": [event.context for event in events],
            "LABELS": [event.label for event in events],
            "SUBJECTS": [event.subject for event in events],
            "TIMES": times,
        }
    return {**groups, **added}
