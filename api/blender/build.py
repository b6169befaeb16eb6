"""Build of the extension's zip: ``python -P -m api.blender.build [FOLDER]``.

Blender loads an extension as a package of a name of its own, so that its modules import each other by relative imports;
here they are written as everywhere else, and changed in the zip. Modules that the extension shares with the pipeline
are copied into it. The same sources give the same bytes.
"""

import re
import sys
import tomllib
import zipfile
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_SOURCES = Path(__file__).parent / "extension"
MANIFEST = _SOURCES / "blender_manifest.toml"
"""Manifest of the extension, in Blender's form."""
SHARED = ("pipeline/export/character/bone_names.py", "pipeline/motion/skeleton/humanoid.py")
"""Modules of the pipeline that the zip holds a copy of; they know the standard library alone."""
_PACKAGE = "api.blender.extension"
_MOMENT = (1980, 1, 1, 0, 0, 0)


def sources() -> dict[str, str]:
    """Text files of the extension by their names in the zip."""
    modules = [*sorted(_SOURCES.glob("*.py")), *(_ROOT / name for name in SHARED)]
    texts = {path.name: nest_imports(path.read_text(encoding="utf-8")) for path in modules}
    return {
        **texts,
        MANIFEST.name: MANIFEST.read_text(encoding="utf-8"),
        "LICENSE": (_ROOT / "LICENSE").read_text(encoding="utf-8"),
    }


def nest_imports(source: str) -> str:
    """Source of a module with relative imports of the extension's modules, and of those that it shares.

    >>> nest_imports("from api.blender.extension.client import BlenderClient")
    'from .client import BlenderClient'
    >>> nest_imports("    from api.blender.extension import scene")
    '    from . import scene'
    """
    for name in SHARED:
        module = name.removesuffix(".py").replace("/", ".")
        source = source.replace(f"from {module} import", f"from .{module.rpartition('.')[2]} import")
    source = re.sub(rf"(?m)^( *)from {re.escape(_PACKAGE)}\.(\w+) import", r"\1from .\2 import", source)
    return re.sub(rf"(?m)^( *)from {re.escape(_PACKAGE)} import", r"\1from . import", source)


def build(folder: Path) -> Path:
    """Write the zip into a folder; return its path."""
    manifest = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{manifest['id']}-{manifest['version']}.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in sorted(sources().items()):
            entry = zipfile.ZipInfo(name, _MOMENT)
            entry.external_attr, entry.create_system = 0o644 << 16, 3
            # Compressed bytes may differ between versions of zlib; stored ones are the same everywhere.
            archive.writestr(entry, text.encode(), zipfile.ZIP_STORED)
    return path


if __name__ == "__main__":
    print(build(Path(sys.argv[1] if sys.argv[1:] else "build")))  # noqa: T201 - the path is the program's output
