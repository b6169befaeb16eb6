"""Objects that other packages add by entry points. Standard library only."""

from importlib.metadata import entry_points
from typing import TypeVar

_Plugin = TypeVar("_Plugin")


def load_plugins(group: str, kind: type[_Plugin]) -> dict[str, _Plugin]:
    """Load the objects of a group of entry points, by name.

    Raises
    ------
    ImportError
        If an object can't be loaded, or is of another kind; the message names the package.
    """
    plugins = {}
    for point in sorted(entry_points(group=group)):
        package = point.dist.name if point.dist else "a package"
        try:
            plugin = point.load()
        except Exception as error:
            raise ImportError(f"{point.name} of {package} ({group}) can't be loaded: {error}") from error
        if not isinstance(plugin, kind):
            message = f"{point.name} of {package} ({group}) is no {kind.__name__}"
            raise ImportError(message)  # noqa: TRY004 - a package is at fault, not a caller
        plugins[point.name] = plugin
    return plugins
