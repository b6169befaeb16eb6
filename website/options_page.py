"""Page ``docs/reference/options.md``: choices of a reconstruction with their values, limits and defaults."""

from collections.abc import Iterator

from api.web.options import PURPOSES, Purpose
from pipeline.core.options.choices import Choice, Value, declared_choices
from pipeline.core.options.config import CHOICES, ReconstructionConfig

_INTRODUCTION = """\
# Options of a reconstruction

This page lists the choices of a reconstruction with their values, limits and defaults.

A job's `spec` has the fields of the first column ([API](../../openapi/openapi.json)). `multicap reconstruct` has the
options of the second column. `GET /v1/options` lists the same choices for a form, and the networks that are installed.
"""
_PURPOSES = """\
## What for

The form of the page asks first what a take is for, and sets these options (`purposes` in `GET /v1/options`).
"""
_LOCAL = """\
## Options of the command line alone

Results do not depend on these options.
"""


def document() -> str:
    """Write the page as Markdown."""
    local = [choice for choice in declared_choices(ReconstructionConfig) if choice.name not in CHOICES]
    lines = [
        _INTRODUCTION,
        "| field of a job | option | meaning | values | default |",
        "| --- | --- | --- | --- | --- |",
        *(f"| [](){{ #{choice.name} }}`{choice.name}` {_row(choice)}" for choice in CHOICES.values()),
        "",
        *(line for choice in CHOICES.values() if choice.kind in {"one", "several"} for line in _values(choice)),
        _PURPOSES,
        "| what for | options | files |",
        "| --- | --- | --- |",
        *map(_purpose, PURPOSES),
        "",
        _LOCAL,
        "| option | meaning | values | default |",
        "| --- | --- | --- | --- |",
        *map(_row, local),
    ]
    return "\n".join(lines) + "\n"


def _row(choice: Choice) -> str:
    """Cells of a choice: option, meaning, values and default."""
    return f"| `--{choice.option}` | {choice.about.sentence} | {_kind(choice)} | {_default(choice)} |"


def _purpose(purpose: Purpose) -> str:
    options = f"--exports {','.join(purpose.exports)}" + (
        f" --preset {purpose.preset}" if purpose.preset != "default" else ""
    )
    return f"| {purpose.label} | `{options}` | {purpose.note} |"


def _kind(choice: Choice) -> str:
    about = choice.about
    names = ", ".join(f"`{name}`" for name in choice.values)
    if choice.kind in {"one", "several"}:
        return names if choice.kind == "one" else f"a list of {names}"
    if choice.kind == "flag":
        return "`true` or `false`; the option has no value"
    limits = [
        f"{words} {limit:g}"
        for words, limit in (("at least", about.minimum), ("more than", about.above), ("at most", about.maximum))
        if limit is not None
    ]
    noun = {"number": "a number", "whole_number": "a whole number", "frame_range": "two whole numbers"}[choice.kind]
    return f"{', or '.join(filter(None, (names, noun)))}, {' and '.join(limits)}"


def _default(choice: Choice) -> str:
    if choice.default is None:
        return str(choice.about.unset)
    if choice.kind == "several":
        return ", ".join(f"`{name}`" for name in choice.default)
    if choice.kind == "flag":
        return f"`{str(choice.default).lower()}`"
    return f"`{choice.default}`" if isinstance(choice.default, str) else f"{choice.default:g}"


def _values(choice: Choice) -> Iterator[str]:
    yield from (f"## Values of `{choice.name}`", "", "| value | meaning |", "| --- | --- |")
    yield from (f"| `{name}` | {_meaning(value)} |" for name, value in choice.values.items())
    yield ""


def _meaning(value: Value) -> str:
    return f"{value.label}. {value.note}" if value.note else value.label
