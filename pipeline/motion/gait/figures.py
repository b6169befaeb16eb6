"""Figures of a person's gait: mean and standard deviation over strides, of each side and of both, and symmetry."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pipeline.core.joints import SIDES
from pipeline.motion.gait.strides import Stride

# Strides after which their number lowers the confidence no more.
_ENOUGH = 4


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation of a figure, and the number of strides; the deviation needs two strides."""

    mean: float
    std: float | None
    num: int


@dataclass(frozen=True, slots=True, eq=False)
class GaitFigures:
    """Figures over the steady strides of a person."""

    num_strides: int
    num_bouts: int
    both: Mapping[str, Spread]
    by_side: Mapping[str, Mapping[str, Spread]]
    symmetry_percent: Mapping[str, float]  # Symmetry index of the figures of ``SYMMETRIC``, 0 if both sides are equal
    is_running: bool  # Whether most strides have a flight and no double support
    confidence: float


FIGURES: Mapping[str, Callable[[Stride], float | None]] = MappingProxyType(
    {
        "stride_length_m": lambda stride: stride.length_m,
        "step_length_m": lambda stride: stride.step_length_m,
        "step_width_m": lambda stride: stride.width_m,
        "stride_time_s": lambda stride: stride.duration_s,
        "step_time_s": lambda stride: stride.step_s,
        "cadence_steps_per_min": lambda stride: 120.0 / stride.duration_s,
        "speed_m_s": lambda stride: stride.speed_m_s,
        "stance_percent": lambda stride: 100.0 * stride.stance_s / stride.duration_s,
        "swing_percent": lambda stride: 100.0 * stride.swing_s / stride.duration_s,
        "double_support_percent": lambda stride: (
            None if stride.double_support_s is None else 100.0 * stride.double_support_s / stride.duration_s
        ),
    }
)
"""Figures of each stride by name; ``None`` where a stride does not tell."""
SYMMETRIC = ("step_length_m", "step_time_s", "stance_percent")


def gait_figures(strides: Sequence[Stride]) -> GaitFigures | None:
    """Summarise the steady strides of a person; ``None`` without any.

    Symmetry is the index of Robinson et al. 1987: 200 (left - right) / (left + right), in percent.
    The confidence is the mean of the strides', times the share of four strides that there are.
    """
    steady = [stride for stride in strides if stride.is_steady]
    if not steady:
        return None
    by_side = {side: _spreads([stride for stride in steady if stride.side == side]) for side in SIDES}
    left, right = (by_side[side] for side in SIDES)
    symmetry = {
        name: 200.0 * (left[name].mean - right[name].mean) / (left[name].mean + right[name].mean)
        for name in SYMMETRIC
        if name in left and name in right and left[name].mean + right[name].mean > 0
    }
    flies = [stride.flight_s > (stride.double_support_s or 0.0) for stride in steady]
    return GaitFigures(
        len(steady),
        len({stride.bout for stride in steady}),
        _spreads(steady),
        by_side,
        symmetry,
        bool(np.mean(flies) > 0.5),
        float(np.mean([stride.confidence for stride in steady])) * min(1.0, len(steady) / _ENOUGH),
    )


def _spreads(strides: Sequence[Stride]) -> dict[str, Spread]:
    spreads = {}
    for name, figure in FIGURES.items():
        values = [value for value in map(figure, strides) if value is not None]
        if values:
            std = float(np.std(values, ddof=1)) if len(values) > 1 else None
            spreads[name] = Spread(float(np.mean(values)), std, len(values))
    return spreads
