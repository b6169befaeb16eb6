"""Bodies of uploads that the service fetches, and of the state of any upload."""

from typing import Literal, Self

from pydantic import AwareDatetime, Field

from api.web.contract.schemas import Id, RequestModel, ResponseModel, SourceUrl
from pipeline.core.problems.code_group import Code
from worker.store.model.session_records import Upload


class UploadSource(RequestModel):
    """File that the service fetches. Unknown fields are refused."""

    url: SourceUrl
    filename: str | None = Field(default=None, examples=["cam01.mp4"])
    """Name of the file, by which its camera is found; by default the last part of the URL's path."""


class UploadError(ResponseModel):
    """Error that ended the fetch of an upload."""

    code: Code = Field(description="Stable code; `/help/problems` lists all codes.", examples=["source_not_found"])
    detail: str = Field(description="Description of the error, a sentence for a person.")
    hint: str | None = Field(description="Advice to the caller.")


class UploadState(ResponseModel):
    """Upload: a file that arrives in pieces."""

    id: Id
    filename: str = Field(description="Name of the file.", examples=["cam01.mp4"])
    state: Literal["receiving", "fetching", "finished", "failed"]
    """`receiving`: the client sends the file; `fetching`: the service fetches it."""
    received_bytes: int = Field(description="Bytes that are stored.", examples=[1_000_000])
    num_bytes: int | None = Field(examples=[5_242_880])
    """Bytes of the whole file; null until the source has answered."""
    error: UploadError | None = Field(description="Error that ended the fetch; null if it did not fail.")
    expires_at: AwareDatetime = Field(description="Time at which the upload is removed unless more bytes arrive.")

    @classmethod
    def from_upload(cls, upload: Upload, received_bytes: int | None = None) -> Self:
        """Build the response from an upload and the bytes that are stored; ``None``: as its row has them."""
        if received_bytes is None:
            received_bytes = upload.fetched_bytes
        if upload.problem is not None:
            state = "failed"
        elif upload.is_fetching:
            state = "fetching"
        else:
            state = "finished" if received_bytes == upload.num_bytes else "receiving"
        num_bytes = None if upload.is_size_unknown else upload.num_bytes
        return cls.from_record(
            upload,
            filename=upload.name,
            state=state,
            received_bytes=received_bytes,
            num_bytes=num_bytes,
            error=upload.problem,
        )
