"""Vocabulary of declared choices: values with labels, limits, and the choices that a dataclass declares.

``pipeline.core.options.config`` declares the choices of a reconstruction with it. A value stands once, with its label:
as ``Annotated[Literal["name"], Value("label")]`` in the union of its choice. Standard library only.
"""

import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints


@dataclass(frozen=True, slots=True)
class Value:
    """A value of a choice."""

    label: str  # Name in forms and documentation
    # Further sentence for the documentation, such as a cost; empty for none
    note: str = field(default="", kw_only=True)


@dataclass(frozen=True, slots=True)
class Network(Value):
    """A detector network; ``pipeline.detection.entries`` has its files, input and outputs."""

    leaves_fields: bool = False  # True if it outputs part affinity fields; the other networks find whole bodies
    publisher: str | None = None  # Source of its files for users; ``None``: Multicap installs it from a package


@dataclass(frozen=True, slots=True)
class OptionalPackage:
    """Package that a part of Multicap needs, and that is not always installed."""

    name: str
    module: str  # Name by which it is imported
    extra: str  # Extra of Multicap that installs it


@dataclass(frozen=True, slots=True)
class OptionalFile:
    """File that a part of Multicap needs, and that is not always installed."""

    name: str  # Name in messages
    path: str  # Path below the storage folder, see ``pipeline.core.runtime.packages.storage``
    install: str  # Command that installs it


@dataclass(frozen=True, slots=True)
class FileSize:
    """Bytes of a person's file of a format, by which space on disks is foreseen."""

    of_file: int = 0  # Mesh, names and the like
    of_frame: int = 0  # Rotations of the skeleton in a frame; twice as many with fingers
    of_joint: int = 0  # A joint's position in a frame


@dataclass(frozen=True, slots=True)
class FileFormat(Value):
    """A format of files: of each person, or of the whole take.

    Another package adds a format by an entry point of the group ``multicap.writers``: its name is the format's name,
    its object the ``FileFormat``. The web API loads the object too, so its module imports no science.

    Parameters
    ----------
    label
        Name of the format for users.
    media_type
        Media type (RFC 6838), as the service sends it.
    holds
        ``motion``: rotations of the skeleton; ``joints``: positions of the detected joints; ``angles``: joint angles;
        ``forces``: forces and moments; ``recording``: one file of the take with all that was seen and found;
        ``model``: a model of the body.
    writer
        Reference of the ``pipeline.export.writers.registry.Writer``, ``package.module:name``, or ``.module:name`` in
        ``pipeline.export.writers``; ``None`` for formats that stages of their own make.
    has_body, has_presets
        True if it holds a body that follows the skeleton; true if names, axes, unit and rest pose come from a preset.
    ending
        Ending of the names of files, without the dot; ``None``: the format's name.
    package, file
        Package that writes and reads the files, beside the packages that all formats need; file that is needed too.
    size
        Size of the files.
    in_take
        True if a file of the whole take holds all people once more.
    note
        Sentence for users.

    Examples
    --------
    >>> studio = FileFormat("Studio", "text/plain", "joints", writer="studio.writer:WRITER", ending="txt")
    >>> studio.ending, studio.has_presets
    ('txt', False)
    """

    media_type: str
    holds: Literal["motion", "joints", "angles", "forces", "recording", "model"]
    writer: str | None = None
    has_body: bool = False
    has_presets: bool = False
    ending: str | None = None
    package: OptionalPackage | None = None
    file: OptionalFile | None = None
    size: FileSize = FileSize()
    in_take: bool = False


@dataclass(frozen=True, slots=True)
class OtherNames:
    """Values of a choice beside the named ones, by a regular expression."""

    pattern: str


Group = Literal["purpose", "people", "quality", "advanced"]
"""Parts of a form of choices: what the files are for, how many people there are, how well, and all else."""


@dataclass(frozen=True, slots=True)
class About:
    """Description of a choice beside its type and default, as a declaration gives it."""

    label: str  # Heading of its field in a form
    sentence: str  # Description for the API, the command line and the documentation
    # Limits of numbers: at least, more than, at most
    minimum: int | float | None = None
    above: int | float | None = None
    maximum: int | float | None = None
    unset: str | None = None  # Meaning of an omitted value, where the default is ``None``
    option: str | None = None  # Name of the option of the command line, if other than the field's
    group: Group = "advanced"  # Part of a form that asks for it


Kind = Literal["one", "several", "flag", "number", "whole_number", "frame_range"]


