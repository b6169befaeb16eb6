"""CSV files of a person's events and strides, for spreadsheets and statistics (RFC 4180).

``person-<id>.events.csv`` has a row an event, ``person-<id>.strides.csv`` a row a stride. Times are on the session's
clock, with their fractions of a frame; ``frame`` is the nearest output frame of the files.
"""

from collections.abc import Iterator, Sequence

from pipeline.core.data.cameras import Timebase
from pipeline.motion.gait.analysis import PersonGait, marked_events, time_s
from pipeline.motion.gait.strides import FIGURES, Stride

EVENTS, STRIDES = "events", "strides"
"""Kinds of the files, which are part of their names."""
_TIMES = ("strike_s", "off_s", "other_strike_s", "next_strike_s")


def gait_tables(gait: PersonGait, timebase: Timebase) -> Iterator[tuple[str, bytes]]:
    """Kind and content of each file that a person has: none without events, none of strides without gait."""
    marks = marked_events(gait)
    if marks:
        rows: list[Sequence[object]] = [("time_s", "frame", "side", "event", "uncertainty_s", "confidence")]
        rows += [
            (
                f"{time_s(timebase, mark.frame):.4f}",
                round(mark.frame),
                mark.context.lower() if mark.context != "General" else "both",
                mark.label.lower().replace(" ", "_"),
                "" if mark.uncertainty_s is None else f"{mark.uncertainty_s:.4f}",
                f"{mark.confidence:.3f}",
            )
            for mark in marks
        ]
        yield EVENTS, _encoded(rows)
    if gait.strides:
        names = ("side", "bout", *_TIMES, *FIGURES, "turn_deg", "is_steady", "confidence")
        yield STRIDES, _encoded([names, *(_stride(stride, gait.start_frame, timebase) for stride in gait.strides)])


def _stride(stride: Stride, start_frame: int, timebase: Timebase) -> Sequence[object]:
    rows = stride.strike_row, stride.off_row, stride.other_strike_row, stride.next_row
    figures = [figure(stride) for figure in FIGURES.values()]
    return (
        stride.side,
        stride.bout,
        *(f"{time_s(timebase, start_frame + row):.4f}" for row in rows),
        *("" if figure is None else f"{figure:.4f}" for figure in figures),
        f"{stride.turn_deg:.1f}",
        int(stride.is_steady),
        f"{stride.confidence:.3f}",
    )


def _encoded(rows: Sequence[Sequence[object]]) -> bytes:
    return "".join(",".join(map(str, row)) + "\r\n" for row in rows).encode("ascii")
