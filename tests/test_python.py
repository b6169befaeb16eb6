"""The package `multicap`: names load lazily and are the same for type checkers and the interpreter."""

import ast
import doctest
import importlib.metadata
import inspect
import pydoc
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import is_typeddict

import pytest

import hatch_build
import multicap
from api.cli import client
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

SOURCE = Path(multicap.__file__)
# Entries of the science, which other packages may call too
METHODS = (
    "pipeline.run.engine.plan:plan",
    "pipeline.run.engine.stage:Stage",
    "pipeline.calibration.adjustment.bundle:adjust",
    "pipeline.calibration.board.calibrate_board:calibrate_board",
    "pipeline.calibration.people.calibrate_people:calibrate_people",
    "pipeline.calibration.known_points.fit:place_by_points",
    "pipeline.calibration.registry:read_contents",
    "pipeline.association.tracking.track_people:reconstruct_tracks",
    "pipeline.association.clustering.cluster_people:reconstruct_by_clustering",
    "pipeline.motion.skeleton.fitting.fit:fit_to_rays",
    "pipeline.geometry.triangulation:triangulate",
)


def typed_references() -> dict[str, str]:
    """Types of the names by the type checkers."""
    found: dict[str, str] = {}
    for block in ast.parse(SOURCE.read_bytes()).body:
        if isinstance(block, ast.If):
            for node in block.body:
                assert isinstance(node, ast.ImportFrom)
                found |= {one.asname or one.name: f"{node.module}:{one.name}" for one in node.names}
    return found


def test_types_and_interpreter_agree() -> None:
    assert typed_references() == multicap._REFERENCES
    assert sorted(multicap._REFERENCES) == multicap.__all__


def returns_nothing(function: Callable[..., object]) -> bool:
    return inspect.signature(function, eval_str=False).return_annotation in (None, "None", inspect.Parameter.empty)


@pytest.mark.parametrize("name", [*(f"multicap:{name}" for name in multicap.__all__), *METHODS])
def test_public_name_has_sections_and_example(name: str) -> None:
    """Sections of numpydoc; `tests/pipeline/test_examples.py` runs the examples of the pipeline."""
    thing = resolve_name(name)
    sections = set(re.findall(r"^(\w+)\n-+$", inspect.getdoc(thing) or "", re.MULTILINE))
    needed = {"Examples"}
    is_error = inspect.isclass(thing) and issubclass(thing, Exception) and "__init__" not in vars(thing)
    if not is_error:
        needed |= {"Attributes" if is_typeddict(thing) else "Methods" if name == "multicap:Session" else "Parameters"}
    if not inspect.isclass(thing) and not returns_nothing(thing):
        needed |= {"Returns"}
    assert needed <= sections
    assert ">>> " in (inspect.getdoc(thing) or "")
    assert name.partition(":")[2] in dir(multicap) or name in METHODS


def test_help_and_signatures_are_short() -> None:
    """An enum is a plain `Literal`, and a default configuration shows what differs from the defaults."""
    for name in multicap.__all__:
        thing = resolve_name(f"multicap:{name}")
        text = (inspect.getdoc(thing) or "") if inspect.isclass(thing) else pydoc.plain(pydoc.render_doc(thing))
        assert len(text.splitlines()) <= 40, name
        if not (inspect.isclass(thing) and issubclass(thing, Exception | dict)):
            signature = str(inspect.signature(thing))
            assert "Annotated" not in signature
            assert len(signature) < 40 * 100


def test_example_of_package_runs(tmp_path: Path) -> None:
    write_simulation(record(replace(find_scene("room"), duration_s=0.4), 0, 3), tmp_path)
    results = doctest.testmod(multicap, extraglobs={"folder": tmp_path})
    assert results.attempted > 4
    assert results.failed == 0


def test_examples_of_client_run() -> None:
    results = doctest.testmod(client)
    assert results.attempted == 3
    assert results.failed == 0


def test_unknown_names_are_refused_as_of_any_module() -> None:
    with pytest.raises(AttributeError, match="module 'multicap' has no attribute 'missing'"):
        multicap.missing  # noqa: B018


def loaded_by(statement: str) -> set[str]:
    text = f"import sys; before = set(sys.modules)\n{statement}\nprint(*set(sys.modules) - before)"
    done = subprocess.run([sys.executable, "-P", "-c", text], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stdout.split()}


def test_import_alone_loads_nothing_else() -> None:
    assert loaded_by("import multicap") - sys.stdlib_module_names - {"__mp_main__"} == {"multicap"}


def test_client_loads_no_science() -> None:
    loaded = loaded_by("import multicap; multicap.Client")
    assert "httpx2" in loaded
    assert not loaded & {"numpy", "celery", "sqlalchemy", "typer", "worker"}


@pytest.mark.parametrize(
    ("source", "nested"),
    [
        (b"from pipeline.data import Camera\n", b"from multicap.pipeline.data import Camera\n"),
        (b"from api import errors\n", b"from multicap.api import errors\n"),
        (b"def f():\n    from  worker import (\n        tasks,\n    )\n", None),
        (b"import numpy\nfrom pipelines.data import Camera\n", b"import numpy\nfrom pipelines.data import Camera\n"),
        (b'"""From pipeline.data import it."""\n', b'"""From pipeline.data import it."""\n'),
        (b"x = '\xc3\xa4', 'worker.process.pool:Pool'\n", b"x = '\xc3\xa4', 'multicap.worker.process.pool:Pool'\n"),
        (b"x = 'worker.process.pool', 'workers.pool:Pool'\n", b"x = 'worker.process.pool', 'workers.pool:Pool'\n"),
    ],
)
def test_modules_of_wheel_import_each_other_inside_of_multicap(source: bytes, nested: bytes | None) -> None:
    expected = nested or source.replace(b"worker", b"multicap.worker")
    assert hatch_build.nest(source) == expected


def test_imports_that_would_bind_plain_name_are_refused() -> None:
    with pytest.raises(ValueError, match="line 2: write `from"):
        hatch_build.nest(b"import json\nimport pipeline.data\n")


def test_version_is_installed_one() -> None:
    assert multicap.__version__ == importlib.metadata.version("multicap")
