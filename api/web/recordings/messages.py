"""Messages of a recording's WebSocket in JSON, of phones, hosts and the service, and their AsyncAPI document."""

from typing import Annotated, Any, Literal, get_args
from uuid import UUID

from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field, TypeAdapter

from api.web.contract.asyncapi import SocketChannel, describe_sockets
from api.web.contract.schemas import ID, RequestModel, ResponseModel, printable_name
from api.web.http.websockets import SocketProblemOut
from api.web.recordings.schemas import PhoneName, RecordingOut, ServerTime, TakeName, VideoSettings
from worker.store.model.phone_records import TakeState

_Number = Annotated[int, Field(ge=1, le=100_000)]
_Count = Annotated[int, Field(ge=0, le=10**15)]
_Seconds = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]
_OwnTime = Annotated[
    float, Field(ge=-1e12, le=1e12, allow_inf_nan=False, description="Time by the client's own clock, in seconds.")
]
_Word = Annotated[str, AfterValidator(printable_name), Field(min_length=1, max_length=100)]
_Std = Annotated[
    float, Field(ge=0.0, le=3600.0, allow_inf_nan=False, description="Standard deviation of the time, in seconds.")
]


class _Received(RequestModel):
    model_config = ConfigDict(strict=True)


class PhoneTrack(_Received):
    """Video track of a phone's camera, as its browser states it."""

    width: int = Field(ge=1, le=16_384, description="Width of the frames in pixels.")
    height: int = Field(ge=1, le=16_384, description="Height of the frames in pixels.")
    frame_rate_hz: float = Field(gt=0.0, le=1000.0, allow_inf_nan=False, description="Frames a second.")
    facing: _Word | None = Field(default=None, description="`facingMode` of the track.")
    label: _Word | None = Field(default=None, description="Name of the camera.")


class Capabilities(_Received):
    """Largest video of a phone, and what its browser can lock."""

    max_width: int = Field(ge=1, le=16_384, description="Largest width in pixels.")
    max_height: int = Field(ge=1, le=16_384, description="Largest height in pixels.")
    max_frame_rate_hz: float = Field(gt=0.0, le=1000.0, allow_inf_nan=False, description="Largest frame rate.")
    locks: tuple[_Word, ...] = Field(default=(), max_length=16, description="Settings that can be locked.")


class PhoneHello(_Received):
    """First message of a phone."""

    type: Literal["hello"]
    phone_id: str = Field(pattern=r"^[A-Za-z0-9_-]{20,64}$", examples=["f3c1b8f0-5a52-4d0e-9b52-7d0c1f3e9a10"])
    """Secret that the phone's browser made at random and keeps; its uploads bring it too."""
    name: PhoneName | None = Field(default=None, description="Name that the phone proposes at its first time.")
    device: _Word = Field(default="unknown", description="Short form of the browser and the device.")
    track: PhoneTrack | None = Field(default=None, examples=[{"width": 1920, "height": 1080, "frame_rate_hz": 30.0}])
    """PhoneTrack of the camera; null until it is allowed."""
    capabilities: Capabilities | None = Field(default=None, description="What the camera can do; null: unknown.")
    mime_types: tuple[_Word, ...] = Field(default=(), max_length=16, examples=[["video/mp4;codecs=avc1"]])
    """Types of video that it records."""


class ClientPing(_Received):
    """Question for the service's time; of phones and hosts."""

    type: Literal["ping"]
    t0_s: _OwnTime


class PhoneClock(_Received):
    """Clock of a phone, measured by its pings: ``server time = offset_s + own time``."""

    offset_s: float = Field(ge=-1e12, le=1e12, allow_inf_nan=False, description="Offset at the moment.")
    std_s: _Std
    drift_ppm: float = Field(default=0.0, ge=-1e5, le=1e5, allow_inf_nan=False, description="Drift.")


class PhoneSending(_Received):
    """Upload that a phone sends at the moment."""

    take: _Number
    part: _Number = 1
    sent_bytes: _Count
    num_bytes: _Count


class PhoneStatus(_Received):
    """State of a phone, as it says every second or so."""

    type: Literal["status"]
    state: Literal["idle", "ready", "live", "recording", "stopping", "sending", "hidden", "failed"] = Field(
        description="What the phone does.", examples=["recording"]
    )
    track: PhoneTrack | None = Field(default=None, description="PhoneTrack of the camera, if there is one.")
    battery: float | None = Field(default=None, ge=0.0, le=1.0, examples=[0.82])
    """Charge of the battery, 0 to 1."""
    charging: bool | None = Field(default=None, description="Whether it charges.")
    free_bytes: _Count | None = Field(default=None, description="Bytes that the browser may still store.")
    clock: PhoneClock | None = Field(
        default=None, examples=[{"offset_s": 1_772_357_100.25, "std_s": 0.0021, "drift_ppm": 3.1}]
    )
    """Clock; null until it is measured."""
    dropped_frames: _Count = Field(default=0, description="Frames of the take that were dropped so far.")
    pending_bytes: _Count = Field(default=0, examples=[7_340_032])
    """Bytes of clips that are not uploaded yet."""
    sending: PhoneSending | None = Field(default=None, description="Upload that it sends; null: none.")
    error: _Word | None = Field(default=None, description="What is wrong, for the host.")


