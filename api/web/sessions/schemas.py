"""Bodies and forms of capture sessions: requests of clients, and the session with the report of its check."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, Self
from urllib.parse import quote
from uuid import UUID

from pydantic import AwareDatetime, Field

from api.web.contract.schemas import ID, SHA256, FindingOut, Id, NextCursor, RequestModel, ResponseModel, SpaceOut
from api.web.errors import ErrorItem
from api.web.http.bodies import form_kinds
from api.web.sessions.manifest import Manifest, SessionName
from api.web.uploads.schemas import UploadState
from pipeline.core.options.job_choices import blurred_name, proxy_name
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import MISSING_PART, PART_NOT_ALLOWED
from pipeline.core.runtime.packages import samples
from pipeline.run.space import foreseen_space
from worker.store.model.session_records import Capture, SessionState
from worker.store.model.states import JobState
from worker.store.spec import JobSpec


class UploadedSession(form_kinds.UploadedFootage):
    """Session of uploaded files, each given by the id of its upload. Unknown fields are refused."""

    keypoints: tuple[UUID, ...] = ()
    """Uploads of keypoints in place of videos: for each camera a zip of its keypoint files, named as the camera or
    stated in `cameras` of the manifest; or FreeMoCap's array of all cameras."""
    points: tuple[UUID, ...] = ()
    """Uploads of 3D points of people at one time, in place of all other files."""
    calibration: UUID | None = Field(default=None, description="Upload of the calibration of all cameras.")
    calibration_id: UUID | None = Field(default=None, examples=[ID])
    """Id of a stored calibration, in place of `calibration`."""
    timestamps: UUID | None = None
    """Upload of the timestamps of keypoints: CSV with the columns camera, frame and time_s."""
    laboratory: UUID | None = None
    """Upload of a laboratory's C3D file beside videos or keypoints: force plates, channels, events."""
    own_points: UUID | None = None
    """Upload of rigid objects and bones among points of your own in the keypoints, YAML or JSON."""
    session_id: UUID | None = None
    """Id of a session whose videos, or keypoints with timestamps, are copied in place of files; such as the session of
    a calibration. Cameras, clock, rates, `sync` and `timeline` that `manifest` leaves unset are copied, too."""
    manifest: Manifest = Field(default=Manifest(), examples=[{"name": "Handshake, take 3"}])

    def uploads(self) -> list[tuple[str, UUID | str]]:
        """Part of the form and id or URL of each upload."""
        single = [(part, getattr(self, part)) for part in ("calibration", "timestamps", "laboratory", "own_points")]
        several = [(part, upload) for part in ("keypoints", "points") for upload in getattr(self, part)]
        return [*super().uploads(), *several, *((part, upload) for part, upload in single if upload is not None)]

    def named(self) -> Iterable[str]:
        """Names of the form's documents that the fields stand for."""
        return () if self.calibration_id is None else ("calibration_id",)

    def source_id(self) -> str | None:
        """Id of the session whose videos or keypoints are copied."""
        return None if self.session_id is None else str(self.session_id)


class UploadedCapture(UploadedSession):
    """Session of uploaded files with the choices of its job. Unknown fields are refused."""

    spec: JobSpec = Field(default=JobSpec(), examples=[{"exports": ["bvh", "glb"]}])


class FileOut(ResponseModel):
    """File of a session."""

    name: str = Field(description="Name of the file.", examples=["cam_0.mp4"])
    kind: str = Field(examples=["video"])
    """Kind of the file: `video`, `keypoints`, `points`, `calibration`, `timestamps`, `laboratory` or
    `own_points`."""
    num_bytes: int = Field(description="Size of the file.", examples=[5_242_880])
    sha256: str = Field(description="SHA-256 of the file in hexadecimal.", examples=[SHA256])
    is_deleted: bool = False
    """True if the file was deleted, and is known by its SHA-256 alone."""


