"""Digest of the code that a function's result depends on. Imports the standard library only, and parses the code.

Of modules within ``BY_STATEMENT`` count the top-level statements that the function uses, there and wherever it leads.
Of the classes in ``BY_MEMBER``, one of these modules, count the members that used statements name. Modules outside
count as a whole, with all modules of the package that they import, directly or indirectly. Imports inside functions
count too. Comments, docstrings, blank lines and the order of files do not change the digest; a checkout and an
installed wheel have the same digest.
"""

import ast
import copy
import functools
import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = "pipeline"
BY_STATEMENT, BY_MEMBER = "pipeline.run.steps", "pipeline.run.engine.context"
# Prefix of module names: `multicap.` in the wheel, empty in a checkout. See `hatch_build.py`.
_PARENT = __name__.removesuffix("pipeline.core.runtime.code_digest")
_WITH_DOCSTRINGS = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_EMPTY_FIELD = re.compile(r"(?:, )?\b\w+=\[\]")


def function_digest(
    root: Path,
    roots: Iterable[tuple[str, str]],
    package: str = PACKAGE,
    by_statement: str = BY_STATEMENT,
    by_member: str = BY_MEMBER,
) -> str:
    """Digest of functions and classes, and of the code that they depend on.

    Parameters
    ----------
    roots
        Modules, and functions or classes at their top level.
    package
        Package whose imports are followed.
    by_statement, by_member
        Package, and a module of it, that count in part.

    Returns
    -------
        SHA-256 in hexadecimal digits; equal for equal code on every machine and version of Python.

    Raises
    ------
    KeyError
        If a module has no such function or class.
    """
    used, origins, whole = _reached(root, roots, package, by_statement, by_member)
    parts: list[object] = [sorted(origins), [used[place].text for place in sorted(used)]]
    parts += [
        [name, _source_digest(_path(root, name).read_bytes())] for name in reachable_modules(root, whole, package)
    ]
    return _sha256(parts)


def _reached(
    root: Path, roots: Iterable[tuple[str, str]], package: str, by_statement: str, by_member: str
) -> tuple[dict[tuple[str, int], "_Part"], set[tuple[str, str, str]], set[str]]:
    """Used parts of modules by place, origins of used imports by module and name, and modules that count as a whole."""
    wanted: dict[str, set[str]] = {}
    used: dict[tuple[str, int], _Part] = {}
    origins: set[tuple[str, str, str]] = set()
    whole: set[str] = set()
    attributes: set[str] = set()

    def parts_of(module: str) -> tuple[_Part, ...]:
        return _parts(_path(root, module).read_bytes(), module == by_member)

    for module, name in roots:
        if not any(name in part.bound and not part.owner for part in parts_of(module)):
            raise KeyError(name)
        wanted.setdefault(module, set()).add(name)
    size = None
    while size != (size := (len(used), len(origins), len(attributes), sum(map(len, wanted.values())))):
        for module in list(wanted):
            names = wanted[module]
            for number, part in enumerate(parts_of(module)):
                if part.owner in names and part.bound & attributes if part.owner else part.bound & names:
                    used[module, number] = part
                    names |= part.read
                    attributes |= part.attributes
                    is_import = not part.text
                    origins |= {(module, *pair) for pair in part.imports if not is_import or pair[0] in names}
        for origin in {origin for _, _, origin in origins}:
            for module in _modules(root, (origin,), package):
                if not f"{module}.".startswith(f"{by_statement}.") or _path(root, module).stem == "__init__":
                    whole.add(module)
                elif module == origin:
                    wanted.setdefault(module, set()).update(*(part.bound for part in parts_of(module)))
                else:
                    wanted.setdefault(module, set()).add(origin.removeprefix(f"{module}."))
    return used, origins, whole


def reachable_modules(root: Path, modules: Iterable[str], package: str = PACKAGE) -> list[str]:
    """List modules and those of the package that they import, directly or indirectly, sorted by name."""
    reached: set[str] = set()
    waiting = set(modules)
    while waiting:
        name = waiting.pop()
        reached.add(name)
        waiting |= _modules(root, _imports(_path(root, name).read_bytes()), package) - reached
    return sorted(reached)


def forget_sources() -> None:
    """Clear the caches of syntax trees and digests."""
    for cached in (_path, _parsed, _parts, _imports, _source_digest):
        cached.cache_clear()


@functools.lru_cache(maxsize=8192)
def _path(root: Path, module: str) -> Path:
    """File of a module, or of a package's ``__init__``."""
    path = root.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


