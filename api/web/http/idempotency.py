"""``Idempotency-Key``: a client that never saw the answer sends the request again, and gets the first answer.

A route that changes something does it in these steps::

    if (earlier := idempotent.begin(parts)) is not None:
        return earlier
    with idempotent.working():
        with idempotent.records.transaction() as work:
            ...
            answer = idempotent.store(work, Answer(...))
    return answer.response()
"""

import asyncio
import contextlib
import hashlib
import json
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated

import structlog
from fastapi import Depends, Header, Request, Response
from starlette.concurrency import run_in_threadpool

from api.web.auth import RecordsDep, UploadsDep
from api.web.dependencies import ServicesDep
from api.web.errors import ApiError
from pipeline.core.problems.request_codes import HEADER_INVALID
from worker.store.repositories.idempotency_keys import KeyClaim
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)

_MAX_KEY_LENGTH = 200
_REPLAYED = {"Idempotent-Replayed": "true"}


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to a request that may come again, complete and as plain data, so that it can be stored."""

    status: int
    headers: Mapping[str, str]
    body: str

    def response(self, more_headers: Mapping[str, str] | None = None) -> Response:
        """Build the response."""
        media_type = "application/json" if self.body else None
        return Response(self.body, self.status, {**self.headers, **(more_headers or {})}, media_type)


@dataclass(slots=True)
class IdempotentRequest:
    """A request that may come again.

    ``key``: key of the client; ``None``: the request is done each time it comes. ``records``: records of the caller.
    ``operation``: method and path: part of the fingerprint. ``lease_s``: time for which the key stays taken if this
    process is killed; renewed while the request is at work.
    """

    key: str | None
    records: TenantRecords
    operation: str
    lease_s: float
    _claim: KeyClaim | None = field(default=None, init=False)

    def is_answered(self) -> bool:
        """Return whether the key has an answer already, of this request or another one."""
        return self.key is not None and self.records.idempotency_keys.is_answered(self.key)

    def begin(self, parts: object) -> Response | None:
        """Claim the key; returns the first answer if the request was answered before.

        ``parts``: JSON of what was sent, as it was understood: the bytes of a form differ from try to try. Raises
        ``KeyReused``, ``KeyBusy``.
        """
        if self.key is None:
            return None
        found = self.records.idempotency_keys.claim(self.key, _fingerprint([self.operation, parts]), self.lease_s)
        if not isinstance(found, KeyClaim):
            return Answer(**found).response(_REPLAYED)
        self._claim = found
        return None

    def store(self, work: TenantRecords, answer: Answer) -> Answer:
        """Store the answer in the transaction of the work that it reports, and return it.

        Raises ``Conflict``: the request took too long, and was sent again in the meantime.
        """
        if self._claim is not None:
            work.idempotency_keys.answer(self._claim, asdict(answer))
        return answer

    def release(self) -> None:
        """Give the key back after a failure, so that the request can be sent again."""
        if self._claim is not None:
            self.records.idempotency_keys.release(self._claim)

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        """Give the key back if the block fails; for work that takes less time than the lease."""
        try:
            yield
        except BaseException:
            self.release()
            raise

    @contextlib.asynccontextmanager
    async def held(self) -> AsyncIterator[None]:
        """Keep the key for as long as the block takes, and give it back if the block fails."""
        renewing = asyncio.create_task(self._renew_forever())
        try:
            yield
        except BaseException:
            await asyncio.shield(run_in_threadpool(self.release))
            raise
        finally:
            renewing.cancel()

    async def _renew_forever(self) -> None:
        while self._claim is not None:
            await asyncio.sleep(self.lease_s / 3)
            try:
                await run_in_threadpool(self.records.idempotency_keys.renew, self._claim, self.lease_s)
            except Exception:
                # The database may be away for a while.
                _log.exception("idempotency_key_not_renewed")


IdempotencyKey = Annotated[
    str | None,
    Header(
        description="The client's own name of this request, such as a UUID. The same request under the same key is "
        "done once; for a day it gets the first answer.",
        max_length=_MAX_KEY_LENGTH,
    ),
]


def _idempotent_request(
    request: Request, services: ServicesDep, records: RecordsDep, idempotency_key: IdempotencyKey = None
) -> IdempotentRequest:
    if idempotency_key is not None and not (idempotency_key.isascii() and idempotency_key.isprintable()):
        raise ApiError(HEADER_INVALID, "Idempotency-Key must be printable ASCII.")
    lease_s = services.settings.idempotency_lease_s
    return IdempotentRequest(idempotency_key or None, records, f"{request.method} {request.url.path}", lease_s)


def _idempotent_upload(
    request: Request, services: ServicesDep, records: UploadsDep, idempotency_key: IdempotencyKey = None
) -> IdempotentRequest:
    idempotent = _idempotent_request(request, services, records, idempotency_key)
    if idempotent.key is not None and (phone := request.state.caller.phone) is not None:
        # Phones have keys of their own: none meets a request of another phone, or of the tenant.
        idempotent.key = _fingerprint([phone.recording_id, phone.number, idempotent.key])
    return idempotent


def _fingerprint(parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


IdempotentRequestDep = Annotated[IdempotentRequest, Depends(_idempotent_request)]
# Of uploads, which phones of recordings send too.
IdempotentUploadDep = Annotated[IdempotentRequest, Depends(_idempotent_upload)]
