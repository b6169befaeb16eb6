"""Rules of a reconstruction's choices: which values each may have, which go together, and which suit a session.

The spec of a job, the command line and ``reconstruct`` ask here, so that each rule has one sentence and all problems
are found at once. ``pipeline.core.options.config`` declares the values and limits. Standard library only.
"""

import contextlib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any, TypeVar, get_type_hints

from pipeline.core.errors import InputError, Problem
from pipeline.core.options.arguments import wrong_values
from pipeline.core.options.choices import Choice, declared_choices
from pipeline.core.options.config import MAX_OUTPUT_FRAMES, NETWORKS, JobChoices, ReconstructionConfig, Smoothing
from pipeline.core.options.file_formats import FILE_FORMATS, Export, installed_formats
from pipeline.core.options.requirements import Steps, faults, path_text, requirement
from pipeline.core.problems import request_codes
from pipeline.core.problems.finding_codes import PARAMETER_RANGE, UNKNOWN_PARAMETER
from pipeline.core.problems.session_codes import TOO_MANY_FRAMES

CONFIG_CHOICES = {choice.name: choice for choice in declared_choices(ReconstructionConfig)}
"""Choices of a reconstruction on this machine by name: choices of jobs, and others."""
_OTHER_FIELDS = {
    name: hint for name, hint in get_type_hints(ReconstructionConfig).items() if name not in CONFIG_CHOICES
}
SAME_INSTANT = 1e-9
"""Part of a frame by which two instants differ that are the same but for rounding."""
INSTALL_BODY = "Run: multicap bodies install"
"""Sentence that tells how to install the human body."""


def require(problems: Iterable[Problem]) -> None:
    """Raise ``InputError`` if there are any problems."""
    if found := tuple(problems):
        raise InputError(found)


def unlisted_value(name: str, value: Any, values: Iterable[Any]) -> Iterator[Problem]:
    """Find out whether an argument is none of the values that it may have."""
    if value not in (allowed := tuple(values)):
        message = f"{name} must be one of {', '.join(map(str, allowed)) or 'none'}, not {value!r:.80}."
        yield Problem(request_codes.VALUE_NOT_ALLOWED, message, field=name)


@contextlib.contextmanager
def collecting() -> Iterator[Callable[[Callable[[], Any]], Any]]:
    """Collect the problems of several steps, and raise them together at the end of the block."""
    problems: list[Problem] = []

    def collect(step: Callable[[], Any]) -> Any:
        try:
            return step()
        except InputError as error:
            problems.extend(error.problems)
            return None

    yield collect
    require(problems)


@dataclass(frozen=True, slots=True)
class Installed:
    """Installed parts where a reconstruction runs, by name; ``None`` where it is unknown, or not needed."""

    networks: Collection[str] | None = None
    bodies: Collection[str] | None = None
    formats: Collection[str] | None = None


def config_problems(config: ReconstructionConfig, num_frames: int, frame_rate_hz: float) -> Iterator[Problem]:
    """Find everything that is wrong with a configuration for a session of so many output frames.

    Choices are compared with each other and with the session only if they have values that they may have.
    """
    others = {name: getattr(config, name) for name in _OTHER_FIELDS}
    chosen = {name: getattr(config, name) for name in CONFIG_CHOICES}
    wrong = (*value_problems(chosen), *wrong_values(_OTHER_FIELDS, others))
    yield from wrong
    if not wrong:
        yield from session_problems(config, num_frames, frame_rate_hz)
        yield from installation_problems(config, Installed(formats=installed_formats()))
        yield from _foreign_parameters(config)


def value_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    """Find values that a choice may not have; ``values`` are by the names of the choices."""
    for name, value in values.items():
        yield from (problem for _, problem in value_faults(CONFIG_CHOICES[name], value))


