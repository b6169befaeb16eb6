"""Settings and fixtures of all tests, and the list of the slow ones."""

import contextlib
import gc
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

from pipeline.core.runtime import child_processes
from tests.s3 import S3, running_s3
from tests.warm_programs import WarmPrograms

# The machines are shared: how long an example takes says nothing. Laws of the pipeline have the usual 100 examples in
# `make test-shapes`.
settings.register_profile("shared", deadline=None, max_examples=100 if os.environ.get("MULTICAP_CHECK_SHAPES") else 40)
settings.load_profile("shared")

# Told that it runs on CI, pytest explains two unequal pictures byte by byte, for a quarter of an hour.
os.environ.pop("CI", None)

# A shell starts background programs with SIGINT ignored, and their children inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Shapes and types of every public call, checked at twice the time: `make test-shapes` does.
if os.environ.get("MULTICAP_CHECK_SHAPES"):
    importlib.import_module("tests.type_checker")  # the hook looks the name up in packages that are loaded
    install_import_hook("pipeline", "tests.type_checker.checked")


# Longest text or bytes that name the case of a test.
_MAX_ID_CHARACTERS = 60


# Tests with a target of their own, `make test-slow`: folders and modules.
SLOW = (
    "api/web/contract/test_schemathesis.py",
    "api/web/http/test_connections.py",
    "api/web/http/test_keys_in_use.py",
    "api/web/http/test_memory.py",
    "api/web/http/test_slow_clients.py",
    "api/web/http/test_strangers.py",
    "api/web/test_damaged_database.py",
    "api/web/test_outages.py",
    "api/web/uploads/test_upload_clients.py",
    "e2e/test_backup.py",
    "e2e/test_benchmarks.py",
    "e2e/test_characters.py",
    "e2e/test_check_of_sessions.py",
    "e2e/test_clocks.py",
    "e2e/test_damaged.py",
    "e2e/test_damaged_files.py",
    "e2e/test_distributed.py",
    "e2e/test_fields.py",
    "e2e/test_foreign_code.py",
    "e2e/test_full_disk.py",
    "e2e/test_generated_clients.py",
    "e2e/test_interrupt.py",
    "e2e/test_manifest.py",
    "e2e/test_offline.py",
    "e2e/test_people_page.py",
    "e2e/test_people_runs_page.py",
    "e2e/test_portals.py",
    "e2e/test_postgres.py",
    "e2e/test_python_page.py",
    "e2e/test_rendered.py",
    "e2e/test_rolled.py",
    "e2e/test_send_waits.py",
    "e2e/test_serve.py",
    "e2e/test_shelf.py",
    "e2e/test_simulated.py",
    "e2e/test_stop.py",
    "e2e/test_traces.py",
    "e2e/test_viewer_tables.py",
    "e2e/test_wheel.py",
    "faults/",
    "hostile/",
    "pipeline/video/test_corpus.py",
    "pipeline/video/test_damage.py",
    "worker/store/backup/",
    "worker/store/test_concurrency.py",
    "worker/store/test_damaged_database.py",
    "worker/store/test_dropped_connections.py",
    "worker/run/test_faults.py",
    "worker/run/test_outages.py",
)

