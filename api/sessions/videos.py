"""Videos of sessions, for players: as they were sent, if browsers play them, else their proxies."""

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from api.auth import VideoViewDep
from api.contract.description import file_content, problems
from api.contract.resource import Resource
from api.dependencies import ServicesDep, SessionId
from api.downloads import ConditionsDep, Download, file_responses, send_file
from api.errors import ApiError
from pipeline.capture.preflight_record import PreflightCamera
from pipeline.job_choices import proxy_name
from pipeline.problem_codes.requests import NOT_FINISHED
from worker.jobs.errors import NotFound
from worker.jobs.model.sessions import Session
from worker.jobs.tenant_records import TenantRecords
from worker.planning import has_videos

router = APIRouter(prefix="/v1/sessions/{session_id}/videos", tags=["sessions"])

_VIDEO = file_content(["video/mp4", "video/webm"], "(the video)")
Camera = Annotated[
    str, Path(description="Name of a camera of the session.", openapi_examples={"camera": {"value": "cam_0"}})
]


@router.get(
    "/{camera}",
    operation_id="getSessionVideo",
    summary="Watch a session's video",
    response_class=Response,
    responses={**file_responses(_VIDEO), **problems(404, 409, 410, 416)},
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

    The video is the file that was sent, if browsers play it. Else it is a proxy: a small copy at the true times of the
    frames, without sound, which is made behind the session's first reconstruction.
    """
    session = records.sessions.get(session_id)
    cameras = session.preflight.cameras
    number = next((number for number, one in enumerate(cameras) if one.name == camera), None)
    if number is None:
        raise NotFound("The session has no camera of this name.")
    media_type = cameras[number].media_type
    file = _proxy(records, session, number) if media_type is None else _sent(session, cameras[number], media_type)
    return send_file(request, services, file, conditions)


def _proxy(records: TenantRecords, session: Session, number: int) -> Download:
    """Proxy of the video of a camera, by its number in the session."""
    camera = session.preflight.cameras[number]
    if not has_videos(session):
        raise NotFound("The session has keypoints, and no videos.")
    proxy = records.results.proxy(session.id, proxy_name(number))
    if proxy is None:
        message = "Browsers can't play the video of this camera, and a copy that they play is not made yet."
        hint = "Read the session until the camera has a video_link; its proxies_job says how far it is."
        raise ApiError(NOT_FINISHED, message, hint=hint)
    name = f"{camera.file.rpartition('.')[0] or camera.file}.mp4"
    remedy = "Retry the session's proxies_job, or send the session again."
    return replace(Download.of(proxy, name), disposition="inline", remedy=remedy)


def _sent(session: Session, camera: PreflightCamera, media_type: str) -> Download:
    """Video of a camera as it was sent."""
    file = next(file for file in session.files if file.name == camera.file)
    # To compare gigabytes before the first picture would take longer than a person waits.
    return Download(
        name=file.name,
        media_type=media_type,
        key=file.key,
        num_bytes=file.num_bytes,
        sha256=file.sha256,
        disposition="inline",
        is_compared=False,
        remedy="Send the session again.",
    )


RESOURCE = Resource(router=router, parameters={"camera": "cam_0"})
