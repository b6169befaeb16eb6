"""Benchmark `load`: response times while many clients poll, some upload, and the workers compute."""

import asyncio
import contextlib
import io
import math
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import httpx2
import numpy as np
import typer

from api.cli.benchmark.long_takes import loop_video
from api.cli.client import Client, Json, ServiceError
from api.cli.console import JsonOption, emit, reporting
from api.cli.served import served
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.samples import Sample
from pipeline.detection import models
from worker.store.spec import JobSpec

_WORKERS = 2
_POLL_EVERY_S = 1.0
# Two workers need longer for a job of the sample, so that they don't run out of work.
_JOB_S = 8.0
# Repetitions that make uploads of some 300 MB.
_UPLOAD_LOOPS = 100
_START_S = 120.0


@dataclass
class Polls:
    """Seconds of each response, and errors."""

    seconds: list[float]
    errors: list[str]


def poll(url: str, paths: Sequence[str], num_clients: int, duration_s: float) -> Polls:
    """Poll with several clients, each once a second over its own connection."""
    return asyncio.run(_poll(url, paths, num_clients, duration_s))


async def _poll(url: str, paths: Sequence[str], num_clients: int, duration_s: float) -> Polls:
    polls = Polls([], [])
    async with contextlib.AsyncExitStack() as stack:
        # Create all clients before the first request: the creation is slow enough to delay the requests of others.
        clients = [
            await stack.enter_async_context(httpx2.AsyncClient(base_url=url, timeout=30.0, trust_env=False))
            for _ in range(num_clients)
        ]
        start_s = time.perf_counter()
        await asyncio.gather(
            *(
                _poll_as(client, paths[k % len(paths)], start_s + _POLL_EVERY_S * k / num_clients, duration_s, polls)
                for k, client in enumerate(clients)
            )
        )
    return polls


async def _poll_as(client: httpx2.AsyncClient, path: str, first_s: float, duration_s: float, polls: Polls) -> None:
    for turn in range(int(duration_s / _POLL_EVERY_S)):
        await asyncio.sleep(max(0.0, first_s + turn * _POLL_EVERY_S - time.perf_counter()))
        started_s = time.perf_counter()
        try:
            answer = await client.get(path)
            if answer.status_code != 200:
                polls.errors.append(f"GET {path}: {answer.status_code}")
        except httpx2.TransportError as error:
            polls.errors.append(f"GET {path}: {error!r}")
        polls.seconds.append(time.perf_counter() - started_s)


@dataclass
class UploadTotals:
    """Uploaded bytes, and errors."""

    num_bytes: int
    errors: list[str]


class _Line(io.FileIO):
    """File that is read at the speed of a network connection."""

    def __init__(self, path: Path, bytes_per_s: float) -> None:
        super().__init__(path)
        self._bytes_per_s, self._free_s = bytes_per_s, time.perf_counter()

    def read(self, size: int | None = -1) -> bytes:
        """Read when the bytes read before would have been sent."""
        time.sleep(max(0.0, self._free_s - time.perf_counter()))
        data = super().read(size) or b""
        self._free_s = max(self._free_s, time.perf_counter()) + len(data) / self._bytes_per_s
        return data


