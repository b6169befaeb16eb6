"""Configuration of the HTTP server: number of connections, sizes of messages, trusted proxies."""

from functools import partial

import uuid_utils
from fastapi import FastAPI
from uvicorn import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from api.web.http.websockets import TOO_LARGE, WRONG_DATA, bounded_websocket, problem_message
from api.web.live.problems import too_large, wrong_text
from api.web.live.schemas import LiveProblemOut
from api.web.recordings import intake as recording_intake
from api.web.recordings.messages import RecordingProblemOut
from api.web.settings import Settings
from pipeline.core.runtime.resources import raise_descriptor_limit

# Time that open requests have to end after SIGTERM.
_GRACE_S = 5
# Idle connections stay open for longer than clients and proxies keep theirs (httpx 5 s, nginx and load balancers 60 s):
# the side that sends has to close first, or a request meets a connection that is being closed.
_KEEP_ALIVE_S = 75
_MAX_HEAD_BYTES = 64 * 2**10
# Descriptors for the database, files and child processes.
_RESERVED_DESCRIPTORS = 256
# A connection's socket, and a file that is received or sent.
_DESCRIPTORS_PER_CONNECTION = 2


class BoundedHead(HttpToolsProtocol):
    """Protocol of the HTTP server that closes connections whose request headers are too large."""

    _num_bytes = 0
    _is_in_head = False

    def data_received(self, data: bytes) -> None:
        """Parse data; close the connection if the headers do not end."""
        super().data_received(data)
        self._num_bytes += len(data)
        if self._is_in_head and self._num_bytes > _MAX_HEAD_BYTES:
            self.transport.close()

    def on_message_begin(self) -> None:
        """Begin to count the bytes of a request's headers."""
        super().on_message_begin()
        self._num_bytes, self._is_in_head = 0, True

    def on_headers_complete(self) -> None:
        """Let a body be of any size."""
        self._is_in_head = False
        super().on_headers_complete()


def _wrong_frames(settings: Settings, path: str, close_code: int) -> str | None:
    """Last message to a client whose frames are too large or no text, by the path of its WebSocket."""
    is_recording = path.startswith("/v1/recordings/")
    if is_recording:
        max_bytes = max(settings.max_recording_message_bytes, settings.max_thumbnail_bytes)
        problems = {TOO_LARGE: recording_intake.too_large(max_bytes), WRONG_DATA: recording_intake.wrong_text()}
    else:
        problems = {TOO_LARGE: too_large(settings.max_live_message_bytes), WRONG_DATA: wrong_text()}
    if (problem := problems.get(close_code)) is None:
        return None
    model = RecordingProblemOut if is_recording else LiveProblemOut
    return problem_message(problem, str(uuid_utils.uuid7()), model).model_dump_json()


def server_config(app: FastAPI, settings: Settings) -> Config:
    """Configure the server, and raise this process's limit on open files as far as allowed."""
    descriptors = raise_descriptor_limit()
    reserved = min(_RESERVED_DESCRIPTORS, descriptors // 2)
    max_connections = max(1, (descriptors - reserved) // _DESCRIPTORS_PER_CONNECTION)
    proxies = settings.trusted_proxies
    return Config(
        app,
        host=settings.host,
        port=settings.port,
        http=BoundedHead,
        limit_concurrency=min(settings.max_connections, max_connections),
        ws=bounded_websocket(partial(_wrong_frames, settings)),
        ws_max_size=max(
            settings.max_live_message_bytes,
            settings.max_recording_message_bytes,
            settings.max_thumbnail_bytes,
            settings.max_phone_picture_bytes,
        ),
        ws_per_message_deflate=False,
        ssl_certfile=settings.certificate,
        ssl_keyfile=None if settings.certificate_key is None else str(settings.certificate_key),
        proxy_headers=bool(proxies),
        forwarded_allow_ips=[str(network) for network in proxies],
        access_log=False,
        server_header=False,
        timeout_keep_alive=_KEEP_ALIVE_S,
        timeout_graceful_shutdown=_GRACE_S,
        log_config=None,
    )
