"""Fetches: the API process that holds the bytes of an upload gets its file from the URL of a client.

Webhooks have the same rules: a name is resolved once, only public addresses are connected to, redirects are not
followed, proxies are not used. A broken connection continues by ``Range``. URLs are secrets: no log and no answer has
them, and their rows forget them at the end.
"""

import asyncio
import contextlib
import re
import socket
import time
from collections import Counter
from collections.abc import AsyncIterator, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NoReturn
from urllib.parse import urlsplit

import httpcore2
import structlog
from starlette.concurrency import run_in_threadpool

from api.web.dependencies import Services
from api.web.errors import ApiError, as_api_error
from api.web.http.bodies.form import too_large
from api.web.sessions.completing import complete
from pipeline.core.problems import request_codes
from worker.run.webhooks.sender import RefusedAddressError, connection_fault, resolve
from worker.store.errors import DamagedDatabase
from worker.store.model.job_records import JobProblem
from worker.store.model.session_records import Fetch, FetchedSession

_log = structlog.get_logger(__name__)

_LOOK_S = 0.5
_AT_ONCE = 6
_AT_ONCE_A_TENANT = 2
# Time after which another process takes up the fetches of a killed one, and time between renewals.
_LEASE_S = 30.0
_RENEW_S = 5.0
# Tries without a new byte, and the pauses between them: about two minutes.
_MAX_TRIES = 8
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 30.0

_BUSY = frozenset({408, 425, 429, 500, 502, 503, 504})
# Statuses of errors of the service itself, and of an upload that is deleted or written to: the fetch is due again.
_UNDECIDED = frozenset({404, 409, 423, 503})
_CONTENT_RANGE = re.compile(r"bytes (\d{1,18})-\d{1,18}/(\d{1,18})", re.ASCII)
_NUMBER = re.compile(r"\d{1,18}", re.ASCII)


class _BusyError(Exception):
    """The source answers with an error that may pass."""


_PASSING = (
    _BusyError,
    httpcore2.TimeoutException,
    httpcore2.NetworkError,
    httpcore2.ProtocolError,
    TimeoutError,
    socket.gaierror,
)


class _CheckedBackend(httpcore2.AnyIOBackend):
    """Network backend that connects to checked addresses only."""

    def __init__(self, allow_private: bool, resolve_s: float) -> None:
        self._allow_private, self._resolve_s = allow_private, resolve_s

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore2.AsyncNetworkStream:
        address = await run_in_threadpool(resolve, host, port, self._allow_private, self._resolve_s)
        return await super().connect_tcp(address, port, timeout, local_address, socket_options)


async def fetch_forever(services: Services) -> None:
    """Fetch uploads that are due, some at a time, and complete their sessions, until the database is damaged."""
    running: dict[str, tuple[asyncio.Task[None], str]] = {}
    fetched_bytes = Counter[str]()
    completing: dict[str, asyncio.Task[None]] = {}
    renewed_s = time.monotonic()
    async with asyncio.TaskGroup() as group:
        while not services.store.is_damaged:
            running = {upload_id: work for upload_id, work in running.items() if not work[0].done()}
            completing = {session_id: task for session_id, task in completing.items() if not task.done()}
            try:
                if time.monotonic() > renewed_s + _RENEW_S:
                    renewed_s = time.monotonic()
                    found = {upload_id: fetched_bytes[upload_id] for upload_id in running}
                    for upload_id in found.keys() - await run_in_threadpool(_renewed, services, found, [*completing]):
                        running[upload_id][0].cancel()  # it was deleted
                    for upload_id in fetched_bytes.keys() - running.keys():
                        del fetched_bytes[upload_id]
                busy = Counter(tenant for _, tenant in running.values())
                for fetch in await run_in_threadpool(_claimed, services, busy):
                    running[fetch.upload.id] = group.create_task(_fetch(services, fetch, fetched_bytes)), fetch.tenant
                for arrival in await run_in_threadpool(_claimed_arrivals, services):
                    completing[arrival.session_id] = group.create_task(complete(services, arrival))
            except DamagedDatabase:
                break
            except Exception:
                _log.exception("fetches_failed")
            await asyncio.sleep(_LOOK_S)


