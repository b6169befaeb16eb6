"""`multicap webhooks`: rotate the signing secret of a tenant, and list undelivered messages."""

from collections.abc import Callable, Mapping
from typing import Annotated

import typer

from api.cli.console import DataOption, JsonOption, refusal, show_list, show_secret, shown_time, shows_help
from worker.store.model.job_records import Delivery
from worker.store.model.rights import DEFAULT_TENANT

if not shows_help():
    from api.cli.store import store_in

app = typer.Typer(help="Webhooks of the service: secrets and undelivered messages.", no_args_is_help=True)
Tenant = Annotated[str, typer.Option(help="Tenant whose webhooks the secret signs.")]

_HOUR_S = 3600.0
_CELLS: Mapping[str, Callable[[Delivery], str]] = {
    "job": lambda delivery: delivery.job_id,
    "tenant": lambda delivery: delivery.tenant,
    "to": lambda delivery: delivery.url,
    "tries": lambda delivery: str(delivery.tries),
    "next": lambda delivery: shown_time(delivery.due_at),
    "problem": lambda delivery: delivery.problem or "",
}
_FIELDS = ("message_id", "job_id", "tenant", "url", "due_at", "tries", "problem")


@app.command()
def rotate(
    tenant: Tenant = DEFAULT_TENANT,
    keep_hours: Annotated[
        float, typer.Option(min=0, max=720, help="Hours for which the previous secret still signs, too.")
    ] = 24.0,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Create and print a new secret that signs a tenant's webhooks."""
    if not 0 < len(tenant) <= 64:
        raise refusal("A tenant's name has 1 to 64 characters. Choose another.")
    with store_in(data) as store:
        secret = store.webhook_secrets.rotate(tenant, keep_hours * _HOUR_S)
    sentence = f"Secret of {tenant}, with which receivers verify its webhooks:"
    show_secret(secret, sentence, {"tenant": tenant, "secret": secret}, as_json)


@app.command("list")
def list_(data: DataOption = None, as_json: JsonOption = False) -> None:
    """List undelivered messages, the oldest first."""
    with store_in(data) as store:
        deliveries = store.webhooks.pending()
    show_list("deliveries", deliveries, _FIELDS, _CELLS, as_json)
