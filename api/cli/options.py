"""Options that several commands share; the options of a reconstruction are made from ``options.config``."""

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer

from api.cli.console import shows_help, warn
from pipeline.capture.preflight_record import Clock
from pipeline.core.errors import InputError, Problem
from pipeline.core.layouts import FILE_LAYOUTS
from pipeline.core.options.choices import Choice
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import UNITS_M, Units, Up
from pipeline.core.options.providers import ProviderChoice, choose_provider
from pipeline.core.options.requirements import requirement
from pipeline.core.options.rules import CONFIG_CHOICES, collecting, require, value_problems
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import (
    PARAMETER_UNREADABLE,
    UNKNOWN_AXIS,
    UNKNOWN_CLOCK,
    UNKNOWN_PROVIDER,
    UNKNOWN_UNITS,
)
from pipeline.core.problems.request_codes import FRAME_RANGE
from pipeline.detection.providers.find import current_provider
from pipeline.run.engine.output_folder import default_cache, is_usable

if not shows_help():
    import numpy as np

    from pipeline.core.parsing import SIDE_PX


def _option(choice: Choice) -> Any:
    """Option of the command line for a choice."""
    text = choice.about.sentence.replace("`", "")
    make = functools.partial(typer.Option, f"--{choice.option}")
    match choice.kind:
        case "one":
            # Values are checked by `checked`, not by Typer: a wrong value is reported as any other problem.
            return make(metavar="|".join(choice.values), help=text)
        case "several":
            names = list(choice.values)
            text = f"{text.removesuffix('.')}, such as {','.join(names[:2])}: {', '.join(names)}."
            return make(metavar="LIST", help=text)
        case "flag":
            return make(help=text)
        case "frame_range":
            return make(metavar="FIRST:STOP", help=_with_unset(choice, text))
    # Limits are checked by `checked` too.
    return make(help=_with_unset(choice, f"{text.removesuffix('.')}: {requirement(choice.schema, {}, null=False)}."))


def _with_unset(choice: Choice, text: str) -> str:
    """Sentence of an option with the meaning of its absence."""
    unset = choice.about.unset or ", ".join(value.label for value in choice.values.values())
    return f"{text} Default: {unset}." if unset else text


UnitsOption = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(UNITS_M),
        help="Unit of lengths, if the format states none (cmu: 5.64 cm, of the CMU database); metres, if plausible.",
        show_default=False,
    ),
]
UpOption = Annotated[
    str, typer.Option(metavar="|".join(get_args(Up)), help="Axis of the calibration that points up: it becomes Z.")
]
SizeOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="WIDTHxHEIGHT|CAMERA=WIDTHxHEIGHT",
        help="Size of the pictures, where no file contains it: of all cameras, or of one; repeatable.",
    ),
]
KeypointsOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FOLDER|CAMERA=FOLDER",
        help="Instead of videos: folder with a folder of keypoint files for each camera. Or CAMERA=FOLDER for each "
        "camera, which states the folder of its files; repeatable.",
        show_default=False,
    ),
]
PairByOrderOption = Annotated[
    bool,
    typer.Option(
        "--pair-by-order", help="Pair cameras with videos or folders by the order of their names, not by their names."
    ),
]
ProviderOption = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(get_args(ProviderChoice)),
        help="What runs the networks, see `multicap help providers`. Default: MULTICAP_PROVIDER, else auto.",
        show_default=False,
    ),
]
LayoutOption = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(FILE_LAYOUTS),
        help="Layout of keypoints whose files do not name them. Default: the number of points and the people tell it.",
        show_default=False,
    ),
]
SceneOption = Annotated[
    str,
    typer.Option(
        help="One of room, store, store-large, outdoor, unsynchronised, crowd, crowd-2, crowd-3, crowd-5, exchange, "
        "contact, handshake, walk, hands, sports, noisy, comings-and-goings."
    ),
]
KeypointRateOption = Annotated[
    float | None, typer.Option(help="Frame rate in Hz of keypoints without timestamps, or of images.")
]


