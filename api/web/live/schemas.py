"""Messages of live captures in JSON, of clients and of the service, and their AsyncAPI document."""

from typing import Annotated, Any, Literal
from uuid import UUID

from pydantic import BaseModel, ConfigDict, FailFast, Field

from api.web.contract.asyncapi import SocketChannel, describe_sockets
from api.web.contract.schemas import ID, DescribedModel, RequestModel
from api.web.http.websockets import SocketProblemOut
from api.web.motion import MotionPose
from api.web.recordings.schemas import TakeCalibrationSpec
from api.web.sessions.manifest import SessionName, Up
from pipeline.core.options.config import DetectedJoints, Profile
from pipeline.run.live.packets import MAX_PX, MAX_TIME_S

Layout = Literal[
    "coco-17", "coco-18", "body-25", "body-25b", "halpe-26", "mediapipe-33", "coco-wholebody-133", "halpe-136"
]
POINTS: dict[Layout, int] = {
    "coco-17": 17,
    "coco-18": 18,
    "body-25": 25,
    "body-25b": 25,
    "halpe-26": 26,
    "mediapipe-33": 33,
    "coco-wholebody-133": 133,
    "halpe-136": 136,
}
"""Number of points of each layout."""
_Pixels = Annotated[float, Field(ge=-MAX_PX, le=MAX_PX, allow_inf_nan=False)]
_Score = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
# A message has room for tens of thousands of wrong numbers, of which the first one says enough.
_Points = Annotated[tuple[tuple[_Pixels, _Pixels, _Score], ...], FailFast(), Field(max_length=max(POINTS.values()))]


_Length = Annotated[float, Field(ge=0.0, le=2.0, allow_inf_nan=False)]
_Lengths = Annotated[tuple[_Length, ...], FailFast(), Field(max_length=64)]


class _Received(RequestModel):
    model_config = ConfigDict(strict=True)


class _Start(_Received):
    calibration: dict[str, Any] | list[Any] | None = None
    """Content of a calibration file in one of the formats in JSON that sessions accept; or `calibration_id`."""
    calibration_id: UUID | None = Field(default=None, examples=[ID])
    """Calibration of the service, of any format; or `calibration`."""
    units: Literal["m", "cm", "mm"] | None = None
    """Unit of length of a calibration whose format does not state it; null: metres."""
    up: Up = Field(default="z", description="Axis of the calibration that points up.")
    format: Literal["json", "packed"] = Field(default="json", description="Form of the instants that are sent back.")
    keep: bool = Field(default=False, description="Whether the keypoints become a session when the client sends `end`.")
    name: SessionName = "live"


class LiveStart(_Start):
    """First message of a client: the cameras, the layout of the keypoints, and what is to be sent back."""

    type: Literal["start"]
    layout: Layout = Field(description="Points of a person, in their order.")
    frame_rate_hz: float = Field(ge=1.0, le=1000.0, allow_inf_nan=False, examples=[60.0])
    """Frame rate of the fastest camera."""
    output_rate_hz: float | None = Field(default=None, ge=0.1, le=1000.0, allow_inf_nan=False)
    """Rate of the instants that are sent back; null: the rate of the cameras."""
    window_s: float = Field(default=0.1, ge=0.001, le=10.0, allow_inf_nan=False)
    """Longest time that a frame waits for earlier frames of other cameras."""
    is_ordered: bool = True
    """True if the frames of each camera come in their order. If not, every frame waits for `window_s`."""
    learn_s: float = Field(default=3.0, ge=0.2, le=60.0, allow_inf_nan=False)
    """Time in sight after which a person's bones are learnt, and the person has a skeleton."""
    bodies: Annotated[tuple[_Lengths, ...], FailFast()] = Field(default=(), max_length=32)
    """Lengths of bones of people of earlier takes in metres, in the order of `bones` of `ready`. These people have the
    first numbers, and are recognised by their proportions."""
    joint_centers: Literal["off", "movenet-multipose", "openpose-mobilenet-thin"] = "off"
    """Network whose offsets of the marks from the joints' centres are used, as in jobs; off: none."""

    def settings(self) -> dict[str, Any]:
        """Settings of the computation."""
        return self.model_dump(
            include={"frame_rate_hz", "output_rate_hz", "window_s", "is_ordered", "learn_s", "bodies"}
        )


