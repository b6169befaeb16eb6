"""Receipts: what was answered to a request that a client may send again, because it never saw the answer.

A request claims its key, does its work, and leaves the answer in the transaction of the work: so there are both or
neither, whoever is killed at whatever moment. Whose claim ran out meanwhile does nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update
from uuid_utils import uuid4

from worker.jobs.database.connection import lock, now
from worker.jobs.database.tables import receipts
from worker.jobs.database.tenants import OfTenant
from worker.jobs.errors import Conflict, KeyBusy, KeyReused

_KEPT_S = 24 * 3600.0


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer over HTTP."""

    status: int
    headers: Mapping[str, str]
    body: str


@dataclass(frozen=True, slots=True)
class Claim:
    """The right to answer for a key. ``render`` says what was made: a session, a job, an upload."""

    key: str
    token: str
    render: Callable[[Any], Answer]


class Receipts(OfTenant):
    """A tenant's receipts, by the keys that its clients chose. They go after a day."""

    _claim: Claim | None = None

    def claim_key(self, key: str, fingerprint: str, lease_s: float) -> str | Answer:
        """Claim a key for a request; returns a token, or what was answered to this very request before.

        Parameters
        ----------
        fingerprint
            Of the request: another one under the same key is refused.
        lease_s
            How long others are kept from it, unless ``renew_claim`` or ``release_claim`` is called.

        Raises
        ------
        KeyReused
            The key belongs to another request.
        KeyBusy
            The same request is being answered.
        """
        mine = receipts.c.tenant == self._owner, receipts.c.key == key
        with self._database.writing() as connection:
            lock(connection, f"receipt {self._owner} {key}")
            connection.execute(delete(receipts).where(receipts.c.expires_at < now()))
            free = receipts.c.claimed_until < now()
            query = select(receipts, free.label("is_free")).where(*mine)
            found = connection.execute(query).one_or_none()
            if found is not None and found.status is None and found.is_free:
                # Whoever claimed it was killed, and has left nothing.
                connection.execute(delete(receipts).where(*mine))
            elif found is not None:
                if found.fingerprint != fingerprint:
                    raise KeyReused("This key was used for another request.")
                if found.status is not None:
                    return Answer(found.status, found.headers, found.body)
                raise KeyBusy("This very request is being answered.")
            token = str(uuid4())
            connection.execute(
                insert(receipts).values(
                    tenant=self._owner,
                    key=key,
                    fingerprint=fingerprint,
                    token=token,
                    claimed_until=now() + lease_s,
                    expires_at=now() + _KEPT_S,
                )
            )
            return token

    def has_receipt(self, key: str) -> bool:
        """Whether a key was answered."""
        query = select(receipts.c.key).where(
            receipts.c.tenant == self._owner, receipts.c.key == key, receipts.c.status.is_not(None)
        )
        with self._database.reading() as connection:
            return connection.scalar(query) is not None

    def renew_claim(self, key: str, token: str, lease_s: float) -> None:
        """Keep a claim for longer."""
        with self._database.writing() as connection:
            connection.execute(update(receipts).where(*self._claimed(key, token)).values(claimed_until=now() + lease_s))

    def release_claim(self, key: str, token: str) -> None:
        """Give a claim back: nothing came of it."""
        with self._database.writing() as connection:
            connection.execute(delete(receipts).where(*self._claimed(key, token)))

    def _leave_receipt(self, connection: Connection, made: object) -> None:
        """Keep the answer, in the transaction that makes what it tells of."""
        if self._claim is None:
            return
        answer = self._claim.render(made)
        kept = connection.execute(
            update(receipts)
            .where(*self._claimed(self._claim.key, self._claim.token))
            .values(status=answer.status, headers=dict(answer.headers), body=answer.body)
        )
        if kept.rowcount == 0:
            raise Conflict("The request took too long; it was sent again in the meantime.")

    def _claimed(self, key: str, token: str) -> tuple[Any, ...]:
        unanswered = receipts.c.status.is_(None)
        return receipts.c.tenant == self._owner, receipts.c.key == key, receipts.c.token == token, unanswered