@dataclass(frozen=True, slots=True)
class Choice:
    """A declared choice."""

    name: str  # Name of the field
    kind: Kind  # ``one`` of the values, ``several`` of them, yes or no, a number, a whole number, or a range of frames
    hint: Any  # Type of the field, with the labels of its values
    values: Mapping[str, Value]  # Named values by name; of numbers, names that stand for no number
    default: Any
    about: About
    schema: Mapping[str, Any]  # JSON Schema of the values; made once, as every job that is read is checked by it

    @property
    def option(self) -> str:
        """Name of the option of the command line, without dashes in front."""
        return self.about.option or self.name.replace("_", "-")

    @property
    def description(self) -> str:
        """The sentence, with the values and their labels or the meaning of an omitted value."""
        parts = [f"`{name}`: {value.label}" for name, value in self.values.items()]
        if self.about.unset is not None:
            parts.append(f"Omitted: {self.about.unset}")
        return f"{self.about.sentence} {'; '.join(parts)}." if parts else self.about.sentence


def members(hint: Any) -> tuple[Any, ...]:
    """Types of a union; of another type the type itself."""
    return get_args(hint) if get_origin(hint) in {Union, types.UnionType} else (hint,)


_AnyValue = TypeVar("_AnyValue", bound=Value)


def named_values(hint: Any, kind: type[_AnyValue]) -> dict[str, _AnyValue]:
    """Values of a type of this module that are of a kind, by name, in the order of their declaration."""
    found = {}
    for member in members(hint):
        if get_origin(member) is tuple:
            found.update(named_values(get_args(member)[0], kind))
        elif get_origin(member) is Annotated:
            literal, value = get_args(member)
            if isinstance(value, kind):
                found[str(*get_args(literal))] = value
    return found


def plain_hint(hint: Any) -> Any:
    """Type without labels: one ``Literal`` for all names of a choice."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return plain_hint(args[0])
    if origin in {Union, types.UnionType}:
        plain = [plain_hint(member) for member in args]
        names = tuple(name for member in plain if get_origin(member) is Literal for name in get_args(member))
        rest = [member for member in plain if get_origin(member) is not Literal]
        return Union[tuple([Literal[names], *rest] if names else rest)]  # noqa: UP007 - as many as there are
    if origin is None or origin is Literal or not args:
        return hint
    if isinstance(args[0], list):  # arguments of a callable
        return origin[[plain_hint(arg) for arg in args[0]], plain_hint(args[1])]
    return origin[tuple(plain_hint(arg) for arg in args)]


def plainly_annotated(function: Callable[..., Any]) -> None:
    """Give a function types without labels, which ``help`` shows."""
    function.__annotations__ = {name: plain_hint(hint) for name, hint in function.__annotations__.items()}


def _schema(hint: Any, about: About) -> dict[str, Any]:
    """JSON Schema of a type of a choice; ``about`` limits its numbers."""
    if get_origin(hint) is tuple:
        items = get_args(hint)
        if items[1] is Ellipsis:
            return {"type": "array", "items": _schema(items[0], about), "uniqueItems": True}
        schemas = [_schema(item, about) for item in items]
        return {"type": "array", "prefixItems": schemas, "minItems": len(items), "maxItems": len(items)}
    names = list(named_values(hint, Value))
    branches: list[dict[str, Any]] = []
    if names:
        branches.append({"type": "string", **({"enum": names} if len(names) > 1 else {"const": names[0]})})
    for member in members(hint):
        if get_origin(member) is Annotated:
            note = get_args(member)[1]
            branches += [{"type": "string", "pattern": note.pattern}] if isinstance(note, OtherNames) else []
        elif get_origin(member) is tuple:
            branches.append(_schema(member, about))
        elif member in {int, float}:
            limits = {"minimum": about.minimum, "exclusiveMinimum": about.above, "maximum": about.maximum}
            kind = {"type": "integer" if member is int else "number"}
            branches.append(kind | {name: limit for name, limit in limits.items() if limit is not None})
        else:
            branches.append({"type": "boolean" if member is bool else "null"})
    return branches[0] if len(branches) == 1 else {"anyOf": branches}


def declared_choices(declaration: type[Any]) -> tuple[Choice, ...]:
    """Choices that a dataclass declares, in their order; fields without ``About`` are left out."""
    hints = get_type_hints(declaration, include_extras=True)
    found = []
    for declared in fields(declaration):
        hint = hints[declared.name]
        if get_origin(hint) is Annotated:
            inner, about = get_args(hint)
            named, schema = named_values(inner, Value), _schema(inner, about)
            found.append(Choice(declared.name, _kind(inner), inner, named, declared.default, about, schema))
    return tuple(found)


def _kind(hint: Any) -> Kind:
    plain = [member for member in members(hint) if get_origin(member) is not Annotated and member is not type(None)]
    match plain:
        case []:
            return "one"
        case [one] if get_origin(one) is tuple:
            return "several" if get_args(one)[1] is Ellipsis else "frame_range"
        case [one] if one is bool:
            return "flag"
        case [one] if one is int:
            return "whole_number"
        case [one] if one is float:
            return "number"
    message = f"Choices have no type {hint}."
    raise TypeError(message)
