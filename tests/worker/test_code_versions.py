"""A stage's number in ``worker/plan.py`` goes up when its code changes; and laws of the digest that sees to it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.code_digest import function_digest, reachable_modules
from tests.worker.code_versions import FUNCTIONS, RECORD, ROOT, Version, mistakes, recorded, versions_of
from worker.plan import ASSOCIATE, CODE_VERSIONS, DETECT, EXPORT, FIT, LENGTHS, POSES
from worker.stages import STAGES


def test_no_stage_s_sources_changed_under_the_same_number() -> None:
    now = versions_of()
    assert mistakes(recorded(), now) == []
    assert now == recorded(), f"A number was raised: run `{RECORD}`."


def test_the_functions_are_those_of_the_stages() -> None:
    assert {stage: function.__name__ for stage, function in STAGES.items()} == FUNCTIONS
    assert set(CODE_VERSIONS) == set(FUNCTIONS)


def version(number: int, digest: str = "a") -> dict[str, Version]:
    return {FIT: {"version": number, "digest": digest}}


def test_mistakes_say_what_to_do() -> None:
    assert mistakes(version(1), version(1)) == []
    assert mistakes(version(1), version(2, "b")) == []
    assert mistakes({}, version(1)) == []
    (changed,) = mistakes(version(1), version(1, "b"))
    assert "stage fit" in changed
    assert "worker/plan.py" in changed
    assert RECORD in changed
    (back,) = mistakes(version(2), version(1, "b"))
    assert "went back" in back


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of the sources."""
    for package in ("pipeline", "worker"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def append(path: Path) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write("\nUNUSED = 1\n")


def changed(sources: Path) -> set[str]:
    before, now = versions_of(), versions_of(sources)
    return {stage for stage in now if now[stage]["digest"] != before[stage]["digest"]}


def test_comments_docstrings_and_layout_change_nothing(sources: Path) -> None:
    for path in sources.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        path.write_text(f'"""Something else."""\n# A comment.\n\n{text}\n\n# The end.\n', encoding="utf-8")
    edit(sources / "pipeline/skeleton/feet.py", "\n    return ", '\n    """Said again."""\n    # Why.\n    return ')
    assert changed(sources) == set()


def test_a_constant_of_the_feet_counts_from_the_fit_on(sources: Path) -> None:
    path = sources / "pipeline/skeleton/feet.py"
    name = next(
        line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("_") and " = " in line
    )
    edit(path, name, name.partition(" = ")[0] + " = 123.456")
    assert changed(sources) == {FIT, EXPORT}


def test_what_a_function_imports_inside_counts(sources: Path) -> None:
    """``detect.registry`` imports the conversions of networks where it needs them."""
    append(sources / "pipeline/detect/conversion/onnx_graph.py")
    assert DETECT in changed(sources)


def test_a_module_that_no_stage_imports_counts_for_none(sources: Path) -> None:
    append(sources / "pipeline/simulation/body.py")
    (sources / "pipeline/new.py").write_text("NEW = 1\n", encoding="utf-8")
    assert changed(sources) == set()


def test_the_stage_s_own_function_and_its_helpers_count(sources: Path) -> None:
    edit(
        sources / "worker/stages.py",
        "    first = cut.frames.start",
        "    first = 1 + cut.frames.start",
    )
    assert changed(sources) == {LENGTHS}
    edit(sources / "worker/stages.py", "cutoff_hz=spec.cutoff_hz", "cutoff_hz=2 * spec.cutoff_hz")
    assert changed(sources) == {LENGTHS, POSES, ASSOCIATE, FIT}


def write(root: Path, **modules: str) -> None:
    for name, text in modules.items():
        path = root.joinpath(*name.split("__")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def test_the_graph_of_imports(tmp_path: Path) -> None:
    write(
        tmp_path,
        pkg__a="import pkg.b\n",
        pkg__b="def f():\n    from pkg import c\n    return c\n",
        pkg__c="from pkg.inner.d import thing as other\n",
        pkg__inner__d="import pkg.a\nimport numpy\nthing = 1\n",
        pkg__e="",
    )
    (tmp_path / "pkg" / "inner" / "__init__.py").touch()
    assert reachable_modules(tmp_path, ["pkg.a"], "pkg") == ["pkg.a", "pkg.b", "pkg.c", "pkg.inner", "pkg.inner.d"]


def test_another_origin_of_a_name_is_another_function(tmp_path: Path) -> None:
    main = "from pkg.{} import work\nfrom pkg.b import unused\n\n\ndef run():\n    return work()\n"
    write(tmp_path, main=main.format("a"), pkg__a="def work(): return 1\n", pkg__b="def work(): return 1\nunused = 2\n")
    first = function_digest(tmp_path, "main", "run", "pkg")
    write(tmp_path, pkg__b="def work(): return 1\nunused = 3\n")
    assert function_digest(tmp_path, "main", "run", "pkg") == first
    write(tmp_path, main=main.format("b"))
    assert function_digest(tmp_path, "main", "run", "pkg") != first
    with pytest.raises(KeyError):
        function_digest(tmp_path, "main", "walk", "pkg")


def test_recording_refuses_a_number_that_was_forgotten(sources: Path) -> None:
    shutil.copytree(ROOT / "tests/worker", sources / "tests/worker", ignore=shutil.ignore_patterns("__pycache__"))

    def record(*options: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "tests.worker.code_versions", "--record", *options]
        environment = {"PYTHONPATH": str(sources)}
        return subprocess.run(command, cwd=sources, env=environment, capture_output=True, text=True, check=False)

    file = sources / "tests/worker/code_versions.json"
    before = file.read_bytes()
    append(sources / "pipeline/export/bvh.py")
    refused = record()
    assert (refused.returncode, file.read_bytes()) == (1, before)
    assert "stage export changed" in refused.stderr
    assert record("--results-unchanged").returncode == 0
    assert file.read_bytes() != before
    edit(sources / "pipeline/export/bvh.py", "UNUSED = 1", "UNUSED = 2")
    edit(sources / "worker/plan.py", f"EXPORT: {CODE_VERSIONS[EXPORT]}", f"EXPORT: {CODE_VERSIONS[EXPORT] + 1}")
    assert record().returncode == 0
