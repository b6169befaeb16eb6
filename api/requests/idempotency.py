"""``Idempotency-Key``: a client that never saw the answer sends the request again, and gets the first answer."""

import asyncio
import contextlib
import hashlib
import json
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Annotated, Any

import structlog
from fastapi import Depends, Header, Request, Response
from starlette.concurrency import run_in_threadpool

from api.auth import RecordsDep
from api.dependencies import ServicesDep
from api.errors import ApiError
from worker.jobs.repositories.idempotency_keys import Answer, Claim
from worker.jobs.repositories.records import Records

_log = structlog.get_logger(__name__)

_MAX_KEY_LENGTH = 200


@dataclass(slots=True)
class Once:
    """A request that may come again.

    Parameters
    ----------
    key
        As the client sent it; ``None``: each such request is another one.
    records
        Whose; after ``claim`` they leave the receipt.
    operation
        What is asked for: part of the fingerprint.
    lease_s
        How long the key stays taken if this process is killed; renewed as long as the request is at work.
    """

    key: str | None
    records: Records
    operation: str
    lease_s: float
    _token: str | None = field(default=None, init=False)

    def is_answered(self) -> bool:
        """Whether there is an answer already, to this request or another one under its key."""
        return self.key is not None and self.records.has_receipt(self.key)

    def claim(self, parts: object, render: Callable[[Any], Answer]) -> Response | None:
        """Begin; returns the first answer if there is one.

        Parameters
        ----------
        parts
            JSON of what was sent, as it was understood: how a form was cut into bytes differs from try to try.
        render
            Says what was made.

        Raises
        ------
        KeyReused
        KeyBusy
        """
        if self.key is None:
            return None
        found = self.records.claim_key(self.key, _fingerprint([self.operation, parts]), self.lease_s)
        if isinstance(found, Answer):
            return respond(found, {"Idempotent-Replayed": "true"})
        self._token = found
        self.records = self.records.answering(Claim(self.key, found, render))
        return None

    def give_up(self) -> None:
        """Nothing came of it; the next try begins anew."""
        if self.key is not None and self._token is not None:
            self.records.release_claim(self.key, self._token)

    def run(self, parts: object, act: Callable[[Records], Any], render: Callable[[Any], Answer]) -> Response:
        """Do something quick that ends with one transaction, once."""
        if (before := self.claim(parts, render)) is not None:
            return before
        try:
            return respond(render(act(self.records)))
        except BaseException:
            self.give_up()
            raise

    @contextlib.asynccontextmanager
    async def held(self) -> AsyncIterator[None]:
        """Keep the claim for as long as the block takes, and give it up if that fails."""
        renewing = asyncio.create_task(self._renew_forever())
        try:
            yield
        except BaseException:
            await asyncio.shield(run_in_threadpool(self.give_up))
            raise
        finally:
            renewing.cancel()

    async def _renew_forever(self) -> None:
        while self.key is not None and self._token is not None:
            await asyncio.sleep(self.lease_s / 3)
            try:
                await run_in_threadpool(self.records.renew_claim, self.key, self._token, self.lease_s)
            except Exception:
                # The database may be away for a while.
                _log.exception("idempotency_key_not_renewed")


def respond(answer: Answer, headers: dict[str, str] | None = None) -> Response:
    """Send an answer."""
    media_type = "application/json" if answer.body else None
    return Response(answer.body, answer.status, {**answer.headers, **(headers or {})}, media_type)


def _once(
    request: Request,
    services: ServicesDep,
    records: RecordsDep,
    idempotency_key: Annotated[
        str | None,
        Header(
            description="The client's own name of this request, such as a UUID. The same request under the same key is "
            "done once; for a day it gets the first answer.",
            max_length=_MAX_KEY_LENGTH,
        ),
    ] = None,
) -> Once:
    if idempotency_key is not None and not (idempotency_key.isascii() and idempotency_key.isprintable()):
        raise ApiError(400, "header_invalid", "Idempotency-Key must be printable ASCII.")
    lease_s = services.settings.idempotency_lease_s
    return Once(idempotency_key or None, records, f"{request.method} {request.url.path}", lease_s)


def _fingerprint(parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


OnceDep = Annotated[Once, Depends(_once)]
