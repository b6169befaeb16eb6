"""Forms that create records: names of their parts, and what each kind of form has."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from uuid import UUID

from pydantic import BaseModel, Field

from api.web.contract.schemas import UPLOAD_IDS, RequestModel, SourceUrl
from pipeline.core.problems.code_group import Code

VIDEOS, KEYPOINTS, CALIBRATION, TIMESTAMPS = "videos", "keypoints", "calibration", "timestamps"
INTRINSICS, IMAGES, CHARACTER, POINTS = "intrinsics", "images", "character", "points"
LABORATORY, OWN_POINTS = "laboratory", "own_points"
VIEWS = (VIDEOS, KEYPOINTS, IMAGES, POINTS)
"""Parts with a file for each camera, or several of 3D points; the other parts have one file."""

MANIFEST, SPEC = "manifest", "spec"

FORM_TYPE, JSON_TYPE = "multipart/form-data", "application/json"
"""Content types of the bodies: a form, and JSON that names uploads."""
EITHER_TYPE = (FORM_TYPE, JSON_TYPE)

CALIBRATION_ID = "calibration_id"
"""Document that names a stored calibration in place of a file."""

SESSION_ID = "session_id"
"""Field that names a stored session whose footage is used in place of files."""


class UploadedFiles(RequestModel):
    """Files that are sent as uploads, each given by the id of its upload. Unknown fields are refused."""

    def uploads(self) -> list[tuple[str, UUID | str]]:
        """Part of the form and id of each upload, or the URL that its file is fetched from."""
        return []

    def named(self) -> Iterable[str]:
        """Names of the form's documents that the fields stand for."""
        return ()

    def source_id(self) -> str | None:
        """Id of the session whose footage takes the place of files; ``None`` if files are sent."""
        return None

    def upload_ids(self) -> tuple[str, ...]:
        """Ids of all uploads."""
        return tuple(sorted({str(upload) for _, upload in self.uploads() if isinstance(upload, UUID)}))


class UploadedFootage(UploadedFiles):
    """Files of cameras that are sent as uploads. Unknown fields are refused."""

    videos: tuple[UUID | SourceUrl, ...] = Field(default=(), examples=[UPLOAD_IDS])
    """Uploads of the videos, one for each camera, or of a zip of its images. Or URLs of such files, whose names are the
    last parts of the paths: the service fetches them, and checks the files when all are there. Jobs of the session wait
    for them."""

    def uploads(self) -> list[tuple[str, UUID | str]]:
        """Part of the form and id or URL of each upload."""
        return [(VIDEOS, upload) for upload in self.videos]

    @property
    def has_urls(self) -> bool:
        """True if some videos are fetched."""
        return any(isinstance(video, str) for video in self.videos)


@dataclass(frozen=True, slots=True, kw_only=True)
class FormKind:
    """Kind of a form.

    - ``name``: name of the form's schema in the contract.
    - ``noun``: what is sent, for problems.
    - ``parts``: names of the parts with files, with their descriptions.
    - ``documents``: names of the other parts, with the models of their JSON; ``None`` for an id.
    - ``uploaded``: model of the JSON that takes the form's place and names uploads.
    - ``faults``: code, sentence and part of each fault of a complete form, by the numbers of its files and documents.
    - ``has_job``: true if the record is reconstructed at once.
    """

    name: str
    noun: str
    parts: Mapping[str, str]
    documents: Mapping[str, type[BaseModel] | None]
    uploaded: type[UploadedFiles]
    faults: Callable[[Mapping[str, int]], Iterable[tuple[Code, str, str]]] = lambda counts: ()
    has_job: bool = False

    @property
    def models(self) -> dict[str, type[BaseModel]]:
        """Models of the documents that are JSON, by the names of their parts."""
        return {part: model for part, model in self.documents.items() if model is not None}
