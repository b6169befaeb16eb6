"""Digest of the code that a function's result depends on. Imports the standard library only, and parses the code.

The digest covers the function, the statements of its module that it uses, and all modules of a package that these
import, directly or indirectly, also inside functions. Comments, docstrings, blank lines and the order of files do not
change the digest; a checkout and an installed wheel have the same digest.
"""

import ast
import functools
import hashlib
import json
import re
from collections.abc import Container, Iterable, Iterator, Sequence
from pathlib import Path

PACKAGE = "pipeline"
# Prefix of module names: `multicap.` in the wheel, empty in a checkout. See `hatch_build.py`.
_PARENT = __name__.removesuffix("pipeline.runtime.code_digest")
_WITH_DOCSTRINGS = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_EMPTY_FIELD = re.compile(r"(?:, )?\b\w+=\[\]")


def function_digest(root: Path, module: str, function: str, package: str = PACKAGE) -> str:
    """Digest of a function and of the modules that it depends on.

    Parameters
    ----------
    root
        Folder of the packages' sources.
    module, function
        Names of a module, inside or outside of ``package``, and of a function at its top level.
    package
        Package whose imports are followed.

    Returns
    -------
        SHA-256 in hexadecimal digits; equal for equal code on every machine and version of Python.

    Raises
    ------
    KeyError
        If the module has no such function.
    """
    statements = _parse(_path(root, module)).body
    used, names = _used(statements, function)
    origins = sorted(origin for statement in used for origin in _origins(statement, names))
    direct = _modules(root, (origin for _, origin in origins), package)
    code = [_canonical(statement) for statement in used if not isinstance(statement, ast.Import | ast.ImportFrom)]
    parts = [origins, code]
    parts += [
        [name, _source_digest(_path(root, name).read_bytes())] for name in reachable_modules(root, direct, package)
    ]
    return _sha256(parts)


def reachable_modules(root: Path, modules: Iterable[str], package: str = PACKAGE) -> list[str]:
    """List modules and those of the package that they import, directly or indirectly, sorted by name."""
    found: set[str] = set()
    waiting = set(modules)
    while waiting:
        name = waiting.pop()
        found.add(name)
        waiting |= _modules(root, _imports(_path(root, name).read_bytes()), package) - found
    return sorted(found)


def forget_sources() -> None:
    """Clear the caches of syntax trees and digests."""
    for cached in (_parsed, _imports, _source_digest):
        cached.cache_clear()


def _path(root: Path, module: str) -> Path:
    """File of a module, or of a package's ``__init__``."""
    path = root.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def _parse(path: Path) -> ast.Module:
    return _parsed(path.read_bytes())


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


def _used(statements: Sequence[ast.stmt], function: str) -> tuple[list[ast.stmt], set[str]]:
    """Top-level statements of a module that a function depends on, in order, and all names that they read."""
    makers: dict[str, set[int]] = {}
    for number, statement in enumerate(statements):
        for name in _bound_names(statement):
            makers.setdefault(name, set()).add(number)
    used: set[int] = set()
    names = {function}
    waiting = set(makers[function])
    while waiting:
        number = waiting.pop()
        used.add(number)
        read = _read_names(statements[number])
        names |= read
        waiting |= {maker for name in read for maker in makers.get(name, ())} - used
    return [statements[number] for number in sorted(used)], names


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


def _read_names(node: ast.AST) -> set[str]:
    """Names that a syntax tree reads, annotations left out: they do not affect results."""
    found = {node.id} if isinstance(node, ast.Name) else set()
    for field, value in ast.iter_fields(node):
        if field not in {"annotation", "returns"}:
            children = value if isinstance(value, list) else [value]
            found |= {name for child in children if isinstance(child, ast.AST) for name in _read_names(child)}
    return found


def _origins(node: ast.AST, wanted: Container[str] | None = None) -> Iterator[tuple[str, str]]:
    """Names that an import binds, each with its origin, ``module`` or ``module.name``."""
    if isinstance(node, ast.Import):
        pairs = [(alias.asname or alias.name.partition(".")[0], alias.name) for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        pairs = [(alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names]
    else:
        return
    yield from (pair for pair in pairs if wanted is None or pair[0] in wanted)


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
