"""Qualisys real-time protocol: a server that answers receivers as Qualisys Track Manager does.

Protocol: https://docs.qualisys.com/qtm-rt-protocol. The address states the base port, usually 22222: receivers connect
to the next port, in little endian, and discover servers by datagrams to the fourth one. ``qtm_parameters`` says what
receivers are told of people, ``qtm_frames`` what they get. The list of people of a receiver changes when it reads the
parameters; an event tells it that there are others.

A receiver that reads too slowly misses frames: what waits for it is bounded, and so is the rate of its requests.
"""

import asyncio
import importlib.metadata
import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Self, cast

from pipeline.run.live.outputs.output import LiveOutput, OutputStart
from pipeline.run.live.outputs.qtm_frames import FrameEncoder, FrameRequest, read_components
from pipeline.run.live.outputs.qtm_parameters import ParameterError, Parameters
from pipeline.run.live.records import LiveInstant

_ERROR, _COMMAND, _XML, _DATA, _NO_MORE_DATA, _EVENT, _DISCOVER = 0, 1, 2, 3, 4, 6, 7
# Event, and state, that a measurement runs: receivers read the parameters again.
_CONNECTED = b"\x01"
_SHUTTING_DOWN = b"\x0c"
_HEADER = struct.Struct("<II")
_DISCOVERY = struct.Struct("<II2s")
_WELCOME = "QTM RT Interface connected"
# Minor numbers of the versions 1.x that are spoken.
_VERSIONS = range(8, 28)
_TCP_OFFSET, _DISCOVERY_OFFSET = 1, 4
_MAX_RECEIVERS = 16
# Bytes that a receiver may have sent and that are not answered, and bytes that wait for it before frames are left out.
_MAX_RECEIVED, _MAX_WAITING = 64 * 1024, 256 * 1024
# Time between two answers to a receiver.
_PAUSE_S = 0.002


def packet(kind: int, content: bytes | str) -> bytes:
    """Packet of a type; a text ends with a zero."""
    content = content.encode() + b"\0" if isinstance(content, str) else content
    return _HEADER.pack(_HEADER.size + len(content), kind) + content


