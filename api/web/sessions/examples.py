"""Examples of capture sessions."""

from typing import Any

from api.web.contract.examples import JOB_ID, SESSION_ID, SHA256

MANIFEST: dict[str, Any] = {
    "name": "Handshake, take 3",
    "cameras": [{"name": "cam_1", "file": "GX010042.mp4", "offset_s": 0.48}],
    "units": "mm",
    "metadata": {"scene": 12},
}
CHANGES = {"name": "Handshake, take 4"}

_PREFLIGHT: dict[str, Any] = {
    "cameras": [
        {
            "name": f"cam_{index}",
            "file": f"cam_{index}.mp4",
            "size_px": [1280, 720],
            "frame_rate_hz": 25.0,
            "num_frames": 300,
            "start_time_s": 0.0,
            "plays_in_browsers": True,
            "video_link": f"/v1/sessions/{SESSION_ID}/videos/cam_{index}",
            "media_start_s": 0.0,
            "thumbnails": [{"time_s": 5.0, "link": f"/v1/sessions/{SESSION_ID}/thumbnails/cam_{index}/0"}],
            "more_files": [],
        }
        for index in range(2)
    ],
    "timebase": {"start_time_s": 0.0, "frame_rate_hz": 25.0, "num_frames": 300},
    "warnings": ["cam_0.mp4: 1 frame is left out, because another frame has the same timestamp."],
    "findings": [
        {
            "code": "frames_repeated",
            "camera": "cam_0",
            "severity": "warning",
            "message": "cam_0.mp4: 1 frame is left out, because another frame has the same timestamp.",
            "hint": "Export the video again at a constant frame rate.",
            "evidence": {"file": "cam_0.mp4", "num_frames": 1},
        }
    ],
    "layout": None,
}

_SESSION: dict[str, Any] = {
    "id": SESSION_ID,
    "name": "Handshake, take 3",
    "created_at": "2026-03-01T09:30:00Z",
    "files": [
        {"name": "cam_0.mp4", "kind": "video", "num_bytes": 5242880, "sha256": SHA256, "is_deleted": False},
        {"name": "cam_1.mp4", "kind": "video", "num_bytes": 5242880, "sha256": SHA256, "is_deleted": False},
        {"name": "calibration.toml", "kind": "calibration", "num_bytes": 1024, "sha256": SHA256, "is_deleted": False},
    ],
    "num_bytes": 10486784,
    "videos_deleted_at": None,
    "duration_s": 12.0,
    "num_jobs": 1,
    "newest_job": {"id": JOB_ID, "state": "running"},
    "proxies_job": None,
    "shows_blurred": False,
    "preflight": _PREFLIGHT,
    "sync": "declared",
    "timeline": "take",
    "space": {"store_bytes": 8800000, "scratch_bytes": 3700000, "num_people": 3},
    "metadata": {"scene": 12},
    "links": {"self": f"/v1/sessions/{SESSION_ID}", "jobs": f"/v1/sessions/{SESSION_ID}/jobs"},
}

ANSWERS: dict[str, Any] = {
    "Session": _SESSION,
    "SessionPage": {"sessions": [_SESSION], "next_cursor": None},
}
