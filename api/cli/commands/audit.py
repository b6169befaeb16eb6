"""`multicap audit`: the audit trail of a service."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.console import JsonOption, show_list, shows_help
from worker.store.model.rights import AuditEvent

if not shows_help():
    from api.cli.store import store_in


def command(
    tenant: Annotated[str | None, typer.Option(help="Entries of one tenant; without it of all tenants.")] = None,
    limit: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Largest number of entries; the last ones are listed.")
    ] = 100,
    data: Annotated[Path | None, typer.Option(help="Data folder of the service, as for `serve`.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List creations, changes and deletions in the service with their tenant and key, the latest first."""
    with store_in(data) as store:
        events = store.audit.events(tenant, limit)
        names = {key.id: key.name for key in store.keys.all()}

    def key_name(event: AuditEvent) -> str:
        return names.get(event.actor.key_id, event.actor.key_id) if event.actor.key_id else ""

    cells: dict[str, Callable[[AuditEvent], str]] = {
        "when": lambda event: f"{event.done_at:%Y-%m-%d %H:%M:%S} UTC",
        "tenant": lambda event: event.tenant,
        "key": key_name,
        "did": lambda event: event.act,
        "to": lambda event: event.subject,
    }
    show_list("events", events, _document, cells, as_json)


def _document(event: AuditEvent) -> dict[str, Any]:
    return {
        "done_at": event.done_at.isoformat(),
        "tenant": event.tenant,
        "key_id": event.actor.key_id,
        "request_id": event.actor.request_id,
        "act": event.act,
        "subject": event.subject,
    }
