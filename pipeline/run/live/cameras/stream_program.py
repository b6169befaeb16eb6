"""``python -m pipeline.run.live.cameras.stream_program``: open a camera's stream and decode it, for another process.

A process a camera, with limits on memory and files: strangers' streams may make FFmpeg crash, hang or exhaust memory.
Messages are JSON objects, a line each. To stdin come a ``StreamRequest``; then ``path`` of the shared file, ``start_s``
at which a file is to be played, and ``slot`` for each wanted picture: the newest one is written to that slot of the
shared file. To stdout go ``opened``, ``decoded`` for each frame, ``picture`` for each one that was written, and
``ended`` with a problem, or without one at the end of the stream. The process ends when stdin is closed. With
``record`` the frames go to a file, up to the message ``stop``, and ``decoded`` tells of each one in the file.
"""

import errno
import itertools
import json
import mmap
import os
import socket
import statistics
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import av
import av.logging
from av.container import InputContainer
from av.error import FFmpegError
from av.filter import Graph
from av.video.frame import PictureType, VideoFrame
from av.video.stream import VideoStream

from pipeline.core.errors import UnusableError
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import STREAM_REFUSED, STREAM_SILENT
from pipeline.core.runtime.confinement import ChildLimits, confine, tell_ready
from pipeline.run.live.cameras.sources import SourceKind
from pipeline.run.live.clocks import ArrivalClock, CaptureClock, LateFrames, PlaybackClock, StreamClock
from pipeline.run.live.packets import PhonePicture
from pipeline.video.container import CODECS, DECODE_ERRORS, display_pts, first_video, open_container
from pipeline.video.decode_process import rgb_converter, write_rows
from pipeline.video.images.frames import decode_image
from pipeline.video.orientation import display_orientation
from pipeline.video.probe import square_pixels

# Longest waits: for the connection with its first packets, and for the next packet.
_OPEN_S, _READ_S = 10.0, 5.0
# More than a packet of a picture has.
_PICTURE_BYTES = 2**18
# Frames by which the rate of a file is known.
_NUM_MEASURED = 50
_NETWORK = {"fflags": "nobuffer", "analyzeduration": "2000000", "max_delay": "200000"}
_OPTIONS: dict[SourceKind, dict[str, str]] = {
    # No other address than the stated one is opened: RTP comes over the connection of RTSP, whose redirects FFmpeg does
    # not follow, and HTTP has neither playlists nor redirects.
    "rtsp": _NETWORK | {"rtsp_transport": "tcp", "allowed_media_types": "video", "protocol_whitelist": "tcp,tls"},
    "http": _NETWORK
    | {"format_whitelist": "mpjpeg,mjpeg,mpegts", "protocol_whitelist": "http,https,tls,tcp", "max_redirects": "0"},
    "device": {"format_whitelist": "v4l2"},
}
_FORMATS: dict[SourceKind, str] = {"rtsp": "rtsp", "device": "v4l2"}
_RECORDED = {"preset": "ultrafast", "tune": "zerolatency", "crf": "16"}
_RECORDED_TICK = Fraction(1, 1000)
_RECORDED_BYTES = 4 * 2**30
# Formats without times of frames: FFmpeg invents some.
_WITHOUT_TIMES = frozenset({"mpjpeg", "mjpeg"})


class StreamRequest(NamedTuple):
    """Stream to open."""

    kind: SourceKind
    address: str
    size_px: tuple[int, int]  # Size of the pictures by the calibration, which devices are asked for
    host: str | None = None  # Host of the address, where it has an IP address in its place
    record: str | None = None  # New file that gets all frames, up to a message ``stop``; ``None``: none
    pictures: int | None = None  # Open socket that brings a phone's pictures


class _Taken(NamedTuple):
    """Decoded frame."""

    number: int  # Number of frames before it, left out ones included
    time_s: float  # Time at which it was taken
    frame: VideoFrame


