"""Problem codes of live captures: of messages that clients send, and of captures that end early."""

from pipeline.core.problems.model import CodeGroup

_WHERE = ("live",)

LIVE = CodeGroup(
    "Live captures",
    "Values of `code` in the messages `problem` of `WS /v1/live`; see [live captures](live_service.md).",
)

LIVE_MESSAGE = LIVE.code(
    "live_message",
    _WHERE,
    "A message is not JSON in UTF-8, not an object, or not of a type that is expected at this point.",
    "Send `start` first, then `keypoints` or packed keypoints, and `end` last.",
)
LIVE_FIELDS = LIVE.code(
    "live_fields",
    _WHERE,
    "Fields of a message are missing or wrong; `errors` lists all of them.",
    "Correct the fields that `errors` lists, and start again.",
)
LIVE_PACKET = LIVE.code(
    "live_packet",
    _WHERE,
    "A packed message does not have the form, the numbers or the length that it states.",
    "Follow the table of packed keypoints; all numbers are finite and little-endian.",
)
LIVE_CAMERA = LIVE.code(
    "live_camera",
    _WHERE,
    "Keypoints are of a camera that the calibration does not have.",
    "Name a camera of the message `ready`, or send its place in that list.",
)
LIVE_JOINTS = LIVE.code(
    "live_joints",
    _WHERE,
    "A person has another number of points than the layout of the capture.",
    "Send all points of the layout; points that were not found have the score 0.",
)
LIVE_TOO_LARGE = LIVE.code(
    "live_too_large",
    _WHERE,
    "A message has more bytes, or more people, than the service accepts.",
    "Send one camera's frame in a message, with at most as many people as the service allows.",
)
LIVE_TOO_FAST = LIVE.code(
    "live_too_fast",
    _WHERE,
    "The client sends more messages a second than the service accepts.",
    "Send each camera's frames at their own rate.",
)
LIVE_TIME = LIVE.code(
    "live_time",
    _WHERE,
    "The time of a frame is far ahead of all others.",
    "Send times in seconds on one clock of all cameras; after a long pause begin another capture.",
)
LIVE_IDLE = LIVE.code(
    "live_idle",
    _WHERE,
    "The client sent nothing, or received nothing, for too long.",
    "Send frames without people too, read what comes, and send `end` when the capture is over.",
)
LIVE_KEY_ENDED = LIVE.code(
    "live_key_ended", _WHERE, "The key of the connection was revoked or has expired.", "Connect with a valid key."
)
LIVE_FAILED = LIVE.code(
    "live_failed",
    _WHERE,
    "The computation of the capture failed or did not answer in time; other captures go on.",
    "Start the capture again; if it fails again, send the operator the `request_id`.",
)
LIVE_STOPPED = LIVE.code(
    "live_stopped",
    _WHERE,
    "The service was stopped during the capture, and closed the connection with 1012; nothing of the capture is kept.",
    "Begin another capture when the service answers again.",
)


STREAMS = CodeGroup(
    "Cameras of live captures", "Problems of the cameras of `multicap live`; see [live cameras](live_cameras.md)."
)

CAMERA_SOURCE = STREAMS.code(
    "camera_source",
    ("command",),
    "`--camera` is not CAMERA=SOURCE, names an unknown camera or one twice, or there are fewer than two.",
    "Name two cameras of the calibration or more, each with its stream, device or file.",
)
STREAM_REFUSED = STREAMS.code(
    "stream_refused",
    ("command",),
    "The address of a stream answers, but gives no stream, or nothing is at the address.",
    "Check the address, and user and password in it.",
)
STREAM_SILENT = STREAMS.code(
    "stream_silent",
    ("command",),
    "A camera does not answer, or sends no pictures for seconds.",
    "See that the camera is on and reached from this machine.",
)
