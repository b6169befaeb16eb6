"""Plans of clusters: the queue's simulation against theory, needs against hand-made costs, and the command."""

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.benchmark.plan.command import forecast
from api.cli.benchmark.plan.needs import PlannedTake, Prices, needs_of, stage_loads
from api.cli.benchmark.plan.queue_simulation import Failures, JobArrival, StageLoad, simulate
from api.cli.main import app

ONE_CHUNK = (StageLoad(1, 1.0),)
TAKE = PlannedTake(cameras=4, minutes=10.0, rate_hz=30.0, mbit_per_s=8.0)
# A job of a thousand camera frames at 10 ms each, half of it in the detection; further frames cost 8 ms.
COST: dict[str, Any] = {
    "profiles": [
        {
            "profile": "balanced",
            "provider": "cpu",
            "camera_frames": 1000,
            "camera_frame_core_ms": 10.0,
            "added_camera_frame_core_ms": 8.0,
            "stages_core_s": {"open": 0.0, "detect": 5.0, "fit": 5.0},
        }
    ]
}


def test_one_worker_waits_as_the_pollaczek_khinchine_formula_says() -> None:
    chance, time_s, arrivals = random.Random(3), 0.0, []  # noqa: S311 - no secret
    for _ in range(40_000):
        time_s += chance.expovariate(0.5)
        arrivals.append(JobArrival("one", time_s, ONE_CHUNK))
    outcome = simulate(arrivals, num_workers=1)
    # Mean waiting time of M/D/1 at half load: rho / (2 (1 - rho)) of a service time of 1 s.
    assert np.mean(outcome.waiting_s) == pytest.approx(0.5, rel=0.05)
    assert outcome.busy_s == pytest.approx(40_000.0)


def test_a_stage_begins_when_the_one_before_is_done() -> None:
    stages = (StageLoad(3, 1.0), StageLoad(1, 2.0), StageLoad(2, 1.0))
    outcome = simulate([JobArrival("one", 5.0, stages)], num_workers=2)
    assert outcome.end_s == 5.0 + 2.0 + 2.0 + 1.0
    assert outcome.waiting_s == [0.0]
    assert simulate([JobArrival("one", 0.0, stages)], num_workers=1, gap_s=0.5).end_s == 7.0 + 5 * 0.5


def test_a_long_queue_of_one_tenant_delays_nobody_else() -> None:
    many = [JobArrival("large", 0.0, ONE_CHUNK)] * 100
    outcome = simulate([*many, JobArrival("small", 10.0, ONE_CHUNK)], num_workers=2)
    (end_s,) = (end_s for end_s, tenant, _ in outcome.work if tenant == "small")
    assert end_s <= 12.0
    assert outcome.end_s == pytest.approx(50.5, abs=0.5)


def test_lost_workers_cost_time_and_no_job() -> None:
    jobs = [JobArrival("one", 0.0, (StageLoad(10, 10.0),))] * 10
    whole = simulate(jobs, num_workers=4)
    outcome = simulate(jobs, num_workers=4, failures=Failures(mean_s=60.0, lease_s=20.0))
    assert outcome.lost_chunks > 0
    assert len(outcome.response_s) == 10
    assert outcome.end_s > whole.end_s


def test_needs_follow_the_costs() -> None:
    needs = needs_of(COST, "balanced", TAKE, camera_hours=1000.0, utilization=0.5, num_machines=4)
    # An hour of a camera has 108,000 frames of 8 ms.
    assert needs.core_hours_a_camera_hour == pytest.approx(108_000 * 0.008 / 3600.0)
    assert needs.jobs_a_day == pytest.approx(1500.0)
    assert needs.cores == 20  # 240 core hours, half a day long
    assert needs.upload_gib == pytest.approx(1000 * 3600 * 1e6 / 2**30)
    assert needs.stored_gib > needs.upload_gib
    assert needs.chunks_per_s == pytest.approx(1500 * needs.chunks_a_job / 86_400)
    price = Prices(core_hour=0.05, gib_month=0.02, days_kept=15.0).of_day(needs, camera_hours=1000.0)
    assert price["processors_a_day"] == pytest.approx(20 * 24 * 0.05)
    assert price["storage_a_day"] == pytest.approx(needs.stored_gib * 0.01)
    assert price["camera_hour"] == pytest.approx((24.0 + needs.stored_gib * 0.01) / 1000.0)
    twice = needs_of(COST, "balanced", TAKE, camera_hours=2000.0, utilization=0.5, num_machines=4)
    assert twice.cores == 40
    more = needs_of(COST, "balanced", TAKE, camera_hours=1000.0, utilization=0.5, num_machines=16)
    assert more.network_mbit_per_s > needs.network_mbit_per_s


def test_chunks_can_be_joined_and_take_as_long_together() -> None:
    whole, joined = (stage_loads(COST, "balanced", TAKE, most) for most in (None, 16))
    assert max(load.num_chunks for load in whole) == 4 * 180
    assert max(load.num_chunks for load in joined) == 16
    seconds = [sum(load.num_chunks * load.chunk_s for load in loads) for loads in (whole, joined)]
    assert seconds == pytest.approx([72_000 * 0.008] * 2)


REPORT = {
    "jobs": {"one": 4, "two": 4},
    "workers": 2,
    "wall_s": 8.0,
    "worker_busy": 1.0,
    "gap_s": 0.0,
    "chunk_s": {"detect": 1.0},
    "chunks_a_job": {"detect": 2},
    "finished_s": {"one": 8.0, "two": 8.0},
}


def test_a_forecast_is_compared_with_what_was_measured() -> None:
    assert forecast(REPORT, REPORT)["wall_ratio"] == pytest.approx(1.0)
    slower = {**REPORT, "chunk_s": {"detect": 2.0}}
    assert forecast(REPORT, slower)["wall_ratio"] == pytest.approx(2.0)


def run(folder: Path, document: object, *words: str) -> Any:
    (folder / "cost.json").write_text(document if isinstance(document, str) else json.dumps(document))
    (folder / "report.json").write_text(json.dumps(REPORT))
    command = ["benchmark", "plan", str(folder / "cost.json"), "--camera-hours", "20", "--json"]
    return CliRunner().invoke(app, [*command, *words])


def test_the_command_prints_needs_queue_and_forecast(tmp_path: Path) -> None:
    answer = run(tmp_path, COST, "--measured", str(tmp_path / "report.json"))
    result = json.loads(answer.stdout)
    assert result["needs"]["jobs_a_day"] == 30
    assert result["queue"]["waiting_p95_s"] >= result["queue"]["waiting_median_s"] >= 0.0
    assert result["forecast"]["measured_wall_s"] == 8.0


def test_another_report_is_refused_by_its_name(tmp_path: Path) -> None:
    answer = run(tmp_path, COST, "--measured", str(tmp_path / "cost.json"))
    assert answer.exit_code != 0
    assert "cost.json is no report of `make load`" in answer.stdout + answer.stderr


@pytest.mark.parametrize("document", ["{", {"profiles": []}, [1], {"profiles": [{"profile": "balanced"}]}])
def test_another_document_is_refused_by_its_name(tmp_path: Path, document: object) -> None:
    answer = run(tmp_path, document)
    assert answer.exit_code != 0
    assert "cost.json" in answer.stdout + answer.stderr
    assert "Traceback" not in answer.stdout + answer.stderr
