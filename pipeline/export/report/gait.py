"""Tables of a report about gait and movements, from the figures of ``metrics.json``."""

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.motion.gait.movements import MovementKind

Person = tuple[str, Mapping[str, Any]]
"""Name of a person, and the entry in ``metrics.json``."""

# Figure, unit and decimals of each column.
_FIGURES = {
    "Stride length": ("stride_length_m", "m", 2),
    "Step width": ("step_width_m", "m", 2),
    "Cadence": ("cadence_steps_per_min", "steps/min", 0),
    "Speed": ("speed_m_s", "m/s", 2),
    "Stance": ("stance_percent", "%", 0),
    "Double support": ("double_support_percent", "%", 0),
}
GAIT_COLUMNS = ("Person", "Side", "Strides", *_FIGURES, "Confidence")
MOVEMENT_COLUMNS = ("Person", "Movement", "Time", "Duration", "Height or depth", "Confidence")
_KINDS: Mapping[MovementKind, str] = {
    "jump": "Jump",
    "squat": "Squat",
    "sit_to_stand": "Stands up from a seat",
    "stand_to_sit": "Sits down",
}
_AMOUNTS = {
    "height_by_flight_m": "{:.2f} m by flight time",
    "height_by_hips_m": "{:.2f} m by the hips",
    "depth_m": "{:.2f} m deep",
}


def gait_rows(people: Sequence[Person]) -> list[tuple[str, ...]]:
    """Rows of ``GAIT_COLUMNS``: both sides together, left and right of each person who walks."""
    return [
        (
            name,
            side,
            str(gait[side].get("stride_time_s", {"num": 0})["num"]),
            *(_spread(gait[side].get(figure), unit, digits) for figure, unit, digits in _FIGURES.values()),
            f"{100 * gait['confidence']:.0f} %",
        )
        for name, figures in people
        if (gait := figures["gait"]) is not None
        for side in ("both", "left", "right")
    ]


def movement_rows(people: Sequence[Person]) -> list[tuple[str, ...]]:
    """Rows of ``MOVEMENT_COLUMNS``, of each person in order of time."""
    return [
        (
            name,
            _KINDS[movement["kind"]],
            f"{movement['start_s']:.2f} s",
            f"{movement['duration_s']:.2f} s",
            ", ".join(text.format(movement[figure]) for figure, text in _AMOUNTS.items() if figure in movement),
            f"{100 * movement['confidence']:.0f} %",
        )
        for name, figures in people
        for movement in figures["movements"]
    ]


def _spread(spread: Mapping[str, Any] | None, unit: str, digits: int) -> str:
    """Mean, and the standard deviation if there is one."""
    if spread is None:
        return "-"
    mean = f"{spread['mean']:.{digits}f}"
    return (
        f"{mean} {unit}" if spread["std"] is None else f"{mean} \N{PLUS-MINUS SIGN} {spread['std']:.{digits}f} {unit}"
    )
