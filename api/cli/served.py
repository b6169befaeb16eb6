"""Temporary service in a child process, for commands that need one."""

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

from api.cli.client import Client, ServiceError
from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.parent_watch import tied_to_parent

READY = "Multicap is ready at "
"""Text before the service's address, printed as soon as the service is ready."""
_STOP_S = 30.0


@contextlib.contextmanager
def served(data_dir: Path, workers: int) -> Iterator[Client]:
    """Run a service on a free port during the block; yield its client. Raises ``ServiceError`` if it does not start."""
    data_dir.mkdir(parents=True, exist_ok=True)
    command = module_command("api.cli.main", "serve", "--port", "0")
    log = data_dir / "serve.log"
    with (
        log.open("wb") as output,
        subprocess.Popen(  # noqa: S603 - our own command
            tied_to_parent([*command, "--data", str(data_dir), "--workers", str(workers)]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=output,
            text=True,
            start_new_session=True,  # Ctrl-C reaches only this process, which stops the service
        ) as process,
    ):
        try:
            line = process.stdout.readline() if process.stdout else ""
            if not line.startswith(READY):
                raise ServiceError(f"The service did not start. {log.read_text(encoding='utf-8').strip()}")
            url = line.removeprefix(READY).strip()
            with Client.connect(url, trust_env=False) as client:
                yield client
        finally:
            process.terminate()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
