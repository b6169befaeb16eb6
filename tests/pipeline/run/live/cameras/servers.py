"""Cameras on loopback: RTSP with H.264 over RTP, HTTP with MJPEG, and servers that misbehave."""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import av
import cv2

from tests.pipeline.media import picture

SIZE_PX = (64, 48)
_MAX_PAYLOAD = 1200


def encoded_pictures(num_pictures: int, size_px: tuple[int, int] = SIZE_PX) -> list[list[bytes]]:
    """NAL units of each picture in H.264, every one decodable by itself."""
    encoder = av.CodecContext.create("libx264", "w")
    assert isinstance(encoder, av.VideoCodecContext)
    (encoder.width, encoder.height), encoder.pix_fmt = size_px, "yuv420p"
    encoder.options = {"tune": "zerolatency", "x264-params": "keyint=1:slices=1"}
    pictures = []
    for number in range(num_pictures):
        packets = encoder.encode(av.VideoFrame.from_ndarray(picture(number, size_px), format="rgb24"))
        content = b"".join(bytes(packet) for packet in packets)
        pictures.append([unit.rstrip(b"\0") for unit in content.split(b"\0\0\1") if unit.strip(b"\0")])
    return pictures


def rtp_packets(units: Sequence[bytes], sequence: int, stamp: int) -> list[bytes]:
    """RTP packets of a picture (RFC 6184): whole NAL units, or pieces of them (FU-A)."""
    payloads = []
    for unit in units:
        if len(unit) <= _MAX_PAYLOAD:
            payloads.append(unit)
            continue
        head, pieces = unit[0], [unit[k : k + _MAX_PAYLOAD] for k in range(1, len(unit), _MAX_PAYLOAD)]
        for place, piece in enumerate(pieces):
            marks = 0x80 * (place == 0) | 0x40 * (place == len(pieces) - 1)
            payloads.append(bytes([head & 0xE0 | 28, marks | head & 0x1F]) + piece)
    return [
        struct.pack(">BBHII", 0x80, 96 | 0x80 * (place == len(payloads) - 1), (sequence + place) % 2**16, stamp, 7)
        + payload
        for place, payload in enumerate(payloads)
    ]


class LoopbackServer:
    """Server on a free port of this machine, or on a given one; a thread for each connection runs ``answer``."""

    def __init__(self, answer: Callable[[socket.socket], None], port: int = 0) -> None:
        self._answer, self._open = answer, list[socket.socket]()
        self._listening = socket.create_server(("127.0.0.1", port))
        self.port = self._listening.getsockname()[1]
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                self._open.append(connection)
                self._threads.append(threading.Thread(target=self._serve, args=[connection], daemon=True))
                self._threads[-1].start()

    def _serve(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection:
            self._answer(connection)

    def close(self) -> None:
        """Stop, as a camera that loses its power."""
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        for each in (self._listening, *self._open):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        for thread in self._threads:
            thread.join(5.0)

    def __enter__(self) -> "LoopbackServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def rtsp_camera(pictures: Sequence[Sequence[bytes]], rate_hz: float, jitter_s: Sequence[float]) -> Callable[..., None]:
    """Camera that plays pictures over and over by RTSP; picture k is sent ``jitter_s[k]`` late, again and again."""

    def answer(connection: socket.socket) -> None:
        reader = connection.makefile("rb")
        while line := reader.readline():
            method, fields = line.split()[0].decode(), dict[str, str]()
            while (head := reader.readline().decode().strip()) != "":
                name, _, value = head.partition(":")
                fields[name.lower()] = value.strip()
            extra, body = {}, b""
            if method == "OPTIONS":
                extra["Public"] = "OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN"
            elif method == "DESCRIBE":
                body = b"v=0\r\no=- 1 1 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
                body += b"a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1\r\na=control:video\r\n"
                extra["Content-Type"] = "application/sdp"
            elif method == "SETUP":
                extra |= {"Transport": "RTP/AVP/TCP;unicast;interleaved=0-1", "Session": "1"}
            else:
                extra["Session"] = "1"
            head_lines = ["RTSP/1.0 200 OK", f"CSeq: {fields['cseq']}", f"Content-Length: {len(body)}"]
            head_lines += [f"{name}: {value}" for name, value in extra.items()]
            connection.sendall("\r\n".join([*head_lines, "", ""]).encode() + body)
            if method == "PLAY":
                play(connection)

    def play(connection: socket.socket) -> None:
        start_s, sequence, number = time.monotonic(), 0, 0
        while True:
            due_s = start_s + number / rate_hz + jitter_s[number % len(jitter_s)]
            time.sleep(max(0.0, due_s - time.monotonic()))
            for packet in rtp_packets(pictures[number % len(pictures)], sequence, round(90_000 * number / rate_hz)):
                connection.sendall(struct.pack(">cBH", b"$", 0, len(packet)) + packet)
                sequence += 1
            number += 1

    return answer


def mjpeg_camera(num_pictures: int, rate_hz: float) -> Callable[[socket.socket], None]:
    """Camera that sends pictures in JPEG over and over, in one answer of HTTP."""
    encoded = [cv2.imencode(".jpg", picture(number, SIZE_PX))[1].tobytes() for number in range(num_pictures)]

    def answer(connection: socket.socket) -> None:
        connection.recv(65_536)
        connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=next\r\n\r\n")
        start_s, number = time.monotonic(), 0
        while True:
            jpeg = encoded[number % num_pictures]
            head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            connection.sendall(head.encode() + jpeg + b"\r\n")
            number += 1
            time.sleep(max(0.0, start_s + number / rate_hz - time.monotonic()))

    return answer


def silent(connection: socket.socket) -> None:
    """Take everything, and answer nothing."""
    while connection.recv(65_536):
        pass


@contextlib.contextmanager
def serving(answer: Callable[[socket.socket], None], port: int = 0) -> Iterator[LoopbackServer]:
    """Server during the block."""
    with LoopbackServer(answer, port) as server:
        yield server
