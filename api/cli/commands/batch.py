"""`multicap batch`: many takes of one rig, one after the other; a run that was ended continues where it was."""

import contextlib
import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli import options
from api.cli.console import EXIT_FAILED, JsonOption, StageBars, console, emit, print_table, reporting, shows_help
from pipeline.core.errors import InputError, PipelineError, SessionRefused
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import Units, Up

if not shows_help():
    from api.cli.takes import TakeSource, find_takes
    from pipeline.export.person_files import replacing
    from pipeline.export.quality.report import all_checks
    from pipeline.export.results import not_written
    from pipeline.run.engine.local import reconstruct_to_files

_TABLE = "batch.csv"
# Kept in the folder of a take's results: what they were made of, and the take's row of the table.
_RECORD = ".batch.json"
_COLUMNS = ("take", "state", "people", "frames", "rate_hz", "reprojection_error_px", "warnings", "message")


@dataclass(frozen=True, slots=True)
class _Choices:
    """Choices that all takes have in common."""

    config: ReconstructionConfig
    typed: Mapping[str, Any]  # Options as they were typed
    units: Units | None
    up: Up
    pair_by_order: bool
    layout: str | None
    cache: Path | None

    def fingerprint(self, take: "TakeSource") -> str:
        """Digest of the files of a take and of all choices."""
        typed = {name: value for name, value in self.typed.items() if name != "processes"}
        facts = [take.fingerprint(), typed, self.units, self.up, self.pair_by_order, self.layout]
        return sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


@options.with_choices()
def command(
    *,
    source: Annotated[
        Path,
        typer.Argument(metavar="FOLDER|LIST", help="Folder with a folder for each take, or a JSON list of takes."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results, a folder a take; made if it is missing.")],
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file of all takes that have none of their own.", show_default=False)
    ] = None,
    units: options.UnitsOption = None,
    up: options.UpOption = "z",
    pair_by_order: options.PairByOrderOption = False,
    frame_rate: options.KeypointRateOption = None,
    layout: options.LayoutOption = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """Reconstruct many takes; a failure does not stop the rest. Run the command again to go on after an interruption.

    A take whose files and choices equal the ones of its results is kept.
    """
    rows: list[dict[str, Any]] = []
    with reporting(
        as_json, lambda: f"{len(rows)} takes are finished. Run the command again: it continues with the rest."
    ):
        config = options.checked(chosen)
        takes = find_takes(source, out, calibration, frame_rate)
        in_world = options.known_units(units), options.known_up(up)
        choices = _Choices(config, chosen, *in_world, pair_by_order, layout, options.users_cache())
        try:
            for number, take in enumerate(takes, 1):
                if not as_json:
                    console.print(f"Take {number} of {len(takes)}: {take.name}")
                rows.append(_row(take, choices, out / take.name, show_bars=not as_json))
                with replacing(out / _TABLE, [_table(rows)]):
                    pass
        except OSError as error:
            raise not_written(out, error) from error
    if as_json:
        emit({"takes": rows})
    else:
        print_table(_COLUMNS, ([_shown(row[column]) for column in _COLUMNS] for row in rows))
        typer.echo(f"  {out / _TABLE}")
    if any(row["state"] == "failed" for row in rows):
        raise typer.Exit(EXIT_FAILED)


def _row(take: "TakeSource", choices: _Choices, folder: Path, *, show_bars: bool) -> dict[str, Any]:
    """Row of a take, which is reconstructed unless its results are there."""
    fingerprint, record = choices.fingerprint(take), folder / _RECORD
    kept = _kept(record, fingerprint)
    if kept is not None:
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    record.unlink(missing_ok=True)
    try:
        session = take.open(choices.units, choices.pair_by_order, choices.up, choices.layout)
        with StageBars(visible=show_bars) as bars:
            sources = [path for path in (take.calibration, take.timestamps) if path is not None]
            written = reconstruct_to_files(
                session, folder, choices.config, bars.update, choices.cache, take.name, sources
            )
    except PipelineError as error:
        with contextlib.suppress(OSError):  # files of an earlier run are in it
            folder.rmdir()
        advice = [error.advice] if isinstance(error, SessionRefused) else []
        told = error.problems if isinstance(error, InputError) else [error]
        return _failed(take, "; ".join([*map(str, told), *advice]))
    metrics = written.metrics
    row = {
        "take": take.name,
        "state": "done",
        "people": len(metrics["people"]),
        "frames": metrics["num_frames"],
        "rate_hz": metrics["frame_rate_hz"],
        "reprojection_error_px": metrics["reprojection_error_px"]["median"],
        "warnings": len(list(all_checks(metrics))) + len(session.findings),
        "message": "",
    }
    files = [path.name for path in written.paths]
    with replacing(record, [json.dumps({"fingerprint": fingerprint, "files": files, "row": row}).encode()]):
        pass
    return row


def _kept(record: Path, fingerprint: str) -> dict[str, Any] | None:
    """Row of a take whose results are there; ``None`` if they are not, or are of other files or choices."""
    try:
        document = json.loads(record.read_bytes())
        is_same = document["fingerprint"] == fingerprint
        row: dict[str, Any] = document["row"]
        is_whole = all((record.parent / name).is_file() for name in document["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return row if is_same and is_whole else None


def _failed(take: "TakeSource", message: str) -> dict[str, Any]:
    return dict.fromkeys(_COLUMNS) | {"take": take.name, "state": "failed", "message": message}


def _table(rows: Sequence[Mapping[str, Any]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _shown(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
