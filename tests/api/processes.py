"""Service in a child process, and its peak memory."""

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import psutil

from api.web.settings import GIB, Settings
from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.api.conftest import NO_BROKER


@contextlib.contextmanager
def serving(
    settings: Settings, port: int = 0, descriptors: int | None = None, **variables: str
) -> Iterator[tuple[httpx2.Client, psutil.Process]]:
    """Run the service in a child process during the block.

    Parameters
    ----------
    descriptors
        Soft limit on open files that the process starts with.
    variables
    Further environment variables, without the prefix.
    """
    environment = os.environ | {
        "MULTICAP_DATA_DIR": str(settings.data_dir),
        "MULTICAP_BROKER_URL": NO_BROKER,
        "MULTICAP_PREFLIGHT_COMMAND": str(list(settings.preflight_command)).replace("'", '"'),
        "MULTICAP_PORT": str(port),
        "MULTICAP_MAX_FILE_BYTES": str(3 * GIB),
        **{f"MULTICAP_{name}": value for name, value in variables.items()},
    }
    log = settings.data_dir.parent / "log"
    with log.open("ab") as output:
        child = subprocess.Popen(
            tied_to_parent([*_limited(descriptors), sys.executable, "-m", "api"]),
            env=environment,
            stdout=output,
            stderr=output,
        )
    try:
        process = psutil.Process(child.pid)
        deadline_s = time.monotonic() + 120
        while not (listening := [c for c in process.net_connections("tcp") if c.status == psutil.CONN_LISTEN]):
            assert child.poll() is None, log.read_text()
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        address = f"http://127.0.0.1:{listening[0].laddr.port}"
        with httpx2.Client(base_url=address, timeout=300, trust_env=False) as client:
            yield client, process
    finally:
        child.terminate()
        child.wait(20)


def _limited(descriptors: int | None) -> list[str]:
    return [] if descriptors is None else [str(shutil.which("prlimit")), f"--nofile={descriptors}:"]


def peak_bytes(process: psutil.Process) -> int:
    """Peak resident memory of a process so far."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    (kib,) = re.findall(r"VmHWM:\s+(\d+) kB", status)
    return int(kib) * 1024
