"""Clocks of a synchronisation as a JSON document."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

from pipeline.capture.synchronization.sound_offsets import SoundOffsets
from pipeline.core.data.cameras import Synchronization
from pipeline.core.errors import Problem, listed


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
        "refusals": _problems(synchronization.refusals),
        "warnings": _problems(synchronization.warnings),
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


def _problems(problems: Sequence[Problem]) -> list[dict[str, Any]]:
    return [
        {"code": problem.code, "message": problem.message, "camera": problem.camera, "hint": problem.hint}
        for problem in listed(problems)
    ]
