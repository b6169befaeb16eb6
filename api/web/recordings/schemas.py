"""Bodies of recordings: requests of hosts, and recordings with their phones and takes."""

from collections.abc import Mapping
from typing import Annotated, Any, Self
from uuid import UUID

from pydantic import AfterValidator, AwareDatetime, Field
from pydantic_core import PydanticCustomError

from api.web.calibrations.schemas import BOARD_PATTERN
from api.web.contract.schemas import ID, FindingOut, Id, NextCursor, RequestModel, ResponseModel, printable_name
from pipeline.calibration.camera_names import MAX_NAME_LENGTH, name_problem
from pipeline.core.options.job_choices import MAX_STATURE_M, MAX_STATURES, MIN_STATURE_M
from pipeline.core.problems.request_codes import WRONG_FORMAT
from worker.store.model import phone_records
from worker.store.spec import JobSpec


def camera_name(text: str) -> str:
    """Refuse a name that a calibration refuses for a camera."""
    if fault := name_problem(text):
        raise PydanticCustomError(WRONG_FORMAT, "The name {fault}", {"fault": fault})
    return text


PhoneName = Annotated[
    str,
    AfterValidator(printable_name),
    AfterValidator(camera_name),
    Field(
        min_length=1,
        max_length=MAX_NAME_LENGTH,
        description="Name of the phone, and of its camera in sessions; without slashes.",
        examples=["Left"],
    ),
]
TakeName = Annotated[
    str, AfterValidator(printable_name), Field(min_length=1, max_length=200, description="Name of the take.")
]
ServerTime = Annotated[
    float,
    Field(
        ge=0.0,
        le=1e11,
        allow_inf_nan=False,
        description="Seconds since 1970 by the service's clock.",
        examples=[1_772_357_400.0],
    ),
]


class RecordingSpec(RequestModel):
    """Recording to be opened. Unknown fields are refused."""

    name: Annotated[str, AfterValidator(printable_name)] = Field(
        default="Recording", min_length=1, max_length=200, description="Name for people.", examples=["Rehearsal"]
    )
    expires_in_s: float | None = Field(default=None, ge=60.0, allow_inf_nan=False)
    """Seconds until the recording ends, with its link and with uploads that no session took; by default a day, or the
    service's limit."""


class VideoSettings(RequestModel):
    """Size and rate of the video that phones are asked for. Unknown fields are refused."""

    width: int = Field(ge=16, le=16_384, description="Width in pixels.")
    height: int = Field(ge=16, le=16_384, description="Height in pixels.")
    frame_rate_hz: float = Field(ge=1.0, le=1000.0, allow_inf_nan=False, description="Frames a second.")


class TakeSessionSpec(RequestModel):
    """Session to be made from a take. Unknown fields are refused."""

    calibration_id: UUID = Field(description="Calibration whose cameras have the names of the phones.")
    name: TakeName | None = Field(default=None, description="Name of the session; by default the name of the take.")
    job: JobSpec | None = Field(default=None, examples=[{}])
    """Choices of a job that reconstructs the session at once; null: none. Without `sync`, it measures the clocks within
    their uncertainty (`auto`)."""


class TakeCalibrationSpec(RequestModel):
    """Calibration to be made from a take. Unknown fields are refused."""

    name: TakeName | None = Field(default=None, description="Name of the calibration; by default the name of the take.")
    stature_m: tuple[Annotated[float, Field(ge=MIN_STATURE_M, le=MAX_STATURE_M)], ...] = Field(
        default=(), max_length=MAX_STATURES, examples=[[1.78]]
    )
    """Statures in metres of the people who walk about; or `board`."""
    board: str | None = Field(default=None, max_length=100, pattern=BOARD_PATTERN)
    """Board that is shown, as in calibrations; or `stature_m`."""

    def spec(self, cameras: tuple[Mapping[str, Any], ...], name: str) -> dict[str, Any]:
        """Choices of the calibration as ``CalibrationSpec`` has them."""
        method = "people" if self.board is None else "board"
        return {
            "method": method,
            "name": self.name or name,
            "stature_m": list(self.stature_m),
            "board": self.board,
            "cameras": list(cameras),
        }


class PhoneOut(ResponseModel):
    """Phone of a recording."""

    number: int = Field(description="Number of the phone, from 1.")
    name: str = Field(description="Name of the phone, and of its camera in sessions.", examples=["Phone 1"])
    device: str = Field(description="What the phone's browser says of itself.", examples=["Chrome, Android"])
    joined_at: AwareDatetime = Field(description="Time at which it joined first.")
    is_removed: bool = Field(description="Whether the host has removed it for good.")