# Tests whose programs start as those of users do: they try how programs start, what limits them, and how they end.
COLD = (
    "api/cli/commands/test_own_models.py",
    "api/web/sessions/test_preflight.py",
    "e2e/",
    "faults/",
    "hostile/",
    "pipeline/core/runtime/",
    "pipeline/video/test_damage.py",
    "pipeline/video/test_decode_process.py",
    "pipeline/video/test_probe_children.py",
    "test_warm_programs.py",
    *(f"worker/run/test_{name}.py" for name in ("app", "embedded", "presence", "supervisor")),
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests, and keep the tests of a module together: its fixtures are made once, in one process.

    Groups of several modules come first, since they take longest.
    """
    tests = Path(__file__).parent
    of_groups, of_modules = [], []
    for item in items:
        module = item.path.relative_to(tests).as_posix()
        if module.startswith(SLOW):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(module))
            of_modules.append(item)
        else:
            of_groups.append(item)
    items[:] = of_groups + of_modules


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no module of slow tests where none of them runs, and no module without slow tests where they alone run."""
    words = config.option.markexpr.split()
    if "slow" not in words or collection_path.suffix != ".py":
        return None
    is_slow = collection_path.relative_to(Path(__file__).parent).as_posix().startswith(SLOW)
    if "not slow" in config.option.markexpr:
        return True if is_slow else None
    # A module that marks single tests names the mark.
    has_slow = is_slow or "slow" in collection_path.read_text(encoding="utf-8")
    return None if has_slow or words[-2:] not in (["slow"], ["and", "slow"]) else True


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Search for no garbage among modules and tests, which stay: it takes a fifth of the time of their collection."""
    gc.disable()
    _import_from_own_place(session.config)
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _import_from_own_place(config: pytest.Config) -> None:
    """Import the modules of tests from another place on in each process of a run of pytest-xdist.

    In a fresh clone each process compiles a part of all modules, and loads the parts that others have compiled.
    Otherwise each compiles all of them, at the same time, which takes three times as long as their collection later.
    """
    process: dict[str, Any] | None = getattr(config, "workerinput", None)
    if process is None:
        return
    tests = Path(__file__).parent
    given = [config.invocation_params.dir / argument.partition("::")[0] for argument in config.args]
    paths = [path for folder in given for path in (sorted(folder.rglob("test_*.py")) if folder.is_dir() else [folder])]
    first = len(paths) * int(process["workerid"].removeprefix("gw")) // process["workercount"]
    for path in paths[first:]:
        # An error is raised again where pytest imports the module.
        with contextlib.suppress(Exception, pytest.skip.Exception), warnings.catch_warnings(action="error"):
            if pytest_ignore_collect(path, config) is None:
                importlib.import_module(".".join(path.relative_to(tests.parent).with_suffix("").parts))


def pytest_make_parametrize_id(val: object) -> str | None:
    """Name of a long value: its beginning and length. Else it would be the value, which all processes exchange."""
    if isinstance(val, str | bytes) and len(val) > _MAX_ID_CHARACTERS:
        return f"{val[:_MAX_ID_CHARACTERS]!a}, {len(val)} long"
    return None


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """End what tests of a group have started: no event loop runs beside a browser, and idle services take time."""
    if nextitem is not None and _group(nextitem) == _group(item):
        return
    if (browsing := sys.modules.get("tests.e2e.browsing")) is not None:
        browsing.close_browser()
    for fixture in item.session._fixturemanager.getfixturedefs("served", item) or ():
        fixture.finish(item._request)  # type: ignore[attr-defined]


def _group(item: pytest.Item) -> str:
    """Group of tests that one process runs, one after the other."""
    mark = item.get_closest_marker("xdist_group")
    assert mark is not None
    return str(mark.args[0])


@pytest.fixture(scope="session")
def s3() -> Iterator[S3]:
    """S3 server for tests that use a prefix of their own in its bucket, and change nothing else."""
    with running_s3() as server:
        yield server


@pytest.fixture(scope="session", autouse=True)
def task_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Cache of finished tasks that all processes of a test run share: a detection is computed once."""
    # The base of a process of pytest-xdist is a folder in the base of the run.
    base = tmp_path_factory.getbasetemp()
    run = base.parent if base.name.startswith("popen-") else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MULTICAP_CACHE_HOME", str(run / "task-cache"))
        yield run / "task-cache"


@pytest.fixture(scope="session")
def warm_programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WarmPrograms]:
    """Programs that check files, forked from a process that has loaded them."""
    with WarmPrograms(tmp_path_factory.mktemp("warm")) as programs:
        yield programs


@pytest.fixture(scope="module", autouse=True)
def programs_of_a_module(request: pytest.FixtureRequest, warm_programs: WarmPrograms) -> Iterator[None]:
    """Fork the programs that the tests of a module start, unless the module is among ``COLD``."""
    with pytest.MonkeyPatch.context() as patch:
        module = request.path.relative_to(Path(__file__).parent).as_posix()
        if not module.startswith(COLD):
            patch.setattr(child_processes, "python_command", warm_programs.python_command)
        yield
