"""Output of the command line.

A command's product goes to stdout: tables and figures for a person, or one JSON object for a program. Progress,
warnings and errors go to stderr.
"""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as ProgressBars
from rich.text import Text

from pipeline.capture.preflight_record import LayoutRead
from pipeline.core.errors import InputError, PipelineError, SessionRefused
from pipeline.core.findings import Finding, worst_first
from pipeline.core.problems.finding_codes import INTERRUPTED, MEMORY_LIMIT
from pipeline.core.progress import Progress
from pipeline.run.engine.plan import STAGE_BY_NAME

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2

_NO_MEMORY = "There is not enough memory for this. Close other programs, or take fewer frames or cameras at once."

DataOption = Annotated[Path | None, typer.Option("--data", help="Data folder of the service, as for `serve`.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]

Item = TypeVar("Item")

console = Console(stderr=True, highlight=False, markup=False, emoji=False)


def shows_help() -> bool:
    """Return whether this process shows the help of a command, or completes its words for a shell, and runs none.

    Modules of commands then leave out the libraries that take a second to load; declarations of options need none.
    """
    *words, last = sys.argv
    is_help = last == "--help" and "--" not in words and not words[-1].startswith("-")
    return is_help or "_MULTICAP_COMPLETE" in os.environ


def emit(value: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout."""
    sys.stdout.write(json.dumps(value, allow_nan=False, ensure_ascii=False) + "\n")


def show_sizes(sizes: Sequence[Mapping[str, Any]], as_json: bool) -> None:
    """Print what was measured at each size, a column a key."""
    if as_json:
        emit({"sizes": sizes})
        return
    columns = [name.replace("_", " ") for name in sizes[0]]
    print_table(columns, ([f"{value:.4g}" for value in size.values()] for size in sizes))


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], title: str = "") -> None:
    """Print a table on stdout, a line a row, columns two spaces apart; nothing is cut or wrapped.

    Names come from clients: characters that a terminal would obey are shown as escapes. An empty cell is a dash.
    """
    lines = [[_visible(cell) or "-" for cell in row] for row in (columns, *rows)]
    widths = [max(map(cell_len, column)) for column in zip(*lines, strict=True)]
    if title:
        typer.echo(f"\n{title}")
    for number, line in enumerate(lines):
        text = "  ".join(cell + " " * (width - cell_len(cell)) for cell, width in zip(line, widths, strict=True))
        typer.echo(typer.style(text.rstrip(), bold=True) if number == 0 else text.rstrip())


def document(item: object, names: Sequence[str]) -> dict[str, Any]:
    """JSON object of some attributes of a record."""
    return {name: _plain(getattr(item, name)) for name in names}


def _plain(value: Any) -> Any:
    if isinstance(value, datetime):
        return value.isoformat()
    return sorted(value) if isinstance(value, frozenset) else value


def show_list(
    name: str, items: Sequence[Item], names: Sequence[str], cells: Mapping[str, Callable[[Item], str]], as_json: bool
) -> None:
    """Print items as a table, or as one JSON object.

    ``name`` is the field of the JSON object, ``names`` are the fields of an item; ``cells`` make its cells, by heading.
    """
    if as_json:
        emit({name: [document(item, names) for item in items]})
        return
    print_table(list(cells), ([cell(item) for cell in cells.values()] for item in items))


def show_secret(secret: str, sentence: str, document: Mapping[str, Any], as_json: bool) -> None:
    """Print a new secret on stdout, and on stderr a sentence about it; or the JSON object that contains the secret."""
    if as_json:
        emit(document)
        return
    console.print(sentence)
    typer.echo(secret)


def _visible(text: str) -> str:
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def shown_time(moment: datetime) -> str:
    """A time as people read it, in UTC."""
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def warn(sentence: str) -> None:
    """Print a warning on stderr."""
    console.print(Text.assemble(("warning ", "yellow"), sentence), soft_wrap=True)


def show_session(findings: Sequence[Finding], layout: LayoutRead | None) -> None:
    """Print the findings of a session as warnings, and the layout of its keypoints; see ``show_layout``."""
    for finding in findings:
        warn(finding.message)
    show_layout(findings, layout)


def show_layout(findings: Iterable[Finding], layout: LayoutRead | None) -> None:
    """Print the layout in which keypoints were read, unless a finding states it."""
    if layout is not None and all(finding.message != str(layout) for finding in findings):
        console.print(str(layout), soft_wrap=True)


def _print_error(sentence: str) -> None:
    console.print(Text.assemble(("error ", "bold red"), sentence), soft_wrap=True)


def show_findings(findings: Sequence[Finding], all_is_well: str) -> None:
    """Print the findings of a check, errors first, or the sentence that nothing was found."""
    for finding in worst_first(findings):
        (_print_error if finding.severity == "error" else warn)(str(finding))
    if not findings:
        console.print(all_is_well)


class _Interruption(KeyboardInterrupt):
    """SIGINT or SIGTERM."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def _interruptible() -> Iterator[None]:
    """Raise ``_Interruption`` at SIGINT and SIGTERM, once: nothing interrupts the cleaning up."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, _: object) -> None:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)
        raise _Interruption(number)

    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is interrupt:
                signal.signal(number, handler)


@contextmanager
def reporting(as_json: bool, what_is_left: Callable[[], str] = str) -> Iterator[None]:
    """Turn errors of the pipeline, and interruptions, into clear words and the documented exit codes.

    Bad input lists its problems, one a line or as ``{"problems": [...]}``. ``what_is_left`` says after an interruption
    what the command has left on disk, in a sentence.
    """
    try:
        with _interruptible():
            yield
    except _Interruption as error:
        sentence = f"Interrupted by {signal.Signals(error.number).name}. {what_is_left()}".strip()
        if as_json:
            emit({"problems": [{"code": INTERRUPTED, "message": sentence}]})
        else:
            _print_error(sentence)
        raise typer.Exit(128 + error.number) from error
    except InputError as error:
        if as_json:
            emit({"problems": [asdict(problem) for problem in error.problems]})
        else:
            for problem in error.problems:
                _print_error(str(problem))
            if isinstance(error, SessionRefused):
                console.print(error.advice)
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except (PipelineError, MemoryError) as error:
        code, sentence = (error.code, str(error)) if isinstance(error, PipelineError) else (MEMORY_LIMIT, _NO_MEMORY)
        if as_json:
            emit({"problems": [{"code": code, "message": sentence}]})
        else:
            _print_error(sentence)
        raise typer.Exit(EXIT_FAILED) from error


@contextmanager
def writing(name: object) -> Iterator[None]:
    """Turn an error of the disk into a ``PipelineError`` that says what can't be written, a file or folder, and why."""
    try:
        yield
    except OSError as error:
        raise PipelineError(f"{name} can't be written: {error.strerror or error}.") from error


def require_writable(*files: Path | None) -> None:
    """Raise ``PipelineError`` for a file that can't be written, before the work for it; its folder is made.

    ``None``: a file that was not asked for.
    """
    for file in filter(None, files):
        is_new = not os.path.lexists(file)
        with writing(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.open("ab").close()
            if is_new:
                file.unlink()


@contextmanager
def byte_bar(label: str, visible: bool) -> Iterator[Callable[[int, int], None]]:
    """A progress bar of bytes, until the end of the block; to be told how many are done, of how many."""
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    with ProgressBars(*columns, console=console, disable=not visible) as bars:
        task = bars.add_task(label, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


class StageBars:
    """Progress bars by stage, with frames a second and the time left.

    ``seconds`` holds the time of each stage, ``reused`` the units of each stage whose outputs an earlier run has left.
    """

    def __init__(self, visible: bool) -> None:
        self._bars = ProgressBars(
            TextColumn("{task.description:<18}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            auto_refresh=console.is_terminal,  # to a file only the last state is written
            disable=not visible,
        )
        self._tasks: dict[str, TaskID] = {}
        self._started_s: dict[str, float] = {}
        self.seconds: dict[str, float] = {}
        self.reused: dict[str, str] = {}

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
        """Take in a step of ``pipeline.run.engine.local.reconstruct``."""
        now_s = time.monotonic()
        stage = STAGE_BY_NAME[progress.stage]
        if progress.stage not in self._tasks:
            self._started_s[progress.stage] = now_s
            self._tasks[progress.stage] = self._bars.add_task(stage.label, total=progress.total, rate="")
        elapsed_s = now_s - self._started_s[progress.stage]
        self.seconds[progress.stage] = elapsed_s
        if progress.reused:
            self.reused[progress.stage] = f"{progress.reused} of {progress.total} {stage.unit}"
        num_new = progress.done - progress.reused
        rate = f"{num_new / elapsed_s:.1f} frames/s" if stage.unit == "frames" and num_new and elapsed_s > 1 else ""
        self._bars.update(self._tasks[progress.stage], completed=progress.done, rate=rate)


def refusal(sentence: str) -> typer.Exit:
    """Say what is wrong and what to do; raise what is returned."""
    _print_error(sentence)
    return typer.Exit(EXIT_BAD_INPUT)