class ThumbnailOut(ResponseModel):
    """Small copy of a picture of a video."""

    time_s: float = Field(description="Time of the picture on the session's clock.")
    url: str = Field(description="Path of the JPEG, whose longer side is at most 320 pixels.")


class CameraOut(ResponseModel):
    """Camera of the calibration with its video or its keypoints.

    A player shows the frame of the session's time t at ``t - start_time_s + media_start_s``.
    """

    name: str = Field(description="Name of the camera in the calibration.", examples=["cam_0"])
    file: str = Field(description="Name of the file with the camera's video or keypoints.", examples=["cam_0.mp4"])
    more_files: tuple[str, ...] = ()
    """Names of further files in which the camera's recording goes on, in order."""
    size_px: tuple[int, int] = Field(description="Width and height of the frames.", examples=[[1280, 720]])
    frame_rate_hz: float = Field(description="Frame rate of the video or the keypoints.", examples=[25.0])
    num_frames: int = Field(description="Number of frames in the file.", examples=[300])
    start_time_s: float = Field(description="Time of the camera's first frame on the session's clock.", examples=[0.0])
    plays_in_browsers: bool = Field(description="Whether browsers play the video that was sent.", examples=[True])
    video_url: str | None = Field(examples=[f"/v1/sessions/{ID}/videos/cam_0"])
    """Path of a video that browsers play: the one that was sent, or a proxy of it. Null until the proxy is made, and
    for keypoints. If `shows_blurred`, a copy with blurred heads; null until it is made."""
    media_start_s: float = Field(examples=[0.0])
    """Time of the first frame on the clock of the video at `video_url`."""
    thumbnails: tuple[ThumbnailOut, ...] = ()
    """Pictures at which the check looked, ascending in time; `pictures` of a finding's evidence has their places in
    this list. None for keypoints, and if `shows_blurred`."""

    @classmethod
    def from_capture(cls, capture: Capture, number: int) -> Self:
        """Build the response from a camera of a session, by its number."""
        camera = capture.session.preflight.cameras[number]
        plays = camera.media_type is not None
        is_there = capture.session.videos_deleted_at is None
        is_sent_shown = plays and is_there and not capture.is_blurred
        is_copy_made = blurred_name(number) in capture.blurred or (
            not capture.is_blurred and proxy_name(number) in capture.proxies
        )
        session, name = f"/v1/sessions/{capture.session.id}", quote(camera.name, safe="")
        path = f"{session}/videos/{name}"
        return cls.from_record(
            camera,
            plays_in_browsers=plays,
            video_url=path if is_sent_shown or is_copy_made else None,
            media_start_s=camera.media_start_s if is_sent_shown else 0.0,
            thumbnails=tuple(
                ThumbnailOut(time_s=thumbnail.time_s, url=f"{session}/thumbnails/{name}/{number}")
                for number, thumbnail in enumerate(camera.thumbnails if is_there and not capture.is_blurred else ())
            ),
        )


class TimebaseOut(ResponseModel):
    """Clock of the output frames: frame k is at ``start_time_s + k / frame_rate_hz``."""

    start_time_s: float = Field(description="Time of output frame 0.", examples=[0.0])
    frame_rate_hz: float = Field(description="Output frames a second.", examples=[25.0])
    num_frames: int = Field(description="Number of output frames.", examples=[300])


class LayoutOut(ResponseModel):
    """Layout in which points without names were read."""

    name: str = Field(description="Name of the layout, as `layout` of the manifest states it.")
    told_by: Literal["choice", "number", "pictures", "world", "points"]
    """How the layout was told: stated by the manifest; by the number of points; by lengths of people in the pictures or
    in the world; or the detected points are the same in all layouts."""
    num_people: int = Field(description="Detections of people whose lengths told it; 0 otherwise.")


