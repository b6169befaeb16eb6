"""Examples of the contract: requests and responses for one capture."""

import json
from typing import Any

from api.errors import title_of
from api.http.file_names import disposition_of
from pipeline.stages.plan import STAGE_BY_NAME
from pipeline.stages.stage import ASSOCIATE, CALIBRATE, DETECT, EXPORT, FIND_BOARD, FIT, IDENTIFY, LOOK

_SESSION_ID = "01890a5d-ac96-774b-bcce-b302099a8057"
_JOB_ID = "01890a5e-1f3b-7d52-9c41-5a6f0b1c2d3e"
_CALIBRATION_ID = "01890a5b-9d2c-7f10-8a11-2b3c4d5e6f70"
_LINK_ID = "01890a66-3b8e-7a60-9d11-7c8d9e0f1a2b"
_SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

UPLOAD_IDS = [f"01890a5c-7c1e-7a4b-8f00-00000000000{index}" for index in range(3)]

PATH_PARAMETERS = {
    "calibration_id": _CALIBRATION_ID,
    "session_id": _SESSION_ID,
    "job_id": _JOB_ID,
    "link_id": _LINK_ID,
    "upload_id": UPLOAD_IDS[0],
    "name": "person-1.bvh",
    "sample_file": "cam01.mp4",
    "camera": "cam_0",
    "number": 0,
}

REQUEST_HEADERS = {
    "Idempotency-Key": "01890a5b-02aa-7cc1-9d10-6f0a7b8c9d0e",
    "Tus-Resumable": "1.0.0",
    "Upload-Length": "5242880",
    "Upload-Metadata": "filename Y2FtXzAubXA0",
    "Upload-Offset": "1048576",
    "Last-Event-ID": "16",
    "If-None-Match": f'"{_SHA256}"',
    "If-Match": f'"{_SHA256}"',
}

ANSWER_HEADERS = {
    "Retry-After": "1",
    "ETag": f'"{_SHA256}"',
    "Accept-Ranges": "bytes",
    **disposition_of("handshake-take-3_person-1.bvh"),
    "Set-Cookie": "multicap_session=...; HttpOnly; Max-Age=43200; Path=/; SameSite=strict",
    "Tus-Resumable": "1.0.0",
    "Upload-Offset": "1048576",
    "Upload-Length": "5242880",
    "Upload-Metadata": "filename Y2FtXzAubXA0",
    "Upload-Expires": "Tue, 03 Mar 2026 09:30:00 GMT",
}

DOCUMENTS: dict[str, Any] = {
    "manifest": {
        "name": "Handshake, take 3",
        "cameras": [{"name": "cam_1", "file": "GX010042.mp4", "offset_s": 0.48}],
        "units": "mm",
        "metadata": {"scene": 12},
    },
    "spec": {
        "method": "tracking",
        "profile": "balanced",
        "joints": "auto",
        "detector": "auto",
        "smoothing": "fit",
        "cutoff_hz": 6.0,
        "feet": "auto",
        "joint_centers": "auto",
        "refine_calibration": "off",
        "sync": "declared",
        "frame_range": None,
        "output_rate_hz": None,
        "people": "auto",
        "exports": ["bvh"],
    },
    "link": {"scope": "file", "name": "person-1.bvh", "expires_in_s": 900.0},
    "rename": {"name": "Handshake, take 4"},
    "rename_calibration": {"name": "Studio B, March"},
    "edits": {
        "edits": [
            {"action": "merge", "person": 1, "other": 3},
            {"action": "rename", "person": 1, "name": "Anna"},
            {"action": "cut", "start_frame": 25, "stop_frame": 250},
        ]
    },
    "calibration_spec": {"method": "board", "name": "Studio B", "board": "charuco:7x5:0.06:0.045:DICT_4X4_50"},
}

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
            "video_link": f"/v1/sessions/{_SESSION_ID}/videos/cam_{index}",
            "media_start_s": 0.0,
            "thumbnails": [{"time_s": 5.0, "link": f"/v1/sessions/{_SESSION_ID}/thumbnails/cam_{index}/0"}],
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
}

_SESSION: dict[str, Any] = {
    "id": _SESSION_ID,
    "name": "Handshake, take 3",
    "created_at": "2026-03-01T09:30:00Z",
    "files": [
        {"name": "cam_0.mp4", "kind": "video", "num_bytes": 5242880, "sha256": _SHA256},
        {"name": "cam_1.mp4", "kind": "video", "num_bytes": 5242880, "sha256": _SHA256},
        {"name": "calibration.toml", "kind": "calibration", "num_bytes": 1024, "sha256": _SHA256},
    ],
    "num_bytes": 10486784,
    "duration_s": 12.0,
    "num_jobs": 1,
    "newest_job": {"id": _JOB_ID, "state": "running"},
    "proxies_job": None,
    "preflight": _PREFLIGHT,
    "sync": "declared",
    "metadata": {"scene": 12},
    "links": {"self": f"/v1/sessions/{_SESSION_ID}", "jobs": f"/v1/sessions/{_SESSION_ID}/jobs"},
}