def _renewed(services: Services, fetched_bytes: Mapping[str, int], session_ids: Collection[str]) -> set[str]:
    """Renew fetches, and sessions that are completed; return the ids of the uploads that still exist."""
    times = _LEASE_S, services.settings.upload_keep_s
    services.store.arrivals.renew(session_ids, *times)
    return services.store.uploads.renew_fetches(fetched_bytes, *times)


def _claimed_arrivals(services: Services) -> list[FetchedSession]:
    """Take sessions whose files are all here."""
    return [
        arrival
        for arrival in services.store.arrivals.due()
        if all(map(services.uploads.is_here, arrival.uploads))
        and services.store.arrivals.claim(arrival.session_id, _LEASE_S)
    ]


def _claimed(services: Services, busy: Counter[str]) -> list[Fetch]:
    """Take due fetches as far as there is room for them."""
    claimed: list[Fetch] = []
    for fetch in services.store.uploads.due_fetches() if busy.total() < _AT_ONCE else ():
        has_room = busy.total() < _AT_ONCE and busy[fetch.tenant] < _AT_ONCE_A_TENANT
        is_ours = has_room and services.uploads.is_here(fetch.upload)
        if is_ours and services.store.uploads.claim_fetch(fetch.upload.id, _LEASE_S):
            claimed.append(fetch)
            busy[fetch.tenant] += 1
    return claimed


async def _fetch(services: Services, fetch: Fetch, fetched_bytes: Counter[str]) -> None:
    """Fetch an upload and record the end, unless it is left to another try; count its bytes."""
    upload_id = fetch.upload.id
    problem = None
    try:
        await _until_whole(services, fetch, fetched_bytes)
        _log.info("upload_fetched", upload=upload_id)
    except Exception as error:
        answer = as_api_error(error)
        if answer.status == 500:
            _log.exception("fetch_failed", upload=upload_id)
        else:
            _log.info("fetch_ended", upload=upload_id, code=answer.code)
        if answer.status in _UNDECIDED:
            return
        problem = JobProblem(answer.code, answer.detail, hint=answer.hint)
    try:
        await run_in_threadpool(services.store.uploads.end_fetch, upload_id, problem)
    except Exception:  # it is due again when its lease ends
        _log.exception("fetch_not_recorded", upload=upload_id)


async def _until_whole(services: Services, fetch: Fetch, fetched_bytes: Counter[str]) -> None:
    """Fetch the rest of an upload; after a break continue where it broke."""
    num_tries, furthest = 0, -1
    while True:
        offset = await run_in_threadpool(services.uploads.offset, fetch.upload)
        fetched_bytes[fetch.upload.id] = offset
        if 0 < offset == fetch.upload.num_bytes:
            return
        if offset > furthest:
            num_tries, furthest = 0, offset
        attempt = _Attempt(services, fetch, offset, fetched_bytes)
        try:
            if await attempt.received() == attempt.fetch.upload.num_bytes:
                return
        except RefusedAddressError:
            raise ApiError(request_codes.SOURCE_REFUSED, "The address of the source is not public.") from None
        except _PASSING as error:
            _log.info("fetch_broken", upload=fetch.upload.id, error=type(error).__name__)
            num_tries += 1
            if num_tries == _MAX_TRIES:
                raise ApiError(request_codes.SOURCE_BROKEN, _fault(error)) from None
            await asyncio.sleep(min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2.0 ** (num_tries - 1)))
        fetch = attempt.fetch


def _fault(error: Exception) -> str:
    """Sentence about the last try."""
    match error:
        case _BusyError():
            return f"The source answers with {error}."
        case socket.gaierror():
            return "The name of the source can't be resolved."
        case httpcore2.TimeoutException() | TimeoutError():
            return "The source takes too long."
        case _:
            return connection_fault(error)


