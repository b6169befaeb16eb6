"""Programs with the clients that generators make of the contract, which `docs/reference/clients.md` names."""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import pytest

from api.web.contract.openapi import COMMITTED
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.served_captures import ServedCapture, served_capture

GENERATORS = Path(__file__).parent / "generators"
PAGE = GENERATORS.parents[2] / "docs/reference/clients.md"
TIMEOUT_S = 400.0
# Commands that make each client, and programs that use it
COMMANDS = {
    "python": [
        "openapi-python-client generate --path openapi.json --config python-client.yaml --meta none"
        " --output-path multicap_client",
        "python send.py",
        "python upload.py",
    ],
    "hey-api": ["npx openapi-ts", "npx tsc", "node send.ts", "node upload.ts"],
    "openapi-fetch": ["node generate.mjs", "npx tsc", "node send.ts"],
}


@pytest.fixture(scope="module")
def portal(sample: Sample, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedCapture]:
    with served_capture(sample, tmp_path_factory.mktemp("portal")) as portal:
        yield portal


def run(command: list[str], folder: Path) -> str:
    """Run a command; return what it writes."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        command,
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


def test_page_names_tested_versions() -> None:
    """Versions on the page are those of the locks."""
    pinned = json.loads((GENERATORS / "package.json").read_text("utf-8"))["dependencies"]
    tested = {name: pinned[name] for name in ("@hey-api/openapi-ts", "openapi-typescript", "openapi-fetch")}
    tested["openapi-python-client"] = version("openapi-python-client")
    assert dict(re.findall(r"`([\w@/-]+) (\d+\.\d+\.\d+)`", PAGE.read_text("utf-8"))) == tested


@pytest.mark.parametrize("generator", COMMANDS)
def test_programs_with_generated_client(portal: ServedCapture, tmp_path: Path, generator: str) -> None:
    if generator != "python":
        if not (GENERATORS / "node_modules" / ".installed").is_file():
            pytest.skip("generators of TypeScript clients are not installed (`make generators` does it)")
        (tmp_path / "node_modules").symlink_to(GENERATORS / "node_modules")
        (tmp_path / "package.json").write_text('{"private": true, "type": "module"}')
        shutil.copy(GENERATORS / "tsconfig.json", tmp_path)
    shutil.copy(COMMITTED, tmp_path / "openapi.json")
    shutil.copytree(GENERATORS / generator, tmp_path, dirs_exist_ok=True)
    for line in COMMANDS[generator]:
        command = shlex.split(line)
        program = command[1].partition(".")[0]
        if program in {"send", "upload"}:
            command += [portal.url, portal.key, str(portal.take)]
        output = run(command, tmp_path)
        assert "warning" not in output.lower(), output  # of what a generator can't express, and leaves out
        if program == "send":
            require_downloads(portal, tmp_path)
        if program == "upload":
            assert portal.served.wait_for_end(output.split()[-1])["state"] == "succeeded"
