"""AsyncAPI document of the WebSocket of live captures."""

from typing import Any

from api.web.contract.asyncapi import SocketChannel, describe_sockets
from api.web.live.schemas import RECEIVED, SENT

_CAMERA = {
    "name": "cam_1",
    "size_px": [1920, 1080],
    "matrix": [[1400.0, 0.0, 959.5], [0.0, 1400.0, 539.5], [0.0, 0.0, 1.0]],
    "distortions": [0.0, 0.0, 0.0, 0.0],
    "rotation": [1.2, 0.0, 0.0],
    "translation": [0.0, 1.0, 4.0],
}
_REQUEST_ID = "019f8b1e-6f2a-7c3d-9a41-2b7e5d0c8f63"
_DROPPED = {"input": 0, "output": 0}

MESSAGES: dict[str, Any] = {
    "LiveStart": {
        "type": "start",
        "calibration": {"cameras": [_CAMERA, {**_CAMERA, "name": "cam_2", "rotation": [1.2, 0.8, 0.8]}]},
        "layout": "coco-17",
        "frame_rate_hz": 60.0,
        "output_rate_hz": 30.0,
        "keep": True,
        "name": "rehearsal",
    },
    "LiveKeypoints": {
        "type": "keypoints",
        "camera": "cam_1",
        "time_s": 12.35,
        "people": [[[612.5, 204.0, 0.98]] * 17],
    },
    "LiveEnd": {"type": "end"},
    "LiveReady": {
        "type": "ready",
        "cameras": ["cam_1", "cam_2"],
        "layout": "coco-17",
        "joints": ["nose", "left_eye", "right_eye"],
        "bones": ["Hips", "Spine", "Chest"],
        "parents": [None, "Hips", "Spine"],
        "rig": [
            {
                "name": name,
                "size_px": [1920, 1080],
                "matrix": _CAMERA["matrix"],
                "cam_from_world": {
                    "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
                    "translation_m": [0.0, 1.0, 4.0],
                },
            }
            for name in ("cam_1", "cam_2")
        ],
        "limits": {"message_bytes": 1048576, "messages_per_s": 4000.0, "people": 32, "idle_s": 30.0},
        "request_id": _REQUEST_ID,
    },
    "LiveInstantOut": {
        "type": "instant",
        "dropped": _DROPPED,
        "sequence": 741,
        "time_s": 12.35,
        "lag_s": 0.0,
        "people": [{"id": 1, "joints_m": [[0.52, -1.13, 1.61], [0.55, -1.1, 1.64], None], "skeleton": None}],
    },
    "LiveEnded": {
        "type": "ended",
        "counts": {"received": 7200, "taken": 7198, "late": 12, "too_late": 2},
        "dropped": _DROPPED,
        "session_id": "019f8b1e-7a10-7b52-8c3f-4d1e9a6b2c05",
        "kept_frames": 7200,
    },
    "LiveProblemOut": {
        "type": "problem",
        "code": "live_joints",
        "detail": "Person 0 has 16 points, and the layout has 17.",
        "errors": [],
        "hint": None,
        "retryable": False,
        "close_code": 1008,
        "request_id": _REQUEST_ID,
    },
}
"""Messages by model."""


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
    return describe_sockets("Multicap live captures", _DESCRIPTION, [_CHANNEL], MESSAGES)
