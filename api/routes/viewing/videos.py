"""Videos of sessions, for players: as they were sent, if browsers play them."""

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response

from api.auth import VideoViewDep
from api.contract.description import problems
from api.dependencies import ServicesDep, SessionId
from api.downloads import ConditionsDep, Download, file_responses, send_file
from api.errors import ApiError
from worker.jobs.errors import NotFound
from worker.jobs.model import Session

router = APIRouter(prefix="/v1/sessions/{session_id}/videos", tags=["sessions"])

_VIDEO: dict[str, Any] = {
    media_type: {
        "schema": {"type": "string", "format": "binary", "contentMediaType": media_type},
        "example": "(the video)",
    }
    for media_type in ("video/mp4", "video/webm")
}
Camera = Annotated[
    str, Path(description="Name of a camera of the session.", openapi_examples={"camera": {"value": "cam_0"}})
]


@router.get(
    "/{camera}",
    operation_id="getSessionVideo",
    summary="Watch a session's video",
    response_class=Response,
    responses={**file_responses(_VIDEO), **problems(404, 410, 416)},
)
def get_session_video(
    session_id: SessionId,
    camera: Camera,
    request: Request,
    services: ServicesDep,
    records: VideoViewDep,
    conditions: ConditionsDep,
) -> Response:
    """Watch the video of a camera, or a range of the file, as players ask for it.

    The video is the file that was sent, if browsers play it.
    """
    return send_file(request, services, _sent(records.sessions.get(session_id), camera), conditions)


def _sent(session: Session, name: str) -> Download:
    """Video of a camera as it was sent."""
    camera = next((one for one in session.preflight.cameras if one.name == name), None)
    if camera is None:
        raise NotFound("The session has no camera of this name.")
    if camera.media_type is None:
        raise ApiError("not_found", "Browsers can't play the video of this camera.")
    file = next(one for one in session.files if one.name == camera.file)
    # To compare gigabytes before the first picture would take longer than a person waits.
    return Download(
        name=file.name,
        media_type=camera.media_type,
        key=file.key,
        num_bytes=file.num_bytes,
        sha256=file.sha256,
        disposition="inline",
        is_compared=False,
        remedy="Send the session again.",
    )
