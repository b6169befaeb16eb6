"""Gait and movements of a person, from the final positions of the joints, and as plain values for ``metrics.json``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.motion.gait.events import FootEvent, find_swings
from pipeline.motion.gait.movements import BodyMovement, find_movements
from pipeline.motion.gait.points import body_points
from pipeline.motion.gait.strides import GaitFigures, Spread, Stride, find_strides, gait_figures


@dataclass(frozen=True, slots=True, eq=False)
class PersonGait:
    """Gait and movements of a person. Rows are the track's rows."""

    start_frame: int  # Output frame of the first row
    events: tuple[FootEvent, ...] = ()  # Foot strikes and foot offs of gait, in order of time
    strides: tuple[Stride, ...] = ()
    figures: GaitFigures | None = None  # ``None`` without gait
    movements: tuple[BodyMovement, ...] = ()
    belt_m_s: float = 0.0  # Speed of the treadmill's belt; 0 without one
    has_marks: bool = False  # True if events are of heels and toes, not of ankles


def analyse_gait(track: Track3D, joints: JointSet, frame_rate_hz: float) -> PersonGait:
    """Find a person's gait and movements; empty for joint sets without legs, and for people who only stand."""
    points = body_points(track, joints, frame_rate_hz)
    if points is None:
        return PersonGait(track.start_frame)
    strides, events = find_strides(points, find_swings(points))
    speed_m_s = float((points.belt_m_s**2).sum() ** 0.5)
    return PersonGait(
        track.start_frame,
        events,
        strides,
        gait_figures(strides),
        find_movements(points),
        speed_m_s if strides else 0.0,
        bool(points.is_marked.all()),
    )


Context = Literal["Left", "Right", "General"]


class MarkedEvent(NamedTuple):
    """Event in the words of C3D files: for feet, the words of Vicon and Visual3D."""

    label: str  # ``Foot Strike`` and ``Foot Off`` of gait; ``Take Off`` and ``Landing`` of jumps
    context: Context  # Side of a foot; ``General`` for both feet
    frame: float  # Output frame, with its fraction
    uncertainty_s: float | None
    confidence: float


def marked_events(gait: PersonGait) -> tuple[MarkedEvent, ...]:
    """Events of gait and of jumps in order of time."""
    marks = [
        MarkedEvent(
            "Foot Strike" if event.kind == "foot_strike" else "Foot Off",
            "Left" if event.side == "left" else "Right",
            gait.start_frame + event.row,
            event.uncertainty_s,
            event.confidence,
        )
        for event in gait.events
    ]
    for movement in gait.movements:
        if movement.kind == "jump":
            marks += [
                MarkedEvent(label, "General", gait.start_frame + row, None, movement.confidence)
                for label, row in (("Take Off", movement.start_row), ("Landing", movement.end_row))
            ]
    return tuple(sorted(marks, key=lambda mark: mark.frame))


_DECIMALS = 3


def gait_document(gait: PersonGait) -> dict[str, Any] | None:
    """Figures of a person's gait, rounded; ``None`` without gait."""
    figures = gait.figures
    if figures is None:
        return None
    return {
        "num_strides": figures.num_strides,
        "num_bouts": figures.num_bouts,
        "is_running": figures.is_running,
        "events_of": "heels and toes" if gait.has_marks else "ankles",
        "treadmill_m_s": round(gait.belt_m_s, _DECIMALS) if gait.belt_m_s else None,
        "confidence": round(figures.confidence, _DECIMALS),
        "both": _spreads(figures.both),
        **{side: _spreads(spreads) for side, spreads in figures.by_side.items()},
        "symmetry_percent": {name: round(value, 1) for name, value in figures.symmetry_percent.items()},
    }


def movement_documents(gait: PersonGait, timebase: Timebase) -> list[dict[str, Any]]:
    """Jumps, squats, sitting down and standing up in order of time; times are on the session's clock."""
    return [_movement(movement, gait.start_frame, timebase) for movement in gait.movements]


def _movement(movement: BodyMovement, start_frame: int, timebase: Timebase) -> dict[str, Any]:
    figures = {
        "height_by_flight_m": movement.height_by_flight_m,
        "height_by_hips_m": movement.height_by_hips_m,
        "depth_m": movement.depth_m,
    }
    return {
        "kind": movement.kind,
        "start_s": round(time_s(timebase, start_frame + movement.start_row), _DECIMALS),
        "duration_s": round(movement.duration_s, _DECIMALS),
        "confidence": round(movement.confidence, _DECIMALS),
        **{name: round(value, _DECIMALS) for name, value in figures.items() if value is not None},
    }


def time_s(timebase: Timebase, frame: float) -> float:
    """Time on the session's clock of an output frame with a fraction."""
    return timebase.start_time_s + frame / timebase.frame_rate_hz


def _spreads(spreads: Mapping[str, Spread]) -> dict[str, Any]:
    return {
        name: {
            "mean": round(spread.mean, _DECIMALS),
            "std": None if spread.std is None else round(spread.std, _DECIMALS),
            "num": spread.num,
        }
        for name, spread in spreads.items()
    }
