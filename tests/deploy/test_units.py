"""Units of systemd: accepted, closed, with settings and programs that exist."""

import importlib.util
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.deploy.test_containers import OTHER_VARIABLES, settings

SYSTEMD = Path(__file__).parents[2] / "deploy" / "systemd"
UNITS = sorted(SYSTEMD.glob("*.service"))
# Of 10, by systemd; its own service of a web server has 9.
MAX_EXPOSURE = 2.5

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")


@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_variables_are_settings_and_programs_exist(path: Path) -> None:
    text = path.read_text()
    names = set(re.findall(r"^Environment=(\w+)=", text, re.MULTILINE))
    assert {"MULTICAP_DATA_DIR", "MULTICAP_DATABASE_URL_FILE", "MULTICAP_BROKER_URL_FILE"} <= names
    assert names <= settings() | OTHER_VARIABLES
    (module,) = re.findall(r"^ExecStart=/opt/multicap/bin/python -P -m multicap\.(\S+)", text, re.MULTILINE)
    assert importlib.util.find_spec(module) is not None


def test_common_file_has_settings_alone() -> None:
    names = set(re.findall(r"^(\w+)=", (SYSTEMD / "environment").read_text(), re.MULTILINE))
    assert names <= settings() | OTHER_VARIABLES


@needs_systemd
@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_systemd_accepts_units(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / path.name
    copy.write_text(path.read_text().replace("/opt/multicap/bin/python", "/usr/bin/env"))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(copy)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@needs_systemd
@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_units_are_closed(path: Path) -> None:
    command = ["systemd-analyze", "security", "--offline=yes", f"--threshold={int(MAX_EXPOSURE * 10)}", str(path)]
    subprocess.run(command, check=True, capture_output=True)