@dataclass
class _Attempt:
    """One request for the bytes of an upload from ``offset`` on; ``fetch`` gets the size of the file."""

    services: Services
    fetch: Fetch
    offset: int
    fetched_bytes: Counter[str]

    async def received(self) -> int:
        """Request the bytes and append them to the upload; return its new offset."""
        settings, uploads, fetch = self.services.settings, self.services.uploads, self.fetch
        headers: dict[bytes | str, bytes | str] = {
            "Host": urlsplit(fetch.url).netloc,
            "User-Agent": "Multicap-Fetch/1",
            "Accept": "*/*",
            "Accept-Encoding": "identity",
            **({"Range": f"bytes={self.offset}-"} if self.offset else {}),
            **({"If-Range": fetch.validator} if self.offset and fetch.validator else {}),
        }
        times = {"timeout": dict.fromkeys(("connect", "read", "write", "pool"), settings.client_idle_s)}
        backend = _CheckedBackend(settings.fetch_private, settings.client_idle_s)
        async with contextlib.AsyncExitStack() as stack:
            pool = await stack.enter_async_context(httpcore2.AsyncConnectionPool(network_backend=backend))
            async with asyncio.timeout(settings.client_idle_s):
                response = await stack.enter_async_context(
                    pool.stream("GET", fetch.url, headers=headers, extensions=times)
                )
            num_known = await run_in_threadpool(self._accept, response.status, _texts(response))
            await stack.enter_async_context(uploads.writing(fetch.upload.id))
            return await uploads.append(self.fetch.upload, self.offset, self._pieces(response, num_known), None)

    def _accept(self, status: int, headers: Mapping[str, str]) -> int:
        """Check the head of a response; return how many of its first bytes are there already."""
        if status in _BUSY:
            raise _BusyError(status)
        upload, length = self.fetch.upload, headers.get("content-length", "")
        if status == 416 or (status == 206 and self.offset):
            part = _CONTENT_RANGE.fullmatch(headers.get("content-range", ""))
            if part is None or (int(part[1]), int(part[2])) != (self.offset, upload.num_bytes):
                _raise_changed()
            return 0
        if status != 200:
            hint = "Send a link that gives the file itself: redirects are not followed."
            raise ApiError(request_codes.SOURCE_NOT_FOUND, f"The source answers with {status}.", hint=hint)
        if headers.get("content-encoding", "identity") != "identity" or not _NUMBER.fullmatch(length):
            message = "The source states no size, or compresses the file."
            raise ApiError(request_codes.SOURCE_UNUSABLE, message, hint="Send the file as an upload.")
        num_bytes, validator = int(length), _validator(headers)
        if self.offset:
            if (num_bytes, validator) != (upload.num_bytes, self.fetch.validator):
                _raise_changed()
            return self.offset
        settings = self.services.settings
        if num_bytes > settings.max_file_bytes:
            raise too_large("file", settings.max_file_bytes)
        if not settings.shared_uploads:
            self.services.disk.require_room(num_bytes)
        records = self.services.store.tenant(self.fetch.tenant, self.services.quotas)
        upload = records.uploads.announce(upload.id, num_bytes, validator)
        self.fetch = replace(self.fetch, upload=upload, validator=validator)
        return 0

    async def _pieces(self, response: httpcore2.Response, num_known: int) -> AsyncIterator[bytes]:
        """Bytes of a response behind its first ``num_known``; ends a response that is too slow."""
        settings, started_s, num_bytes = self.services.settings, time.monotonic(), 0
        async for data in response.aiter_stream():
            elapsed_s, start = time.monotonic() - started_s, max(0, num_known - num_bytes)
            num_bytes += len(data)
            if elapsed_s > settings.client_idle_s and num_bytes < elapsed_s * settings.client_min_bytes_per_s:
                raise httpcore2.ReadTimeout
            if start < len(data):
                self.fetched_bytes[self.fetch.upload.id] += len(data) - start
                yield data[start:]


def _raise_changed() -> NoReturn:
    raise ApiError(request_codes.SOURCE_CHANGED, "The file changed at its source while it was fetched.")


def _texts(response: httpcore2.Response) -> dict[str, str]:
    return {name.decode("latin-1").lower(): value.decode("latin-1").strip() for name, value in response.headers}


def _validator(headers: Mapping[str, str]) -> str | None:
    """Value for ``If-Range``: a strong ETag, or else the date of the last change."""
    etag = headers.get("etag", "")
    return etag if etag.startswith('"') else headers.get("last-modified")
