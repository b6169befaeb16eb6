"""Objects that other packages add by entry points, and readers of formats. Standard library only."""

import importlib
import pkgutil
import warnings
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from types import ModuleType
from typing import TypeVar

READERS = "multicap.readers"
"""Group of the entry points of readers."""


class PluginWarning(UserWarning):
    """An object of another package can't be used. The command line ends with it; a service goes on without."""


@dataclass(frozen=True, slots=True, eq=False)
class FormatReader:
    """Base of the readers of formats."""

    name: str


_entry_points = cache(entry_points)  # the search takes some milliseconds
_Plugin = TypeVar("_Plugin")
_Reader = TypeVar("_Reader", bound=FormatReader)


def load_plugins(group: str, kind: type[_Plugin]) -> dict[str, _Plugin]:
    """Load the objects of a group of entry points, by name.

    Objects that can't be loaded or are of another kind are left out, with a ``PluginWarning`` that names the package.
    """
    plugins = {}
    for point in sorted(_entry_points().select(group=group)):
        try:
            plugin = point.load()
            if not isinstance(plugin, kind):
                raise TypeError(f"it is no {kind.__name__}")  # noqa: TRY301 - reported like an error of the package
        except Exception as error:
            package = point.dist.name if point.dist else "its package"
            message = f"The format {point.name} of {package} ({group}) can't be loaded: {error}."
            warnings.warn(f"{message} Update {package}, or uninstall it.", PluginWarning, stacklevel=2)
        else:
            plugins[point.name] = plugin
    return plugins


def load_readers(kind: type[_Reader], folder: ModuleType) -> tuple[_Reader, ...]:
    """Load the readers of a kind: of other packages, then of the modules of a folder."""
    found: list[object] = [*load_plugins(READERS, FormatReader).values()]
    for module in pkgutil.iter_modules(folder.__path__):
        found += vars(importlib.import_module(f"{folder.__name__}.{module.name}")).values()
    return tuple(dict.fromkeys(reader for reader in found if isinstance(reader, kind)))