class PhoneRename(_Received):
    """Name that the phone's user gives it."""

    type: Literal["rename"]
    name: PhoneName


class PhoneStarted(_Received):
    """A phone records a take, or continues with another part of it."""

    type: Literal["started"]
    take: _Number
    part: _Number = 1
    first_frame_s: ServerTime = Field(description="Time of the first frame by the service's clock.")
    std_s: _Std
    track: PhoneTrack | None = None
    mime_type: _Word | None = None


class PhoneStopped(_Received):
    """A phone has stopped to record a take; its clip is on the phone."""

    type: Literal["stopped"]
    take: _Number
    num_parts: _Number = 1
    num_bytes: _Count
    num_frames: _Count
    dropped_frames: _Count = 0
    lost_s: _Seconds = Field(default=0.0, description="Seconds that were lost, such as by a reload.")
    is_cut: bool = Field(default=False, description="Whether it ended by itself before the stop.")


class LostTime(_Received):
    """Time of a take of which a phone has no pictures."""

    from_s: ServerTime
    to_s: ServerTime


class PhoneFile(_Received):
    """An upload of a part of a clip is complete."""

    type: Literal["file"]
    take: _Number
    part: _Number = 1
    upload_id: UUID
    num_bytes: _Count
    first_frame_s: ServerTime
    std_s: _Std
    duration_s: _Seconds
    num_frames: _Count = 0
    dropped_frames: _Count = 0
    lost: tuple[LostTime, ...] = Field(default=(), max_length=100)
    track: PhoneTrack | None = None
    mime_type: _Word | None = None


class HostStart(_Received):
    """Start of a take on all phones."""

    type: Literal["start"]
    name: TakeName | None = Field(default=None, examples=["Handshake"])
    """Name of the take; null: `Take` and its number."""
    settings: VideoSettings | None = Field(default=None, description="Size and rate; null: what phones can.")


class HostStop(_Received):
    """Stop of the take on all phones."""

    type: Literal["stop"]


class HostRename(_Received):
    """Another name of a phone."""

    type: Literal["rename"]
    phone: _Number
    name: PhoneName


class HostRemove(_Received):
    """Removal of a phone for good."""

    type: Literal["remove"]
    phone: _Number


class HostUpload(_Received):
    """Request for the clips of a take."""

    type: Literal["upload"]
    take: _Number


class HostDiscard(_Received):
    """Removal of a take, from the phones too."""

    type: Literal["discard"]
    take: _Number


class Pong(ResponseModel):
    """Answer to a ping."""

    type: Literal["pong"] = "pong"
    t0_s: float = Field(description="Time of the ping, by the client's own clock.")
    server_s: ServerTime


class OfferedTake(ResponseModel):
    """Take as a phone needs to know it."""

    number: int
    name: str = Field(examples=["Take 1"])
    state: TakeState
    start_s: ServerTime
    stop_s: ServerTime = Field(description="Time of the stop; until the host stops it, the latest one.")
    settings: VideoSettings | None = None
    is_upload_wanted: bool = Field(description="Whether the phone is asked to send its clip.")
    parts: tuple[int, ...] = Field(description="Parts of the phone's clip that the service has.")


class PhoneWelcome(ResponseModel):
    """First message to a phone. All later messages state changes; after a reconnection this one states all."""

    type: Literal["welcome"] = "welcome"
    number: int = Field(description="Number of the phone.")
    name: str = Field(description="Name of the phone.", examples=["Phone 1"])
    recording_id: str = Field(examples=[ID])
    recording: str = Field(description="Name of the recording.", examples=["Rehearsal"])
    expires_at: AwareDatetime
    server_s: ServerTime
    takes: tuple[OfferedTake, ...]
    limits: dict[str, float] = Field(examples=[{"message_bytes": 16_384, "messages_per_s": 50.0, "idle_s": 30.0}])
    """Limits: `message_bytes`, `thumbnail_bytes`, `thumbnails_per_s`, `picture_bytes`, `pictures_per_s`,
    `messages_per_s`, `idle_s`."""
    request_id: str = Field(examples=[ID])


class StartOut(ResponseModel):
    """Start of a take at a time."""

    type: Literal["start"] = "start"
    take: int
    name: str = Field(examples=["Take 1"])
    at_server_s: ServerTime
    latest_stop_s: ServerTime = Field(description="Time at which the phone stops by itself.")
    settings: VideoSettings | None = None


class StopOut(ResponseModel):
    """Stop of a take at a time."""

    type: Literal["stop"] = "stop"
    take: int
    at_server_s: ServerTime


