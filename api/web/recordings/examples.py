"""Examples of recordings: bodies of requests and responses, and messages of the WebSocket by model."""

from typing import Any

from api.web.contract.examples import CALIBRATION_ID, JOB_ID, SESSION_ID, UPLOAD_IDS

RECORDING_ID = "01890a67-5c1e-7a4b-8f00-0d5e6f7a8b9c"
_START_S = 1772357400.0
_TRACK = {"width": 1920, "height": 1080, "frame_rate_hz": 30.0, "facing": "environment", "label": None}
_SETTINGS = {"width": 1920, "height": 1080, "frame_rate_hz": 30.0}
_REQUEST_ID = "019f8b1e-6f2a-7c3d-9a41-2b7e5d0c8f63"

SPEC: dict[str, Any] = {"name": "Rehearsal", "expires_in_s": 14_400.0}
SESSION_SPEC: dict[str, Any] = {"calibration_id": CALIBRATION_ID, "job": {}}
CALIBRATION_SPEC: dict[str, Any] = {"name": "Studio, phones", "stature_m": [1.78]}

_CLIP_FILE: dict[str, Any] = {
    "part": 1,
    "upload_id": UPLOAD_IDS[0],
    "num_bytes": 24_117_248,
    "first_frame_s": _START_S + 0.0124,
    "std_s": 0.0031,
    "duration_s": 31.2,
    "facts": {"num_frames": 936, "dropped_frames": 0, "lost": [], "track": _TRACK, "mime_type": "video/mp4"},
}
_STARTED: dict[str, Any] = {
    "part": 1,
    "first_frame_s": _START_S + 0.0124,
    "std_s": 0.0031,
    "track": _TRACK,
    "mime_type": "video/mp4",
}
_STOPPED: dict[str, Any] = {
    "num_parts": 1,
    "num_bytes": 24_117_248,
    "num_frames": 936,
    "dropped_frames": 0,
    "lost_s": 0.0,
    "is_cut": False,
}
_TAKE: dict[str, Any] = {
    "number": 1,
    "name": "Take 1",
    "state": "recorded",
    "start_s": _START_S,
    "stop_s": _START_S + 31.0,
    "settings": _SETTINGS,
    "is_upload_wanted": True,
    "session_id": None,
    "job_id": None,
    "calibration_id": None,
    "clips": [{"phone": 1, "started": _STARTED, "stopped": _STOPPED, "files": [_CLIP_FILE], "used_part": 1}],
}
_RECORDING: dict[str, Any] = {
    "id": RECORDING_ID,
    "name": "Rehearsal",
    "created_at": "2026-03-01T09:00:00Z",
    "expires_at": "2026-03-01T13:00:00Z",
    "phones": [
        {
            "number": 1,
            "name": "Phone 1",
            "device": "Chrome, Android",
            "joined_at": "2026-03-01T09:01:00Z",
            "is_removed": False,
        }
    ],
    "takes": [_TAKE],
}
_JOIN: dict[str, Any] = {
    "url": f"https://192.168.1.20:8443/record#join={RECORDING_ID}.mcl_...",
    "secret": "mcl_...",
    "qr_svg": '<svg xmlns="http://www.w3.org/2000/svg" ...></svg>',
    "expires_at": "2026-03-01T13:00:00Z",
}

ANSWERS: dict[str, Any] = {
    "Recording": _RECORDING,
    "NewRecording": _RECORDING | {"phones": [], "takes": [], "join": _JOIN},
    "RecordingPage": {"recordings": [_RECORDING], "next_cursor": None},
    "TakeSession": {
        "session_id": SESSION_ID,
        "job_id": JOB_ID,
        "cameras": {"Phone 1": 0.0124, "Phone 2": 0.0311},
        "left_out": ["Phone 3 has sent no clip of this take."],
    },
}