class _Stream:
    """Open stream: a thread decodes it, and the newest frame waits to be written."""

    def __init__(self, request: StreamRequest) -> None:
        self._request = request
        self._number = 0
        self._newest: _Taken | None = None
        self._start_s: float | None = None
        self.is_stopped = False
        self._is_started = threading.Event()
        self._to_rgb: Graph | None = None
        self._size_px = (0, 0)
        self._aspect: Fraction | None = None  # of a pixel; ``None``: the stream states none
        self._square_width = 0
        self._picture: mmap.mmap | None = None

    def share(self, path: str) -> None:
        """Open the file for pictures."""
        with Path(path).open("r+b") as file:
            self._picture = mmap.mmap(file.fileno(), 0)

    def start(self, start_s: float) -> None:
        """Play a file from a time on."""
        self._start_s = start_s
        self._is_started.set()

    def write_newest(self, slot: int) -> None:
        """Write the newest picture to a slot of the shared file."""
        taken = self._newest
        if taken is None or self._picture is None:
            return
        self._to_rgb = self._to_rgb or rgb_converter(taken.frame, self._square_width)
        self._to_rgb.vpush(taken.frame)
        rgb = self._to_rgb.vpull()
        num_bytes = 3 * rgb.width * rgb.height
        with memoryview(self._picture) as pictures:
            write_rows(rgb, pictures[slot * num_bytes : (slot + 1) * num_bytes])
        _say("picture", slot=slot, number=taken.number, time_s=taken.time_s)

    def decode(self) -> None:
        """Decode to the end of the stream, and say how it ended."""
        try:
            with self._frames() as timed:
                self._record(timed) if self._request.record else self._show(timed)
        except UnusableError as error:
            _say_end(error)
        except MemoryError:
            _say_end(UnusableError(session_codes.VIDEO_UNREADABLE, "The stream needs more memory than is allowed."))
        except DECODE_ERRORS as error:
            _say_end(_usual_problem(error))
        else:
            _say("ended")

    @contextmanager
    def _frames(self) -> Iterator[Iterator[tuple[float, VideoFrame]]]:
        """Open the stream during the block; its frames with the times at which they were taken, which ascend."""
        if self._request.pictures is None:
            with _opened(self._request) as container:
                yield self._timed_frames(container, _find_video(container))
        else:
            with socket.socket(fileno=self._request.pictures) as pictures:
                yield self._timed_pictures(pictures)

    def _record(self, timed: Iterable[tuple[float, VideoFrame]]) -> None:
        """Write the frames to a file, at the times at which they were taken."""
        first_s: float | None = None
        with av.open(str(self._request.record), "w", format="matroska") as file:
            target = file.add_stream("libx264", options=_RECORDED)
            for time_s, frame in timed:
                self._require_size(frame)
                if first_s is None:
                    first_s = time_s
                    target.width, target.height = self._size_px
                    target.pix_fmt = "yuv420p" if all(side % 2 == 0 for side in self._size_px) else "yuv444p"
                    target.sample_aspect_ratio = self._aspect or Fraction(1)
                    target.codec_context.time_base = _RECORDED_TICK
                written = frame.reformat(format=target.pix_fmt)
                written.pts, written.time_base = round((time_s - first_s) / _RECORDED_TICK), _RECORDED_TICK
                written.pict_type = PictureType.NONE
                file.mux(target.encode(written))
                _say("decoded", number=self._number, time_s=time_s)
                if self.is_stopped:
                    break
            file.mux(target.encode(None))

    def _require_size(self, frame: VideoFrame) -> None:
        if (frame.width, frame.height) != self._size_px:
            raise UnusableError(
                session_codes.VIDEO_CHANGES_SIZE, "The size of the pictures has changed.", "Start again."
            )

    def _show(self, timed: Iterable[tuple[float, VideoFrame]]) -> None:
        """Make each frame the newest one when it was decoded, and of a file when its time has come."""
        for time_s, frame in timed:
            self._require_size(frame)
            time.sleep(max(0.0, time_s - time.monotonic()))
            self._newest = _Taken(self._number, time_s, frame)
            _say("decoded", number=self._number, time_s=time_s)
        if self._newest is None:
            raise UnusableError(session_codes.VIDEO_UNREADABLE, "No picture of the stream can be decoded.")

    def _open(self, frame: VideoFrame, aspect: Fraction | None, rate_hz: float) -> None:
        """Tell the size of the pictures; of a file wait for its start."""
        self._size_px, self._aspect = (frame.width, frame.height), aspect
        self._square_width, _ = square_pixels(frame.width, aspect)
        self._newest = _Taken(0, time.monotonic(), frame)
        rotation_deg, is_mirrored = display_orientation(frame)
        _say(
            "opened",
            stored_size_px=self._size_px,
            square_width=self._square_width,
            rotation_deg=rotation_deg,
            is_mirrored=is_mirrored,
            rate_hz=_rate_hz(self._request) if self._request.kind == "file" else rate_hz,
        )
        if self._request.kind == "file":
            self._is_started.wait()

    def _timed_pictures(self, pictures: socket.socket) -> Iterator[tuple[float, VideoFrame]]:
        """Frames of a phone, which states their times."""
        last_s = -float("inf")
        pictures.settimeout(_OPEN_S)
        try:
            while picture := PhonePicture.decode(pictures.recv(_PICTURE_BYTES)):
                self._number += 1
                time_s = min(picture.time_s, time.monotonic())
                if time_s > last_s and (frame := decode_image(picture.jpeg)) is not None:
                    last_s = time_s
                    if self._newest is None:
                        self._open(frame, None, 0.0)
                        pictures.settimeout(_READ_S)
                    yield time_s, frame
        except TimeoutError:
            raise UnusableError(STREAM_SILENT, "The phone sends no pictures.", "Keep its page in front.") from None

    def _timed_frames(self, container: InputContainer, stream: VideoStream) -> Iterator[tuple[float, VideoFrame]]:
        """Frames of a container."""
        tick_s = float(stream.time_base or Fraction(1, 1000))
        has_times = container.format.name not in _WITHOUT_TIMES
        clock: CaptureClock | None = None
        if self._request.kind != "file":
            clock = StreamClock() if has_times else ArrivalClock()
        late, last_s = LateFrames(), -float("inf")
        for packet in container.demux(stream):
            now_s = time.monotonic()
            self._number += bool(packet.size)
            stamp_s = packet.pts * tick_s if has_times and packet.pts is not None else None
            if clock and stamp_s is not None and late.leaves_out(clock, stamp_s, now_s, packet.is_keyframe):
                continue
            for frame in _decoded(packet):
                pts = display_pts(frame)
                stamp_s = pts * tick_s if has_times and pts is not None else now_s
                if self._newest is None:
                    self._open(frame, stream.sample_aspect_ratio, float(stream.average_rate or 0))
                if clock is None:
                    clock = PlaybackClock(self._start_s or now_s, stamp_s)
                time_s = clock.capture_s(stamp_s)
                if self._request.kind != "file":
                    # After a jump of the stream's times, a frame that the decoder still had may be far in the future.
                    time_s = min(time_s, time.monotonic())
                if time_s > last_s:
                    last_s = time_s
                    yield time_s, frame