def value_faults(choice: Choice, value: Any) -> list[tuple[Steps, Problem]]:
    """Find what is wrong with a value of a choice: problems, with the steps from the value to what is wrong."""
    found = []
    words: dict[int, str] = {}  # of each schema: a list may have thousands of wrong items
    for steps, code, schema in faults(choice.schema, value):
        field = path_text((choice.name, *steps))
        if id(schema) not in words:
            words[id(schema)] = requirement(schema, {})
        found.append((steps, Problem(code, f"{field} must be {words[id(schema)]}.", field=field)))
    if not found and choice.kind == "several" and len(set(value)) < len(value):
        message = f"{choice.name} must name each format once."
        found.append(((), Problem(request_codes.EXPORT_REPEATED, message, field=choice.name)))
    return found


def plain_value(choice: Choice, value: Any) -> Any:
    """Plain value of a choice without faults: a tuple for a list, numbers of Python."""
    if isinstance(value, list | tuple):
        return tuple(plain_value(choice, item) for item in value)
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if is_number:
        return float(value) if choice.kind == "number" else int(value)
    return value


def session_problems(choices: JobChoices, num_frames: int, frame_rate_hz: float) -> Iterator[Problem]:
    """Find choices that do not suit a session of so many output frames."""
    if choices.frame_range is not None:
        start, stop = choices.frame_range
        wrong = tuple(frame_range_problems(start, stop, num_frames))
        yield from wrong
        num_frames = num_frames if wrong else stop - start
    yield from cutoff_problems(choices.smoothing, choices.cutoff_hz, frame_rate_hz)
    yield from file_problems(choices.exports, num_frames, frame_rate_hz, choices.output_rate_hz)


def frame_range_problems(start: int, stop: int, num_frames: int) -> Iterator[Problem]:
    """Find out whether a session lacks a range of output frames."""
    if not 0 <= start < stop <= num_frames:
        message = f"The capture has the output frames 0 to {num_frames}, not {start} to {stop}."
        hint = "The second number is the one after the last frame."
        yield Problem(request_codes.FRAME_RANGE, message, field="frame_range", hint=hint)


def cutoff_problems(smoothing: Smoothing, cutoff_hz: float, frame_rate_hz: float) -> Iterator[Problem]:
    """Find out whether a low-pass is impossible at a frame rate."""
    if smoothing == "butterworth" and not 0 < cutoff_hz < frame_rate_hz / 2:
        message = f"The cutoff must be below half of the capture's frame rate, {frame_rate_hz / 2:g} Hz."
        yield Problem(request_codes.CUTOFF_RANGE, message, field="cutoff_hz", hint="6 Hz suits most movements.")


def file_problems(
    exports: Collection[Export], num_frames: int, frame_rate_hz: float, output_rate_hz: float | None
) -> Iterator[Problem]:
    """Find out whether result files have more frames than they may.

    ``output_rate_hz``: rate of the motion in the files; ``None``: the session's rate.
    """
    if output_rate_hz is not None:
        num_frames = num_resampled(num_frames, frame_rate_hz, output_rate_hz)
    if num_frames > MAX_OUTPUT_FRAMES:
        message = f"At this rate the capture has {num_frames:,} frames; at most {MAX_OUTPUT_FRAMES:,} are written."
        hint = "Ask for a lower rate, or for fewer frames by frame_range."
        yield Problem(TOO_MANY_FRAMES, message, field="output_rate_hz", hint=hint)


def format_problems(exports: Collection[Export], installed: Collection[str]) -> Iterator[Problem]:
    """Find formats whose package, or whose file, is missing. ``installed``: formats that can be written."""
    for export, form in FILE_FORMATS.items():
        if form.package is None or export not in exports or export in installed:
            continue
        command = f"pip install multicap[{form.package.extra}]"
        if form.file is None:
            message = f"{export.upper()} files need the package {form.package.name}, which is not installed."
            hint = f"Install it by Multicap's extra: {command}. Or use another format."
        else:
            needed = f"the package {form.package.name} and {form.file.name}"
            message = f"{export.upper()} files need {needed}, and one or both are not installed."
            hint = f"Install them: {command}, then {form.file.install}. Or use another format."
        yield Problem(request_codes.FORMAT_NOT_INSTALLED, message, field="exports", hint=hint)


