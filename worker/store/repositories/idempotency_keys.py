"""Idempotency keys: answers to requests that a client may send again because it never saw the answer.

A request claims its key, does its work, and stores the answer in the transaction of the work. So both are there or
neither, whenever a process is killed. A request whose claim ran out in the meantime changes nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, delete, insert, select, update
from uuid_utils import uuid4

from worker.store.database.access import Repository
from worker.store.database.connection import lock, now
from worker.store.database.tables import idempotency_keys
from worker.store.errors import Conflict, KeyBusy, KeyReused

_KEPT_S = 24 * 3600.0


@dataclass(frozen=True, slots=True)
class KeyClaim:
    """Right to store the answer of a key: a lease with a token, like a chunk's."""

    key: str
    token: str


class IdempotencyKeys(Repository):
    """Idempotency keys of a tenant, chosen by its clients. They are forgotten after a day.

    An answer is any JSON object of the caller.
    """

    def claim(self, key: str, fingerprint: str, lease_s: float) -> KeyClaim | Mapping[str, Any]:
        """Claim a key for a request; returns the claim, or the answer that the same request got before.

        ``fingerprint``: digest of the request: another request under the same key is refused. ``lease_s``: time for
        which other requests are refused, unless ``renew`` or ``release`` is called. Raises ``KeyReused``: the key
        belongs to another request. Raises ``KeyBusy``: the same request is at work.
        """
        this_key = self._of(key)
        with self._access.writing() as connection:
            lock(connection, f"idempotency key {self._access.owner} {key}")
            connection.execute(delete(idempotency_keys).where(idempotency_keys.c.expires_at < now()))
            is_free = idempotency_keys.c.claimed_until < now()
            query = select(idempotency_keys, is_free.label("is_free")).where(this_key)
            found = connection.execute(query).one_or_none()
            if found is not None and found.answer is None and found.is_free:
                # The request that claimed the key was killed, and has changed nothing.
                connection.execute(delete(idempotency_keys).where(this_key))
            elif found is not None:
                if found.fingerprint != fingerprint:
                    raise KeyReused("This key was used for another request.")
                if found.answer is None:
                    raise KeyBusy("This very request is being answered.")
                answer: Mapping[str, Any] = found.answer
                return answer
            claim = KeyClaim(key, str(uuid4()))
            connection.execute(
                insert(idempotency_keys).values(
                    tenant=self._access.owner,
                    key=key,
                    fingerprint=fingerprint,
                    token=claim.token,
                    claimed_until=now() + lease_s,
                    expires_at=now() + _KEPT_S,
                )
            )
            return claim

    def is_answered(self, key: str) -> bool:
        """True if a key has an answer."""
        query = select(idempotency_keys.c.key).where(self._of(key), idempotency_keys.c.answer.is_not(None))
        with self._access.reading() as connection:
            return connection.scalar(query) is not None

    def renew(self, claim: KeyClaim, lease_s: float) -> None:
        """Keep a claim for longer."""
        with self._access.writing() as connection:
            claimed = update(idempotency_keys).where(self._claimed(claim))
            connection.execute(claimed.values(claimed_until=now() + lease_s))

    def release(self, claim: KeyClaim) -> None:
        """Give a claim back after a request that failed, so that the request can be sent again."""
        with self._access.writing() as connection:
            connection.execute(delete(idempotency_keys).where(self._claimed(claim)))

    def answer(self, claim: KeyClaim, answer: Mapping[str, Any]) -> None:
        """Store the answer of a claimed key, in the transaction of the work that it reports.

        Raises ``Conflict`` if the claim ran out, and another request may have done the work.
        """
        with self._access.writing() as connection:
            claimed = update(idempotency_keys).where(self._claimed(claim))
            if connection.execute(claimed.values(answer=dict(answer))).rowcount == 0:
                raise Conflict("The request took too long; it was sent again in the meantime.")

    def _of(self, key: str) -> ColumnElement[bool]:
        return (idempotency_keys.c.tenant == self._access.owner) & (idempotency_keys.c.key == key)

    def _claimed(self, claim: KeyClaim) -> ColumnElement[bool]:
        is_open = idempotency_keys.c.answer.is_(None)
        return self._of(claim.key) & (idempotency_keys.c.token == claim.token) & is_open
