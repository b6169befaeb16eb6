"""`multicap audit`: the audit trail of a service."""

from collections.abc import Callable
from typing import Annotated

import typer

from api.cli.console import DataOption, JsonOption, show_list, shows_help
from worker.store.model.rights import AuditEvent

if not shows_help():
    from api.cli.store import store_in


def command(
    tenant: Annotated[str | None, typer.Option(help="Entries of one tenant; without it of all tenants.")] = None,
    limit: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Largest number of entries; the last ones are listed.")
    ] = 100,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """List creations, changes and deletions in the service with their tenant and key, the latest first."""
    with store_in(data) as store:
        events = store.audit.events(tenant, limit)
        names = {key.id: key.name for key in store.keys.all()}

    cells: dict[str, Callable[[AuditEvent], str]] = {
        "when": lambda event: f"{event.done_at:%Y-%m-%d %H:%M:%S} UTC",
        "tenant": lambda event: event.tenant,
        "key": lambda event: names.get(event.key_id or "", event.key_id or ""),
        "did": lambda event: event.act,
        "to": lambda event: event.subject,
    }
    fields = ("done_at", "tenant", "key_id", "request_id", "act", "subject")
    show_list("events", events, fields, cells, as_json)
