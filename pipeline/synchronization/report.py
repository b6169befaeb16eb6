"""Plots of a synchronisation: the error of each camera over its offset, as SVG documents."""

from math import isfinite
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.data import CameraClock
from pipeline.synchronization.synchronize import CameraEvidence, Synchronized

_WIDTH, _HEIGHT, _MARGIN = 640, 240, 36
_HALF_S = 2.5


def error_pictures(synchronized: Synchronized) -> dict[str, str]:
    """SVG documents by file name, such as ``sync_cam_1.svg``: a camera's error over its offset."""
    clocks = synchronized.synchronization.clocks
    return {
        f"sync_{_file_name(clock.camera)}.svg": _error_svg(clock, evidence)
        for clock, evidence in zip(clocks, synchronized.evidence, strict=True)
    }


def _file_name(camera: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in camera)


def _error_svg(clock: CameraClock, evidence: CameraEvidence) -> str:
    found_s = clock.offset_s
    offsets_s = evidence.shifts_s + clock.start_s
    is_shown = np.abs(offsets_s - found_s) <= _HALF_S
    offsets_s, error = offsets_s[is_shown], evidence.error[is_shown]
    low_s, high_s = found_s - _HALF_S, found_s + _HALF_S

    def across(value_s: float) -> float:
        return _MARGIN + (value_s - low_s) / (high_s - low_s) * (_WIDTH - 2 * _MARGIN)

    def down(share: float) -> float:
        return _HEIGHT - _MARGIN - share * (_HEIGHT - 2 * _MARGIN)

    marks = "".join(
        f'<text x="{across(float(second)):.0f}" y="{_HEIGHT - 14}" text-anchor="middle">{second} s</text>'
        for second in range(int(np.ceil(low_s)), int(np.floor(high_s)) + 1)
    )
    spread_s = clock.sigma_s if isfinite(clock.sigma_s) else 0.0
    band = across(found_s - spread_s), across(found_s + spread_s)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" font-size="12" '
        f'font-family="sans-serif"><title>Error over the offset: {found_s:.4f} s found</title>'
        f'<rect width="100%" height="100%" fill="#f4f4f4"/>'
        f'<text x="{_MARGIN}" y="20">Share of moving joints that disagree, over the offset; '
        f"found {found_s:.4f} s, standard deviation {1000 * spread_s:.1f} ms</text>"
        f'<text x="4" y="{down(1.0) + 4:.0f}">100 %</text><text x="4" y="{down(0.0) + 4:.0f}">0 %</text>'
        f'<path d="M{_MARGIN},{down(0.0):.0f}H{_WIDTH - _MARGIN}M{_MARGIN},{down(1.0):.0f}H{_WIDTH - _MARGIN}" '
        f'stroke="#bbb"/>{marks}'
        f'<rect x="{band[0]:.1f}" y="{down(1.0):.0f}" width="{max(band[1] - band[0], 1.0):.1f}" '
        f'height="{down(0.0) - down(1.0):.0f}" fill="#d62728" fill-opacity="0.5"/>'
        f'<path d="{_line(offsets_s, error, across, down)}" fill="none" stroke="#1f4e79" stroke-width="1.5"/></svg>\n'
    )


def _line(
    offsets_s: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], across: Any, down: Any
) -> str:  # fmt: skip
    """Path of a curve; it is broken where nothing was compared."""
    step_s = float(np.median(np.diff(offsets_s))) if len(offsets_s) > 1 else 0.0
    parts = []
    for number, (value_s, share) in enumerate(zip(offsets_s.tolist(), error.tolist(), strict=True)):
        is_new = number == 0 or value_s - offsets_s[number - 1] > 1.5 * step_s
        parts.append(f"{'M' if is_new else 'L'}{across(value_s):.1f},{down(share):.1f}")
    return "".join(parts)
