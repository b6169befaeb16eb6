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


def _choice(values: Sequence[str]) -> str:
    return "|".join(values)


# Values are checked by the functions below, not by Typer: a wrong one is reported as any other problem.
MethodOption = Annotated[str, typer.Option(metavar=_choice(METHODS), help="Method that matches detections to people.")]
SmoothingOption = Annotated[str, typer.Option(metavar=_choice(SMOOTHINGS), help="How joint positions are smoothed.")]
FeetOption = Annotated[
    str, typer.Option(metavar=_choice(FEET), help="Hold standing feet in place; auto: where contact is likely.")
]
ExportsOption = Annotated[
    str, typer.Option(metavar="LIST", help=f"Formats of each person's files, such as bvh,csv: {', '.join(EXPORTS)}.")
]
PresetOption = Annotated[
    str, typer.Option(metavar=_choice(PRESETS), help="Application that BVH files are written for; see docs/formats.md.")
]


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