Outputs = Annotated[
    tuple[Annotated[str, Field(min_length=1, max_length=300)], ...],
    Field(max_length=16, examples=[["vmc://192.168.0.20:39539"]]),
]


class LiveCameraIn(_Received):
    """Camera that the service opens."""

    camera: str = Field(min_length=1, max_length=200, description="Name of the camera.", examples=["cam_1"])
    source: str = Field(min_length=1, max_length=2000, examples=["rtsp://192.168.0.11/stream"])
    """Address of its stream, `rtsp://`, `rtsps://`, `http://` or `https://`, with user and password if it wants them; a
    `device` of `GET /v1/live/devices`; or a phone of a recording, `phone://RECORDING_ID/NUMBER`."""


class LiveCamerasStart(_Start):
    """First message of a client whose cameras the service opens, and in whose pictures it detects the people."""

    type: Literal["start_cameras"]
    cameras: tuple[LiveCameraIn, ...] = Field(min_length=2, max_length=64)
    """Cameras of the calibration, two or more."""
    profile: Profile = Field(default="fast", description="Networks that find the joints, by speed and accuracy.")
    joints: DetectedJoints = Field(default="auto", description="Joints to find.")
    sync_s: float | None = Field(default=None, ge=3.0, le=25.0, allow_inf_nan=False)
    """Length of the beginning from whose people constant offsets of the cameras' clocks are found."""
    outputs: Outputs = ()
    """Addresses of programs that get the people, as the service's machine reaches them. The protocols have neither keys
    nor encryption."""


class LivePatternStart(_Received):
    """First message of a client that sets up receivers: a simulated person moves, without cameras."""

    type: Literal["start_test_pattern"]
    outputs: Outputs = ()
    """Addresses of programs that get the person, as in `start_cameras`."""
    format: Literal["json", "packed"] = Field(default="json", description="Form of the instants that are sent back.")


class LiveRecordStart(TakeCalibrationSpec):
    """First message of a client whose cameras the service records for a moment, so that they become a calibration."""

    type: Literal["record_cameras"]
    cameras: tuple[LiveCameraIn, ...] = Field(min_length=2, max_length=64, description="Cameras, two or more.")
    duration_s: float = Field(default=20.0, ge=1.0, le=60.0, allow_inf_nan=False)
    """Length of the recording, in which the board is shown or people of these statures walk about."""


class LiveKeypoints(_Received):
    """Keypoints of a camera's frame. Frames without people are sent too: the capture waits for each camera."""

    type: Literal["keypoints"]
    camera: str | Annotated[int, Field(ge=0, le=65_535)] = Field(examples=["cam_1"])
    """Name of the camera, or its place in `cameras` of the message `ready`."""
    time_s: float = Field(ge=-MAX_TIME_S, le=MAX_TIME_S, allow_inf_nan=False, examples=[12.35])
    """Time of the frame on the cameras' clock."""
    people: Annotated[tuple[_Points, ...], FailFast()] = Field(max_length=128, examples=[[[[612.5, 204.0, 0.98]] * 17]])
    """For each person all points of the layout: x and y in pixels, and the score, 0 where a point was not found."""


class LiveEnd(_Received):
    """Last message of a client: the capture is over, and what is held back is to be sent."""

    type: Literal["end"]


class _Sent(DescribedModel):
    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)


class LiveCameraOut(_Sent):
    """Camera of a capture in metres, Z up, for drawings."""

    name: str = Field(description="Name of the camera.", examples=["cam_1"])
    size_px: tuple[int, int] = Field(description="Width and height of the picture.", examples=[[1920, 1080]])
    matrix: tuple[tuple[float, ...], ...] = Field(
        description="Rows of the camera matrix.",
        examples=[[[1400.0, 0.0, 959.5], [0.0, 1400.0, 539.5], [0.0, 0.0, 1.0]]],
    )
    cam_from_world: MotionPose


