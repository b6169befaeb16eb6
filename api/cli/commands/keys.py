"""`multicap keys`: create, list and revoke the API keys of a service."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated

import typer

from api.cli import console as terminal
from worker.store.model.rights import DEFAULT_TENANT, Key, Scope

if not terminal.shows_help():
    from api.cli.store import opened_store, settings_in, store_in
    from worker.store.errors import NotFound
    from worker.store.files.disk import DiskSpace

app = typer.Typer(help="API keys of the service: create, list, revoke.", no_args_is_help=True)

_DAY_S = 86_400.0
_FIELDS = ("id", "tenant", "name", "scopes", "created_at", "expires_at", "revoked_at")


@app.command()
def create(
    name: Annotated[str, typer.Argument(help="Name of the key for people, such as its user.")],
    tenant: Annotated[
        str,
        typer.Option(
            help="Tenant whose sessions and jobs the key sees; sessions created without a key belong to `default`."
        ),
    ] = (DEFAULT_TENANT),
    scope: Annotated[list[Scope], typer.Option(help="Scope of the key; repeat the option for several scopes.")] = [  # noqa: B006
        Scope.READ,
        Scope.WRITE,
    ],
    days: Annotated[
        float | None,
        typer.Option(min=1 / 1440, help="Days until the key expires; without it the key is valid until it is revoked."),
    ] = None,
    data: terminal.DataOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Create a key and print it; it can't be read again. After the first key every request needs one."""
    if not (0 < len(name) <= 200 and 0 < len(tenant) <= 64):
        raise terminal.refusal("A key's name has 1 to 200 characters, a tenant's name 1 to 64. Choose other names.")
    with store_in(data) as store:
        key, secret = store.keys.add(tenant, name, set(scope), None if days is None else days * _DAY_S)
    sentence = f"Key {key.id} of {key.tenant}. Store it; it is not shown again:"
    terminal.show_secret(secret, sentence, terminal.document(key, _FIELDS) | {"key": secret}, as_json)


@app.command("list")
def list_(data: terminal.DataOption = None, as_json: terminal.JsonOption = False) -> None:
    """List all keys, without their secrets."""
    with store_in(data) as store:
        keys = store.keys.all()
    now = datetime.now(UTC)
    cells: dict[str, Callable[[Key], str]] = {
        "id": lambda key: key.id,
        "tenant": lambda key: key.tenant,
        "name": lambda key: key.name,
        "scopes": lambda key: " ".join(sorted(key.scopes)),
        "until": lambda key: _until(key, now),
    }
    terminal.show_list("keys", keys, _FIELDS, cells, as_json)


def _until(key: Key, now: datetime) -> str:
    """End of a key's validity in words."""
    if key.revoked_at is not None:
        return f"revoked {terminal.shown_time(key.revoked_at)}"
    if key.expires_at is None:
        return "no end"
    return f"{'expired ' if key.expires_at <= now else ''}{terminal.shown_time(key.expires_at)}"


@app.command()
def revoke(
    key_id: Annotated[str, typer.Argument(metavar="ID", help="ID of the key, from `multicap keys list`.")],
    data: terminal.DataOption = None,
) -> None:
    """Revoke a key at once and forever."""
    settings = settings_in(data)
    with opened_store(settings) as store:
        try:
            # A leaked key must be revocable even if the disk is full.
            key = DiskSpace(settings.data_dir).using_reserve(lambda: store.keys.revoke(key_id))
        except NotFound:
            raise terminal.refusal("There is no such key. `multicap keys list` lists all keys.") from None
    terminal.console.print(f"Key {key.id} ({key.name}) is revoked.")