def _find_video(container: InputContainer) -> VideoStream:
    """Stream of a container that is decoded; raises ``UnusableError`` if there is none."""
    stream = first_video(container)
    if stream is None:
        raise UnusableError(
            session_codes.NO_VIDEO_STREAM, "The stream has no video that can be decoded.", "Check what is sent."
        )
    codec = stream.codec_context.codec.canonical_name
    if codec not in CODECS | {"rawvideo"}:
        hint = f"Use one of {', '.join(sorted(CODECS))}."
        raise UnusableError(session_codes.UNSUPPORTED_CODEC, f"The codec {codec} is not supported.", hint)
    return stream


def _rate_hz(request: StreamRequest) -> float:
    """Rate of a file by the times of its first frames, which are right where its header is not; 0 if there are few."""
    with _opened(request) as container:
        stream = _find_video(container)
        packets = itertools.islice(container.demux(stream), _NUM_MEASURED)
        ticks = sorted(packet.pts for packet in packets if packet.pts is not None)
        steps = [after - before for before, after in itertools.pairwise(ticks) if after > before]
        return float(1 / (statistics.median(steps) * (stream.time_base or Fraction(1, 1000)))) if steps else 0.0


def _decoded(packet: "av.Packet[Any]") -> list[VideoFrame]:
    """Frames of a packet; none if it is damaged."""
    try:
        return packet.decode()
    except MemoryError:
        raise
    except DECODE_ERRORS:
        return []


