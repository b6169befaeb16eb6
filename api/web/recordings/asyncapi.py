"""AsyncAPI document of the WebSocket of recordings."""

from typing import Any

from api.web.contract.asyncapi import SocketChannel, describe_sockets
from api.web.recordings.messages import HOST_RECEIVED, HOST_SENT, PHONE_RECEIVED, PHONE_SENT

_DESCRIPTION = """\
A recording by phones. Phones offer the subprotocols `multicap.recording` and `mc.link.` with the secret of the
recording's link behind it, and say `hello` first; hosts come with a key or the browser's cookie. Phones send small
JPEGs of their pictures as messages of bytes; hosts get them behind the phone's number, an unsigned integer of two
bytes, little-endian. All else is JSON. docs/phones_service.md describes the order of messages, limits and close codes.
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
            packed_received={"Thumbnail": "JPEG of the camera's picture, of at most 1,024 x 1,024 pixels."},
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
