"""The code behind each stage has a digest, which tells other code from this one; and laws of the digest."""

import ast
import shutil
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from pipeline.core.runtime.code_digest import forget_sources, function_digest, reachable_modules
from pipeline.run.engine import code
from pipeline.run.engine.code import LIBRARIES, digests_of_stages, sources_sha256, stage_codes
from pipeline.run.engine.stage import (
    ASSOCIATE,
    CHECK,
    DETECT,
    EDIT,
    EXPECT,
    EXPECT_AGAIN,
    EXPORT,
    FIT,
    HEADS,
    HOLD,
    IDENTIFY,
    LENGTHS,
    OPENSIM,
    OVERLAY,
    POSES,
    RECORD,
    REFINE,
    REFIT,
    REPORT,
    RETARGET,
    WRITE,
)

ROOT = Path(__file__).parents[4]
# Packages that the stages import and that change no number.
NOT_NUMERIC = {
    "defusedxml",
    "filelock",
    "google",
    "httpx2",
    "jaxtyping",
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
def test_all_libraries_of_the_stages_count() -> None:
    folders = [ROOT / "pipeline/run/engine", ROOT / "pipeline/run/steps"]
    paths = [path for folder in folders for path in folder.glob("*.py") if path.stem not in {"__init__", "local"}]
    direct = {f"pipeline.run.{path.parent.name}.{path.stem}" for path in paths}
    paths = [ROOT.joinpath(*name.split(".")) for name in reachable_modules(ROOT, direct)]
    files = [path / "__init__.py" if path.is_dir() else path.with_suffix(".py") for path in paths]
    packages = {name.partition(".")[0] for path in files for name in imported_by(path)}
    others = packages - set(sys.stdlib_module_names) - {"pipeline"}
    assert others >= NOT_NUMERIC
    distributions = packages_distributions()
    assert {distributions[name][0] for name in others - NOT_NUMERIC} == {*LIBRARIES}


@pytest.mark.slow
def test_another_version_of_a_library_is_other_code() -> None:
    assert not {*digests_of_stages(ROOT, ("numpy",)).values()} & {*stage_codes().values()}


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of the sources."""
    shutil.copytree(ROOT / "pipeline", tmp_path / "pipeline", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def append(path: Path) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write("\nUNUSED = 1\n")


@pytest.fixture(autouse=True, scope="module")
def syntax_trees() -> Iterator[None]:
    """The syntax trees of most sources, which stay the same, are kept from test to test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(code, "forget_sources", lambda: None)
        yield
    forget_sources()


def changed(sources: Path) -> set[str]:
    before, after = stage_codes(), digests_of_stages(sources)
    return {stage for stage, code in after.items() if code != before[stage]}


@pytest.mark.slow
def test_comments_docstrings_and_layout_change_nothing(sources: Path) -> None:
    for path in sources.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        path.write_text(f'"""Something else."""\n# A comment.\n\n{text}\n\n# The end.\n', encoding="utf-8")
    edit(
        sources / "pipeline/motion/skeleton/feet/contacts.py",
        "\n    return ",
        '\n    """Said again."""\n    # Why.\n    return ',
    )
    assert changed(sources) == set()


@pytest.mark.slow
def test_a_constant_of_contacts_counts_for_the_fit(sources: Path) -> None:
    path = sources / "pipeline/motion/skeleton/feet/contacts.py"
    name = next(
        line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("_") and " = " in line
    )
    edit(path, name, name.partition(" = ")[0] + " = 123.456")
    assert changed(sources) == {FIT, HOLD, REFIT}


@pytest.mark.slow
def test_what_a_function_imports_inside_counts(sources: Path) -> None:
    """``detect.registry`` imports the conversions of networks where it needs them."""
    append(sources / "pipeline/detection/conversion/onnx_graph.py")
    assert DETECT in changed(sources)


@pytest.mark.slow
def test_a_module_that_no_stage_imports_counts_for_none(sources: Path) -> None:
    append(sources / "pipeline/validation/simulation/motion/body.py")
    (sources / "pipeline/new.py").write_text("NEW = 1\n", encoding="utf-8")
    assert changed(sources) == set()


def test_the_stage_s_own_function_and_its_helpers_count(sources: Path) -> None:
    stages = sources / "pipeline/run/steps"
    edit(stages / "lengths.py", "context.numbered_from_first(frames, session), detected", "frames, detected")
    assert changed(sources) == {LENGTHS}
    edit(stages / "detect.py", "slice(number, number + 1)", "slice(number, number + 2)")
    assert changed(sources) == {LENGTHS, DETECT}


@pytest.mark.slow
def test_a_declaration_counts_for_no_code(sources: Path) -> None:
    """Choices and cuts are in the keys themselves, and ``detect`` names the stage ``look``."""
    edit(sources / "pipeline/run/steps/look.py", '"Look at people"', '"Look"')
    edit(sources / "pipeline/run/steps/look.py", "def is_detecting", "UNUSED = 1\n\n\ndef is_detecting")
    assert changed(sources) == set()


@pytest.mark.slow
def test_what_a_task_asks_its_context_counts(sources: Path) -> None:
    context = sources / "pipeline/run/engine/context.py"
    edit(context, "facts.frame_rate_hz) + 2", "facts.frame_rate_hz) + 3")  # a helper of what they ask
    assert changed(sources) == {CHECK, REFINE, LENGTHS, POSES}
    edit(context, "return self.detections.offsets", "return {**self.detections.offsets}")
    fitted = {FIT, HOLD, REFIT, OVERLAY, REPORT, RECORD, RETARGET, OPENSIM, WRITE, EXPORT}
    assert changed(sources) == {CHECK, REFINE, LENGTHS, POSES} | fitted
    edit(context, "return range(frames.start - first, frames.stop - first)", "return frames")
    assert changed(sources) == {CHECK, REFINE, LENGTHS, POSES} | fitted


def test_the_form_of_stored_people_counts_for_those_who_write_or_read_them(sources: Path) -> None:
    edit(
        sources / "pipeline/run/engine/people.py",
        "    spans: tuple[PersonSpan, ...]\n",
        "    frames: tuple[PersonSpan, ...]\n",
    )
    assert changed(sources) == {
        *(ASSOCIATE, EXPECT, EXPECT_AGAIN, IDENTIFY),
        *(EDIT, FIT, HOLD, HEADS, REFIT, OVERLAY, REPORT, RECORD, RETARGET, OPENSIM, WRITE, EXPORT),
    }


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
    first = function_digest(tmp_path, [("main", "run")], "pkg", "main")
    write(tmp_path, pkg__b="def work(): return 1\nunused = 3\n")
    assert function_digest(tmp_path, [("main", "run")], "pkg", "main") == first
    write(tmp_path, main=main.format("b"))
    assert function_digest(tmp_path, [("main", "run")], "pkg", "main") != first
    with pytest.raises(KeyError):
        function_digest(tmp_path, [("main", "walk")], "pkg", "main")


def test_members_of_a_class_count_if_they_are_named(tmp_path: Path) -> None:
    main = "from pkg.asked import Asked\n\n\ndef run(asked):\n    return asked.one()\n"
    asked = (
        "from pkg.far import used, unused\n\n\nclass Asked:\n    size = 1\n\n"
        "    def __init__(self):\n        self.start()\n\n"
        "    def start(self): ...\n\n    def one(self):\n        return self.two\n\n"
        "    @property\n    def two(self):\n        return used()\n\n    def three(self):\n        return unused()\n"
    )
    far = "def used(): ...\n\n\ndef unused(): ...\n"

    def digest(**texts: str) -> str:
        write(tmp_path, **{"pkg__main": main, "pkg__asked": asked, "pkg__far": far} | texts)
        return function_digest(tmp_path, [("pkg.main", "run"), ("pkg.asked", "Asked")], "pkg", "pkg", "pkg.asked")

    first = digest()
    assert digest(pkg__asked=asked.replace("return unused()", "return None")) == first
    assert digest(pkg__far=far.replace("unused(): ...", "unused(): return 1")) == first
    assert digest(pkg__main=main.replace("asked.one", "asked.three")) != first
    for old, new in (
        ("size = 1", "size = 2"),
        ("def start(self): ...", "def start(self): return"),
        ("used()", "used(1)"),
    ):
        assert digest(pkg__asked=asked.replace(old, new, 1)) != first, old
    assert digest(pkg__far=far.replace("def used(): ...", "def used(): return 1")) != first


@pytest.mark.slow
def test_digests_are_kept_for_the_next_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    compute = code._codes_on_cpu.__wrapped__
    codes = compute()
    (file,) = (tmp_path / "stage-codes").iterdir()
    assert file.stem == sources_sha256()
    with monkeypatch.context() as patch:
        patch.setattr(code, "digests_of_stages", lambda: pytest.fail("computed again"))
        assert compute() == codes == digests_of_stages()
    computed = 0

    def count() -> dict[str, str]:
        nonlocal computed
        computed += 1
        return dict(codes)

    monkeypatch.setattr(code, "digests_of_stages", count)
    damages = ("", "[]", "{}", file.read_text().replace("a", "g"), file.read_text()[:-9])
    for damaged in damages:
        file.write_text(damaged)
        assert compute() == codes
    file.unlink()
    file.parent.rmdir()
    file.parent.write_text("The folder can't be made.")
    assert compute() == codes
    assert computed == len(damages) + 1
