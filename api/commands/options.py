"""Options that several commands share."""

from collections.abc import Sequence
from typing import Annotated, cast, get_args

import typer

from pipeline.calibration.registry import UNITS_M, Units
from pipeline.config import Export, Feet, Method, Preset, Smoothing
from pipeline.errors import InputError, Problem

METHODS: tuple[str, ...] = get_args(Method)
SMOOTHINGS: tuple[str, ...] = get_args(Smoothing)
FEET: tuple[str, ...] = get_args(Feet)
EXPORTS: tuple[str, ...] = get_args(Export)
PRESETS: tuple[str, ...] = get_args(Preset)

MethodOption = Annotated[str, typer.Option(help=f"How detections become tracks: {' or '.join(METHODS)}.")]
"""To be checked by ``known_method``, which reports a wrong one as any other problem."""
SmoothingOption = Annotated[str, typer.Option(help=f"What becomes of the joints' positions: {', '.join(SMOOTHINGS)}.")]
"""Likewise by ``known_smoothing``."""
FeetOption = Annotated[
    str, typer.Option(help=f"Which feet that stand are held in place: {', '.join(FEET)}; auto means likely ones.")
]
"""Likewise by ``known_feet``."""
ExportsOption = Annotated[
    str, typer.Option(metavar="LIST", help=f"Files of each person, such as bvh,csv; of {', '.join(EXPORTS)}.")
]
"""Likewise by ``known_exports``."""
PresetOption = Annotated[
    str, typer.Option(help=f"What BVH files are to be opened with: {', '.join(PRESETS)}; see docs/formats.md.")
]
"""Likewise by ``known_preset``."""


def known_method(name: str) -> Method:
    """Check the name of a method; ``InputError`` if there is none of that name."""
    return cast(Method, _known("method", name, METHODS))


def known_smoothing(name: str) -> Smoothing:
    """Check the name of a smoothing; ``InputError`` if there is none of that name."""
    return cast(Smoothing, _known("smoothing", name, SMOOTHINGS))


def known_feet(name: str) -> Feet:
    """Check what to do with feet; ``InputError`` if there is nothing of that name."""
    return cast(Feet, _known("feet", name, FEET))


def known_units(name: str) -> Units:
    """Check the name of a unit; ``InputError`` if there is none of that name."""
    return cast(Units, _known("units", name, tuple(UNITS_M)))


def known_exports(names: str) -> tuple[Export, ...]:
    """Check a list of formats; ``InputError`` if there is none of a name."""
    return tuple(cast(Export, _known("export", name.strip(), EXPORTS)) for name in names.split(",") if name.strip())


def known_preset(name: str) -> Preset:
    """Check the name of a preset; ``InputError`` if there is none of that name."""
    return cast(Preset, _known("preset", name, PRESETS))


def _known(kind: str, name: str, names: Sequence[str]) -> str:
    if name not in names:
        hint = f"Use {', '.join(names)}."
        raise InputError([Problem(f"unknown_{kind}", f"There is no {kind} '{name}'.", hint=hint)])
    return name
