"""What the command line says: to a person on stderr by rich, to a program as one JSON object on stdout."""

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBars
from rich.table import Table
from rich.text import Text

from pipeline.errors import InputError, PipelineError
from pipeline.progress import Progress

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2

console = Console(stderr=True, highlight=False)

_LABELS = {
    "detect": "Detect 2D joints",
    "lengths": "Measure bones",
    "poses": "Find people",
    "associate": "Track people",
    "fit": "Fit skeletons",
    "export": "Write files",
}


def emit(value: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout."""
    sys.stdout.write(json.dumps(value, allow_nan=False, ensure_ascii=False) + "\n")


def show_sizes(sizes: Sequence[Mapping[str, Any]], as_json: bool) -> None:
    """Print what was measured at each size, a column a key."""
    if as_json:
        emit({"sizes": sizes})
        return
    table = Table(*(name.replace("_", " ") for name in sizes[0]))
    for size in sizes:
        table.add_row(*(f"{value:.4g}" for value in size.values()))
    console.print(table)


@contextmanager
def reporting(as_json: bool) -> Iterator[None]:
    """Turn errors of the pipeline into clear words and the documented exit codes.

    Bad input lists its problems, one a line or as ``{"problems": [...]}``.
    """
    try:
        yield
    except InputError as error:
        if as_json:
            emit({"problems": [asdict(problem) for problem in error.problems]})
        else:
            for problem in error.problems:
                console.print(Text.assemble(("error ", "bold red"), str(problem)))
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except PipelineError as error:
        if as_json:
            emit({"problems": [{"code": error.code, "message": str(error)}]})
        else:
            console.print(Text.assemble(("error ", "bold red"), str(error)))
        raise typer.Exit(EXIT_FAILED) from error


class StageBars:
    """Progress bars by stage, with frames a second and the time left; keeps each stage's seconds."""

    def __init__(self, visible: bool) -> None:
        self._bars = ProgressBars(
            TextColumn("{task.description:<18}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not visible,
        )
        self._tasks: dict[str, TaskID] = {}
        self._started_s: dict[str, float] = {}
        self.seconds: dict[str, float] = {}

    def __enter__(self) -> "StageBars":
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def update_job(self, job: Mapping[str, Any]) -> None:
        """Take in a job of the service as it is now."""
        for stage in job["stages"]:
            if stage["started_at"]:
                self.update(Progress(stage["name"], stage["done"], stage["total"]))

    def update(self, progress: Progress) -> None:
        """Take in a step of ``pipeline.run.reconstruct``."""
        now_s = time.monotonic()
        if progress.stage not in self._tasks:
            self._started_s[progress.stage] = now_s
            self._tasks[progress.stage] = self._bars.add_task(_LABELS[progress.stage], total=progress.total, rate="")
        elapsed_s = now_s - self._started_s[progress.stage]
        self.seconds[progress.stage] = elapsed_s
        rate = f"{progress.done / elapsed_s:.1f} frames/s" if progress.stage == "detect" and elapsed_s > 1 else ""
        self._bars.update(self._tasks[progress.stage], completed=progress.done, rate=rate)


def refusal(sentence: str) -> typer.Exit:
    """Say what is wrong and what to do; raise what is returned."""
    console.print(Text.assemble(("error ", "bold red"), sentence), soft_wrap=True)
    return typer.Exit(EXIT_BAD_INPUT)