class RenameOut(ResponseModel):
    """Name of the phone, which the host or the service has chosen."""

    type: Literal["rename"] = "rename"
    name: str = Field(examples=["Left"])


class UploadOut(ResponseModel):
    """Request to send the clip of a take."""

    type: Literal["upload"] = "upload"
    take: int


class DeleteOut(ResponseModel):
    """The clip of a take is no longer needed: a session was made from it, or it was discarded."""

    type: Literal["delete"] = "delete"
    take: int


class LiveOut(ResponseModel):
    """Beginning or end of pictures for live captures; a phone sends none until it is told."""

    type: Literal["live"] = "live"
    is_on: bool
    size_px: tuple[int, int] | None = Field(description="Calibrated size of the camera; null: unknown.")


class EndedOut(ResponseModel):
    """The recording has ended, or the phone was removed; the connection is closed."""

    type: Literal["ended"] = "ended"
    reason: Literal["recording", "removed", "replaced"]
    """`recording`: it was deleted or its time is over; `removed`: the host removed the phone; `replaced`: the same
    phone has connected again."""


class LivePhoneOut(ResponseModel):
    """Phone as it is at the moment."""

    number: int
    is_connected: bool = Field(examples=[True])
    status: dict[str, Any] | None = Field(description="Last message `status` of the phone; null: none yet.")
    hello: dict[str, Any] | None
    """`track`, `capabilities` and `mime_types` of the phone's message `hello`; null: unknown."""


class HostState(ResponseModel):
    """All that hosts see, at each change; at most four times a second."""

    type: Literal["state"] = "state"
    recording: RecordingOut | None
    """The recording with its phones and takes; null: as in the state before. A take that is not stopped changes its
    state at `stop_s`."""
    live: tuple[LivePhoneOut, ...] = Field(description="Phones at the moment, in the order of their numbers.")
    relay: Literal["ok", "away"]
    """`away`: the broker does not answer, and phones at other API processes are seen late or not at all; recording
    continues."""
    server_s: ServerTime
    request_id: str = Field(examples=[ID])


class RecordingProblemOut(SocketProblemOut):
    """Problem of a message. With a `close_code` the connection is closed; without one it continues."""


PhoneMessage = PhoneHello | ClientPing | PhoneStatus | PhoneRename | PhoneStarted | PhoneStopped | PhoneFile
HostMessage = ClientPing | HostStart | HostStop | HostRename | HostRemove | HostUpload | HostDiscard
PHONE_RECEIVED: tuple[type[BaseModel], ...] = get_args(PhoneMessage)
HOST_RECEIVED: tuple[type[BaseModel], ...] = get_args(HostMessage)
PHONE_SENT: tuple[type[BaseModel], ...] = (
    *(PhoneWelcome, Pong, StartOut, StopOut, RenameOut, UploadOut, DeleteOut, LiveOut, EndedOut),
    RecordingProblemOut,
)
HOST_SENT: tuple[type[BaseModel], ...] = (HostState, Pong, EndedOut, RecordingProblemOut)

PHONE_MESSAGES: TypeAdapter[PhoneMessage] = TypeAdapter(Annotated[PhoneMessage, Field(discriminator="type")])
HOST_MESSAGES: TypeAdapter[HostMessage] = TypeAdapter(Annotated[HostMessage, Field(discriminator="type")])


_DESCRIPTION = """\
A recording by phones. Phones offer the subprotocols `multicap.recording` and `mc.link.` with the secret of the
recording's link behind it, and say `hello` first; hosts come with a key or the browser's cookie. Phones send small
JPEGs of their pictures as messages of bytes; hosts get them behind the phone's number, an unsigned integer of two
bytes, little-endian. For live captures phones send larger ones behind their times. All else is JSON.
`/help/recording-protocol` describes the order of messages, limits and close codes.
"""
_ADDRESS = "/v1/recordings/{recording_id}/connect"
_PARAMETERS = {"recording_id": "Id of the recording."}


def describe_recordings() -> dict[str, Any]:
    """AsyncAPI 3.0 document."""
    channels = [
        SocketChannel(
            name="phone",
            address=_ADDRESS,
            received=PHONE_RECEIVED,
            sent=PHONE_SENT,
            packed_received={
                "Thumbnail": "JPEG of the camera's picture, of at most 1,024 x 1,024 pixels.",
                "LivePicture": "`MCP1`, its time by the service's clock (double, little-endian), and such a JPEG.",
            },
            security=("link",),
            parameters=_PARAMETERS,
        ),
        SocketChannel(
            name="host",
            address=_ADDRESS,
            received=HOST_RECEIVED,
            sent=HOST_SENT,
            packed_sent={"ShownThumbnail": "Number of a phone, and a JPEG of its camera's picture."},
            parameters=_PARAMETERS,
        ),
    ]
    return describe_sockets("Multicap recordings by phones", _DESCRIPTION, channels)
