"""A service of our own for the time of a block, as our own commands use it."""

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

from api.cli.client import Client, ServiceError
from api.cli.commands.serve import READY
from pipeline.runtime.child_processes import module_command
from worker.process.lifeline import tied

_STOP_S = 30.0


@contextlib.contextmanager
def served(data_dir: Path, workers: int) -> Iterator[Client]:
    """A service of our own on a free port, for the time of the block.

    Raises
    ------
    ServiceError
        If it does not start.
    """
    data_dir.mkdir(parents=True, exist_ok=True)
    command = module_command("api.cli.main", "serve", "--port", "0")
    log = data_dir / "serve.log"
    with (
        log.open("wb") as output,
        subprocess.Popen(  # noqa: S603 - the command is ours
            tied([*command, "--data", str(data_dir), "--workers", str(workers)]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=output,
            text=True,
            start_new_session=True,  # Ctrl-C reaches us alone, and we stop it
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
