"""Routes of uploads that the service fetches from URLs, and of the state of any upload."""

from fastapi import APIRouter, Response, status

from api.web.auth import UploadsDep
from api.web.contract.description import RETRY_AFTER, Resource, location, problems
from api.web.dependencies import ServicesDep, UploadId
from api.web.errors import ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.idempotency import Answer, IdempotentRequestDep
from api.web.uploads.intake import FETCH_RETRY_S, begun_upload, source_fault, source_name
from api.web.uploads.schemas import UploadSource, UploadState

router = APIRouter(prefix="/v1/uploads", tags=["uploads"], route_class=SmallBodyRoute)


@router.post(
    "/from-url",
    summary="Fetch an upload",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=UploadState,
    responses={
        202: {"headers": {"Location": location("upload"), **RETRY_AFTER}},
        **problems(400, 409, 413, 415, 422, 507),
    },
)
def create_upload_from_url(source: UploadSource, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
    """Have the service fetch a file. Read the upload until its state is `finished` or `failed`; delete it to cancel."""
    if (earlier := idempotent.begin(source.model_dump(mode="json"))) is not None:
        return earlier
    with idempotent.working():
        if (fault := source_fault(services, source.url, source.filename)) is not None:
            code, message, hint = fault
            raise unprocessable([ErrorItem(code=code, message=message, pointer=pointer_to("url"), hint=hint)])
        name = source.filename or source_name(source.url)
        with begun_upload(services, idempotent.records, name, source_url=source.url) as (work, upload):
            headers = {"Location": f"/v1/uploads/{upload.id}", "Retry-After": str(FETCH_RETRY_S)}
            body = UploadState.from_upload(upload, 0).model_dump_json()
            answer = idempotent.store(work, Answer(202, headers, body))
    return answer.response()


@router.get("/{upload_id}", summary="Read an upload", responses=problems(400, 404, 421, 422))
def get_upload_state(upload_id: UploadId, services: ServicesDep, records: UploadsDep) -> UploadState:
    """Read the state of an upload: how many of its bytes are there, and the error of a fetch that failed."""
    upload = records.uploads.get(upload_id)
    return UploadState.from_upload(upload, services.uploads.offset(upload))


RESOURCE = Resource(router=router)