def _stage(name: str, state: str, done: int, total: int) -> dict[str, Any]:
    started = state in {"running", "done"}
    return {
        "name": name,
        "label": STAGE_BY_NAME[name].label,
        "state": state,
        "done": done,
        "total": total,
        "unit": STAGE_BY_NAME[name].unit,
        "fraction": done / total,
        "started_at": "2026-03-01T09:31:01Z" if started else None,
        "finished_at": None,
        "reused": False,
    }


_CALIBRATION: dict[str, Any] = {
    "id": _CALIBRATION_ID,
    "name": "Studio B",
    "method": "file",
    "state": "ready",
    "created_at": "2026-03-01T09:00:00Z",
    "source": {"file": "Calib.toml", "format": "TOML", "units": "m", "axes": "as calibrated; Z must point up"},
    "warnings": [],
    "cameras": [
        {
            "name": "cam_0",
            "size_px": [1280, 720],
            "matrix": [[1040.0, 0.0, 640.0], [0.0, 1040.0, 360.0], [0.0, 0.0, 1.0]],
            "lens": "standard",
            "distortion": [-0.12, 0.03, 0.0, 0.0, 0.0],
            "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
            "translation_m": [0.0, 1.5, 4.0],
            "position_m": [0.0, -4.0, 1.5],
        }
    ],
    "sha256": _SHA256,
    "report": None,
    "error": None,
    "links": {
        "self": f"/v1/calibrations/{_CALIBRATION_ID}",
        "file": f"/v1/calibrations/{_CALIBRATION_ID}/file",
        "job": None,
        "session": None,
    },
}

_JOB: dict[str, Any] = {
    "id": _JOB_ID,
    "kind": "reconstruction",
    "calibration_id": None,
    "session_id": _SESSION_ID,
    "session_name": "Handshake, take 3",
    "num_frames": 300,
    "duration_s": 12.0,
    "state": "running",
    "spec": DOCUMENTS["spec"],
    "attempt": 1,
    "revision": 0,
    "results_revision": None,
    "visuals_job": None,
    "stages": [
        _stage(LOOK, "done", 24, 24),
        _stage(DETECT, "running", 150, 600),
        _stage(ASSOCIATE, "waiting", 0, 1),
        _stage(IDENTIFY, "waiting", 0, 1),
        _stage(FIT, "waiting", 0, 1),
        _stage(EXPORT, "waiting", 0, 1),
    ],
    "progress": 0.24,
    "queue_position": None,
    "eta_s": 19.0,
    "created_at": "2026-03-01T09:31:00Z",
    "started_at": "2026-03-01T09:31:01Z",
    "finished_at": None,
    "expires_at": None,
    "error": None,
    "waiting_for": None,
    "warnings": [],
    "result_warnings": [],
    "links": {
        "self": f"/v1/jobs/{_JOB_ID}",
        "session": f"/v1/sessions/{_SESSION_ID}",
        "attempts": f"/v1/jobs/{_JOB_ID}/attempts",
        "events": f"/v1/jobs/{_JOB_ID}/events",
        "results": f"/v1/jobs/{_JOB_ID}/results",
        "results_zip": f"/v1/jobs/{_JOB_ID}/results.zip",
        "people": None,
        "cancel": f"/v1/jobs/{_JOB_ID}/cancel",
        "visuals": None,
        "retry": None,
    },
}

_RESULTS: dict[str, Any] = {
    "results": [
        {
            "name": "person-1.bvh",
            "kind": "bvh",
            "person": "person-1",
            "person_name": "person-1",
            "format": "bvh",
            "preset": "default",
            "download_name": "handshake-take-3_person-1.bvh",
            "media_type": "text/plain; charset=utf-8",
            "num_bytes": 204800,
            "sha256": _SHA256,
            "revision": 0,
            "link": f"/v1/jobs/{_JOB_ID}/results/person-1.bvh",
        }
    ]
}

_LINK: dict[str, Any] = {
    "id": _LINK_ID,
    "job_id": _JOB_ID,
    "scope": "file",
    "name": "person-1.bvh",
    "created_at": "2026-03-01T09:40:00Z",
    "expires_at": "2026-03-01T09:55:00Z",
}

