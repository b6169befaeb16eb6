"""`multicap doctor`: look for what is wrong with a service, and remove files that belong to nothing."""

from typing import Annotated

import typer

from api.cli.console import DataOption, JsonOption, emit, shows_help

if not shows_help():
    from api.cli.store import opened_store, settings_in
    from worker.store.files.artifacts import open_artifacts
    from worker.store.files.disk import DiskSpace
    from worker.store.repositories.work.expiry import orphaned_prefixes

_GIB = 2**30


def command(
    data: DataOption = None,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the files that belong to nothing.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Look for what is wrong with a service: database, disk, artifact store, files that belong to nothing.

    After a restore of an older backup the files of later sessions have no rows. They are removed with --remove alone,
    because a later backup may still know them. The exit code is 1 if something is wrong.
    """
    settings = settings_in(data)
    with opened_store(settings) as store:
        artifacts = open_artifacts(settings.artifacts_url, settings.data_dir)
        disk = DiskSpace(settings.data_dir, settings.headroom_bytes)
        checks = {"database": store.ping(), "artifacts": artifacts.ping(), "disk": disk.has_room()}
        orphans = orphaned_prefixes(store.removals, artifacts) if checks["artifacts"] else []
        if remove and orphans:
            disk.using_reserve(lambda: store.removals.add(orphans))
    if as_json:
        emit({"checks": checks, "orphans": orphans, "removed": remove, "disk_free_bytes": disk.free_bytes})
    else:
        for name, is_good in checks.items():
            typer.echo(f"{name}: {'ok' if is_good else 'not usable'}")
        typer.echo(f"free on the disk: {disk.free_bytes / _GIB:.1f} GiB")
        for prefix in orphans:
            typer.echo(f"  {prefix}")
        if orphans:
            done = "The service removes them now." if remove else "Remove them with --remove."
            typer.echo(f"{len(orphans)} folders belong to no session, job or character of the database. {done}")
    if not all(checks.values()) or (orphans and not remove):
        raise typer.Exit(1)