def installation_problems(choices: JobChoices, installed: Installed) -> Iterator[Problem]:
    """Find choices that need a body, formats or networks that are not installed."""
    has_body = any(FILE_FORMATS[export].has_body for export in choices.exports)
    if (
        has_body
        and choices.body != "capsules"
        and installed.bodies is not None
        and choices.body not in installed.bodies
    ):
        message = f"The body {choices.body} is not installed for files of this job."
        yield Problem(request_codes.BODY_NOT_INSTALLED, message, field="body", hint=INSTALL_BODY)
    if installed.formats is not None:
        yield from format_problems(choices.exports, installed.formats)
    if installed.networks is not None:
        missing = [name for name in choices.networks.names if name not in installed.networks]
        if missing:
            message = f"Networks of this job are not installed: {', '.join(missing)}."
            field = "profile" if choices.detector == "auto" else "detector"
            yield Problem(request_codes.DETECTOR_NOT_INSTALLED, message, field=field, hint=install_command(*missing))


def install_command(*names: str) -> str:
    """Sentence that tells how to install networks."""
    publishers = {name: network.publisher for name in names if (network := NETWORKS.get(name))}
    if own := next((name for name in names if name.startswith("own-")), None):
        return f"Add the file of {own}: multicap models add FILE --head HEAD --joints LAYOUT"
    for name, publisher in publishers.items():
        if publisher is not None:
            return f"Get it from {publisher}, then run: multicap models add {name} --from FOLDER or URL"
    return f"Run: multicap models install {' '.join(names)}"


def num_resampled(num_frames: int, frame_rate_hz: float, new_rate_hz: float) -> int:
    """Number of frames at another rate with the same first frame, the last one not after the old last one."""
    return math.floor((num_frames - 1) / (frame_rate_hz / new_rate_hz) + SAME_INSTANT) + 1


def _foreign_parameters(config: ReconstructionConfig) -> Iterator[Problem]:
    """Find parameters of the method that is not used."""
    if foreign := config.clustering if config.method == "tracking" else config.tracking:
        message = f"{', '.join(foreign)}: the method '{config.method}' has no use for the other one's parameters."
        yield Problem(UNKNOWN_PARAMETER, message, hint="Omit them, or use the other method.")


_Parameters = TypeVar("_Parameters", bound=Any)


def change_parameters(parameters: _Parameters, changes: Mapping[str, float]) -> _Parameters:
    """Set fields of a dataclass of parameters.

    ``parameters``: dataclass instance with fields of type float, int or bool. ``changes``: new values by field name; 0
    or 1 for a bool. Raises ``InputError`` if a name is unknown or a value is not allowed; lists all of them. Values are
    positive numbers; fields whose name begins with ``weight`` may be 0.
    """
    known = {field.name: type(getattr(parameters, field.name)) for field in fields(parameters)}
    problems = []
    for name, value in changes.items():
        if name not in known:
            hint = f"Known are {', '.join(known)}."
            problems.append(Problem(UNKNOWN_PARAMETER, f"The method has no parameter {name!r}.", hint=hint))
        elif rule := _violated_rule(name, known[name], value):
            problems.append(Problem(PARAMETER_RANGE, f"{name} must be {rule}, not {value:g}.", field=name))
    if problems:
        raise InputError(problems)
    values: dict[str, Any] = {name: known[name](value) for name, value in changes.items()}
    changed: _Parameters = replace(parameters, **values)
    return changed


def _violated_rule(name: str, kind: type, value: float) -> str | None:
    """Describe the values that a parameter may have, if this value is none of them; else return ``None``."""
    if kind is bool:
        return None if value in {0, 1} else "0 or 1"
    if not math.isfinite(value) or value < 0 or (value == 0 and not name.startswith("weight")):
        return "a positive number"
    if kind is int and value != int(value):
        return "a whole number"
    return None