class _Receiver(asyncio.Protocol):
    """Connection of a receiver."""

    def __init__(self, server: "QtmOutput") -> None:
        self._server = server
        self._received = bytearray()
        self._is_slow, self._is_pausing = False, False
        self._version = 1
        self._stream: FrameRequest | None = None
        self._listed: dict[str, tuple[int, ...]] = {}  # People that the receiver knows, by parameter

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport = cast(asyncio.Transport, transport)
        transport.set_write_buffer_limits(_MAX_WAITING)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _MAX_WAITING)
        self._host: str = transport.get_extra_info("peername")[0]
        receivers = self._server.receivers
        if len(receivers) == _MAX_RECEIVERS:
            idle = next((receiver for receiver in receivers if receiver.is_idle), None)
            if idle is None:
                transport.write(packet(_ERROR, f"{_MAX_RECEIVERS} receivers are connected already"))
                transport.close()
                return
            idle.close()
        receivers[self] = None
        transport.write(packet(_COMMAND, _WELCOME))

    def connection_lost(self, _: Exception | None) -> None:
        self._server.receivers.pop(self, None)

    @property
    def is_idle(self) -> bool:
        """True if the receiver gets no frames."""
        return self._stream is None

    def close(self) -> None:
        """End the connection, with an event."""
        self._send(_EVENT, _SHUTTING_DOWN)
        self._transport.abort()
        self.connection_lost(None)

    def pause_writing(self) -> None:
        self._is_slow = True

    def resume_writing(self) -> None:
        self._is_slow = False
        self._answer()

    def data_received(self, data: bytes) -> None:
        self._received += data
        if len(self._received) > _MAX_RECEIVED:
            self._transport.abort()
        else:
            self._answer()

    def _answer(self) -> None:
        """Answer the next request, and then the others, one at a time."""
        if self._is_slow or self._is_pausing or len(self._received) < _HEADER.size:
            return
        size, kind = _HEADER.unpack_from(self._received)
        if not _HEADER.size <= size <= _MAX_RECEIVED:
            self._transport.abort()
        elif len(self._received) >= size:
            content = bytes(self._received[_HEADER.size : size])
            del self._received[:size]
            self._command(content) if kind == _COMMAND else self._send(_ERROR, "Only commands are answered")
            self._is_pausing = True
            asyncio.get_running_loop().call_later(_PAUSE_S, self._resume)

    def _resume(self) -> None:
        self._is_pausing = False
        self._answer()

    def _command(self, content: bytes) -> None:
        name, *words = content.rstrip(b"\0").decode("ascii", "replace").lower().split() or [""]
        if name in _COMMANDS:
            _COMMANDS[name](self, words)
        else:
            self._send(*_ANSWERS.get(name, (_ERROR, "Parse error")))

    def _send(self, kind: int, content: bytes | str) -> None:
        if not self._transport.is_closing():
            self._transport.write(packet(kind, content))

    def set_version(self, words: Sequence[str]) -> None:
        if not words:
            self._send(_COMMAND, f"Version is 1.{self._version}")
        elif words[0] in {f"1.{minor}" for minor in _VERSIONS}:
            self._version = int(words[0].partition(".")[2])
            self._send(_COMMAND, f"Version set to {words[0]}")
        else:
            self._send(_ERROR, f"Version must be 1.{_VERSIONS[0]} to 1.{_VERSIONS[-1]}")

    def get_parameters(self, words: Sequence[str]) -> None:
        parameters = self._server.parameters
        try:
            text, lists = parameters.read(words, self._version)
        except ParameterError as error:
            self._send(_ERROR, str(error))
            return
        self._listed |= dict.fromkeys(lists, tuple(parameters.skeletons))
        self._send(_XML, text)

    def get_frame(self, words: Sequence[str]) -> None:
        components, latest = read_components(words), self._server.latest
        if components is None:
            self._send(_ERROR, "Parse error")
        elif latest is None:
            self._send(_ERROR, "No frame yet")
        else:
            self._send(_DATA, self._frame(components, latest))

    def stream_frames(self, words: Sequence[str]) -> None:
        self._stream = None
        if list(words) == ["stop"]:
            return
        stream, latest = FrameRequest.read(words, self._server.rate_hz), self._server.latest
        if stream is None:
            self._send(_ERROR, "Parse error")
        elif stream.udp_host not in {None, self._host}:
            self._send(_ERROR, "Frames are sent to the address of the connection only")
        else:
            self._stream = stream
            # Clients wait for a packet in answer.
            if latest is None:
                self._send(_NO_MORE_DATA, b"")
            else:
                self.show(latest, is_first=True)

    def tell_people(self) -> None:
        """Send an event if there are others than the receiver knows."""
        people = self._server.parameters.skeletons.keys()
        if not self._is_slow and any(people - set(known) for known in self._listed.values()):
            self._send(_EVENT, _CONNECTED)

    def show(self, frame: FrameEncoder, is_first: bool = False) -> int:
        """Send a frame if the stream has it; return how many packets were sent."""
        stream = self._stream
        if stream is None or self._is_slow or not (is_first or frame.number % stream.divisor == 0):
            return 0
        content = self._frame(stream.components, frame)
        if stream.udp_port is not None:
            return self._server.send_datagram(packet(_DATA, content), (self._host, stream.udp_port))
        self._send(_DATA, content)
        return 1

    def _frame(self, components: Sequence[str], frame: FrameEncoder) -> bytes:
        all_people = tuple(self._server.parameters.skeletons)
        return frame.frame(components, {"3d": all_people, "skeleton": all_people, **self._listed})