def with_choices(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command options for choices of a reconstruction, by default all, in place of its parameter ``chosen``.

    The command gets a mapping from the names of the choices to the values as they were typed; ``checked`` checks them.
    """
    return with_options("chosen", [_parameter(CONFIG_CHOICES[name]) for name in names or CONFIG_CHOICES], dict)


def with_options(
    name: str, options: Sequence[inspect.Parameter], value: Callable[[Mapping[str, Any]], object]
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command options in place of the parameter ``name``, which gets their ``value``."""

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        parameters: list[inspect.Parameter] = []
        for parameter in signature.parameters.values():
            parameters += options if parameter.name == name else [parameter]

        @functools.wraps(command)
        def command_with_options(**values: Any) -> None:
            typed = {option.name: values.pop(option.name) for option in options}
            command(**values, **{name: value(typed)})

        # Typer reads the names, types and defaults of options from these.
        command_with_options.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        command_with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return command_with_options

    return decorated


def _parameter(choice: Choice) -> inspect.Parameter:
    """Parameter of a command for a choice: its option with type and default."""
    kind: Any = {"flag": bool, "number": float, "whole_number": int}.get(choice.kind, str)
    default = choice.default
    if choice.kind == "several":
        default = ",".join(default)
    elif kind is not str and default in choice.values:
        default = None
    if default is None:
        kind = kind | None
    annotation = Annotated[kind, _option(choice)]
    return inspect.Parameter(choice.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def checked(chosen: Mapping[str, Any], *checks: Callable[[], None]) -> ReconstructionConfig:
    """Check the values of the options that ``with_choices`` made; other choices have their defaults.

    Raises ``InputError`` if choices may not have their values, or a range of frames can't be read; it lists all of
    them, and what ``checks`` of other options raise.
    """
    values: dict[str, Any] = {}
    with collecting() as collect:
        for name, value in chosen.items():
            if (typed := collect(functools.partial(_typed, CONFIG_CHOICES[name], value))) is not None:
                values[name] = typed
        collect(lambda: require(value_problems(values)))
        for check in checks:
            collect(check)
    return ReconstructionConfig(**values)


def _typed(choice: Choice, value: Any) -> Any:
    match choice.kind:
        case "several":
            return tuple(name.strip() for name in value.split(",") if name.strip())
        case "frame_range":
            return _frame_range(value)
    return choice.default if value is None else value


def _frame_range(text: str | None) -> tuple[int, int] | None:
    """FIRST:STOP as two numbers; whether a session has such frames is checked later."""
    if text is None:
        return None
    first, _, stop = text.partition(":")
    try:
        return int(first), int(stop)
    except ValueError:
        message = f"{text!r} is not FIRST:STOP."
        raise InputError([Problem(FRAME_RANGE, message, field="frame_range", hint="Write it as 100:250.")]) from None


def stated_sizes(texts: Sequence[str]) -> tuple[dict[str, tuple[int, int]], list[Problem]]:
    """Sizes of pictures by camera, of all others under an empty name; and problems of texts that are none."""
    sizes_px: dict[str, tuple[int, int]] = {}
    problems = []
    for text in texts:
        name, _, sides = text.rpartition("=")
        width, _, height = sides.lower().partition("x")
        if width.isdecimal() and height.isdecimal() and SIDE_PX.holds(np.array([width, height], float)):
            sizes_px[name] = (int(width), int(height))
        else:
            message = f"{text!r} is not WIDTHxHEIGHT or CAMERA=WIDTHxHEIGHT, of {SIDE_PX}."
            problems.append(Problem(PARAMETER_UNREADABLE, message, hint="Write it as 1920x1080 or left=1920x1080."))
    return sizes_px, problems


def known_units(name: str | None) -> Units | None:
    """Check the name of a unit; ``InputError`` if there is none of that name."""
    return None if name is None else cast(Units, _known(UNKNOWN_UNITS, "unit", "units", name, tuple(UNITS_M)))


def take_provider(name: str | None) -> None:
    """Take the value of ``--provider`` for this process and those that it starts.

    Raises ``InputError`` if there is none of that name; says so if the CPU runs the networks instead.
    """
    if name is not None:
        choose_provider(
            cast(ProviderChoice, _known(UNKNOWN_PROVIDER, "provider", "provider", name, get_args(ProviderChoice)))
        )
    if note := current_provider().note:
        warn(note)


def users_cache() -> Path | None:
    """Folder of the user's cache; ``None``, with a warning, if it can't be written to."""
    folder = default_cache()
    if is_usable(folder):
        return folder
    warn(
        f"Intermediate outputs are not kept for later runs: {folder} can't be written to. Choose a folder by "
        "--cache, or by MULTICAP_CACHE_HOME."
    )
    return None


def known_up(name: str) -> Up:
    """Check the name of an axis; ``InputError`` if there is none of that name."""
    return cast(Up, _known(UNKNOWN_AXIS, "axis", "up", name, get_args(Up)))


def known_clock(name: str) -> Clock:
    """Check the name of a clock of videos; ``InputError`` if there is none of that name."""
    return cast(Clock, _known(UNKNOWN_CLOCK, "clock", "clock", name, get_args(Clock)))


def _known(code: Code, noun: str, field: str, name: str, names: Sequence[str]) -> str:
    if name not in names:
        hint = f"Use {', '.join(names)}."
        raise InputError([Problem(code, f"There is no {noun} '{name}'.", field=field, hint=hint)])
    return name
