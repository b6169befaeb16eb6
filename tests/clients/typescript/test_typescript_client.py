"""The client for npm without a service: Node runs tests of its modules against servers of their own."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from tests.api.portal.node import run_by_node

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
PACKAGE = ROOT / "clients" / "typescript"


@pytest.mark.parametrize("module", ["downloads", "events", "http", "uploads"])
def test_modules_of_client(module: str, tmp_path: Path) -> None:
    if not (PACKAGE / "dist" / ".built").is_file():
        pytest.skip("the client for npm is not built (`make clients` does it)")
    run_by_node(HERE / f"{module}.test.mjs", tmp_path)


def test_version_is_project_version() -> None:
    """The same version in the notation of npm: 1.0.0rc1 is 1.0.0-rc.1."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    package = json.loads((PACKAGE / "package.json").read_text("utf-8"))
    lock = json.loads((PACKAGE / "package-lock.json").read_text("utf-8"))
    assert package["version"] == re.sub(r"(a|b|rc)(\d+)$", r"-\1.\2", version)
    assert lock["version"] == package["version"] == lock["packages"][""]["version"]


def test_lock_names_no_host() -> None:
    assert "resolved" not in (PACKAGE / "package-lock.json").read_text("utf-8")
