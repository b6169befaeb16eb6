"""Connection of a live capture: its WebSocket, its caller, and what they may do."""

import asyncio
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from starlette.websockets import WebSocket, WebSocketDisconnect

from api.web.auth import Caller
from api.web.dependencies import Services
from api.web.http.websockets import SocketProblem
from api.web.live.intake import require_size
from api.web.metrics import LiveMetrics
from api.web.settings import Settings
from pipeline.core.problems.request_codes import LIVE_IDLE, LIVE_KEY_ENDED
from worker.store.model.rights import Actor
from worker.store.tenant_records import TenantRecords


@dataclass(frozen=True, slots=True)
class LiveConnection:
    """Open WebSocket of a live capture."""

    websocket: WebSocket
    services: Services
    caller: Caller
    key_ended: asyncio.Event  # Set when the caller's key is no longer valid

    @property
    def settings(self) -> Settings:
        """Settings of the service."""
        return self.services.settings

    @property
    def metrics(self) -> LiveMetrics:
        """Counters of live captures."""
        metrics: LiveMetrics = self.websocket.app.state.metrics.live
        return metrics

    @property
    def request_id(self) -> str:
        """Id of the connection, also in the log."""
        return str(self.websocket.state.request_id)

    @property
    def records(self) -> TenantRecords:
        """Records of the caller's tenant."""
        actor = Actor(self.caller.key.id if self.caller.key else None, self.request_id)
        return self.services.store.tenant(self.caller.tenant, self.services.quotas, actor)

    async def send(self, message: BaseModel) -> None:
        """Send a message in JSON."""
        await self.websocket.send_text(message.model_dump_json())

    async def receive(self, *, may_idle: bool = False) -> dict[str, Any]:
        """Next message, of an allowed size and in time; raises ``SocketProblem`` or ``WebSocketDisconnect``."""
        try:
            async with asyncio.timeout(None if may_idle else self.settings.live_idle_s):
                message = dict(await self.websocket.receive())
        except TimeoutError:
            raise SocketProblem(LIVE_IDLE, f"The client sent nothing for {self.settings.live_idle_s:g} s.") from None
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1005))
        require_size(message, self.settings.max_live_message_bytes)
        return message

    async def watch_key(self) -> None:
        """Raise ``SocketProblem`` when the key has ended."""
        await self.key_ended.wait()
        raise SocketProblem(LIVE_KEY_ENDED, "The key of the connection is no longer valid.")
