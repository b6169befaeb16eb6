"""`multicap audit`: the audit trail of a service."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.console import show_list
from api.cli.store import store_in
from worker.jobs.model import Deed


def command(
    tenant: Annotated[str | None, typer.Option(help="Entries of one tenant; without it of all tenants.")] = None,
    limit: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Largest number of entries; the last ones are listed.")
    ] = 100,
    data: Annotated[Path | None, typer.Option(help="Data folder of the service, as for `serve`.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """List creations, changes and deletions in the service with their tenant and key, the latest first."""
    with store_in(data) as store:
        deeds = store.deeds(tenant, limit)
        names = {key.id: key.name for key in store.list_keys()}

    def name_of(deed: Deed) -> str:
        return names.get(deed.actor.key_id, deed.actor.key_id) if deed.actor.key_id else ""

    cells: dict[str, Callable[[Deed], str]] = {
        "when": lambda deed: f"{deed.done_at:%Y-%m-%d %H:%M:%S} UTC",
        "tenant": lambda deed: deed.tenant,
        "key": name_of,
        "did": lambda deed: deed.act,
        "to": lambda deed: deed.subject,
    }
    show_list("deeds", deeds, _document, cells, as_json)


def _document(deed: Deed) -> dict[str, Any]:
    return {
        "done_at": deed.done_at.isoformat(),
        "tenant": deed.tenant,
        "key_id": deed.actor.key_id,
        "request_id": deed.actor.request_id,
        "act": deed.act,
        "subject": deed.subject,
    }