class PreflightOut(ResponseModel):
    """Result of the check of a session's files."""

    cameras: tuple[CameraOut, ...] = Field(description="Cameras of the session.")
    timebase: TimebaseOut = Field(description="Clock of the output frames.")
    findings: tuple[FindingOut, ...] = Field(description="Findings of the check.")
    layout: LayoutOut | None = None
    """Layout of keypoints whose files do not name their points; null for others."""

    @classmethod
    def from_capture(cls, capture: Capture) -> Self:
        """Build the response from a session and its proxies."""
        preflight = capture.session.preflight
        cameras = tuple(CameraOut.from_capture(capture, number) for number in range(len(preflight.cameras)))
        return cls.from_record(preflight, cameras=cameras)


class SessionUrls(ResponseModel):
    """Paths of a session and of its jobs."""

    self: str = Field(description="Path of the session.", examples=[f"/v1/sessions/{ID}"])
    jobs: str = Field(description="Path of the session's jobs.", examples=[f"/v1/sessions/{ID}/jobs"])


class NewestJobOut(ResponseModel):
    """Newest job of a session."""

    id: Id
    state: JobState = Field(description="State of the job.")


class SessionChanges(RequestModel):
    """Changes of a session. Unknown fields are refused."""

    name: SessionName


class SessionOut(ResponseModel):
    """Capture session."""

    id: Id
    name: str = Field(description="Name of the session for people.", examples=["Handshake, take 3"])
    created_at: AwareDatetime = Field(description="Time of the creation.")
    state: SessionState = Field(examples=["ready"])
    """`fetching` while the service fetches videos from URLs and checks them: `files` and `preflight` are empty, and
    jobs wait; `failed` if they can't be used."""
    fetches: tuple[UploadState, ...] = ()
    """Uploads that the session waits for; `received_bytes` are some seconds old."""
    errors: tuple[ErrorItem, ...] = ()
    """Everything that is wrong with a session that failed. Delete it, and send it again."""
    files: tuple[FileOut, ...] = Field(description="Files of the session.")
    num_bytes: int = Field(description="Size of all files that are not deleted.", examples=[5_242_880])
    videos_deleted_at: AwareDatetime | None = None
    """Time at which the session's videos were deleted, with their thumbnails and proxies; null: they are there, or it
    has keypoints."""
    duration_s: float = Field(description="Duration: output frames divided by the frame rate.", examples=[12.0])
    num_jobs: int = Field(description="Number of the session's reconstructions.")
    newest_job: NewestJobOut | None = Field(description="Reconstruction that was queued last; null without any.")
    proxies_job: NewestJobOut | None
    """Job that makes small copies of the videos that browsers can't play; null if none had to."""
    shows_blurred: bool = False
    """True if a job of the session has `blur_faces`: videos are shown with blurred heads alone, and thumbnails not at
    all. False until the first such job ends, if an earlier job has shown the videos."""
    preflight: PreflightOut = Field(description="Result of the check of the files.")
    sync: Literal["declared", "auto"] = Field(description="Synchronisation of jobs whose spec does not state `sync`.")
    timeline: Literal["take", "person"]
    """Frames of the files of jobs whose spec does not state `timeline`."""
    space: SpaceOut | None = None
    """Space that a reconstruction of the session with the default choices is foreseen to need; null of a session that
    was sent for a calibration, and until its files are there."""
    metadata: dict[str, Any] = Field(description="Metadata of the manifest.", examples=[{"scene": 12}])
    notes: dict[str, str] = Field(examples=[{}])
    """Known causes of warnings, by code: of the sample capture; empty for others."""
    urls: SessionUrls

    @classmethod
    def from_capture(cls, capture: Capture) -> Self:
        """Build the response from a session and its jobs."""
        session = capture.session
        address = f"/v1/sessions/{session.id}"
        has_space = session.purpose != "calibration" and session.state == "ready"
        return cls.from_record(
            session,
            fetches=tuple(UploadState.from_upload(upload) for upload in capture.uploads),
            files=tuple(
                FileOut.from_record(file, is_deleted=file not in session.stored_files) for file in session.files
            ),
            num_bytes=sum(file.num_bytes for file in session.stored_files),
            duration_s=session.preflight.duration_s,
            num_jobs=capture.num_jobs,
            newest_job=capture.newest_job,
            proxies_job=capture.proxies_job,
            shows_blurred=capture.is_blurred,
            preflight=PreflightOut.from_capture(capture),
            sync=session.preflight.sync,
            timeline=session.preflight.timeline,
            notes=samples.notes_about([file.sha256 for file in session.files if file.kind == "video"]),
            space=foreseen_space(session.preflight, JobSpec().config) if has_space else None,
            urls=SessionUrls(self=address, jobs=f"{address}/jobs"),
        )

    def for_link(self) -> Self:
        """Session as a link to one of its jobs shows it: nothing of its other jobs, and no data of the client."""
        return self.model_copy(update={"num_jobs": 1, "newest_job": None, "proxies_job": None, "metadata": {}})


