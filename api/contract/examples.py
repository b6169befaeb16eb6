"""Examples that resources share: ids of one capture, headers, problems."""

from typing import Any

from api.errors import title_of
from api.http.file_names import disposition_of

SESSION_ID = "01890a5d-ac96-774b-bcce-b302099a8057"
JOB_ID = "01890a5e-1f3b-7d52-9c41-5a6f0b1c2d3e"
CALIBRATION_ID = "01890a5b-9d2c-7f10-8a11-2b3c4d5e6f70"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

UPLOAD_IDS = [f"01890a5c-7c1e-7a4b-8f00-00000000000{index}" for index in range(3)]

REQUEST_HEADERS = {
    "Idempotency-Key": "01890a5b-02aa-7cc1-9d10-6f0a7b8c9d0e",
    "Tus-Resumable": "1.0.0",
    "Upload-Length": "5242880",
    "Upload-Metadata": "filename Y2FtXzAubXA0",
    "Upload-Offset": "1048576",
    "Last-Event-ID": "16",
    "If-None-Match": f'"{SHA256}"',
    "If-Match": f'"{SHA256}"',
}

ANSWER_HEADERS = {
    "Retry-After": "1",
    "ETag": f'"{SHA256}"',
    "Accept-Ranges": "bytes",
    **disposition_of("handshake-take-3_person-1.bvh"),
    "Set-Cookie": "multicap_session=...; HttpOnly; Max-Age=43200; Path=/; SameSite=strict",
    "Tus-Resumable": "1.0.0",
    "Upload-Offset": "1048576",
    "Upload-Length": "5242880",
    "Upload-Metadata": "filename Y2FtXzAubXA0",
    "Upload-Expires": "Tue, 03 Mar 2026 09:30:00 GMT",
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
        "instance": f"/v1/jobs/{JOB_ID}",
        "code": code,
        "errors": [_TRUNCATED] if status == 422 else [],
        "camera": None,
        "stage": None,
        "hint": None,
        "retryable": status in {408, 423, 429, 460, 500, 503, 507},
        "request_id": "01890a60-7f10-7cc3-8d4e-0a1b2c3d4e5f",
    }
