"""Examples in docstrings run and give what they show."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

from pipeline.core.options.file_formats import is_installed

ROOT = Path(__file__).parents[2]
EXAMPLES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): path.read_text(encoding="utf-8").count(">>> ")
    - path.read_text(encoding="utf-8").count("# doctest: +SKIP")
    for path in sorted((ROOT / "pipeline").rglob("*.py"))
}


@pytest.mark.parametrize("name", [name for name, count in EXAMPLES.items() if count > 0])
def test_examples_of_module_give_their_results(name: str) -> None:
    if name.endswith(".usd") and not is_installed("usd"):
        pytest.skip("the package usd-core is not installed")
    failed, tried = doctest.testmod(import_module(name))
    assert tried == EXAMPLES[name]
    assert not failed
