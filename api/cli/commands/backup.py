"""`multicap backup`: create, restore and verify backups of a service."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from api.cli.console import EXIT_BAD_INPUT, EXIT_FAILED, DataOption, JsonOption, byte_bar, console, emit, shows_help
from pipeline.core.problems.finding_codes import BACKUP_FAILED, BAD_USAGE
from pipeline.core.problems.request_codes import DATABASE_DAMAGED

if not shows_help():
    from api.cli.store import settings_in
    from api.web.settings import Settings
    from worker.store.backup.archive import BackupError, BackupUsageError
    from worker.store.backup.contents import BackupReport
    from worker.store.backup.create import create_backup
    from worker.store.backup.restore import restore_backup, verify_backup
    from worker.store.errors import DamagedDatabase, UnknownSchema

app = typer.Typer(help="Backups of the service: create, restore, verify.", no_args_is_help=True)
Archive = Annotated[Path, typer.Argument(metavar="FILE", help="Backup file.")]

# Largest number of listed problems; --json lists all.
_MAX_LINES = 20


@app.command()
def create(
    archive: Annotated[Path, typer.Argument(metavar="FILE", help="New backup file; it must not exist.")],
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Back up a service, which may be running."""
    settings = settings_in(data)
    with _reported(as_json), byte_bar("Backing up", visible=not as_json) as on_progress:
        report = create_backup(
            settings.data_dir, settings.resolved_database_url, settings.artifacts_url, archive, on_progress
        )
    _finish(report, f"Backed up to {archive}:", archive, as_json)


@app.command()
def restore(
    archive: Archive,
    data: Annotated[Path, typer.Option(help="Data folder of the restored service: new or empty.")],
    as_json: JsonOption = False,
) -> None:
    """Restore a service from a backup, into a new folder and, with MULTICAP_DATABASE_URL, an empty database."""
    settings = Settings(data_dir=data)
    with _reported(as_json), byte_bar("Restoring", visible=not as_json) as on_progress:
        report = restore_backup(
            archive, settings.data_dir, settings.resolved_database_url, settings.artifacts_url, on_progress
        )
    _finish(report, f"Restored to {data}:", archive, as_json)


@app.command()
def verify(archive: Archive, as_json: JsonOption = False) -> None:
    """Check a whole backup as `restore` does, without restoring it."""
    with _reported(as_json), byte_bar("Verifying", visible=not as_json) as on_progress:
        report = verify_backup(archive, on_progress)
    _finish(report, f"{archive} is damaged:" if report.faults else f"{archive} is whole:", archive, as_json)


@contextlib.contextmanager
def _reported(as_json: bool) -> Iterator[None]:
    """Report errors as sentences or JSON, with the documented exit codes."""
    try:
        yield
    except (BackupError, DamagedDatabase, UnknownSchema) as error:
        code, faults = _code_and_faults(error)
        is_usage = isinstance(error, BackupUsageError)
        if as_json:
            emit({"problems": [{"code": code, "message": fault} for fault in faults]})
        else:
            _list("error", "bold red", faults)
        raise typer.Exit(EXIT_BAD_INPUT if is_usage else EXIT_FAILED) from error


def _code_and_faults(error: "BackupError | DamagedDatabase | UnknownSchema") -> tuple[str, tuple[str, ...]]:
    match error:
        case BackupUsageError():
            return BAD_USAGE, error.faults
        case BackupError():
            return BACKUP_FAILED, error.faults
        case DamagedDatabase():
            return DATABASE_DAMAGED, (f"{error}\n{error.instructions()}",)
        case _:
            return BACKUP_FAILED, (str(error),)


def _finish(report: "BackupReport", sentence: str, archive: Path, as_json: bool) -> None:
    """Report the contents of a backup; exit with 1 if it has faults or lacks files."""
    if as_json:
        emit(
            {
                "path": str(archive),
                "archive_bytes": report.archive_bytes,
                **report.manifest.model_dump(mode="json"),
                "faults": list(report.faults),
                "file_problems": [problem.model_dump() for problem in report.problems],
            }
        )
    else:
        _describe(report, sentence)
    if report.faults or report.lost:
        raise typer.Exit(EXIT_FAILED)


def _describe(report: "BackupReport", sentence: str) -> None:
    manifest = report.manifest
    jobs = ", ".join(f"{number} {state}" for state, number in manifest.rows.jobs.items())
    console.print(
        f"{sentence} {manifest.rows.sessions} sessions, {sum(manifest.rows.jobs.values())} jobs"
        f"{f' ({jobs})' if jobs else ''}, {manifest.rows.uploads} uploads, {manifest.files} files, "
        f"{report.archive_bytes / 1e6:,.1f} MB; state of {manifest.created_at:%Y-%m-%d %H:%M:%S} UTC, "
        f"Multicap {manifest.multicap_version}.",
        markup=False,
        soft_wrap=True,
    )
    if manifest.artifacts_url:
        sentence = (
            f"Artifacts are not in the backup: they stay in {manifest.artifacts_url}. Use the bucket's versioning."
        )
        console.print(sentence, markup=False, soft_wrap=True)
    _list("error", "bold red", report.faults)
    _list("warning", "yellow", [f"{lost.path} is {lost.problem}: it can't be restored." for lost in report.lost])
    others = [problem for problem in report.problems if not problem.needed]
    _list("note", "dim", [f"{other.path} is {other.problem}; it is made or sent again." for other in others])


def _list(label: str, style: str, sentences: tuple[str, ...] | list[str]) -> None:
    for sentence in sentences[:_MAX_LINES]:
        console.print(Text.assemble((f"{label} ", style), sentence), soft_wrap=True)
    if len(sentences) > _MAX_LINES:
        console.print(Text.assemble((f"{label} ", style), f"{len(sentences) - _MAX_LINES} more; --json lists all."))
