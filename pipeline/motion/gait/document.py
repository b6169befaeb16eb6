"""Gait and movements of a person as plain values, for ``metrics.json`` and its readers."""

from collections.abc import Mapping
from typing import Any

from pipeline.core.data.cameras import Timebase
from pipeline.motion.gait.analysis import PersonGait
from pipeline.motion.gait.figures import Spread
from pipeline.motion.gait.movements import BodyMovement

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
