"""Arguments of public functions: compared with their types, so that a wrong one gets a sentence, not a trace."""

import reprlib
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from os import PathLike
from typing import Any, Literal, ParamSpec, TypeVar, Union, cast, get_args, get_origin

from pipeline.core.errors import InputError, Problem
from pipeline.core.options.choices import plainly_annotated
from pipeline.core.problems.request_codes import VALUE_NOT_ALLOWED, WRONG_TYPE

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_UNIONS = {Union, types.UnionType}
_NOUNS: Mapping[Any, str] = {
    Mapping: "a mapping",
    PathLike: "a path",
    get_origin(Callable[..., Any]): "a function",
    None: "None",
    type(None): "None",
    str: "a text",
}
_NUMBERS: Mapping[Any, tuple[type, str]] = {float: (Real, "a number"), int: (Integral, "a whole number")}


def checked(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Raise ``InputError`` with all arguments of a call that don't have their types, before the function runs.

    ``help`` shows types without the labels of choices.
    """
    plainly_annotated(function)
    parameters = signature(function)
    hints = {name: hint for name, hint in function.__annotations__.items() if name != "return"}

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if problems := tuple(wrong_values(hints, parameters.bind(*args, **kwargs).arguments)):
            raise InputError(problems)
        return function(*args, **kwargs)

    return call


def wrong_values(hints: Mapping[str, Any], values: Mapping[str, Any]) -> Iterator[Problem]:
    """Find values, by name, that don't have their types; text as a type is not looked at."""
    for name, value in values.items():
        if name in hints and not _fits(value, hints[name]):
            code = VALUE_NOT_ALLOWED if get_origin(hints[name]) is Literal else WRONG_TYPE
            message = f"{name} must be {_words(hints[name])}, not {reprlib.repr(value):.80}."
            yield Problem(code, message, field=name)


def _fits(value: Any, hint: Any) -> bool:
    origin, args = get_origin(hint), get_args(hint)
    if origin in _UNIONS:
        return any(_fits(value, member) for member in args)
    if origin is Literal:
        return isinstance(value, str) and value in args
    if hint in _NUMBERS:
        return isinstance(value, _NUMBERS[hint][0]) and not isinstance(value, bool)
    kind = origin or hint
    if _is_array(kind) and hasattr(value, "__array__"):  # NumPy's, pandas', xarray's
        return True
    if hint is Any or not isinstance(kind, type):
        return hint is not None or value is None
    is_kind = isinstance(value, kind) and not (origin and isinstance(value, str))
    return is_kind and (not args or not _is_list(kind) or all(_fits(item, args[0]) for item in iter(cast(Any, value))))


def _is_array(kind: Any) -> bool:
    return getattr(kind, "__name__", None) == "ndarray"


def _is_list(kind: type) -> bool:
    return issubclass(kind, Collection) and not issubclass(kind, Mapping | str)


def _words(hint: Any) -> str:
    origin, args = get_origin(hint), get_args(hint)
    if origin in _UNIONS:
        return ", or ".join(dict.fromkeys(_words(member) for member in args))
    if origin is Literal:
        return f"one of {', '.join(args)}"
    if hint in _NUMBERS:
        return _NUMBERS[hint][1]
    kind = origin or hint
    if kind in _NOUNS or _is_array(kind):
        return _NOUNS.get(kind, "an array")
    if isinstance(kind, type) and _is_list(kind):
        return f"a list, each item {_words(args[0])}" if args and args[0] is not Any else "a list"
    return f"a {getattr(kind, '__name__', kind)}"
