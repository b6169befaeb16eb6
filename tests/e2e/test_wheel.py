"""Wheel, installed without the checkout: its modules do not conflict with other modules.

Its service starts without compiled kernels, once: it reports its progress, and is ready when a job can start.
"""

import ast
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest

from api.cli.served import READY
from hatch_build import install_page_libraries
from pipeline.core.errors import ModelError
from pipeline.core.options.config import JobChoices
from pipeline.core.runtime.packages.samples import Sample
from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.detection import models
from pipeline.run.engine.code import stage_codes
from pipeline.run.warm_up import NUM_COMPILED
from tests.e2e.captures import keypoint_capture, video_capture
from tests.e2e.serving import digests
from tests.e2e.test_serve_keypoints import archives
from tests.ports import free_port
from tests.waiting import wait_for

ROOT = Path(__file__).parents[2]
COMPILING = re.compile(r"A worker compiles the numeric kernels: (\d+) of (\d+) steps\. A first start takes .*")
# Time limit on a busy machine; compiling takes minutes.
LONGEST_S = 600.0

RECONSTRUCT = """
import sys
from pathlib import Path
import multicap

capture, out = map(Path, sys.argv[1:])
session = multicap.open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
multicap.write_results(multicap.reconstruct(session), out)
"""
SEND = """
import sys
from pathlib import Path
import multicap

url, capture, out = sys.argv[1:]
one_each = [Path(capture, name).read_bytes() for name in ("calibration.json", "timestamps.csv")]
archives = {path.stem: path.read_bytes() for path in Path(capture, "archives").iterdir()}
seen = []
with multicap.Client.connect(url) as client:
    job = client.submit_keypoints(archives, *one_each, {})
    job = client.follow(job, lambda job: seen.append(job["progress"]), timeout_s=300)
    client.download(job, Path(out))
print(seen[-1])
"""