_COMMANDS: Mapping[str, Callable[[_Receiver, Sequence[str]], None]] = MappingProxyType(
    {
        "version": _Receiver.set_version,
        "getparameters": _Receiver.get_parameters,
        "getcurrentframe": _Receiver.get_frame,
        "streamframes": _Receiver.stream_frames,
    }
)
_ANSWERS: Mapping[str, tuple[int, bytes | str]] = MappingProxyType(
    {
        "qtmversion": (_COMMAND, f"Multicap {importlib.metadata.version('multicap')}"),
        "byteorder": (_COMMAND, "Byte order is little endian"),
        "getstate": (_EVENT, _CONNECTED),
        "getlastevent": (_EVENT, _CONNECTED),
        "releasecontrol": (_COMMAND, "You are already a regular client"),
    }
)


class _Discovery(asyncio.DatagramProtocol):
    """Answers to datagrams that look for servers."""

    def __init__(self, base_port: int) -> None:
        text = f"{socket.gethostname()}, Multicap, 0 cameras\0".encode()
        self._answer = packet(_COMMAND, text + base_port.to_bytes(2, "big"))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, address: tuple[str, int]) -> None:
        if len(data) == _DISCOVERY.size:
            size, kind, port = _DISCOVERY.unpack(data)
            if (size, kind) == (_DISCOVERY.size, _DISCOVER):
                self._transport.sendto(self._answer, (address[0], int.from_bytes(port, "big")))

    def error_received(self, _: Exception) -> None:
        """Ignore that a receiver is not there any more."""


class QtmOutput(LiveOutput):
    """Output of the Qualisys real-time protocol; see ``LiveOutput``. Receivers are answered on a thread."""

    def __init__(self, start: OutputStart) -> None:
        super().__init__(start)
        self.parameters = Parameters(start.rate_hz, start.joints)
        self.receivers: dict[_Receiver, None] = {}  # The oldest connection first
        self.latest: FrameEncoder | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="qtm", daemon=True)

    def __enter__(self) -> Self:
        try:
            self._loop.run_until_complete(self._listen(self.address.host, self.address.port))
        except OSError:
            self._loop.close()
            raise
        self._thread.start()
        return self

    async def _listen(self, host: str, base_port: int) -> None:
        port = base_port + _TCP_OFFSET if base_port else 0
        self._server = await self._loop.create_server(lambda: _Receiver(self), host, port)
        base_port = self._server.sockets[0].getsockname()[1] - _TCP_OFFSET
        every_host = ("::" if ":" in host else "0.0.0.0") if self.address.is_network else host  # noqa: S104
        try:
            self._discovery, _ = await self._loop.create_datagram_endpoint(
                lambda: _Discovery(base_port), (every_host, base_port + _DISCOVERY_OFFSET)
            )
        except OSError:
            self._server.close()
            raise
        self.address = replace(self.address, port=base_port)
        self._datagrams = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        self._datagrams.setblocking(False)

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.run_until_complete(self._close())
        self._loop.close()

    async def _close(self) -> None:
        self._server.close()
        self._discovery.close()
        for receiver in list(self.receivers):
            receiver.close()
        self._datagrams.close()
        await asyncio.sleep(0)

    def send(self, instant: LiveInstant) -> int:
        """Send the people of an instant; see ``LiveOutput``."""
        return asyncio.run_coroutine_threadsafe(self._show(instant), self._loop).result()

    async def _show(self, instant: LiveInstant) -> int:
        number = 1 + round(self.elapsed_s(instant) * self.rate_hz)
        self.latest = FrameEncoder(instant, number, len(self.joints))
        is_changed = self.parameters.update(instant)
        num_sent = 0
        for receiver in list(self.receivers):
            num_sent += receiver.show(self.latest)
            if is_changed:
                receiver.tell_people()
        return num_sent

    def send_datagram(self, content: bytes, address: tuple[str, int]) -> int:
        """Send a datagram; return 0 if it is lost."""
        try:
            self._datagrams.sendto(content, address)
        except OSError:
            return 0
        return 1
