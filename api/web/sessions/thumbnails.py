"""Thumbnails of sessions: small copies of the pictures at which the check of a session looked."""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from api.web.auth import VideoViewDep
from api.web.contract.description import Resource, file_content, problems
from api.web.dependencies import ServicesDep, SessionId
from api.web.downloads import ConditionsDep, Download, file_responses, send_file
from api.web.sessions.videos import Camera, deleted
from pipeline.capture.preflight_record import thumbnail_name
from worker.store.errors import NotFound
from worker.store.files.file_keys import thumbnail_key

router = APIRouter(prefix="/v1/sessions/{session_id}/thumbnails", tags=["sessions"])

_JPEG = file_content(["image/jpeg"])
Number = Annotated[int, Path(ge=0, le=255, description="Place of the picture in `thumbnails` of the camera.")]


@router.get(
    "/{camera}/{number}",
    summary="Look at a picture of a session's video",
    response_class=Response,
    responses={**file_responses(_JPEG), **problems(404, 410, 416, 422)},
)
def get_session_thumbnail(
    session_id: SessionId,
    camera: Camera,
    number: Number,
    request: Request,
    services: ServicesDep,
    records: VideoViewDep,
    conditions: ConditionsDep,
) -> Response:
    """Look at a small copy of a picture of a camera, at most 320 pixels wide and high, at which the check looked.

    Of a session with a job that has `blur_faces`, there are none.
    """
    capture = records.sessions.capture(session_id)
    if capture.is_blurred:
        raise NotFound("A job of this capture blurs faces, and the pictures of its check are not blurred.")
    if capture.session.videos_deleted_at is not None:
        raise deleted()
    cameras = capture.session.preflight.cameras
    place = next((place for place, known in enumerate(cameras) if known.name == camera), None)
    if place is None:
        raise NotFound("The session has no camera of this name.")
    if number >= len(cameras[place].thumbnails):
        raise NotFound("The camera has no such picture.")
    thumbnail, name = cameras[place].thumbnails[number], thumbnail_name(place, number)
    file = Download(
        name=f"{camera}-{number}.jpg",
        media_type="image/jpeg",
        key=thumbnail_key(session_id, name),
        num_bytes=thumbnail.num_bytes,
        sha256=thumbnail.sha256,
        disposition="inline",
        remedy="Send the capture again.",
    )
    return send_file(request, services, file, conditions)


RESOURCE = Resource(router=router)
