"""Problem codes of recordings by phones: of messages of their WebSockets, and of connections that end early."""

from pipeline.core.problems.model import CodeGroup

_WHERE = ("recording",)

RECORDINGS = CodeGroup(
    "Recordings by phones",
    "Values of `code` in the messages `problem` of `WS /v1/recordings/{recording_id}/connect`; see "
    "[recordings](phones_service.md).",
)

RECORDING_MESSAGE = RECORDINGS.code(
    "recording_message",
    _WHERE,
    "A message is not JSON in UTF-8, not an object, or not of a type that is expected at this point.",
    "A phone sends `hello` first; then send messages of the types that openapi/recordings.asyncapi.json lists.",
)
RECORDING_FIELDS = RECORDINGS.code(
    "recording_fields",
    _WHERE,
    "Fields of a message are missing or wrong; `errors` lists all of them.",
    "Correct the fields that `errors` lists, and connect again.",
)
RECORDING_THUMBNAIL = RECORDINGS.code(
    "recording_thumbnail",
    _WHERE,
    "A message of bytes is no JPEG of at most 1,024 pixels a side, or comes from a host.",
    "Send small JPEGs of the camera's picture, from phones alone.",
)
RECORDING_TOO_LARGE = RECORDINGS.code(
    "recording_too_large",
    _WHERE,
    "A message or a thumbnail has more bytes than the service accepts.",
    "Keep to `limits` of the message `welcome`.",
)
RECORDING_TOO_FAST = RECORDINGS.code(
    "recording_too_fast",
    _WHERE,
    "The client sends more messages a second than the service accepts.",
    "Keep to `limits` of the message `welcome`.",
)
RECORDING_IDLE = RECORDINGS.code(
    "recording_idle",
    _WHERE,
    "A phone sent nothing, or a client received nothing, for too long.",
    "Connect again; a phone sends `status` every second.",
)
RECORDING_BUSY = RECORDINGS.code(
    "recording_busy",
    _WHERE,
    "The recording has as many hosts connected, or as many connections that have not said hello, as it may have.",
    "Close pages of the recording that nobody needs; phones connect again after a moment.",
)
RECORDING_LINK_ENDED = RECORDINGS.code(
    "recording_link_ended",
    _WHERE,
    "The link or the key of the connection is no longer valid.",
    "Open the newest link, or sign in again.",
)