_STATUS: dict[str, Any] = {
    "state": "recording",
    "track": _TRACK,
    "battery": 0.82,
    "charging": False,
    "free_bytes": 21_474_836_480,
    "clock": {"offset_s": 1772357100.25, "std_s": 0.0021, "drift_ppm": 3.1},
    "dropped_frames": 0,
    "pending_bytes": 7_340_032,
    "sending": None,
    "error": None,
}
_HELLO: dict[str, Any] = {
    "track": _TRACK,
    "capabilities": {
        "max_width": 3840,
        "max_height": 2160,
        "max_frame_rate_hz": 60.0,
        "locks": ["exposureMode", "focusMode", "whiteBalanceMode"],
    },
    "mime_types": ["video/mp4;codecs=avc1"],
}

MESSAGES: dict[str, Any] = {
    "PhoneHello": {"type": "hello", "phone_id": "f3c1b8f0-5a52-4d0e-9b52-7d0c1f3e9a10", "name": "Left", **_HELLO},
    "ClientPing": {"type": "ping", "t0_s": 300.125},
    "PhoneStatus": {"type": "status", **_STATUS},
    "PhoneRename": {"type": "rename", "name": "Left"},
    "PhoneStarted": {"type": "started", "take": 1, **_STARTED},
    "PhoneStopped": {"type": "stopped", "take": 1, **_STOPPED},
    "PhoneFile": {
        "type": "file",
        "take": 1,
        **{name: value for name, value in _CLIP_FILE.items() if name != "facts"},
        **_CLIP_FILE["facts"],
    },
    "HostStart": {"type": "start", "name": "Handshake", "settings": _SETTINGS},
    "HostStop": {"type": "stop"},
    "HostRename": {"type": "rename", "phone": 1, "name": "Left"},
    "HostRemove": {"type": "remove", "phone": 3},
    "HostUpload": {"type": "upload", "take": 1},
    "HostDiscard": {"type": "discard", "take": 1},
    "Pong": {"type": "pong", "t0_s": 300.125, "server_s": _START_S + 0.375},
    "PhoneWelcome": {
        "type": "welcome",
        "number": 1,
        "name": "Phone 1",
        "recording_id": RECORDING_ID,
        "recording": "Rehearsal",
        "expires_at": "2026-03-01T13:00:00Z",
        "server_s": _START_S,
        "takes": [
            {
                "number": 1,
                "name": "Take 1",
                "state": "recording",
                "start_s": _START_S,
                "stop_s": _START_S + 3600.0,
                "settings": _SETTINGS,
                "is_upload_wanted": False,
                "parts": [],
            }
        ],
        "limits": {
            "message_bytes": 16_384,
            "messages_per_s": 50.0,
            "thumbnail_bytes": 30_000,
            "thumbnails_per_s": 2.0,
            "idle_s": 30.0,
        },
        "request_id": _REQUEST_ID,
    },
    "StartOut": {
        "type": "start",
        "take": 1,
        "name": "Take 1",
        "at_server_s": _START_S,
        "latest_stop_s": _START_S + 3600.0,
        "settings": _SETTINGS,
    },
    "StopOut": {"type": "stop", "take": 1, "at_server_s": _START_S + 31.0},
    "RenameOut": {"type": "rename", "name": "Left"},
    "UploadOut": {"type": "upload", "take": 1},
    "DeleteOut": {"type": "delete", "take": 1},
    "EndedOut": {"type": "ended", "reason": "recording"},
    "HostState": {
        "type": "state",
        "recording": _RECORDING,
        "live": [{"number": 1, "is_connected": True, "status": _STATUS, "hello": _HELLO}],
        "relay": "ok",
        "server_s": _START_S + 40.0,
        "request_id": _REQUEST_ID,
    },
    "RecordingProblemOut": {
        "type": "problem",
        "code": "conflict",
        "detail": "A take is being recorded; stop it first.",
        "errors": [],
        "hint": None,
        "retryable": False,
        "close_code": None,
        "request_id": _REQUEST_ID,
    },
}
"""Messages by model."""
