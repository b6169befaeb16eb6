"""PostgreSQL server for tests, if the machine has its programs."""

import contextlib
import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

POSTGRES_VARIABLE = "MULTICAP_TEST_POSTGRES_URL"

# Where Debian and Fedora have them.
_PROGRAMS = sorted([*Path("/usr/lib/postgresql").glob("*/bin"), *Path("/usr/pgsql").glob("bin")])
_TESTS_ONLY = ["-c", "fsync=off", "-c", "max_connections=200"]


@dataclass
class Postgres:
    """Running server."""

    bin_dir: Path
    folder: Path
    port: int

    @property
    def url(self) -> str:
        """URL of the server's first database."""
        return f"postgresql://postgres@127.0.0.1:{self.port}/postgres"

    def control(self, *arguments: str) -> None:
        """Call ``pg_ctl``."""
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={self.folder}"
        log = ["-l", str(self.folder / "log"), "-o", " ".join([options, *_TESTS_ONLY])]
        _call(self.bin_dir / "pg_ctl", "-w", "-D", self.folder / "data", *log, *arguments)


def _call(*command: str | Path) -> None:
    # Its programs refuse root.
    prefix = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    subprocess.run([*prefix, *command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@contextlib.contextmanager
def running_postgres() -> Iterator[Postgres]:
    """Run a server during the block; skip the test if it can't be run."""
    if not _PROGRAMS:
        pytest.skip(f"PostgreSQL is not installed, and {POSTGRES_VARIABLE} names no server")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    # Not among pytest's folders, which are closed to the user that the server runs as.
    with tempfile.TemporaryDirectory(prefix="multicap-postgres-") as folder:
        if os.geteuid() == 0:
            shutil.chown(folder, "postgres")
        server = Postgres(_PROGRAMS[-1], Path(folder), port)
        _call(server.bin_dir / "initdb", "-U", "postgres", "-A", "trust", "-D", server.folder / "data")
        server.control("start")
        try:
            yield server
        finally:
            server.control("-m", "immediate", "stop")
