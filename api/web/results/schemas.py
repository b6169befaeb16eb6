"""Bodies about result files."""

from typing import Self

from pydantic import Field

from api.web.contract.schemas import ResponseModel, fields_of
from api.web.http.file_names import result_name
from pipeline.core.options.config import FILE_FORMATS
from worker.store.model.jobs import JobRecord, Result


class ResultOut(ResponseModel):
    """Result file of a job."""

    name: str = Field(description="Name of the file.")
    kind: str = Field(description="Kind of the file, such as `bvh`, `skeletons`, `metrics`.")
    person: str | None = Field(description="Person in the file; null if it concerns all people.")
    person_name: str | None = Field(
        description="Name of the person, such as `Anna`, or `person-1` if no edit gave one; null if it concerns all "
        "people."
    )
    format: str | None = Field(description="Format of a person's or of all people's motion, a value of `exports`.")
    preset: str | None = Field(description="Preset of a BVH or FBX file; null of other files.")
    download_name: str = Field(
        description="Name under which clients save the file; it tells takes, and revisions of the edits, apart."
    )
    media_type: str = Field(description="Content type of the file.")
    num_bytes: int = Field(description="Size of the file.")
    sha256: str = Field(description="SHA-256 of the file in hexadecimal; it is the file's strong ETag, too.")
    revision: int = Field(description="Revision of the edits that the file shows.")
    link: str = Field(description="Path of the file.")

    @classmethod
    def of(cls, job: JobRecord, result: Result) -> Self:
        """Build the response from a result of a job."""
        form = next((form for name, form in FILE_FORMATS.items() if name == result.kind), None)
        return cls(
            format=result.kind if form is not None else None,
            preset=job.spec.bvh if form is not None and form.has_presets else None,
            download_name=result_name(job.session_name, result.name, result.revision, result.person_name),
            link=f"/v1/jobs/{job.id}/results/{result.name}",
            **fields_of(result, cls, without=("format", "preset", "download_name", "link")),
        )


class ResultList(ResponseModel):
    """All result files of a job."""

    results: tuple[ResultOut, ...]