class LiveReady(_Sent):
    """First message of the service: the capture has begun."""

    type: Literal["ready"] = "ready"
    cameras: tuple[str, ...] = Field(examples=[["cam_1"]])
    """Names of the cameras; packets state places in this list."""
    layout: Layout = Field(description="Layout of the keypoints.")
    joints: tuple[str, ...] = Field(examples=[["nose", "left_eye"]])
    """Names of the joints in `joints_m` of people."""
    bones: tuple[str, ...] = Field(description="Names of the joints of skeletons.", examples=[["Hips", "Spine"]])
    parents: tuple[str | None, ...] = Field(examples=[[None, "Hips"]])
    """Parent of each joint of skeletons; null for the root."""
    rig: tuple[LiveCameraOut, ...] = Field(description="Cameras as the capture uses them, in the order of `cameras`.")
    frame_rate_hz: float | None = Field(default=None, examples=[12.5])
    """Rate of the instants of cameras that the service opens."""
    limits: dict[str, float] = Field(examples=[{"message_bytes": 1_048_576, "people": 32, "idle_s": 30.0}])
    """Limits of the connection: bytes, rates, people, times; none of cameras that the service opens."""
    request_id: str = Field(description="Id of the connection, also in the service's log.", examples=[ID])


class DroppedOut(_Sent):
    """Messages that were dropped so far, the oldest first, because one side was too slow."""

    input: int = Field(description="Frames that waited for the computation for too long.")
    output: int = Field(description="Instants that waited for the client for too long.")


_Point = tuple[float, float, float]


class LiveSkeletonOut(_Sent):
    """Pose of a person's animation skeleton; `/help/conventions` describes the rest pose."""

    root_m: _Point = Field(description="World position of the root.")
    rotations_xyzw: tuple[tuple[float, float, float, float], ...]
    """Rotation of each joint to its parent, or of the root to the world, as a quaternion."""
    bone_lengths_m: tuple[float, ...] = Field(description="Length of the bone from its parent to each joint.")
    joints_m: tuple[_Point, ...] = Field(description="World position of each joint.")


class LivePersonOut(_Sent):
    """Person at an instant."""

    id: int = Field(description="Number of the person, the same for the whole capture.")
    joints_m: tuple[_Point | None, ...] = Field(examples=[[[0.52, -1.13, 1.61], None]])
    """World position of each of `joints`; null where it is unknown."""
    skeleton: LiveSkeletonOut | None = Field(description="Skeleton; null until the person's bones are learnt.")


class LiveInstantOut(_Sent):
    """People at an instant; it is final."""

    type: Literal["instant"] = "instant"
    dropped: DroppedOut
    sequence: int = Field(description="Number of the instant, from 0. Dropped instants leave gaps.")
    time_s: float = Field(description="Time of the instant on the cameras' clock.", examples=[12.35])
    lag_s: float = Field(description="Time from the instant to the newest frame when it became final.", examples=[0.0])
    people: tuple[LivePersonOut, ...]


class LiveCameraStatusOut(_Sent):
    """State of a camera, and the frames of the last second."""

    name: str = Field(description="Name of the camera.", examples=["cam_1"])
    state: Literal["open", "lost", "ended"] = Field(description="A camera that is lost is opened again.")
    decoded_hz: int = Field(description="Frames that came.", examples=[25])
    detected_hz: int = Field(description="Frames in which people were detected.", examples=[12])
    dropped: int = Field(description="Frames of the whole capture that were not detected.")
    lost: int = Field(description="Times that its stream was lost.")


class LiveLatencyOut(_Sent):
    """Times from the picture to its people, of the last instants."""

    p50: float | None = Field(description="Median in seconds; null without any instant.", examples=[0.12])
    p95: float | None = Field(description="95th percentile in seconds.", examples=[0.3])


class LiveOutputOut(_Sent):
    """State of an output, and its counts of the whole capture."""

    address: str = Field(description="Address of the output.", examples=["vmc://192.168.0.20:39539"])
    protocol: str = Field(description="Name of the protocol.", examples=["VMC"])
    state: Literal["listening", "waiting", "sending", "no receiver", "failed"]
    """listening: no receiver has connected; waiting: no person is there; no receiver: its machine answers so."""
    message: str | None = Field(description="Reason why it failed.", examples=["Network is unreachable"])
    sent: int = Field(description="Packets that were sent.", examples=[7200])
    dropped: int = Field(description="Instants that waited for too long.")
    failed: int = Field(description="Instants that could not be sent.")


class LiveStatusOut(_Sent):
    """State of cameras that the service opens, each second."""

    type: Literal["status"] = "status"
    time_s: float = Field(description="Time since the start.", examples=[12.0])
    instants_hz: int = Field(description="Instants of the last second.", examples=[12])
    latency_s: LiveLatencyOut
    cameras: tuple[LiveCameraStatusOut, ...]
    outputs: tuple[LiveOutputOut, ...]


