"""Report of a synchronisation: clocks as JSON, and the error of each camera over its offset as SVG documents."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import ceil, floor, inf, isfinite
from statistics import median
from typing import Any

from pipeline.capture.synchronization.sound_offsets import SoundOffsets
from pipeline.core.data.cameras import CameraClock, ClockEvidence, Synchronization
from pipeline.core.errors import listed
from pipeline.core.findings import from_problem


def sync_document(synchronization: Synchronization) -> dict[str, Any]:
    """Clocks as JSON: ``session time = offset + rate * own time``; an uncertainty that is not finite is ``None``."""
    clocks = synchronization.clocks
    return {
        "offsets_s": {clock.camera: round(clock.offset_s, 6) for clock in clocks},
        "uncertainty_s": {
            clock.camera: round(clock.sigma_s, 6) if isfinite(clock.sigma_s) else None for clock in clocks
        },
        "rates": {clock.camera: round(clock.rate, 9) for clock in clocks},
        "certain": synchronization.is_certain,
        "refusals": [from_problem(refusal).to_json() for refusal in listed(synchronization.refusals)],
        "warnings": [from_problem(warning, "warning").to_json() for warning in listed(synchronization.warnings)],
        "evidence": {
            pair.camera: {
                "offsets_s": [round(value, 4) for value in pair.offsets_s],
                "disagreement": [round(value, 4) for value in pair.disagreement],
            }
            for pair in synchronization.evidence
        },
    }


def sound_document(sound: SoundOffsets) -> dict[str, Any]:
    """Offsets from sound as JSON, relative to the first camera that has one, and why others have none."""
    return {
        "offsets_s": {name: round(value, 6) for name, value in sound.offset_s.items()},
        "uncertainty_s": {name: round(value, 6) for name, value in sound.sigma_s.items()},
        "reasons": dict(sound.reasons),
    }


_WIDTH, _HEIGHT, _MARGIN = 640, 240, 36
_HALF_S = 2.5

_Place = Callable[[float], float]


def error_pictures(synchronization: Synchronization) -> dict[str, str]:
    """SVG documents by file name, such as ``sync_cam_1.svg``: a camera's error over its offset."""
    return {
        f"sync_{_file_name(clock.camera)}.svg": _error_svg(clock, evidence)
        for clock, evidence in zip(synchronization.clocks, synchronization.evidence, strict=True)
    }


def _file_name(camera: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in camera)


def _error_svg(clock: CameraClock, evidence: ClockEvidence) -> str:
    found_s = clock.offset_s
    low_s, high_s = found_s - _HALF_S, found_s + _HALF_S

    def across(value_s: float) -> float:
        return _MARGIN + (value_s - low_s) / (high_s - low_s) * (_WIDTH - 2 * _MARGIN)

    def down(share: float) -> float:
        return _HEIGHT - _MARGIN - share * (_HEIGHT - 2 * _MARGIN)

    marks = "".join(
        f'<text x="{across(float(second)):.0f}" y="{_HEIGHT - 14}" text-anchor="middle">{second} s</text>'
        for second in range(ceil(low_s), floor(high_s) + 1)
    )
    spread_s = clock.sigma_s if isfinite(clock.sigma_s) else 0.0
    band = across(found_s - spread_s), across(found_s + spread_s)
    line = _line(evidence.offsets_s, evidence.disagreement, across, down)
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
        f'<path d="{line}" fill="none" stroke="#1f4e79" stroke-width="1.5"/></svg>\n'
    )


def _line(offsets_s: Sequence[float], shares: Sequence[float], across: _Place, down: _Place) -> str:
    """Path of a curve; it is broken where nothing was compared."""
    step_s = median(later - offset_s for offset_s, later in pairwise(offsets_s)) if len(offsets_s) > 1 else 0.0
    parts = []
    before_s = -inf
    for value_s, share in zip(offsets_s, shares, strict=True):
        is_new = value_s - before_s > 1.5 * step_s
        parts.append(f"{'M' if is_new else 'L'}{across(value_s):.1f},{down(share):.1f}")
        before_s = value_s
    return "".join(parts)