def clean_environment() -> dict[str, str]:
    """Environment without what makes Python find the checkout."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Output of a program in an environment without the checkout."""
    done = subprocess.run(
        list(map(str, command)),
        cwd=cwd,
        env=clean_environment() | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Programs of an environment with the wheel and the dependencies of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-P", "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=ROOT)
    (wheel,) = folder.glob("*.whl")
    run(sys.executable, "-P", "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    python = folder / "venv/bin/python"
    pip: list[str | Path] = [sys.executable, "-P", "-m", "pip", "--disable-pip-version-check", "--python", python]
    run(*pip, "install", "--no-deps", "--no-index", wheel, cwd=folder)
    # A folder named in a `.pth` file is searched, but `.pth` files in it, such as that of the checkout, are not read.
    packages = run(python, "-P", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    Path(packages, "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    return python.parent


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of modules with the names of our packages; each ends the process that imports it."""
    folder = tmp_path_factory.mktemp("foreign")
    for name in ("api", "pipeline", "worker"):
        (folder / f"{name}.py").write_text("raise RuntimeError('foreign code')\n", encoding="utf-8")
    return folder


@dataclass(frozen=True, slots=True)
class FirstStart:
    """Service that was started without compiled kernels, and what it said until its first job was done.

    Parameters
    ----------
    said
        Sentences of ``/readyz`` while it was not ready, each once.
    kernels_before, kernels
        Files of compiled kernels when it was ready, and after a job that was sent then.
    """

    address: str
    home: Path
    said: list[str]
    kernels_before: set[Path]
    kernels: set[Path]
    told: str
    log: list[dict[str, Any]]


@contextmanager
def starting(programs: Path, cwd: Path, folder: Path) -> Iterator[tuple[httpx2.Client, subprocess.Popen[str]]]:
    """Service that starts, with the installed networks and no kernels in its home folder."""
    try:
        networks = [models.installed_path(name) for name in JobChoices().networks.names]
    except ModelError as error:
        pytest.skip(str(error))
    (folder / "home" / "models").mkdir(parents=True)
    for network in networks:
        (folder / "home" / "models" / network.name).symlink_to(network)
    port = free_port()
    serve = [programs / "multicap", "serve", "--port", port, "--workers", "1", "--data", folder / "data"]
    environment = clean_environment() | {"MULTICAP_HOME": str(folder / "home")}
    with (folder / "stderr").open("wb") as errors, ExitStack() as stack:
        process = stack.enter_context(
            subprocess.Popen(
                tied_to_parent(list(map(str, serve))),
                cwd=cwd,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=environment,
            )
        )
        address = f"http://127.0.0.1:{port}"
        client = stack.enter_context(httpx2.Client(base_url=address, timeout=180, trust_env=False))
        try:
            yield client, process
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def answers(client: httpx2.Client) -> bool:
    try:
        return client.get("/healthz").is_success
    except httpx2.TransportError:
        return False


def post_session(client: httpx2.Client, sample: Sample) -> str:
    with ExitStack() as opened:
        parts = [("videos", path) for path in sample.videos.values()] + [("calibration", sample.calibration)]
        files = [(part, (path.name, opened.enter_context(path.open("rb")))) for part, path in parts]
        return str(client.post("/v1/sessions", files=files).raise_for_status().json()["urls"]["jobs"])


def wait_until_ready(client: httpx2.Client) -> list[str]:
    """Wait until the service is ready; return the sentences of ``/readyz`` meanwhile, each once."""
    said: list[str] = []
    deadline_s = time.monotonic() + LONGEST_S
    while (answer := client.get("/readyz")).status_code == 503:
        assert time.monotonic() < deadline_s, said
        said += [item["message"] for item in answer.json()["errors"] if item["message"] not in said]
        time.sleep(0.1)
    assert answer.status_code == 200, answer.text
    return said


def kernel_files(home: Path) -> set[Path]:
    return set((home / "kernels").rglob("*.nbc"))


@pytest.fixture(scope="module")
def first_start(
    programs: Path, foreign: Path, sample: Sample, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[FirstStart]:
    """Service of the wheel after its first start, which goes on."""
    folder = tmp_path_factory.mktemp("first")
    with starting(programs, foreign, folder) as (client, process):
        wait_for(lambda: answers(client))
        jobs = post_session(client, sample)
        said = wait_until_ready(client)
        kernels_before = kernel_files(folder / "home")
        answer = client.post(jobs, json={"frame_range": [0, 4]}).raise_for_status().json()
        wait_for(lambda: client.get(answer["urls"]["self"]).json()["state"] == "succeeded")
        assert process.stdout is not None
        assert process.stdout.readline().startswith(READY)
        lines = (folder / "data" / "logs" / "worker.log").read_text().splitlines()
        log = [json.loads(line) for line in lines if line[:1] == "{"]
        told = (folder / "stderr").read_text()
        kernels = kernel_files(folder / "home")
        yield FirstStart(str(client.base_url), folder / "home", said, kernels_before, kernels, told, log)


def test_wheel_holds_one_package(programs: Path, tmp_path: Path) -> None:
    text = "import importlib.metadata as m; print(*{str(path).split('/')[0] for path in m.files('multicap')})"
    found = run(programs / "python", "-P", "-c", text, cwd=tmp_path).split()
    assert [name for name in found if not name.endswith(".dist-info") and name != ".."] == ["multicap"]
    for name in ("api", "pipeline", "worker"):
        text = f"import importlib.util; print(importlib.util.find_spec({name!r}))"
        assert run(programs / "python", "-P", "-c", text, cwd=tmp_path) == "None\n"


def test_page_of_wheel_has_its_libraries(programs: Path, tmp_path: Path) -> None:
    if not (ROOT / "api/portal/vendor").is_dir():
        pytest.skip("the page's libraries are not installed (`make setup`)")
    text = "import multicap, pathlib; print(pathlib.Path(multicap.__file__).parent / 'api' / 'portal')"
    portal = Path(run(programs / "python", "-P", "-c", text, cwd=tmp_path).strip())
    for name in ("vendor/lit-html/lit-html.js", "vendor/three/three.module.js", "send/view.js", "index.html"):
        assert (portal / name).read_bytes() == (ROOT / "api/portal" / name).read_bytes()
    assert not (portal / "node_modules").exists()
    viewer = Path("pipeline/export/report/assets/viewer.js")
    assert (portal.parents[1] / viewer).read_bytes() == (ROOT / viewer).read_bytes()


def test_build_installs_page_s_libraries_from_npm(tmp_path: Path) -> None:
    portal = tmp_path / "api" / "portal"
    shutil.copytree(ROOT / "api/portal", portal, ignore=shutil.ignore_patterns("node_modules", "vendor"))
    if not install_page_libraries(tmp_path):
        pytest.skip("npm's packages can't be installed here")
    names = {path.relative_to(portal).as_posix() for path in portal.rglob("*") if path.is_file()}
    assert "vendor/three/three.core.js" in names
    assert not any(name.startswith("node_modules") for name in names)
    assert "from '../../three.module.js'" in (portal / "vendor/three/addons/controls/OrbitControls.js").read_text()
    # The script of reports is one module, which imports nothing.
    script = (tmp_path / "pipeline/export/report/assets/viewer.js").read_text()
    assert len(script) > 400_000
    assert not re.search(r"^import|[;}]import[ {*]", script)


def test_stages_have_codes_of_checkout(programs: Path, foreign: Path) -> None:
    text = "import json; from multicap.pipeline.run.engine.code import stage_codes as c; print(json.dumps({**c()}))"
    assert json.loads(run(programs / "python", "-c", text, cwd=foreign)) == {**stage_codes()}


def test_command_line(programs: Path, foreign: Path) -> None:
    said = run(programs / "multicap", "--version", cwd=foreign)
    assert said.startswith("multicap ")
    assert run(programs / "python", "-m", "multicap", "--version", cwd=foreign) == said


def test_program_keeps_its_own_modules(programs: Path, tmp_path: Path) -> None:
    (tmp_path / "pipeline.py").write_text("import multicap\nOPEN = multicap.open_session\n", encoding="utf-8")
    text = "import pipeline, multicap; print(pipeline.__file__, pipeline.OPEN is multicap.open_session)"
    assert run(programs / "python", "-c", text, cwd=tmp_path) == f"{tmp_path / 'pipeline.py'} True\n"


def test_type_checkers_find_types(programs: Path, foreign: Path) -> None:
    """The wheel has the modules that `multicap` imports for type checkers, and is marked as typed."""
    text = "import multicap, pathlib; print(pathlib.Path(multicap.__file__).parent)"
    package = Path(run(programs / "python", "-c", text, cwd=foreign).strip())
    assert (package / "py.typed").is_file()
    nodes = ast.walk(ast.parse((package / "__init__.py").read_bytes()))
    imported = [str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)]
    modules = [name for name in imported if name not in sys.stdlib_module_names]
    assert len(modules) >= 10
    assert [
        name for name in modules if not package.parent.joinpath(*name.split(".")).with_suffix(".py").is_file()
    ] == []


def test_ready_is_said_when_job_would_start_at_once(first_start: FirstStart) -> None:
    matches = [COMPILING.fullmatch(sentence) for sentence in first_start.said]
    steps = [(int(match[1]), int(match[2])) for match in matches if match]
    assert len(steps) >= 5, first_start.said
    assert steps == sorted(steps)
    assert {total for _, total in steps} == {NUM_COMPILED}
    assert first_start.kernels_before
    assert first_start.kernels == first_start.kernels_before
    assert COMPILING.search(first_start.told), first_start.told
    (compiled,) = [event for event in first_start.log if event["event"] == "kernels_compiled"]
    assert compiled["done"] == compiled["total"] == NUM_COMPILED


def test_processes_of_pool(programs: Path, foreign: Path, tmp_path: Path, first_start: FirstStart) -> None:
    options = [*video_capture(tmp_path / "capture"), f"--out={tmp_path / 'out'}", "--chunk-frames=10"]
    command: list[str | Path] = [programs / "multicap", "reconstruct", "--json", *options, "--processes=2"]
    said = run(*command, cwd=foreign, MULTICAP_HOME=str(first_start.home))
    assert json.loads(said)["metrics"]["num_frames"] == 20


def test_job_by_client_and_same_in_process(
    programs: Path, foreign: Path, tmp_path: Path, first_start: FirstStart
) -> None:
    capture = tmp_path / "capture"
    keypoint_capture(capture)
    (capture / "archives").mkdir()
    for _, (name, content) in archives(capture):
        (capture / "archives" / name).write_bytes(content)
    sent, local = tmp_path / "sent", tmp_path / "local"
    said = run(programs / "python", "-c", SEND, first_start.address, capture, sent, cwd=foreign)
    assert float(said) == 1.0
    home = str(first_start.home)
    run(programs / "python", "-c", RECONSTRUCT, capture, local, cwd=foreign, MULTICAP_HOME=home)
    assert len(list(local.glob("*.bvh"))) >= 2
    assert digests(sent) == digests(local)
