"""PostgreSQL server for tests, if the machine has its programs."""

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.ports import free_port

POSTGRES_VARIABLE = "MULTICAP_TEST_POSTGRES_URL"

# Folders of Debian and Fedora.
_PROGRAMS = sorted([*Path("/usr/lib/postgresql").glob("*/bin"), *Path("/usr/pgsql").glob("bin")])
_TESTS_ONLY = ["-c", "fsync=off", "-c", "max_connections=200"]


@dataclass
class Postgres:
    """Running server."""

    bin_dir: Path
    folder: Path
    port: int
    address: str = "127.0.0.1"
    prefix: Sequence[str] = ()

    @property
    def url(self) -> str:
        """URL of the server's first database."""
        return f"postgresql://postgres@{self.address}:{self.port}/postgres"

    def control(self, *arguments: str) -> None:
        """Call ``pg_ctl``."""
        _call(*self.command(*arguments))

    def command(self, *arguments: str) -> list[str]:
        """Command that calls ``pg_ctl``."""
        options = f"-p {self.port} -c listen_addresses={self.address} -c unix_socket_directories={self.folder}"
        log = ["-l", str(self.folder / "log"), "-o", " ".join([options, *_TESTS_ONLY])]
        control = [str(self.bin_dir / "pg_ctl"), "-w", "-D", str(self.folder / "data")]
        return [*self.prefix, *_as_postgres(), *control, *log, *arguments]


def _as_postgres() -> list[str]:
    # Its programs refuse root.
    return ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []


def _call(*command: str | Path) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@contextlib.contextmanager
def running_postgres(address: str = "127.0.0.1", prefix: Sequence[str] = ()) -> Iterator[Postgres]:
    """Run a server during the block; skip the test if it can't be run.

    Parameters
    ----------
    address
        Address to listen on.
    prefix
        Command that runs another one, for example in another network.
    """
    if not _PROGRAMS:
        pytest.skip(f"PostgreSQL is not installed, and {POSTGRES_VARIABLE} names no server")
    port = free_port()
    # Not among pytest's folders, which are closed to the user that the server runs as.
    with tempfile.TemporaryDirectory(prefix="multicap-postgres-") as folder:
        if os.geteuid() == 0:
            shutil.chown(folder, "postgres")
        server = Postgres(_PROGRAMS[-1], Path(folder), port, address, prefix)
        _call(*_as_postgres(), server.bin_dir / "initdb", "-U", "postgres", "-A", "trust", "-D", server.folder / "data")
        with (server.folder / "data" / "pg_hba.conf").open("a") as rules:
            rules.write("host all all samenet trust\nhost all all 10.0.0.0/8 trust\n")
        server.control("start")
        # The server is nobody's child. What stops it waits for the end of these tests, also when they are killed.
        stop = ["sh", "-c", 'cat; exec "$@"', "sh", *server.command("-m", "immediate", "stop")]
        with subprocess.Popen(stop, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True):
            yield server
