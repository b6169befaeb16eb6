"""Tables of the costs that `multicap benchmark all` measures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

SCHEMA_VERSION = 1

MINUTE_CAMERA_FRAMES: Mapping[str, int] = {"30": 4 * 60 * 30, "60": 4 * 60 * 60}
"""Frames of a minute of four cameras by frame rate in Hz."""

_MIN_STAGE_MS = 0.01
_Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class CostTable:
    """Table of costs: a title, columns and rows of text."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


def cost_tables(cost: _Row) -> list[CostTable]:
    """Make the tables of a document of `multicap benchmark all --json`."""
    return [
        _minutes(cost["profiles"]),
        _processes(cost["processes"]),
        _stages(cost["profiles"]),
        _jobs(
            "Length of videos",
            {"frames of a camera": lambda job: f"{job['camera_frames'] // job['cameras']}"},
            cost["length"],
        ),
        _jobs(
            "Cameras with videos",
            {"cameras": lambda job: str(job["cameras"])},
            cost["cameras"],
        ),
        _pictures(cost["pictures"]),
        *(
            _jobs(
                f"Simulated keypoints by {name}",
                {
                    "cameras": lambda job: str(job["cameras"]),
                    "people": lambda job: str(job["simulated_people"]),
                    "length": lambda job: f"{job['duration_s']:g} s",
                },
                cost["keypoints"][key],
            )
            for key, name in (("cameras", "cameras"), ("people", "people"), ("duration_s", "length"))
        ),
    ]


def _minutes(jobs: Sequence[_Row]) -> CostTable:
    columns: dict[str, Callable[[_Row], str]] = {
        "profile": lambda job: job["profile"],
        "provider": lambda job: job["provider"],
        **{f"{rate} Hz": _minute(rate) for rate in MINUTE_CAMERA_FRAMES},
        "networks": _share("networks_core_s"),
        "decoding": _share("decoding_core_s"),
        "rest": lambda job: _percent(1 - (job["networks_core_s"] + job["decoding_core_s"]) / job["core_s"]),
        "a further camera frame": lambda job: f"{job['added_camera_frame_core_ms']:.3g} ms",
        "memory": _memory,
    }
    return _table("A minute of four cameras", columns, jobs)


def _processes(jobs: Sequence[_Row]) -> CostTable:
    first = jobs[0]
    columns: dict[str, Callable[[_Row], str]] = {
        "processes": lambda job: str(job["processes"]),
        "seconds": lambda job: _seconds(job["wall_s"]),
        "times as fast": lambda job: f"{first['wall_s'] / job['wall_s']:.2f}",
        "seconds of a core": lambda job: _seconds(job["core_s"]),
        "memory": _memory,
    }
    return _table("Several cores", columns, jobs)


def _stages(jobs: Sequence[_Row]) -> CostTable:
    on_cpu = [job for job in jobs if job["provider"] == "cpu"]
    names = dict.fromkeys(name for job in on_cpu for name in job["stages_core_s"])
    costs = {name: [_stage_ms(job, name) for job in on_cpu] for name in names}
    rows = [
        (name.replace("_", " "), *(f"{ms:.2f}" for ms in of_stage))
        for name, of_stage in costs.items()
        if max(of_stage) >= _MIN_STAGE_MS
    ]
    return CostTable("Stages", ("stage", *(f"`{job['profile']}`" for job in on_cpu)), rows)


def _pictures(rows: Sequence[_Row]) -> CostTable:
    profiles = dict.fromkeys(row["profile"] for row in rows)
    cells = {(row["profile"], row["bodies"]): f"{row['core_ms']:.1f} ({row['pictures']})" for row in rows}
    numbers = sorted({row["bodies"] for row in rows})
    return CostTable(
        "People in a picture",
        ("bodies", *(f"`{profile}`" for profile in profiles)),
        [(str(number), *(cells.get((profile, number), "") for profile in profiles)) for number in numbers],
    )


def _jobs(title: str, sizes: Mapping[str, Callable[[_Row], str]], jobs: Sequence[_Row]) -> CostTable:
    columns = {
        **sizes,
        "seconds of a core": lambda job: _seconds(job["core_s"]),
        "a camera frame": _camera_frame,
        "memory": _memory,
    }
    return _table(title, columns, jobs)


def _table(title: str, columns: Mapping[str, Callable[[_Row], str]], jobs: Iterable[_Row]) -> CostTable:
    return CostTable(title, tuple(columns), [tuple(cell(job) for cell in columns.values()) for job in jobs])


def _minute(rate: str) -> Callable[[_Row], str]:
    return lambda job: f"{job['minute_core_s'][rate]:.0f} s"


def _share(key: str) -> Callable[[_Row], str]:
    return lambda job: _percent(job[key] / job["core_s"])


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _seconds(seconds: float) -> str:
    return f"{seconds:.3g}" if seconds < 100 else f"{seconds:.0f}"


def _camera_frame(job: _Row) -> str:
    return f"{job['camera_frame_core_ms']:.3g} ms"


def _memory(job: _Row) -> str:
    return f"{job['peak_mib']:.0f} MiB"


def _stage_ms(job: _Row, name: str) -> float:
    return 1e3 * float(job["stages_core_s"].get(name, 0.0)) / float(job["camera_frames"])