class LiveNoticeOut(_Sent):
    """Change that a person should know, such as a camera that is lost."""

    type: Literal["notice"] = "notice"
    message: str = Field(description="One sentence for a person.", examples=["cam_1 is open again."])


class LiveDeviceOut(_Sent):
    """Camera of the service's machine."""

    device: str = Field(description="Source of the camera in `start_cameras`.", examples=["/dev/video0"])
    name: str = Field(description="Name that the camera states.", examples=["HD Webcam"])


class LiveProtocolOut(_Sent):
    """Protocol of outputs."""

    scheme: str = Field(description="Scheme of its addresses.", examples=["vmc"])
    label: str = Field(description="Name of the protocol.", examples=["VMC"])
    port: int | None = Field(description="Usual port; null: an address has a name in the place of host and port.")
    is_server: bool = Field(description="True if it listens at its address, and receivers connect.")
    has_people: bool = Field(description="True if an address states a number of people, as `?people=2`.")


class LiveDevicesOut(_Sent):
    """Cameras that live captures may open, and protocols by which they may send people."""

    allows_private: bool
    """True if cameras of the service's machine and addresses of private networks may be opened; public addresses may
    be."""
    devices: tuple[LiveDeviceOut, ...] = Field(description="Cameras of the machine; none unless they may be opened.")
    protocols: tuple[LiveProtocolOut, ...] = Field(description="Protocols of outputs; none unless they may be used.")


class LiveCountsOut(_Sent):
    """Numbers of frames of the whole capture."""

    received: int = Field(description="Frames that came.", examples=[7200])
    taken: int = Field(description="Frames that were used.", examples=[7198])
    late: int = Field(description="Frames that came after later ones, and were sorted in.", examples=[12])
    too_late: int = Field(description="Frames that came too late, and were not used.", examples=[2])


class LiveEnded(_Sent):
    """Last message of the service, after `end`; it then closes the connection with 1000."""

    type: Literal["ended"] = "ended"
    counts: LiveCountsOut
    dropped: DroppedOut
    session_id: str | None = Field(description="Session of what was kept; null without `keep`.", examples=[ID])
    kept_frames: int = Field(examples=[7200])
    """Frames that were kept: fewer than `received` if a session can't have more."""


class LiveRecorded(_Sent):
    """Last message of the service after `record_cameras`: the calibration is being made."""

    type: Literal["recorded"] = "recorded"
    calibration_id: str = Field(description="Calibration, and the job that makes it.", examples=[ID])


class LiveProblemOut(SocketProblemOut):
    """Reason why the capture ends; the service then closes the connection with `close_code`."""

    close_code: int = Field(description="Code with which the connection is closed.", examples=[1011])


RECEIVED: tuple[type[BaseModel], ...] = (
    LiveStart,
    LiveCamerasStart,
    LivePatternStart,
    LiveRecordStart,
    LiveKeypoints,
    LiveEnd,
)
"""Messages of clients."""
SENT: tuple[type[BaseModel], ...] = (
    LiveReady,
    LiveInstantOut,
    LiveStatusOut,
    LiveNoticeOut,
    LiveEnded,
    LiveRecorded,
    LiveProblemOut,
)
"""Messages of the service."""


_DESCRIPTION = """\
A live capture for as long as the WebSocket is open. The client sends `start`, then keypoints of each camera's frames,
and `end`. The service answers `ready`, then instants with people, and `ended`; a `problem` ends the capture early.
With `start_cameras` the service opens the cameras itself, and sends `status` and `notice` too; with
`start_test_pattern` it simulates a person. With `record_cameras`
it records them for a moment, makes a calibration of them, and sends `recorded`.
Keypoints and instants may be packed, as messages of bytes. Pages of allowed origins, whose browsers send no headers,
offer the subprotocols `multicap.live` and `mc.key.` with a key behind it. `/help/live-protocol` describes both forms,
limits and close codes.
"""
_CHANNEL = SocketChannel(
    name="live",
    address="/v1/live",
    received=RECEIVED,
    sent=SENT,
    packed_received={"PackedKeypoints": "Keypoints of a camera's frame: `MCK1`."},
    packed_sent={"PackedInstant": "People at an instant: `MCI1`."},
)


def describe_live() -> dict[str, Any]:
    """AsyncAPI 3.0 document."""
    return describe_sockets("Multicap live captures", _DESCRIPTION, [_CHANNEL])