class SessionPage(ResponseModel):
    """Page of sessions, the newest session first."""

    sessions: tuple[SessionOut, ...]
    next_cursor: NextCursor


def _session_faults(counts: Mapping[str, int]) -> Iterator[tuple[Code, str, str]]:
    if counts[form_kinds.POINTS]:
        for part in counts.keys() - {form_kinds.POINTS, form_kinds.MANIFEST, form_kinds.SPEC}:
            yield PART_NOT_ALLOWED, "A session of 3D points has no such part.", part
        return
    if not any(counts[part] for part in form_kinds.VIEWS):
        yield MISSING_PART, "There are no videos and no keypoints: a session needs either.", form_kinds.VIDEOS
    if not counts[form_kinds.CALIBRATION] and not counts[form_kinds.CALIBRATION_ID]:
        yield MISSING_PART, "There is no calibration: a session needs one.", form_kinds.CALIBRATION
    if counts[form_kinds.CALIBRATION] and counts[form_kinds.CALIBRATION_ID]:
        message = "There is a calibration and a calibration_id: a session needs one of both."
        yield PART_NOT_ALLOWED, message, form_kinds.CALIBRATION_ID
    if counts[form_kinds.VIDEOS]:
        for part in (form_kinds.KEYPOINTS, form_kinds.TIMESTAMPS, form_kinds.OWN_POINTS):
            if counts[part]:
                yield PART_NOT_ALLOWED, "A session of videos has no such files.", part


_PARTS: Mapping[str, str] = {
    form_kinds.VIDEOS: "Videos, one for each camera.",
    form_kinds.KEYPOINTS: "Keypoints in place of videos: for each camera a zip of its keypoint files, named as the "
    "camera or stated in `cameras` of the manifest; or FreeMoCap's array of all cameras, which `pair_by_order` of the "
    "manifest pairs with the cameras.",
    form_kinds.POINTS: "3D points of people at one time, in place of all other files: TRC, C3D, BVH, CSV, NetCDF, NPY "
    "or JSON; or a zip of a JSON file a frame.",
    form_kinds.CALIBRATION: "Calibration of all cameras; or `calibration_id`.",
    form_kinds.TIMESTAMPS: "Timestamps of keypoints: CSV with the columns camera, frame and time_s.",
    form_kinds.LABORATORY: "C3D file of a laboratory beside videos or keypoints: force plates, channels, events.",
    form_kinds.OWN_POINTS: "Rigid objects and bones among points of your own in the keypoints, YAML or JSON.",
}

SESSION_FORM = form_kinds.FormKind(
    name="SessionForm",
    noun="session",
    parts=_PARTS,
    documents={form_kinds.CALIBRATION_ID: None, form_kinds.MANIFEST: Manifest},
    uploaded=UploadedSession,
    faults=_session_faults,
)
CAPTURE_FORM = form_kinds.FormKind(
    name="CaptureForm",
    noun="session",
    parts=_PARTS,
    documents={form_kinds.CALIBRATION_ID: None, form_kinds.MANIFEST: Manifest, form_kinds.SPEC: JobSpec},
    uploaded=UploadedCapture,
    faults=_session_faults,
    has_job=True,
)
"""A session that is reconstructed at once."""
