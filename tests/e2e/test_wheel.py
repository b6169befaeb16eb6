"""Wheel, installed without the checkout: its modules do not conflict with other modules."""

import ast
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest

from api.cli.served import READY
from hatch_build import install_page_libraries
from pipeline.runtime.packages.storage import home
from pipeline.stages.code import stage_codes
from tests.e2e.captures import keypoint_capture, video_capture
from tests.e2e.serving import digests
from tests.e2e.test_serve_keypoints import archives

ROOT = Path(__file__).parents[2]

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


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Output of a program in an environment without the checkout."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=clean | environment, capture_output=True, text=True, check=False
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


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Folder of modules with the names of our packages; each ends the process that imports it."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    for name in ("api", "pipeline", "worker"):
        (folder / f"{name}.py").write_text("raise RuntimeError('foreign code')\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory, programs: Path) -> str:
    """Home folder with the installed networks, and with the wheel's kernels, which are compiled once."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "models").symlink_to(home() / "models")
    run(programs / "python", "-P", "-m", "multicap.pipeline.warm_up", cwd=folder, MULTICAP_HOME=str(folder))
    return str(folder)


def test_the_wheel_holds_one_package(programs: Path, tmp_path: Path) -> None:
    text = "import importlib.metadata as m; print(*{str(path).split('/')[0] for path in m.files('multicap')})"
    found = run(programs / "python", "-P", "-c", text, cwd=tmp_path).split()
    assert [name for name in found if not name.endswith(".dist-info") and name != ".."] == ["multicap"]
    for name in ("api", "pipeline", "worker"):
        text = f"import importlib.util; print(importlib.util.find_spec({name!r}))"
        assert run(programs / "python", "-P", "-c", text, cwd=tmp_path) == "None\n"


def test_the_page_of_the_wheel_has_its_libraries(programs: Path, tmp_path: Path) -> None:
    if not (ROOT / "api/portal/vendor").is_dir():
        pytest.skip("the page's libraries are not installed (`make setup`)")
    text = "import multicap, pathlib; print(pathlib.Path(multicap.__file__).parent / 'api' / 'portal')"
    portal = Path(run(programs / "python", "-P", "-c", text, cwd=tmp_path).strip())
    for name in ("vendor/lit-html/lit-html.js", "vendor/three/three.module.js", "send/view.js", "index.html"):
        assert (portal / name).read_bytes() == (ROOT / "api/portal" / name).read_bytes()
    assert not (portal / "node_modules").exists()


def test_a_build_installs_the_page_s_libraries_from_npm(tmp_path: Path) -> None:
    for name in ("package.json", "package-lock.json", "vendor.mjs"):
        shutil.copy(ROOT / "api/portal" / name, tmp_path)
    if not install_page_libraries(tmp_path):
        pytest.skip("npm's packages can't be installed here")
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert "vendor/three/three.core.js" in names
    assert not any(name.startswith("node_modules") for name in names)
    assert "from '../../three.module.js'" in (tmp_path / "vendor/three/addons/controls/OrbitControls.js").read_text()


def test_stages_have_the_codes_of_the_checkout(programs: Path, foreign: Path) -> None:
    text = "import json; from multicap.pipeline.stages.code import stage_codes; print(json.dumps({**stage_codes()}))"
    assert json.loads(run(programs / "python", "-c", text, cwd=foreign)) == {**stage_codes()}


def test_the_command_line(programs: Path, foreign: Path) -> None:
    said = run(programs / "multicap", "--version", cwd=foreign)
    assert said.startswith("multicap ")
    assert run(programs / "python", "-m", "multicap", "--version", cwd=foreign) == said


def test_a_program_keeps_its_own_modules(programs: Path, tmp_path: Path) -> None:
    (tmp_path / "pipeline.py").write_text("import multicap\nOPEN = multicap.open_session\n", encoding="utf-8")
    text = "import pipeline, multicap; print(pipeline.__file__, pipeline.OPEN is multicap.open_session)"
    assert run(programs / "python", "-c", text, cwd=tmp_path) == f"{tmp_path / 'pipeline.py'} True\n"


def test_type_checkers_find_the_types(programs: Path, foreign: Path) -> None:
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


def test_processes_of_a_pool(programs: Path, foreign: Path, tmp_path: Path, kernels: str) -> None:
    if not (home() / "models/movenet-multipose.onnx").exists():
        pytest.skip("the default detector is not installed")
    options = [*video_capture(tmp_path / "capture"), f"--out={tmp_path / 'out'}", "--chunk-frames=10"]
    command: list[str | Path] = [programs / "multicap", "reconstruct", "--json", *options, "--processes=2"]
    assert json.loads(run(*command, cwd=foreign, MULTICAP_HOME=kernels))["metrics"]["num_frames"] == 20


@pytest.fixture
def service(programs: Path, foreign: Path, tmp_path: Path, kernels: str) -> Iterator[str]:
    """Address of a service that runs from the wheel."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    command: list[str | Path] = [
        programs / "multicap",
        "serve",
        "--port",
        "0",
        "--workers",
        "1",
        "--data",
        tmp_path / "data",
    ]
    with subprocess.Popen(
        command, cwd=foreign, env=clean | {"MULTICAP_HOME": kernels}, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line and process.wait(10) == 1:
                pytest.skip("the default detector is not installed")
            yield line.removeprefix(READY).strip()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def test_a_job_by_the_client_and_the_same_in_the_process(
    programs: Path, foreign: Path, tmp_path: Path, kernels: str, service: str
) -> None:
    capture = tmp_path / "capture"
    keypoint_capture(capture)
    (capture / "archives").mkdir()
    for _, (name, content) in archives(capture):
        (capture / "archives" / name).write_bytes(content)
    sent, local = tmp_path / "sent", tmp_path / "local"
    said = run(programs / "python", "-c", SEND, service, capture, sent, cwd=foreign)
    assert float(said) == 1.0
    run(programs / "python", "-c", RECONSTRUCT, capture, local, cwd=foreign, MULTICAP_HOME=kernels)
    assert len(list(local.glob("*.bvh"))) >= 2
    assert digests(sent) == digests(local)
