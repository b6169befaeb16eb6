"""Benchmark `queue`: times of polling and claiming with few and with many jobs in the queue."""

import contextlib
import os
import random
import socket
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import httpx2
import typer

from api.cli.client import ServiceError
from api.cli.console import JsonOption, emit, reporting
from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase
from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.parent_watch import tied_to_parent
from worker.run.planning import plan_job
from worker.store.model.session_records import InputFile
from worker.store.spec import JobSpec
from worker.store.store import JobStore

_FEW = 20
_CAMERAS, _NUM_FRAMES, _RATE_HZ = 4, 3000, 25.0
_START_S = 60.0


def fill(data_dir: Path, num_jobs: int) -> tuple[JobStore, list[str]]:
    """Create a store with queued jobs, each of two minutes and four cameras; return it with the ids in queue order."""
    data_dir.mkdir()
    store = JobStore(f"sqlite:///{data_dir / 'multicap.db'}")
    store.migrate()
    cameras = [f"cam_{number}" for number in range(_CAMERAS)]
    preflight = Preflight(
        cameras=tuple(PreflightCamera(name, f"{name}.mp4", (1280, 720), _RATE_HZ, _NUM_FRAMES) for name in cameras),
        timebase=PreflightTimebase(0.0, _RATE_HZ, _NUM_FRAMES),
        stretches=(range(_NUM_FRAMES),),
    )
    files = [InputFile(f"{name}.mp4", "video", f"inputs/{name}.mp4", 1, "0" * 64) for name in cameras]
    session = store.sessions.add("take", files, preflight, store.sessions.reserve_id())
    stages = plan_job(session, JobSpec())
    return store, [store.jobs.add(session.id, JobSpec(), stages).id for _ in range(num_jobs)]


@contextlib.contextmanager
def api(data_dir: Path) -> Iterator[httpx2.Client]:
    """Run the web API alone on a data folder."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        fd, port = listening.fileno(), listening.getsockname()[1]
        environment = os.environ | {"MULTICAP_DATA_DIR": str(data_dir)}
        command = tied_to_parent(module_command("api", "--fd", str(fd)))
        with (
            (data_dir / "api.log").open("wb") as log,
            subprocess.Popen(command, env=environment, pass_fds=[fd], stderr=log) as process,
            httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=_START_S, trust_env=False) as client,
        ):
            try:
                yield client
            finally:
                process.terminate()


def _seconds(act: Callable[[], object]) -> float:
    started_s = time.perf_counter()
    act()
    return time.perf_counter() - started_s


def measure(folder: Path, num_jobs: int, rounds: int) -> dict[str, Any]:
    """Measure median times of a poll and of a claim in milliseconds, with few and with many jobs in turns."""
    seconds: defaultdict[tuple[str, int], list[float]] = defaultdict(list)
    chance = random.Random(0)  # noqa: S311 - no secret
    with contextlib.ExitStack() as stack:
        queues = []
        for number in (_FEW, num_jobs):
            store, ids = fill(folder / str(number), number)
            stack.callback(store.close)
            queues.append((number, store, ids, stack.enter_context(api(folder / str(number)))))

        def ask(client: httpx2.Client, job_id: str) -> None:
            if client.get(f"/v1/jobs/{job_id}").json()["state"] not in {"queued", "running"}:
                raise ServiceError("A job is not in the queue.")

        def claim(store: JobStore) -> None:
            chunk = store.leases.claim("benchmark", 60.0)
            if chunk is None:
                raise ServiceError("There is nothing to claim.")
            held.append((store, chunk.chunk_id, chunk.lease_token))

        held: list[tuple[JobStore, int, str]] = []
        for turn in range(rounds + 1):
            for number, store, ids, client in queues:
                polled = _seconds(lambda client=client, ids=ids: ask(client, chance.choice(ids)))  # type: ignore[misc]
                claimed = _seconds(lambda store=store: claim(store))  # type: ignore[misc]
                if turn > 0:  # the first measurements include opening connections
                    seconds["poll", number].append(polled)
                    seconds["claim", number].append(claimed)
            for store, chunk_id, token in held:
                store.leases.release(chunk_id, token)
            held.clear()
    result: dict[str, Any] = {"jobs": [_FEW, num_jobs]}
    for what in ("poll", "claim"):
        few, many = (median(seconds[what, number]) * 1e3 for number in (_FEW, num_jobs))
        result[what] = {"few_ms": few, "many_ms": many, "ratio": many / few}
    return result


def queue(
    jobs: Annotated[int, typer.Option(min=21, max=100_000, help="Number of jobs in the long queue.")] = 2000,
    rounds: Annotated[int, typer.Option(min=10, max=10_000, help="Number of measurements of each kind.")] = 500,
    as_json: JsonOption = False,
) -> None:
    """Time polling and claiming with many queued jobs, compared with few."""
    with reporting(as_json), tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        result = measure(Path(folder), jobs, rounds)
    if as_json:
        emit(result)
        return
    for what in ("poll", "claim"):
        figures = result[what]
        typer.echo(
            f"{what}: {figures['few_ms']:.2f} ms beside {_FEW} jobs, {figures['many_ms']:.2f} ms beside {jobs}: "
            f"{figures['ratio']:.2f} times"
        )
