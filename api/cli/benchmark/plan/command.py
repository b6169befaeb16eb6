"""`multicap benchmark plan`: needs of a day's work, a simulation of its queue, and a forecast of a measured run."""

import json
import math
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from api.cli.benchmark.plan.needs import DAY_S, PlannedTake, Prices, needs_of, stage_loads
from api.cli.benchmark.plan.queue_simulation import Failures, JobArrival, QueueOutcome, StageLoad, simulate
from api.cli.client import ServiceError
from api.cli.console import JsonOption, emit, print_table, reporting
from api.cli.options import checked, with_choices

# Chunks of a stage that are simulated as so many: a day has millions.
_MOST_CHUNKS = 32
_TENANTS = 10
# Keys of a report of ``tests/load/test_tenants.py`` that a forecast needs.
_OF_REPORT = {"jobs", "workers", "wall_s", "worker_busy", "gap_s", "chunk_s", "chunks_a_job", "finished_s"}

CostArgument = Annotated[
    Path, typer.Argument(exists=True, dir_okay=False, help="Document of `multicap benchmark all --json`.")
]


@with_choices("profile")
def plan(
    *,
    cost: CostArgument,
    camera_hours: Annotated[float, typer.Option(min=0.1, help="Hours of cameras a day.")] = 1000.0,
    cameras: Annotated[int, typer.Option(min=2, max=31, help="Cameras of a take.")] = 4,
    minutes: Annotated[float, typer.Option(min=0.1, max=600, help="Length of a take in minutes.")] = 10.0,
    rate_hz: Annotated[float, typer.Option("--rate", min=1, max=1000, help="Frames a second.")] = 30.0,
    mbit: Annotated[float, typer.Option(min=0.1, help="Mbit/s of a camera's video.")] = 8.0,
    utilization: Annotated[float, typer.Option(min=0.05, max=0.95, help="Share of time that workers work.")] = 0.7,
    machine_cores: Annotated[int, typer.Option(min=1, help="Processors of a machine of workers.")] = 16,
    working_hours: Annotated[float, typer.Option(min=1, max=24, help="Hours of the day in which jobs come.")] = 10.0,
    days_between_failures: Annotated[float, typer.Option(min=0.01, help="Days until a worker is lost.")] = 30.0,
    core_hour_price: Annotated[
        float | None, typer.Option(min=0.0, help="Price of a processor for an hour, in any currency.")
    ] = None,
    gib_month_price: Annotated[float, typer.Option(min=0.0, help="Price of a GiB of storage for a month.")] = 0.0,
    days_kept: Annotated[float, typer.Option(min=0.0, help="Days until sessions are deleted.")] = 30.0,
    measured: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Report of `make load` to forecast, too.")
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(
            exists=True, dir_okay=False, help="Another such report, of which the forecast takes the times of chunks."
        ),
    ] = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """Plan a cluster from measured costs: processors, disk, network, rows, their price, and how long jobs wait."""
    with reporting(as_json):
        profile = checked(chosen).profile
        take = PlannedTake(cameras, minutes, rate_hz, mbit)
        document = _read(cost)
        try:
            cores = needs_of(document, profile, take, camera_hours, utilization, 1).cores
            needs = needs_of(document, profile, take, camera_hours, utilization, math.ceil(cores / machine_cores))
            loads = stage_loads(document, profile, take, _MOST_CHUNKS)
        except (KeyError, TypeError, ValueError) as error:
            raise ServiceError(f"{cost.name} is no document of `multicap benchmark all`: {error}") from error
        arrivals = day_of_jobs(round(needs.jobs_a_day), working_hours, loads)
        failures = Failures(days_between_failures * DAY_S)
        outcome = simulate(arrivals, needs.cores, failures=failures)
        result: dict[str, Any] = {
            "needs": needs.as_dict(),
            "machines": math.ceil(needs.cores / machine_cores),
            "alone_s": sum(load.chunk_s * math.ceil(load.num_chunks / needs.cores) for load in loads),
            "queue": figures(outcome, needs.cores),
        }
        if core_hour_price is not None:
            result["price"] = Prices(core_hour_price, gib_month_price, days_kept).of_day(needs, camera_hours)
        if measured is not None:
            report = _report(measured)
            result["forecast"] = forecast(report, report if times is None else _report(times))
    if as_json:
        emit(result)
        return
    for name, rows in result.items():
        if isinstance(rows, Mapping):
            print_table((name, "value"), ((key, f"{value:.4g}") for key, value in rows.items()))


def day_of_jobs(num_jobs: int, working_hours: float, stages: tuple[StageLoad, ...], seed: int = 0) -> list[JobArrival]:
    """Jobs of a day, which come at random times of the working hours, from ten tenants."""
    chance = random.Random(seed)  # noqa: S311 - no secret
    times_s = sorted(chance.uniform(0.0, working_hours * 3600.0) for _ in range(num_jobs))
    return [JobArrival(f"tenant {chance.randrange(_TENANTS)}", time_s, stages) for time_s in times_s]


def figures(outcome: QueueOutcome, num_workers: int) -> dict[str, float]:
    """Waiting and response times of jobs, and what workers did."""
    waiting_s, response_s = np.array(outcome.waiting_s), np.array(outcome.response_s)
    return {
        "waiting_median_s": float(np.median(waiting_s)),
        "waiting_p95_s": float(np.percentile(waiting_s, 95)),
        "response_median_s": float(np.median(response_s)),
        "response_p95_s": float(np.percentile(response_s, 95)),
        "last_end_h": outcome.end_s / 3600.0,
        "busy": outcome.busy_s / (outcome.end_s * num_workers),
        "lost_chunks": float(outcome.lost_chunks),
    }


def forecast(report: Mapping[str, Any], times: Mapping[str, Any]) -> dict[str, float]:
    """Forecast of a run of `make load` from its numbers of jobs and workers, beside what was measured.

    ``times`` is the report that has the times of chunks and the gaps between them: of the same run, or of a shorter
    one.
    """
    stages = tuple(StageLoad(number, times["chunk_s"][stage]) for stage, number in times["chunks_a_job"].items())
    arrivals = [JobArrival(tenant, 0.0, stages) for tenant, number in report["jobs"].items() for _ in range(number)]
    outcome = simulate(arrivals, report["workers"], gap_s=times["gap_s"])
    ends_s = {
        tenant: max(end_s for end_s, owner, _ in outcome.work if owner == tenant) for tenant in report["finished_s"]
    }
    measured_s = report["finished_s"]
    errors = [abs(ends_s[tenant] / measured_s[tenant] - 1.0) for tenant in ends_s]
    return {
        "wall_s": outcome.end_s,
        "measured_wall_s": report["wall_s"],
        "wall_ratio": outcome.end_s / report["wall_s"],
        "mean_error_of_tenants_ends": float(np.mean(errors)),
        "busy": outcome.busy_s / (outcome.end_s * report["workers"]),
        "measured_busy": report["worker_busy"],
    }


def _report(path: Path) -> dict[str, Any]:
    report = _read(path)
    if missing := sorted(_OF_REPORT - report.keys()):
        raise ServiceError(f"{path.name} is no report of `make load`: {', '.join(missing)} are missing.")
    return report


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise ServiceError(f"{path.name} can't be read as JSON: {error}") from error
    if not isinstance(document, dict):
        raise ServiceError(f"{path.name} must hold a JSON object.")
    return document
