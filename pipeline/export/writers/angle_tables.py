"""Joint angles in tables: CSV for spreadsheets and statistics, and MOT, the form of OpenSim's motion files.

A CSV file has the columns ``frame`` (output frame of the session) and ``time_s`` (on the session's clock), each angle
of ``pipeline.motion.angles`` in degrees, and then the standard deviation of each. Cells of unknown angles are empty,
also in frames before and after the track. A MOT file has ``time`` and those angles that are known in some frame; gaps
are filled in, since OpenSim stops reading at a number that is unknown. Numbers are rounded to 0.001 degrees and 1 us.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Timebase
from pipeline.export.timelines import fixed, frame_blocks, held, read_rows, unknown_outside
from pipeline.export.writers.registry import Expected, PersonContent, Writer
from pipeline.motion.angles.compute import JointAngles
from pipeline.motion.balance.compute import Balance
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.gait.analysis import PersonGait, marked_events, time_s
from pipeline.motion.gait.strides import FIGURES, Stride

_DECIMALS = 3
_END_OF_HEAD = "endheader"


def with_sigmas(angles: JointAngles) -> Float[np.ndarray, "frames columns"]:
    """Columns of a CSV file: angles in degrees, then their standard deviations."""
    return np.concatenate([angles.angle_deg, angles.sigma_deg], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class FilledAngles:
    """Angles that are known in some frame, with gaps filled in.

    Programs that read motions stop at a number that is unknown.
    """

    names: tuple[str, ...]
    angle_deg: Float[np.ndarray, "frames angles"]  # Between known angles evenly, before and after them the nearest one


def filled_angles(angles: JointAngles) -> FilledAngles:
    """Columns of a MOT file: angles that are ever known, with gaps filled in."""
    frames = np.arange(len(angles.angle_deg))
    columns = {}
    for name, angle_deg in zip(ANGLE_NAMES, angles.angle_deg.T, strict=True):
        known = np.isfinite(angle_deg)
        if known.any():
            columns[name] = np.interp(frames, frames[known], angle_deg[known])
    return FilledAngles(tuple(columns), np.array([*columns.values()]).reshape(len(columns), len(frames)).T)


def encode_csv(angles: JointAngles, timebase: Timebase, frames: range) -> Iterator[bytes]:
    """Write a person's angles as CSV (RFC 4180), piece by piece; ``frames`` are the output frames of the file."""
    names = [*(f"{name}_deg" for name in ANGLE_NAMES), *(f"{name}_sigma_deg" for name in ANGLE_NAMES)]
    yield (",".join(["frame", "time_s", *names]) + "\r\n").encode("ascii")
    for rows, cells in _blocks(with_sigmas(angles), angles.frames, frames, ","):
        lines = (
            f"{number},{timebase.time_s(number):.6f},{row}\r\n" for number, row in zip(frames[rows], cells, strict=True)
        )
        yield "".join(lines).replace("nan", "").encode("ascii")


def encode_mot(angles: JointAngles, timebase: Timebase, file_name: str, frames: range) -> Iterator[bytes]:
    """Write a person's angles as an OpenSim motion, piece by piece; ``frames`` are the output frames of the file."""
    filled = filled_angles(angles)
    head = (
        file_name,
        "version=1",
        f"nRows={len(frames)}",
        f"nColumns={1 + len(filled.names)}",
        "inDegrees=yes",
        _END_OF_HEAD,
        "\t".join(["time", *filled.names]),
    )
    yield "".join(f"{line}\n" for line in head).encode("utf-8")
    for rows in frame_blocks(len(frames)):
        times_s = np.array([timebase.time_s(number) for number in frames[rows]])
        cells = fixed(held(filled.angle_deg, angles.frames, frames[rows]), _DECIMALS, "\t")
        lines = (
            "\t".join([f"{time_s:.6f}", *([row] if row else [])]) for time_s, row in zip(times_s, cells, strict=True)
        )
        yield "".join(f"{line}\n" for line in lines).encode("ascii")


def read_csv(path: Path) -> Iterator[Float[np.ndarray, "rows columns 1"]]:
    """Read angles and standard deviations in degrees from a file of ``encode_csv``, block by block; NaN where empty."""
    with path.open(encoding="ascii") as file:
        file.readline()
        for values in read_rows(file, ","):
            yield values[:, 2:, None]


def read_mot(path: Path) -> Iterator[Float[np.ndarray, "rows columns 1"]]:
    """Read angles in degrees from a file of ``encode_mot``, block by block."""
    with path.open(encoding="utf-8") as file:
        while (line := file.readline()) and line.rstrip("\n") != _END_OF_HEAD:
            pass
        file.readline()
        for values in read_rows(file, "\t"):
            yield values[:, 1:, None]


def _blocks(
    values: Float[np.ndarray, "rows columns"], of_frames: range, frames: range, separator: str
) -> Iterator[tuple[slice, list[str]]]:
    """Rows of the frames of a file, and their numbers as text, block by block."""
    for rows in frame_blocks(len(frames)):
        yield rows, fixed(unknown_outside(values, of_frames, frames[rows]), _DECIMALS, separator)


def _filled(person: PersonContent) -> Expected:
    return partial(held, filled_angles(person.angles()).angle_deg[..., None], person.angles().frames)


CSV = Writer(
    lambda person: encode_csv(person.angles(), person.timebase, person.frames),
    lambda path, _: read_csv(path),
    lambda person: partial(unknown_outside, with_sigmas(person.angles())[..., None], person.angles().frames),
)
MOT = Writer(
    lambda person: encode_mot(person.angles(), person.timebase, person.file_name, person.frames),
    lambda path, _: read_mot(path),
    _filled,
)


EVENTS, STRIDES, BALANCE = "events", "strides", "balance"
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


# Columns of a table of balance: names of three axes, and the attribute.
_VECTORS = {"center_{}_m": "centre_m", "velocity_{}_m_s": "velocity_m_s", "extrapolated_{}_m": "extrapolated_m"}


def balance_table(balance: Balance, timebase: Timebase) -> Iterator[bytes]:
    """Table of the frames of a person: centre of mass, momenta and margin of stability, with standard deviations."""
    unit = "m_s" if balance.mass_kg is None else "kg_m_s"
    vectors = _VECTORS | {f"momentum_{{}}_{unit}": "momentum"}
    vectors |= {f"angular_momentum_{{}}_{unit.replace('m_s', 'm2_s')}": "angular_momentum"}
    columns = {
        name.format(axis): values
        for name, attribute in vectors.items()
        for axis, values in zip("xyz", getattr(balance, attribute).T, strict=False)
    }
    columns |= {name: getattr(balance, name) for name in ("sigma_m", "margin_m", "margin_sigma_m")}
    yield (",".join(["frame", "time_s", *columns]) + "\r\n").encode("ascii")
    values = np.stack(list(columns.values()), axis=1)
    for rows in frame_blocks(len(values)):
        numbers = zip(balance.frames[rows], fixed(values[rows], 5, ","), strict=True)
        lines = (f"{number},{timebase.time_s(number):.6f},{cells}\r\n" for number, cells in numbers)
        yield "".join(lines).replace("nan", "").encode("ascii")


def _encoded(rows: Sequence[Sequence[object]]) -> bytes:
    return "".join(",".join(map(str, row)) + "\r\n" for row in rows).encode("ascii")
