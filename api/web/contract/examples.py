"""Examples that resources share: ids of one capture, and problems."""

from typing import Any

from api.web.errors import status_title
from pipeline.core.problems.request_codes import (
    CHECKSUM_MISMATCH,
    CLIENT_TOO_SLOW,
    CONFLICT,
    CONTENT_TOO_LARGE,
    DATABASE_UNAVAILABLE,
    EXPIRED,
    HOST_NOT_ALLOWED,
    INTERNAL_ERROR,
    INVALID_REQUEST,
    KEY_REQUIRED,
    MALFORMED_REQUEST,
    NOT_FOUND,
    RANGE_NOT_SATISFIABLE,
    STORAGE_FULL,
    TOO_MANY_REQUESTS,
    TUS_VERSION,
    UNSUPPORTED_MEDIA_TYPE,
    UPLOAD_ELSEWHERE,
    UPLOAD_LOCKED,
)

SESSION_ID = "01890a5d-ac96-774b-bcce-b302099a8057"
JOB_ID = "01890a5e-1f3b-7d52-9c41-5a6f0b1c2d3e"
CALIBRATION_ID = "01890a5b-9d2c-7f10-8a11-2b3c4d5e6f70"
CHARACTER_ID = "01890a5b-a1b2-7c3d-8e4f-5a6b7c8d9e0f"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

UPLOAD_IDS = [f"01890a5c-7c1e-7a4b-8f00-00000000000{index}" for index in range(3)]

_PROBLEMS: dict[int, tuple[str, str]] = {
    400: (MALFORMED_REQUEST, "The request can't be read."),
    401: (KEY_REQUIRED, "The service asks for a key."),
    403: (HOST_NOT_ALLOWED, "The request's Host is not a name of the service."),
    404: (NOT_FOUND, "There is no such job."),
    408: (CLIENT_TOO_SLOW, "The body arrives too slowly. Send it again over a faster connection."),
    409: (CONFLICT, "The job's state does not allow it."),
    410: (EXPIRED, "The file was removed."),
    412: (TUS_VERSION, "The service uses tus 1.0.0."),
    413: (CONTENT_TOO_LARGE, "The session is larger than the service accepts."),
    415: (UNSUPPORTED_MEDIA_TYPE, "A session is sent as multipart/form-data."),
    416: (RANGE_NOT_SATISFIABLE, "The file has no such range."),
    422: (INVALID_REQUEST, "One thing is wrong with the request."),
    421: (UPLOAD_ELSEWHERE, "The bytes of this upload are at another API process."),
    423: (UPLOAD_LOCKED, "Another request is writing to this upload."),
    460: (CHECKSUM_MISMATCH, "The piece that arrived does not have the checksum that was sent."),
    429: (TOO_MANY_REQUESTS, "At most 600 requests a minute are allowed."),
    500: (INTERNAL_ERROR, "The service failed; the log says why."),
    503: (DATABASE_UNAVAILABLE, "The database does not respond."),
    507: (STORAGE_FULL, "The service's disk is full."),
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
        "title": status_title(status),
        "status": status,
        "detail": detail,
        "instance": f"/v1/jobs/{JOB_ID}",
        "code": code,
        "errors": [_TRUNCATED] if status == 422 else [],
        "camera": None,
        "stage": None,
        "hint": None,
        "retryable": status in {408, 423, 429, 460, 500, 503, 507},
        "request_id": "01890a60-7f10-7cc3-8d4e-0a1b2c3d4e5f",
    }
