"""Shapes and types of every public call are checked while the tests run."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

# The machines are shared: how long an example takes says nothing.
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")

# A shell starts background programs with SIGINT ignored, and their children inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)

install_import_hook("pipeline", "beartype.beartype")


@pytest.fixture(scope="session", autouse=True)
def task_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Cache of finished tasks that all processes of a test run share: a detection is computed once."""
    # The base of a process of pytest-xdist is a folder in the base of the run.
    base = tmp_path_factory.getbasetemp()
    run = base.parent if base.name.startswith("popen-") else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MULTICAP_CACHE_HOME", str(run / "task-cache"))
        yield run / "task-cache"