_ATTEMPTS: dict[str, Any] = {
    "attempts": [
        {
            "attempt": 1,
            "state": "running",
            "queued_at": "2026-03-01T09:31:00Z",
            "started_at": "2026-03-01T09:31:01Z",
            "finished_at": None,
            "error": None,
            "failures": [
                {
                    "stage": DETECT,
                    "chunk": 2,
                    "chunk_try": 1,
                    "failed_at": "2026-03-01T09:31:40Z",
                    "reason": {
                        "code": "worker_lost",
                        "detail": f"A worker of the stage {DETECT} stopped responding.",
                        "stage": DETECT,
                        "camera": None,
                        "hint": "It may lack memory.",
                        "retryable": True,
                    },
                }
            ],
        }
    ]
}

JOB_ENDED: dict[str, Any] = {
    "type": "job.succeeded",
    "timestamp": "2026-03-01T09:32:10.250000Z",
    "data": {"id": _JOB_ID, "session_id": _SESSION_ID, "state": "succeeded", "attempt": 1, "warnings": []},
}

EVENTS = f"id: 17\nevent: job\ndata: {json.dumps(_JOB)}\nretry: 2000\n\n"

_CALIBRATION_JOB: dict[str, Any] = _JOB | {
    "kind": "calibration",
    "calibration_id": _JOB_ID,
    "state": "queued",
    "stages": [_stage(FIND_BOARD, "ready", 0, 600), _stage(CALIBRATE, "waiting", 0, 30)],
    "progress": 0.0,
    "queue_position": 1,
    "eta_s": None,
    "started_at": None,
}

_MOTION: dict[str, Any] = {
    "revision": 0,
    "schema_version": 1,
    "frame_rate_hz": 25.0,
    "start_time_s": 0.0,
    "num_frames": 3,
    "joint_names": ["nose", "left_eye"],
    "bones": [["nose", "left_eye"]],
    "skeleton": {"names": ["Hips", "Spine"], "parents": [None, 0]},
    "record": {
        "num_bytes": 44,
        "offsets": {
            "origin_m": 0,
            "joints": 12,
            "skeleton": 24,
            "source_views": 36,
            "score": 38,
            "error": 40,
            "camera_error": 42,
            "identity": 43,
        },
        "absent": -32768,
        "error_step_px": 0.5,
        "unknown_error": 255,
    },
    "people": [
        {
            "id": 1,
            "name": "person-1",
            "color": "#2626ff",
            "start_frame": 0,
            "num_frames": 3,
            "offset_bytes": 0,
            "position_step_m": 0.0001,
            "coverage": 1.0,
            "stature_m": 1.78,
            "reprojection_error_px": 3.1,
            "identity": {"confidence": 1.0, "doubts": []},
            "contacts": [[0, 0, 1, 2]],
        }
    ],
    "cameras": [
        {
            "name": "cam_0",
            "size_px": [1920, 1080],
            "matrix": [[1500.0, 0.0, 959.5], [0.0, 1500.0, 539.5], [0.0, 0.0, 1.0]],
            "distortion": [-0.1, 0.02, 0.0, 0.0],
            "lens": "standard",
            "cam_from_world": {
                "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
                "translation_m": [0.0, 1.2, 4.0],
            },
            "video": "cam_0.mp4",
            "clock": [[0, 0.0, 0.0], [2, 0.08, 0.08]],
        }
    ],
    "clocks": None,
    "is_refined": False,
    "floor": {"height_m": 0.0, "slope_x": 0.0, "slope_y": 0.0},
    "reprojection_error_px": {"median": 3.1, "p95": 8.2, "by_camera": {"cam_0": 3.1}, "by_joint": {"nose": 3.1}},
    "warnings": [],
    "strips": {
        "frames_per_bucket": 1,
        "columns": ["measured", "interpolated", "predicted", "error", "cameras", "identity"],
        "people": ["////AAAAAAAADAwMAQEB////"],
    },
}

_PEOPLE: dict[str, Any] = {
    "revision": 1,
    "num_frames": 300,
    "found": [
        {"id": 1, "start_frame": 0, "num_frames": 120},
        {"id": 2, "start_frame": 0, "num_frames": 300},
        {"id": 3, "start_frame": 140, "num_frames": 160},
    ],
    "edits": DOCUMENTS["edits"]["edits"],
    "people": [
        {
            "id": 1,
            "name": "Anna",
            "pieces": [
                {"person": 1, "start_frame": 0, "stop_frame": 120},
                {"person": 3, "start_frame": 140, "stop_frame": 300},
            ],
        },
        {"id": 2, "name": "person-2", "pieces": [{"person": 2, "start_frame": 0, "stop_frame": 300}]},
    ],
    "start_frame": 25,
    "stop_frame": 250,
}

