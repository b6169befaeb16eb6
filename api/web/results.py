"""Routes of results: list a job's result files, download one file, a range of it, or all files as a zip."""

from collections.abc import Generator, Sequence
from typing import Annotated, Self

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import Field
from zipstream import ZIP_DEFLATED, ZIP_STORED, ZipStream

from api.web import downloads
from api.web.auth import ALL_RESULTS, FileViewDep, JobViewDep
from api.web.contract.description import Resource, file_content, problems
from api.web.contract.schemas import ID, SHA256, ResponseModel
from api.web.dependencies import JobId, Services, ServicesDep
from api.web.downloads import archived_name, content_disposition, download_stem, result_name
from api.web.http.conditional import ByteRange
from pipeline.core.options.file_formats import FILE_FORMATS
from worker.store.errors import DamagedArtifact, NotFound
from worker.store.model.job_records import JobRecord, Result


class ResultOut(ResponseModel):
    """Result file of a job."""

    name: str = Field(description="Name of the file.", examples=["person-1.bvh"])
    kind: str = Field(description="Kind of the file, such as `bvh`, `skeletons`, `metrics`.", examples=["bvh"])
    person: int | None = Field(examples=[1])
    """Id of the person in the file; null if it concerns all people."""
    person_name: str | None = Field(examples=["Anna"])
    """Name of the person, such as `Anna`, or `person-1` if no edit gave one; null if it concerns all people."""
    format: str | None = Field(examples=["bvh"])
    """Format of a person's or of all people's motion, a value of `exports`."""
    preset: str | None = Field(description="Preset of a BVH or FBX file; null of other files.", examples=["default"])
    download_name: str = Field(examples=["handshake-take-3_person-1-anna.bvh"])
    """Name under which clients save the file; it tells takes, and revisions of the edits, apart."""
    media_type: str = Field(description="Content type of the file.", examples=["text/plain; charset=utf-8"])
    num_bytes: int = Field(description="Size of the file.", examples=[204_800])
    sha256: str = Field(examples=[SHA256])
    """SHA-256 of the file in hexadecimal; it is the file's strong ETag, too."""
    revision: int = Field(description="Revision of the edits that the file shows.")
    url: str = Field(description="Path of the file.", examples=[f"/v1/jobs/{ID}/results/person-1.bvh"])

    @classmethod
    def from_result(cls, job: JobRecord, result: Result) -> Self:
        """Build the response from a result of a job."""
        form = next((form for name, form in FILE_FORMATS.items() if name == result.kind), None)
        return cls.from_record(
            result,
            format=result.kind if form is not None else None,
            preset=job.spec.preset if form is not None and form.has_presets else None,
            download_name=result_name(job.session_name, result.name, result.revision, result.person_name),
            url=f"/v1/jobs/{job.id}/results/{result.name}",
        )


class ResultList(ResponseModel):
    """All result files of a job."""

    results: tuple[ResultOut, ...]


router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])

# A file whose type is not known is declared first: generators of clients read what is declared first.
_TYPES = (
    "application/octet-stream",
    *(form.media_type.partition(";")[0] for form in FILE_FORMATS.values()),
    "application/json",
    "image/svg+xml",
    "text/html",
    "video/mp4",
)
_NAME = "person-1.bvh"
_FILE = file_content(dict.fromkeys(_TYPES))


@router.get("/results", summary="List a job's result files", responses=problems(404, 409))
def list_results(job_id: JobId, records: JobViewDep) -> ResultList:
    """List the result files of the last revision that was finished, also while files of a newer one are made."""
    results = records.results.downloads(job_id)
    job = records.jobs.get(job_id)
    return ResultList(results=tuple(ResultOut.from_result(job, result) for result in results))


@router.get(
    f"/{ALL_RESULTS}",
    summary="Download all result files",
    response_class=Response,
    responses={
        200: {
            "description": "Zip archive of all result files.",
            "content": file_content(["application/zip"]),
            "headers": {"Content-Disposition": downloads.HEADERS["Content-Disposition"]},
        },
        **problems(404, 409, 410),
    },
)
def get_all_results(job_id: JobId, services: ServicesDep, records: FileViewDep) -> Response:
    """Download all result files of a job as one archive, with a folder for each person, and one for overlay videos."""
    results = records.results.downloads(job_id)
    _require_whole(services, results)
    job = records.jobs.get(job_id)
    # Compressed while it is sent, in the API's process: the fastest level halves the size of a session's files.
    archive = ZipStream(compress_type=ZIP_DEFLATED, compress_level=1)
    for result in results:
        is_video = result.media_type.startswith("video/")
        of_person = None if result.person is None else f"person-{result.person}"
        folder = result.kind if is_video else of_person
        name = archived_name(job.session_name, result.name, folder, result.revision, result.person_name)
        # Videos are compressed already.
        archive.add(_content(services, result), name, compress_type=ZIP_STORED if is_video else ZIP_DEFLATED)
    headers = {
        "Cache-Control": "private, no-cache",
        **content_disposition(f"{download_stem(job.session_name, job.results_revision or 0)}.zip"),
    }
    return downloads.Stream(iter(archive), headers=headers, media_type="application/zip")


def _content(services: Services, result: Result) -> Generator[bytes, None, None]:
    """Blocks of a file, which is opened with the first block."""
    yield from downloads.file_blocks(services.artifacts.open(result.key, result.sha256), ByteRange(0, result.num_bytes))


def _require_whole(services: Services, results: Sequence[Result]) -> None:
    """Raise the problem of all damaged files, or of the first missing file."""
    wrong = []
    for result in results:
        try:
            services.artifacts.open(result.key, result.sha256).close()
        except NotFound:
            raise downloads.expired() from None
        except DamagedArtifact:
            wrong.append(result.name)
    if wrong:
        raise downloads.damaged(wrong)


@router.get(
    "/results/{name}",
    summary="Download a result file",
    response_class=Response,
    responses={**downloads.file_responses(_FILE, f"jobs/{ID}/results/{_NAME}"), **problems(404, 409, 410, 416, 422)},
)
def get_result(
    job_id: JobId,
    name: Annotated[
        str, Path(description="Name of a result file.", openapi_examples={"bvh": {"value": "person-1.bvh"}})
    ],
    request: Request,
    services: ServicesDep,
    records: FileViewDep,
    conditions: downloads.ConditionsDep,
    redirect: Annotated[
        bool,
        Query(
            description="False: the service sends the file itself, also where its artifact store could. Pages whose "
            "Content-Security-Policy allows the service alone need it."
        ),
    ] = True,
) -> Response:
    """Download a result file: the whole file, or a range, such as the rest of an interrupted download.

    Clients save it under a name that begins with the name of the take, such as `handshake-take-3_person-1.bvh`. After
    edits of its people the name tells their revision, and the name of a person who was given one:
    `handshake-take-3_revision-2_person-1-anna.bvh`.
    """
    result = records.results.get(job_id, name)
    job = records.jobs.get(job_id)
    name = result_name(job.session_name, result.name, result.revision, result.person_name)
    download = downloads.Download.from_result(result, name)
    return downloads.send_file(request, services, download, conditions, may_redirect=redirect)


RESOURCE = Resource(router=router)