class ClipFileOut(ResponseModel):
    """Part of a clip that was uploaded completely."""

    part: int = Field(description="Number of the part, from 1; another one begins when the phone's page is reloaded.")
    upload_id: Id = Field(description="Upload with the video.")
    num_bytes: int = Field(description="Size of the video.", examples=[24_117_248])
    first_frame_s: ServerTime = Field(description="Time of the first frame by the service's clock.")
    std_s: float = Field(description="Standard deviation of that time.", examples=[0.0031])
    duration_s: float = Field(description="Duration of the video as the phone measured it.", examples=[31.2])
    facts: dict[str, Any] = Field(examples=[{"num_frames": 936, "dropped_frames": 0}])
    """Further facts from the phone: the fields of its message `file`."""


class ClipOut(ResponseModel):
    """Clip of a take by one phone."""

    phone: int = Field(description="Number of the phone.")
    started: dict[str, Any] | None = Field(description="Message `started` of the phone; null: it sent none.")
    stopped: dict[str, Any] | None = Field(description="Message `stopped` of the phone; null: it sent none.")
    files: tuple[ClipFileOut, ...] = Field(description="Parts that were uploaded, in order.")
    used_part: int | None
    """Part that a session takes: the longest one, because its videos have no gaps. Null until one is uploaded."""

    @classmethod
    def from_clip(cls, clip: phone_records.TakeClip) -> Self:
        """Build the response from a clip."""
        return cls.from_record(clip, used_part=None if clip.longest is None else clip.longest.part)


class TakeOut(ResponseModel):
    """Take of a recording."""

    number: int = Field(description="Number of the take, from 1.")
    name: str = Field(description="Name of the take.", examples=["Take 1"])
    state: phone_records.TakeState = Field(examples=["recorded"])
    """`recording`; `recorded`: the clips are on the phones or on their way; `used`: a session or a calibration was made
    from it; `discarded`."""
    start_s: ServerTime = Field(description="Time at which phones start, by the service's clock.")
    stop_s: ServerTime = Field(
        description="Time at which they stop; until the host stops them, the latest one.", examples=[1_772_357_431.0]
    )
    settings: VideoSettings | None = Field(description="Size and rate that phones are asked for; null: what they can.")
    is_upload_wanted: bool = Field(description="Whether phones are asked to send their clips.", examples=[True])
    session_id: Id | None = Field(description="Session that was made from it; it may be deleted since.")
    job_id: Id | None = Field(description="Job that was queued with the session.")
    calibration_id: Id | None = Field(description="Calibration that was made from it, by the job of the same id.")
    clips: tuple[ClipOut, ...] = Field(description="Clips of the phones, in the order of their numbers.")

    @classmethod
    def from_take(cls, take: phone_records.RecordingTake, now_s: float) -> Self:
        """Build the response from a take, at a time by the service's clock."""
        clips = tuple(map(ClipOut.from_clip, take.clips))
        return cls.from_record(take, state=take.state(now_s), settings=take.settings or None, clips=clips)


class RecordingOut(ResponseModel):
    """Recording: its phones and its takes."""

    id: Id
    name: str = Field(description="Name for people.", examples=["Rehearsal"])
    created_at: AwareDatetime = Field(description="Time of the creation.")
    expires_at: AwareDatetime = Field(description="Time at which it ends, with its link and its unused uploads.")
    phones: tuple[PhoneOut, ...] = Field(description="Phones that have joined, in the order of their numbers.")
    takes: tuple[TakeOut, ...] = Field(description="Takes, in the order of their numbers.")

    @classmethod
    def from_recording(cls, recording: phone_records.RecordingSession, now_s: float, **computed: Any) -> Self:
        """Build the response from a recording, at a time by the service's clock."""
        takes = tuple(TakeOut.from_take(take, now_s) for take in recording.takes)
        return cls.from_record(recording, takes=takes, **computed)


class JoinOut(ResponseModel):
    """Link by which phones join, shown once."""

    url: str = Field(examples=[f"https://192.168.1.20:8443/record#join={ID}.mcl_..."])
    """Address for phones. The secret is behind the hash, which browsers do not send."""
    secret: str = Field(examples=["mcl_..."])
    """Secret of the link, `mcl_...`, for `Authorization` and subprotocols."""
    qr_svg: str = Field(examples=['<svg xmlns="http://www.w3.org/2000/svg" ...></svg>'])
    """Address as a QR code, an SVG."""
    expires_at: AwareDatetime = Field(description="Time at which the link ends; another link ends it before.")


class NewRecordingOut(RecordingOut):
    """Recording that was opened, or got another link."""

    join: JoinOut


class RecordingPage(ResponseModel):
    """Page of recordings, the newest first."""

    recordings: tuple[RecordingOut, ...]
    next_cursor: NextCursor


class TakeSessionOut(ResponseModel):
    """Session that was made from a take."""

    session_id: Id
    job_id: Id | None = Field(description="Job that reconstructs it; null without `job`.")
    cameras: dict[str, float] = Field(examples=[{"Phone 1": 0.0124, "Phone 2": 0.0311}])
    """Declared offset of each camera's first frame from the start of the take, in seconds."""
    warnings: tuple[FindingOut, ...]
    """Warnings about phones without a clip, and about parts that are not in the session."""