ANSWERS: dict[str, dict[str, Any]] = {
    "MotionDescription": _MOTION,
    "Calibration": _CALIBRATION,
    "CalibrationPage": {"calibrations": [_CALIBRATION], "next_cursor": None},
    "CalibrationJob": _CALIBRATION_JOB,
    "Session": _SESSION,
    "SessionPage": {"sessions": [_SESSION], "next_cursor": None},
    "Job": _JOB,
    "JobPage": {"jobs": [_JOB], "next_cursor": None},
    "People": _PEOPLE,
    "AttemptList": _ATTEMPTS,
    "ResultList": _RESULTS,
    "NewLink": _LINK | {"url": f"/v1/jobs/{_JOB_ID}/results/person-1.bvh?link=mcl_..."},
    "LinkList": {"links": [_LINK]},
    "Caller": {
        "tenant": "studio-a",
        "name": "portal",
        "scopes": ["read", "write"],
        "expires_at": None,
        "quotas": {
            "sessions": {"used": 12, "limit": 100},
            "unfinished_jobs": {"used": 1, "limit": 4},
            "stored_bytes": {"used": 52428800000, "limit": None},
            "uploads": {"used": 0, "limit": None},
        },
    },
    "Health": {"status": "ok"},
    "Readiness": {
        "status": "ready",
        "checks": dict.fromkeys(("database", "broker", "artifacts", "worker", "model", "disk"), True),
        "disk_free_bytes": 214748364800,
    },
    "Sample": {
        "installed": True,
        "install": "Run: multicap samples install",
        "attribution": "Sample capture: demo of several people of Pose2Sim.",
        "files": [
            {"name": "cam01.mp4", "media_type": "video/mp4", "num_bytes": 950272, "link": "/v1/sample/cam01.mp4"}
        ],
    },
    "Options": {
        "profiles": [
            {
                "name": "fast",
                "default_joints": "body",
                "joints": [
                    {
                        "joints": "body",
                        "networks": ["movenet-multipose-int8"],
                        "camera_frame_s": 0.023,
                        "installed": True,
                        "install": "Run: multicap models install movenet-multipose-int8",
                    }
                ],
            }
        ],
        "detectors": [
            {
                "name": "movenet-multipose",
                "installed": True,
                "install": "Run: multicap models install movenet-multipose",
            }
        ],
        "choices": [
            {
                "name": "method",
                "label": "Method",
                "description": "Method that matches detections to people.",
                "group": "advanced",
                "kind": "one",
                "values": [
                    {"name": "tracking", "label": "Tracking of whole bodies", "note": ""},
                    {
                        "name": "clustering",
                        "label": "Clustering of joints for crowds and people who touch",
                        "note": "",
                    },
                ],
                "default": "tracking",
                "unset": None,
                "minimum": None,
                "exclusive_minimum": None,
                "maximum": None,
            }
        ],
    },
}

_PROBLEMS: dict[int, tuple[str, str]] = {
    400: ("malformed_request", "The request can't be read."),
    401: ("key_required", "The service asks for a key."),
    403: ("host_not_allowed", "The request's Host is not a name of the service."),
    404: ("not_found", "There is no such job."),
    408: ("client_too_slow", "The body arrives too slowly. Send it again over a faster connection."),
    409: ("conflict", "The job's state does not allow it."),
    410: ("expired", "The file was removed."),
    412: ("tus_version", "The service uses tus 1.0.0."),
    413: ("content_too_large", "The session is larger than the service accepts."),
    415: ("unsupported_media_type", "A session is sent as multipart/form-data."),
    416: ("range_not_satisfiable", "The file has no such range."),
    422: ("invalid_request", "One thing is wrong with the request."),
    421: ("upload_elsewhere", "The bytes of this upload are at another API process."),
    423: ("upload_locked", "Another request is writing to this upload."),
    460: ("checksum_mismatch", "The piece that arrived does not have the checksum that was sent."),
    429: ("too_many_requests", "At most 600 requests a minute are allowed."),
    500: ("internal_error", "The service failed; the log says why."),
    503: ("database_unavailable", "The database does not respond."),
    507: ("storage_full", "The service's disk is full."),
}
_TRUNCATED: dict[str, Any] = {
    "code": "video_truncated",
    "message": "The video ends in the middle of a frame.",
    "pointer": "/videos/1",
    "file": "cam_1.mp4",
    "camera": "cam_1",
    "field": None,
    "hint": "Copy it from the camera again.",
}


def problem(status: int) -> dict[str, Any]:
    """Example of a problem with an HTTP status."""
    code, detail = _PROBLEMS[status]
    return {
        "type": "about:blank",
        "title": title_of(status),
        "status": status,
        "detail": detail,
        "instance": f"/v1/jobs/{_JOB_ID}",
        "code": code,
        "errors": [_TRUNCATED] if status == 422 else [],
        "camera": None,
        "stage": None,
        "hint": None,
        "retryable": status in {408, 423, 429, 460, 500, 503, 507},
        "request_id": "01890a60-7f10-7cc3-8d4e-0a1b2c3d4e5f",
    }
