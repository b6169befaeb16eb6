"""The code behind each stage has a digest, which tells other code from this one; and laws of the digest."""

import ast
import shutil
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from pipeline.run.engine.code import LIBRARIES, SourceFolder, digests_of_stages, stage_codes
from pipeline.run.engine.plan import STAGES
from pipeline.run.engine.stage import DETECT, EXPORT, FIT, HOLD, LENGTHS, LOOK, POSES, REFIT, WRITE

ROOT = Path(__file__).parents[4]
# Packages that the stages import and that change no number.
NOT_NUMERIC = {
    "defusedxml",
    "filelock",
    "google",
    "httpx2",
    "jaxtyping",
    *("matplotlib", "pandas", "xarray"),  # they show what is reconstructed in notebooks
    "opensim",  # its numbers belong to no reusable output
    "platformdirs",
    "pxr",
    "rerun",
    "threadpoolctl",
    "unearth",
    "yaml",
}


def imported_by(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_bytes())))
    absolute = {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module and not node.level}
    return absolute | {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}


@pytest.mark.slow
def test_libraries_of_stages_all_count() -> None:
    folders = [ROOT / "pipeline/run/engine", ROOT / "pipeline/run/steps"]
    paths = [path for folder in folders for path in folder.glob("*.py") if path.stem not in {"__init__", "local"}]
    direct = {f"pipeline.run.{path.parent.name}.{path.stem}" for path in paths}
    paths = [ROOT.joinpath(*name.split(".")) for name in SourceFolder(ROOT).reachable_modules(direct)]
    files = [path / "__init__.py" if path.is_dir() else path.with_suffix(".py") for path in paths]
    packages = {name.partition(".")[0] for path in files for name in imported_by(path)}
    others = packages - set(sys.stdlib_module_names) - {"pipeline"}
    assert others >= NOT_NUMERIC
    distributions = packages_distributions()
    assert {distributions[name][0] for name in others - NOT_NUMERIC} == {*LIBRARIES}


def test_other_version_of_library_is_other_code() -> None:
    assert not {*digests_of_stages(ROOT, ("numpy",)).values()} & {*stage_codes().values()}


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of the sources."""
    shutil.copytree(ROOT / "pipeline", tmp_path / "pipeline", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def append(path: Path) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write("\nUNUSED = 1\n")


def changed(sources: Path) -> set[str]:
    before, after = stage_codes(), digests_of_stages(sources)
    return {stage for stage, code in after.items() if code != before[stage]}


def test_equal_code_elsewhere_has_equal_digests(sources: Path) -> None:
    assert changed(sources) == set()


def test_changed_module_counts_for_stages_that_reach_it(sources: Path) -> None:
    append(sources / "pipeline/motion/skeleton/feet/stances.py")
    stages = changed(sources)
    assert stages >= {FIT, HOLD, REFIT}
    assert not stages & {LOOK, DETECT, LENGTHS, POSES}


def test_import_inside_function_counts(sources: Path) -> None:
    """``detection.registry`` imports the conversions of networks where it needs them."""
    append(sources / "pipeline/detection/conversion/onnx_graph.py")
    assert DETECT in changed(sources)


def test_module_that_no_stage_imports_counts_for_none(sources: Path) -> None:
    append(sources / "pipeline/validation/simulation/motion/body.py")
    append(sources / "pipeline/run/engine/local.py")
    (sources / "pipeline/new.py").write_text("NEW = 1\n", encoding="utf-8")
    assert changed(sources) == set()


def test_module_of_stage_counts_for_it(sources: Path) -> None:
    append(sources / "pipeline/run/steps/export.py")
    assert changed(sources) == {WRITE, EXPORT}


def test_writer_that_is_loaded_by_name_counts_for_files(sources: Path) -> None:
    append(sources / "pipeline/export/writers/bvh.py")
    stages = changed(sources)
    assert stages >= {EXPORT, WRITE}
    assert not stages & {LOOK, DETECT, FIT, HOLD}


def test_module_of_all_stages_counts_for_all(sources: Path) -> None:
    append(sources / "pipeline/capture/preflight_npz.py")
    assert changed(sources) == {stage.name for stage in STAGES}


def test_prefix_of_wheel_counts_for_none(sources: Path) -> None:
    for path in (sources / "pipeline").rglob("*.py"):
        path.write_bytes(path.read_bytes().replace(b"from pipeline", b"from multicap.pipeline"))
    assert changed(sources) == set()


def test_reachable_modules_follow_all_forms_of_imports(tmp_path: Path) -> None:
    modules = {
        "a": "from pipeline import b\n",
        "b": "def f():\n    from pipeline.inner import (\n        c,  # (first)\n        d,\n    )\n    return c, d\n",
        "inner/__init__": "",
        "inner/c": "if TYPE_CHECKING:\n    from pipeline.types import T\n\n\nx = 1\n",
        "inner/d": "import numpy\nfrom pipeline.a import f as other\nfrom pipeline.e.g import value\n",
        "e/__init__": "",
        "e/g": "value = 1\n",
        "types": "T = int\n",
        "unused": "",
    }
    for name, text in modules.items():
        path = tmp_path / "pipeline" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    reached = SourceFolder(tmp_path).reachable_modules(["pipeline.a"])
    names = "a", "b", "e", "e.g", "inner", "inner.c", "inner.d"
    assert reached == [f"pipeline.{name}" for name in names]