def _opened(request: StreamRequest) -> AbstractContextManager[InputContainer]:
    """Open a stream; raises one of ``DECODE_ERRORS``."""
    kind, address = request.kind, request.address
    if kind == "file":
        return open_container(Path(address))
    options = dict(_OPTIONS[kind])
    if kind == "device":
        options["video_size"] = "{}x{}".format(*request.size_px)
    if kind == "http" and request.host is not None:
        options["headers"] = f"Host: {request.host}\r\n"
    return av.open(address, format=_FORMATS.get(kind), options=options, timeout=(_OPEN_S, _READ_S))


def _usual_problem(error: Exception) -> UnusableError:
    """Problem of an error of FFmpeg, without the address, which may hold a password."""
    text = (error.strerror or "") if isinstance(error, OSError | FFmpegError) else ""
    name = type(error).__name__
    if isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EFBIG, errno.EDQUOT}:
        hint = "Record for a shorter time, or free room on the service's disk."
        return UnusableError(session_codes.VIDEO_UNREADABLE, "The disk has no room for the recording.", hint)
    if isinstance(error, TimeoutError) or name == "ExitError" or "timed out" in text.lower():
        hint = "See that the camera is on and reached from this machine."
        return UnusableError(STREAM_SILENT, "The camera does not answer in time.", hint)
    if "Unauthorized" in name or "Forbidden" in name:
        hint = "Write user and password before the address: rtsp://user:password@..."
        return UnusableError(STREAM_REFUSED, "The camera wants a user and a password, or others.", hint)
    if isinstance(error, ConnectionError | FileNotFoundError) or (isinstance(error, OSError) and error.errno):
        if error.errno == errno.EBUSY:
            return UnusableError(STREAM_REFUSED, "Another program uses the camera.", "End that program.")
        is_led_elsewhere = error.errno == errno.EIO
        hint = "Check the address; redirects are not followed." if is_led_elsewhere else "Check the address."
        return UnusableError(STREAM_REFUSED, f"The stream can't be opened: {text}.", hint)
    hint = "Send H.264 or HEVC by RTSP, or MJPEG or MPEG-TS by HTTP; play files of MP4, MOV, MKV, AVI or MPEG."
    return UnusableError(
        session_codes.VIDEO_UNREADABLE, "The stream can't be read: it is damaged or of an unknown format.", hint
    )


def _say(kind: str, **values: object) -> None:
    os.write(sys.stdout.fileno(), json.dumps({"kind": kind, **values}).encode() + b"\n")


def _say_end(error: UnusableError) -> None:
    _say("ended", code=error.code, message=error.message, hint=error.hint)


def main() -> int:
    """Decode until stdin is closed; return the exit code."""
    request = StreamRequest(**json.loads(sys.stdin.readline()))
    limits = ChildLimits(cpu_s=None)
    confine(limits._replace(file_bytes=_RECORDED_BYTES) if request.record else limits)
    tell_ready()
    av.logging.set_level(av.logging.PANIC)
    stream = _Stream(request)
    threading.Thread(target=stream.decode, daemon=True).start()
    for line in sys.stdin:
        message = json.loads(line)
        if "path" in message:
            stream.share(message["path"])
        elif "stop" in message:
            stream.is_stopped = True
        elif "start_s" in message:
            stream.start(message["start_s"])
        else:
            stream.write_newest(message["slot"])
    # FFmpeg may hang: the thread is not waited for.
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
