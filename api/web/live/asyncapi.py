"""AsyncAPI document of the WebSocket of live captures."""

from typing import Any

from api.web.contract.asyncapi import SocketChannel, describe_sockets
from api.web.live.schemas import RECEIVED, SENT

_DESCRIPTION = """\
A live capture for as long as the WebSocket is open. The client sends `start`, then keypoints of each camera's frames,
and `end`. The service answers `ready`, then instants with people, and `ended`; a `problem` ends the capture early.
Keypoints and instants may be packed, as messages of bytes. Pages of allowed origins, whose browsers send no headers,
offer the subprotocols `multicap.live` and `mc.key.` with a key behind it. docs/live_service.md describes both forms,
limits and close codes.
"""
_CHANNEL = SocketChannel(
    name="live",
    address="/v1/live",
    received=RECEIVED,
    sent=SENT,
    packed_received={"PackedKeypoints": "Keypoints of a camera's frame: `MCK1`."},
    packed_sent={"PackedInstant": "People at an instant: `MCI1`."},
)


def describe_live() -> dict[str, Any]:
    """AsyncAPI 3.0 document."""
    return describe_sockets("Multicap live captures", _DESCRIPTION, [_CHANNEL])
