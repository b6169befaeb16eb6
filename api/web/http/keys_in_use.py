"""Keys and links of running requests: a request ends when its key or its link is revoked or expires.

Event streams and downloads may run for hours after their key was checked.
"""

import asyncio
import contextlib
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Literal, NamedTuple

import structlog
from starlette.concurrency import run_in_threadpool
from starlette.types import Message, Receive, Scope, Send

from api.web.http.middleware import HttpMiddleware
from worker.store.store import JobStore

_log = structlog.get_logger(__name__)

_INTERVAL_S = 0.25


CredentialKind = Literal["key", "link", "join"]


class Credential(NamedTuple):
    """Key or link of a request; ``join`` is the link of a recording."""

    kind: CredentialKind
    id: str | None  # ``None`` for a request without a key, which is allowed as long as the service has no keys


class KeysInUse:
    """Polls the validity of the keys and links of running requests, with one query for all of a kind.

    Other processes revoke them too, so the database is polled.
    """

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._requests: defaultdict[Credential, set[asyncio.Event]] = defaultdict(set)
        self._in_use = asyncio.Event()

    @contextlib.contextmanager
    def watching(self, credential: Credential) -> Iterator[asyncio.Event]:
        """Watch a key or link during the block; the event is set when it is no longer valid."""
        ended = asyncio.Event()
        self._requests[credential].add(ended)
        self._in_use.set()
        try:
            yield ended
        finally:
            self._requests[credential].discard(ended)
            if not self._requests[credential]:
                del self._requests[credential]

    async def poll(self) -> None:
        """Poll the database as long as a key is in use; runs until it is canceled."""
        while True:
            await self._in_use.wait()
            try:
                await self._poll_once()
            except Exception:
                # The database may be unreachable for a while; keys count as valid until it responds.
                _log.exception("keys_not_read")
            if not self._requests:
                self._in_use.clear()
            await asyncio.sleep(_INTERVAL_S)

    async def _poll_once(self) -> None:
        watched = set(self._requests)
        valid = await run_in_threadpool(self._valid, watched)
        for credential in watched - valid:
            for ended in self._requests.get(credential, ()):
                ended.set()

    def _valid(self, watched: set[Credential]) -> set[Credential]:
        valid, store = set[Credential](), self._store
        sources: Mapping[CredentialKind, Callable[[Collection[str]], set[str]]] = {
            "key": store.keys.valid,
            "link": store.link_secrets.valid,
            "join": store.join_secrets.valid,
        }
        for kind, find_valid in sources.items():
            if ids := {credential.id for credential in watched if credential.kind == kind and credential.id}:
                valid |= {Credential(kind, valid_id) for valid_id in find_valid(ids)}
        if Credential("key", None) in watched and not self._store.keys.exist():
            valid.add(Credential("key", None))
        return valid


class RevokedKeyGuard(HttpMiddleware):
    """Report the client as disconnected to a request whose key or link is no longer valid.

    The request's body is not read any further, its response breaks off, and the connection is closed.
    """

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        keys_in_use: KeysInUse = scope["app"].state.services.keys_in_use
        ended: asyncio.Event | None = None
        complete = False

        async def receive_while_valid() -> Message:
            nonlocal ended, complete
            if ended is None and (caller := scope["state"].get("caller")) is not None:
                ended = watches.enter_context(keys_in_use.watching(caller.credential))
            if ended is None or not complete:
                # The next piece of a body arrives soon: `SlowClientGuard` ends the request otherwise.
                message = await receive()
                complete = not message.get("more_body", False)
                return message if ended is None or not ended.is_set() else {"type": "http.disconnect"}
            return await _first(receive, ended)

        with contextlib.ExitStack() as watches:
            await self._app(scope, receive_while_valid, send)
        if ended is not None and ended.is_set():
            _log.info("key_ended")


async def _first(receive: Receive, ended: asyncio.Event) -> Message:
    """Return the client's next message, or a disconnection if the event is set first."""
    coming, ending = asyncio.ensure_future(receive()), asyncio.ensure_future(ended.wait())
    try:
        await asyncio.wait([coming, ending], return_when=asyncio.FIRST_COMPLETED)
        return coming.result() if coming.done() else {"type": "http.disconnect"}
    finally:
        coming.cancel()
        ending.cancel()
