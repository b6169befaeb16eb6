"""Laws of the layout: stages named in one place, a class a name, a web API without science."""

import ast
import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from pipeline.run.engine.plan import STAGES
from pipeline.run.engine.stage import EXPORT, FIT, POSES

ROOT = Path(__file__).parents[1]
PACKAGES = ("api", "multicap", "pipeline", "worker")
# These words have other meanings too: a smoothing, result files, and a field of keypoint files.
NAMES = {stage.name for stage in STAGES} - {FIT, EXPORT, POSES}


def scripts_of_the_page() -> list[Path]:
    portal = ROOT / "api" / "portal"
    others = {"help", "node_modules", "vendor"}
    paths = [path for path in portal.rglob("*.js") if path.relative_to(portal).parts[0] not in others]
    assert len(paths) > 10
    return paths


def lines_with_stages(path: Path) -> list[int]:
    """Lines of a module on which the name of a stage is a constant."""
    text = path.read_text(encoding="utf-8")
    if not any(f'"{name}"' in text for name in NAMES):
        return []
    nodes = ast.walk(ast.parse(text))
    return [node.lineno for node in nodes if isinstance(node, ast.Constant) and node.value in NAMES]


def test_no_stage_is_spelled_elsewhere() -> None:
    spelled = []
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            if path.parent not in (ROOT / "pipeline" / "run" / "engine", ROOT / "pipeline" / "run" / "steps"):
                spelled += [f"{path.relative_to(ROOT)}:{line}" for line in lines_with_stages(path)]
    assert not spelled


def test_no_stage_is_spelled_in_page() -> None:
    labels = {stage.label for stage in STAGES}
    for path in scripts_of_the_page():
        text = path.read_text(encoding="utf-8")
        assert not {label for label in labels if label in text}
        assert not set(re.findall(r"[\"'](\w+)[\"']|\b(\w+):", text)) & {(name, "") for name in NAMES}
        assert not {key for _, key in re.findall(r"[\"'](\w+)[\"']|\b(\w+):", text)} & NAMES


def test_no_two_classes_have_one_name() -> None:
    """Of the sources, their tests and the page's scripts; private classes are nobody else's."""
    names: Counter[str] = Counter()
    for package in (*PACKAGES, "tests"):
        for path in (ROOT / package).rglob("*.py"):
            if "node_modules" not in path.parts:
                names.update(re.findall(r"^ *class (\w+)[(:]", path.read_text(encoding="utf-8"), re.MULTILINE))
    for path in scripts_of_the_page():
        names.update(re.findall(r"^\s*(?:export )?class (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE))
    assert len(names) > 500
    assert not {name for name, count in names.items() if count > 1 and not name.startswith("_")}


SCIENCE = {"scipy", "numba", "cv2", "av", "onnxruntime"}


@pytest.mark.parametrize(
    ("modules", "needed", "unneeded"),
    [
        ("api.web.app, api.__main__", "fastapi", SCIENCE | {"numpy", "alembic"}),
        ("api.cli.commands.serve", "sqlalchemy", SCIENCE | {"fastapi", "alembic"}),
        ("worker.__main__", "celery", SCIENCE | {"fastapi", "alembic"}),
        ("worker.run.reaper", "sqlalchemy", SCIENCE | {"fastapi", "alembic"}),
        ("pipeline.run.engine.local, pipeline.run.session_check.check_session", "numba", {"cv2", "onnxruntime"}),
    ],
    ids=["web API", "supervisor", "main process of workers", "reaper", "job of keypoints"],
)
def test_processes_load_what_they_need(modules: str, needed: str, unneeded: set[str]) -> None:
    """A service starts in seconds: its workers alone load science, and alembic is for an older schema."""
    program = f"import sys, {modules}; print(*sys.modules)"
    ended = subprocess.run([sys.executable, "-P", "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in ended.stdout.split()}
    assert needed in loaded
    assert not loaded & unneeded


@pytest.mark.slow
def test_groups_of_tests_stay_together(tmp_path: Path) -> None:
    """Tests of a group share fixtures that take minutes; some versions of pytest and pytest-xdist scatter them."""
    (tmp_path / "test_group.py").write_text(
        "import os, pathlib, pytest\n"
        "pytestmark = pytest.mark.xdist_group('one')\n"
        "@pytest.mark.parametrize('number', range(8))\n"
        "def test_process(number, tmp_path_factory):\n"
        f"    pathlib.Path({str(tmp_path)!r}, f'{{os.getpid()}}.process').touch()\n"
    )
    options = ["-p", "xdist", "-n2", "--dist=loadgroup", "-q", "-p", "no:cacheprovider", "-c", os.devnull]
    options.append(f"--rootdir={tmp_path}")
    command = [sys.executable, "-P", "-m", "pytest", *options, str(tmp_path)]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # other plugins take seconds to load
    subprocess.run(command, env=environment, capture_output=True, check=True)
    assert len(list(tmp_path.glob("*.process"))) == 1