# Cached, because stages share most modules.
@functools.lru_cache(maxsize=1024)
def _parsed(source: bytes) -> ast.Module:
    """Parse a module, without docstrings and without the wheel's prefix of imports."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            node.module = node.module.removeprefix(_PARENT)
        if isinstance(node, _WITH_DOCSTRINGS):
            node.body = [statement for statement in node.body if not _is_docstring(statement)]
    return tree


@functools.lru_cache(maxsize=1024)
def _imports(source: bytes) -> frozenset[str]:
    # Most nodes are no imports; a call for each of them would take seconds.
    imports = [node for node in ast.walk(_parsed(source)) if isinstance(node, ast.Import | ast.ImportFrom)]
    return frozenset(origin for node in imports for _, origin in _origins(node))


@functools.lru_cache(maxsize=1024)
def _source_digest(source: bytes) -> str:
    return _sha256(_canonical(_parsed(source)))


def _sha256(value: object) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class _Part:
    """A top-level statement of a module, or a member of one of its classes."""

    # Names that it binds and reads, and attributes that it names
    bound: frozenset[str]
    read: frozenset[str]
    attributes: frozenset[str]
    imports: tuple[tuple[str, str], ...]  # Names that imports bind, each with its origin, ``module`` or ``module.name``
    text: str  # Its syntax tree; empty for imports
    owner: str = ""  # Class of a member; empty: it is a statement


# Cached, because stages share these modules.
@functools.lru_cache(maxsize=256)
def _parts(source: bytes, has_members: bool) -> tuple[_Part, ...]:
    """Parts of a module; members of its classes are parts of their own, or belong to the class."""
    parts = []
    for statement in _parsed(source).body:
        if has_members and isinstance(statement, ast.ClassDef):
            members = [inner for inner in statement.body if _is_member(inner)]
            parts += [_part(member, statement.name) for member in members]
            statement = copy.copy(statement)  # noqa: PLW2901
            statement.body = [inner for inner in statement.body if inner not in members]
        parts.append(_part(statement))
    return tuple(parts)


def _part(statement: ast.stmt, owner: str = "") -> _Part:
    is_import = isinstance(statement, ast.Import | ast.ImportFrom)
    read = set(_read(statement))
    return _Part(
        frozenset(_bound_names(statement)),
        frozenset(name for name in read if not name.startswith(".")),
        frozenset(name.removeprefix(".") for name in read if name.startswith(".")),
        tuple(pair for node in ast.walk(statement) for pair in _origins(node)),
        "" if is_import else _canonical(statement),
        owner,
    )


def _is_member(statement: ast.stmt) -> bool:
    """Whether a statement of a class is a method that is called by its name."""
    return isinstance(statement, ast.FunctionDef) and not statement.name.startswith("__")


def _bound_names(statement: ast.AST) -> Iterator[str]:
    """Names that a statement binds, including those in its blocks, excluding those inside functions and classes."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield statement.name
        return
    if isinstance(statement, ast.Name) and isinstance(statement.ctx, ast.Store):
        yield statement.id
    yield from (name for name, _ in _origins(statement))
    for child in ast.iter_child_nodes(statement):
        yield from _bound_names(child)


def _read(node: ast.AST) -> Iterator[str]:
    """Names that a syntax tree reads, and attributes with a dot, without annotations of functions, which do nothing."""
    if isinstance(node, ast.Name):
        yield node.id
    elif isinstance(node, ast.Attribute):
        yield f".{node.attr}"
    for field, value in ast.iter_fields(node):
        if field != "returns" and not (field == "annotation" and isinstance(node, ast.arg)):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _read(child)


def _origins(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Names that an import binds, each with its origin, ``module`` or ``module.name``."""
    if isinstance(node, ast.Import):
        yield from ((alias.asname or alias.name.partition(".")[0], alias.name) for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        yield from ((alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names)


def _modules(root: Path, origins: Iterable[str], package: str) -> set[str]:
    """Modules of a package among import origins, and the packages that contain them."""
    inside = (origin.split(".") for origin in origins if origin.partition(".")[0] == package)
    prefixes = {".".join(split[:length]) for split in inside for length in range(1, len(split) + 1)}
    # The last part of ``module.name`` may be a module, a function or a class.
    return {name for name in prefixes if _path(root, name).is_file()}


def _canonical(statement: ast.AST) -> str:
    """Write a syntax tree as text, without the empty fields that some versions of Python write and others do not."""
    return _EMPTY_FIELD.sub("", ast.dump(statement)).replace("(, ", "(")


def _is_docstring(node: ast.AST) -> bool:
    """Return whether a statement is a bare string."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
