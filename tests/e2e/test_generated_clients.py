"""Programs of `docs/reference/clients.md`, run with the clients that each generator makes of the contract."""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import pytest

from api.web.contract.openapi import COMMITTED
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served, serving

PAGE = Path(__file__).parents[2] / "docs/reference/clients.md"
CLIENTS = Path(__file__).parent / "clients"
ADDRESS, KEY, FOLDER = "https://multicap.example", "mc_...", "take"
TIMEOUT_S = 400.0


@dataclass(frozen=True, slots=True)
class Section:
    """Files and commands of a section of the page."""

    files: dict[str, str]
    commands: list[list[str]]

    @property
    def uses_npm(self) -> bool:
        return ["npm", "install"] in [command[:2] for command in self.commands]


def sections() -> dict[str, Section]:
    """Sections of the page with code, by title."""
    found = {}
    for text in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        blocks = re.findall(r'^```(\w+)(?: title="(\S+)")?\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
        commands = [shlex.split(line) for kind, _, code in blocks if kind == "sh" for line in code.splitlines()]
        files = {name: code for _, name, code in blocks if name}
        found[text.splitlines()[0]] = Section(files, commands)
    return found


SECTIONS = sections()


@dataclass(frozen=True, slots=True)
class ServedCapture:
    """Service with keys, and the folder of a capture."""

    served: Served
    key: str
    take: Path


def multicap(*arguments: str | Path) -> bytes:
    """Run a command of Multicap; return what it prints."""
    command = [sys.executable, "-P", "-m", "api.cli.main", *arguments]
    return subprocess.run(command, capture_output=True, check=True).stdout


@pytest.fixture(scope="module")
def portal(sample: Sample, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedCapture]:
    folder = tmp_path_factory.mktemp("portal")
    take = folder / "take"
    take.mkdir()
    for path in sample.videos.values():
        (take / path.name).symlink_to(path)
    multicap("calibration", "convert", sample.calibration, take / "calibration.toml")
    # Machines of tests are busy: the check of the files may take long.
    with serving(folder / "data", 1) as served:
        key = json.loads(multicap("keys", "create", "portal", "--json", "--data", folder / "data"))["key"]
        served.client.headers["Authorization"] = f"Bearer {key}"
        yield ServedCapture(served, key, take)


def run(command: list[str], folder: Path, portal: ServedCapture) -> str:
    """Run a command of the page; return what it writes."""
    values = {ADDRESS: str(portal.served.client.base_url).rstrip("/"), KEY: portal.key, FOLDER: str(portal.take)}
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        [values.get(word, word) for word in command],
        cwd=folder,
        env=os.environ | {"PATH": path, "PYTHONPATH": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}"
    return done.stdout


def require_downloads(portal: ServedCapture, folder: Path) -> None:
    """Check that a program has written all files of the newest job, byte by byte."""
    (job,) = portal.served.client.get("/v1/jobs", params={"limit": 1}).raise_for_status().json()["jobs"]
    assert job["state"] == "succeeded", job
    assert job["spec"]["frame_range"] == [0, 20]
    results = portal.served.client.get(f"/v1/jobs/{job['id']}/results").raise_for_status().json()["results"]
    assert {"skeletons.json", "person-1.bvh", "person-1.glb"} <= {result["name"] for result in results}
    written = {result["name"]: hashlib.sha256((folder / result["name"]).read_bytes()).hexdigest() for result in results}
    assert written == {result["name"]: result["sha256"] for result in results}


def test_page_installs_what_is_tested() -> None:
    """Versions on the page are those of the locks."""
    pinned = json.loads((CLIENTS / "package.json").read_text("utf-8"))["dependencies"]
    installed: dict[str, str] = {}
    for section in SECTIONS.values():
        for program, action, *packages in section.commands:
            if (program, action) == ("npm", "install"):
                installed |= dict(package.rsplit("@", 1) for package in packages)
            if (program, action) == ("pip", "install"):
                assert packages == [f"openapi-python-client=={version('openapi-python-client')}"]
    assert installed == pinned


@pytest.mark.parametrize("title", ["Python", "TypeScript: hey-api", "TypeScript: openapi-fetch"])
def test_programs_of_page(portal: ServedCapture, tmp_path: Path, title: str) -> None:
    section = SECTIONS[title]
    if section.uses_npm:
        if not (CLIENTS / "node_modules" / ".installed").is_file():
            pytest.skip("generators of TypeScript clients are not installed (`make clients` does it)")
        (tmp_path / "node_modules").symlink_to(CLIENTS / "node_modules")
        (tmp_path / "package.json").write_text('{"private": true, "type": "module"}')
        (tmp_path / "tsconfig.json").write_text(SECTIONS["TypeScript: hey-api"].files["tsconfig.json"])
    shutil.copy(COMMITTED, tmp_path / "openapi.json")
    for name, code in section.files.items():
        (tmp_path / name).write_text(code, encoding="utf-8")
    ran = []
    for command in section.commands:
        if command[1] == "install":
            continue
        output = run(command, tmp_path, portal)
        assert "warning" not in output.lower(), output  # of what a generator can't express, and leaves out
        program = command[1].partition(".")[0]
        if program == "send":
            require_downloads(portal, tmp_path)
        if program == "upload":
            assert portal.served.wait_for_end(output.split()[-1])["state"] == "succeeded"
        ran.append(program)
    assert set(ran) >= {Path(name).stem for name in section.files if Path(name).stem in {"send", "upload"}} >= {"send"}
