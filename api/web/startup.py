"""Reasons for which a service does not start: no keys where other machines reach it, a database that can't be used."""

import shlex

from api.web.settings import Settings
from worker.store.errors import DamagedDatabase
from worker.store.files.artifacts import default_data_dir
from worker.store.files.disk import is_disk_full
from worker.store.store import JobStore


class ExposedError(Exception):
    """The service can be reached from other machines and has no keys; the text states the remedy."""


def require_keys_if_exposed(settings: Settings, store: JobStore) -> None:
    """Raise ``ExposedError`` if other machines can reach the service and it has no keys."""
    if settings.is_exposed and not store.keys.exist():
        data = "" if settings.data_dir == default_data_dir() else f" --data {shlex.quote(str(settings.data_dir))}"
        raise ExposedError(
            f"{settings.host} can be reached from other machines, and there are no keys: anyone could use the "
            f"service. Create a key with `multicap keys create NAME{data}`, or listen on 127.0.0.1."
        )


def unusable_database(settings: Settings, error: Exception) -> str:
    """Message for the operator when the database can't be opened or written."""
    if isinstance(error, DamagedDatabase):
        return f"{error}\n{error.instructions()}"
    if is_disk_full(error):
        return f"The disk of the folder {settings.data_dir} is full. Free space on it, then try again."
    where = "MULTICAP_DATABASE_URL" if settings.database_url else f"the folder {settings.data_dir}"
    return f"The database can't be used. Check that it runs and that {where} is right."