def upload(
    url: str, videos: Sequence[Path], calibration: Path, num_clients: int, duration_s: float, mbit_per_s: float
) -> UploadTotals:
    """Send and delete sessions with several clients, one session after the other, at a total rate."""
    uploads = UploadTotals(0, [])
    end_s = time.perf_counter() + duration_s
    bytes_per_s = mbit_per_s * 1e6 / 8 / max(1, num_clients)
    arguments = (url, [*videos, calibration], bytes_per_s, end_s, uploads, threading.Lock())
    threads = [threading.Thread(target=_upload_as, args=arguments) for _ in range(num_clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return uploads


def _upload_as(
    url: str, paths: Sequence[Path], bytes_per_s: float, end_s: float, uploads: UploadTotals, lock: threading.Lock
) -> None:
    with httpx2.Client(base_url=url, timeout=120.0, trust_env=False) as http:
        while time.perf_counter() < end_s:
            try:
                with contextlib.ExitStack() as opened:
                    parts = ["videos"] * (len(paths) - 1) + ["calibration"]
                    files = [
                        (part, (path.name, opened.enter_context(_Line(path, bytes_per_s))))
                        for part, path in zip(parts, paths, strict=True)
                    ]
                    answer = http.post("/v1/sessions", files=files)
                answer = http.delete(answer.headers["Location"]) if answer.status_code == 201 else answer
                error = None if answer.status_code == 204 else f"POST /v1/sessions: {answer.status_code}"
            except httpx2.TransportError as failure:
                error = f"POST /v1/sessions: {failure!r}"
            with lock:
                if error is None:
                    uploads.num_bytes += sum(path.stat().st_size for path in paths)
                else:
                    uploads.errors.append(error)


def _units_done(client: Client, jobs: Sequence[Json]) -> int:
    return sum(stage["done"] for job in jobs for stage in client.get(job["urls"]["self"])["stages"])


def measure(
    sample: Sample, folder: Path, duration_s: float, polling: int, uploading: int, mbit_per_s: float
) -> dict[str, Any]:
    """Measure a new service under load."""
    videos = [folder / path.name for path in sample.videos.values()]
    with ProcessPool(2) as pool, served(folder / "service", _WORKERS) as client:
        list(pool.map(loop_video, sample.videos.values(), videos, [_UPLOAD_LOOPS] * len(videos)))
        jobs = [
            client.submit(f"Work {number}", list(sample.videos.values()), sample.calibration)
            for number in range(math.ceil(duration_s / _JOB_S))
        ]
        deadline_s = time.monotonic() + _START_S
        while client.get(jobs[0]["urls"]["self"])["progress"] == 0:
            if time.monotonic() > deadline_s:
                raise ServiceError("The workers do not begin.")
            time.sleep(0.1)
        before = _units_done(client, jobs)
        paths = [job["urls"]["self"] for job in jobs]
        uploads = pool.submit(upload, client.url, videos, sample.calibration, uploading, duration_s, mbit_per_s)
        polls = pool.submit(poll, client.url, paths, polling, duration_s).result()
        sent = uploads.result()
        after = _units_done(client, jobs)
        if all(client.get(path)["state"] == "succeeded" for path in paths):
            raise ServiceError("The workers ran out of work before the end; the machine is faster than this benchmark.")
    p50, p95, p99 = (float(value) for value in np.percentile(np.array(polls.seconds) * 1e3, [50, 95, 99]))
    return {
        "polls": len(polls.seconds),
        "p50_ms": p50,
        "p95_ms": p95,
        "p99_ms": p99,
        "max_ms": max(polls.seconds) * 1e3,
        "uploaded_mib": sent.num_bytes / 2**20,
        "worked_units": after - before,
        "errors": polls.errors + sent.errors,
    }


def load(
    duration_s: Annotated[float, typer.Option("--duration", min=5, max=3600, help="Duration in seconds.")] = 120.0,
    polling: Annotated[int, typer.Option(min=1, max=400, help="Number of clients that read a job once a second.")] = 64,
    uploading: Annotated[int, typer.Option(min=0, max=16, help="Number of clients that upload.")] = 4,
    upload_mbit: Annotated[
        float, typer.Option(min=1, help="Total rate of all uploads in Mbit/s. Default: as fast as possible.")
    ] = math.inf,
    as_json: JsonOption = False,
) -> None:
    """Time the responses of a service with two busy workers while clients poll and upload."""
    with reporting(as_json), tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        models.install_networks(JobSpec().config)
        result = measure(samples.install(), Path(folder), duration_s, polling, uploading, upload_mbit)
    if as_json:
        emit(result)
        return
    typer.echo(
        f"{result['polls']} answers, {len(result['errors'])} errors: median {result['p50_ms']:.1f} ms, "
        f"p95 {result['p95_ms']:.1f}, p99 {result['p99_ms']:.1f}, longest {result['max_ms']:.0f}; "
        f"meanwhile {result['uploaded_mib']:.0f} MiB were uploaded and {result['worked_units']} units of work done"
    )
    for error in result["errors"][:10]:
        typer.echo(error)
