"""Records of a tenant: one repository for each resource that belongs to tenants, and transactions over several."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace

from worker.store.database.access import Access, OpenTransaction
from worker.store.database.quotas import NO_QUOTAS, read_usage, require_room
from worker.store.model.rights import Usage
from worker.store.repositories.arrivals import Arrivals
from worker.store.repositories.calibrations import Calibrations
from worker.store.repositories.characters import Characters
from worker.store.repositories.idempotency_keys import IdempotencyKeys
from worker.store.repositories.jobs import Jobs, Results
from worker.store.repositories.links import Links
from worker.store.repositories.recordings import Recordings
from worker.store.repositories.sessions import Edits, Sessions
from worker.store.repositories.uploads import Uploads
from worker.store.repositories.visuals import Visuals
from worker.store.repositories.webhooks import read_secrets


class Records:
    """One repository for each resource that belongs to tenants. Every method of a repository is one transaction."""

    def __init__(self, access: Access) -> None:
        self.sessions = Sessions(access)
        self.arrivals = Arrivals(access)
        self.calibrations = Calibrations(access)
        self.characters = Characters(access)
        self.edits = Edits(access)
        self.jobs = Jobs(access)
        self.visuals = Visuals(access)
        self.results = Results(access)
        self.uploads = Uploads(access)
        self.idempotency_keys = IdempotencyKeys(access)
        self.links = Links(access)
        self.recordings = Recordings(access)


class TenantRecords(Records):
    """Records of one tenant; records of other tenants are treated as unknown.

    Methods of repositories share one transaction inside ``transaction``.
    """

    def __init__(self, access: Access) -> None:
        super().__init__(access)
        self._access = access

    @contextlib.contextmanager
    def transaction(self) -> Iterator["TenantRecords"]:
        """Do several things in one transaction: all of them happen, or none if the block raises.

        The block gets the same records. It must neither wait for a client nor touch files: in SQLite, other writers
        wait for its end.
        """
        with self._access.writing() as connection:
            yield TenantRecords(replace(self._access, transactions=OpenTransaction(connection)))

    def usage(self) -> Usage:
        """Amounts that the tenant has of what quotas limit."""
        with self._access.reading() as connection:
            return read_usage(connection, self._access.owner)

    def require_room(self, num_bytes: int, unfinished_jobs: int = 0) -> None:
        """Raise ``QuotaExceeded`` if a session of so many bytes would exceed a quota; before its files are sent."""
        if self._access.quotas == NO_QUOTAS:
            return
        more = {"sessions": 1, "stored_bytes": num_bytes, "unfinished_jobs": unfinished_jobs}
        require_room(self._access.quotas, self.usage(), **more)

    def has_webhook_secret(self) -> bool:
        """True if messages to the tenant can be signed."""
        with self._access.reading() as connection:
            return bool(read_secrets(connection, self._access.owner))
