"""Costs of jobs: what is counted, and what is made of it."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.cli.benchmark import cost as cost_module
from api.cli.benchmark.cost import JobCost, measure_job, processor_name, simulated_session
from api.cli.benchmark.cost_tables import CostTable, cost_tables
from api.cli.benchmark.tracking import crowd
from api.cli.main import app
from pipeline.core.options.config import PROFILES, ReconstructionConfig
from pipeline.core.runtime.packages import samples
from pipeline.detection import models
from pipeline.run.engine.stage import LOOK

COST = JobCost(
    cameras=4,
    camera_frames=400,
    people=3,
    core_s=20.0,
    networks_core_s=12.0,
    decoding_core_s=3.0,
    wall_s=16.0,
    stages_core_s={"open": 0.5, LOOK: 1.5, "detect": 17.0, "fit": 0.999, "write": 0.001},
    peak_mib=500.0,
)


@pytest.mark.slow
def test_job_is_measured_in_its_own_process() -> None:
    simulation = crowd(3, 1, 1.0)
    cost = measure_job(partial(simulated_session, simulation), ReconstructionConfig(), "cpu")
    assert (cost.cameras, cost.people) == (3, 1)
    assert cost.camera_frames == 75
    assert cost.networks_core_s == 0
    assert cost.core_s > 0
    assert sum(cost.stages_core_s.values()) == pytest.approx(cost.core_s, abs=0.2)
    assert {"associate", "fit", "export"} <= cost.stages_core_s.keys()
    assert cost.peak_mib > 50


def measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """Document of the command, with nothing computed: every job costs the same."""
    asked: list[tuple[int, int, str, str, int]] = []

    def measure(opened: Any, config: ReconstructionConfig, provider: str) -> JobCost:
        videos, _ = opened.args
        loops = 1 if videos[0].parent == tmp_path else 2
        asked.append((len(videos), loops, config.profile, provider, config.processes))
        # A job of twice as many frames costs three quarters more: a quarter of the shorter one is done once.
        return COST if loops == 1 else replace(COST, camera_frames=800, core_s=35.0)

    videos = {f"cam_{k}": tmp_path / f"cam_{k}.mp4" for k in range(4)}
    sample = samples.Sample(tmp_path, videos, tmp_path / "rig.toml", "BSD", "A")
    picture = {"profile": "fast", "bodies": 2, "pictures": 9, "core_ms": 21.04}
    keypoint_job = {**COST.as_dict(), "simulated_people": 3, "duration_s": 20.0}
    monkeypatch.setattr(cost_module, "measure_job", measure)
    monkeypatch.setattr(cost_module, "looped_sample", lambda sample, loops, folder: None)
    monkeypatch.setattr(cost_module, "_pictures", lambda profile, videos: [picture] if profile == "fast" else [])
    monkeypatch.setattr(
        cost_module, "measure_keypoints", lambda: {key: [keypoint_job] for key in ("cameras", "people", "duration_s")}
    )
    monkeypatch.setattr(cost_module, "_other_providers", lambda: ["openvino"])
    monkeypatch.setattr(cost_module, "warm_up", lambda: None)
    monkeypatch.setattr(models, "install_networks", lambda config: None)
    monkeypatch.setattr(samples, "install", lambda: sample)
    result = CliRunner().invoke(app, ["benchmark", "all", "--json"])
    assert result.exit_code == 0, result.output
    # Jobs that were measured already are not measured again.
    assert asked == [
        *((4, loops, profile, "cpu", 1) for profile in PROFILES for loops in (1, 2)),
        *((4, loops, "balanced", "openvino", 1) for loops in (1, 2)),
        (4, 1, "balanced", "cpu", 2),
        (2, 1, "fast", "cpu", 1),
    ]
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def tables(cost: dict[str, Any]) -> dict[str, CostTable]:
    return {table.title: table for table in cost_tables(cost)}


def test_minute_costs_its_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """35 s for 800 camera frames, and 37.5 ms of a core for each further one."""
    cost = measured(monkeypatch, tmp_path)
    job = cost["profiles"][0]
    assert job["minute_core_s"] == {"30": pytest.approx(275.0), "60": pytest.approx(545.0)}
    of_minute = tables(cost)["A minute of four cameras"]
    assert dict(zip(of_minute.columns, of_minute.rows[0], strict=True)) == {
        "profile": "fast",
        "provider": "cpu",
        "30 Hz": "275 s",
        "60 Hz": "545 s",
        "networks": "34 %",
        "decoding": "9 %",
        "rest": "57 %",
        "a further camera frame": "37.5 ms",
        "memory": "500 MiB",
    }


def test_stages_are_milliseconds_of_camera_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """17 s for 800 camera frames are 21.25 ms; what takes next to nothing is left out."""
    stages = tables(measured(monkeypatch, tmp_path))["Stages"]
    milliseconds = {"open": "0.62", LOOK: "1.88", "detect": "21.25", "fit": "1.25"}
    assert stages.rows == [(stage, *[text] * 3) for stage, text in milliseconds.items()]


def test_pictures_are_rows_by_bodies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = tables(measured(monkeypatch, tmp_path))["People in a picture"]
    assert pictures.columns == ("bodies", "`fast`")
    assert pictures.rows == [("2", "21.0 (9)")]


def test_processor_is_named_with_its_instructions(tmp_path: Path) -> None:
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text(
        "processor\t: 0\nmodel name\t: Chip 3000\nflags\t\t: fpu avx2 avx512_vnni\n\nmodel name\t: Other\n"
    )
    assert processor_name(cpuinfo) == "Chip 3000, AVX2, VNNI"
    assert processor_name(tmp_path / "missing")


def test_every_key_is_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cost = measured(monkeypatch, tmp_path)
    keys = {*cost, *cost["machine"], *cost["keypoints"], *cost["pictures"][0]}
    for jobs in (cost["profiles"], cost["processes"], cost["length"], cost["cameras"], *cost["keypoints"].values()):
        keys |= {key for job in jobs for key in job}
    text = (Path(__file__).parents[4] / "docs/lab/benchmarks.md").read_text(encoding="utf-8")
    assert [key for key in sorted(keys) if f"`{key}`" not in text] == []
