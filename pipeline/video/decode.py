"""Decode ranges of frames: exactly the frames asked for, whatever the cut."""

import gc
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from av.container import InputContainer
from av.filter import Graph
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from jaxtyping import UInt8

from pipeline.errors import InputError, Problem
from pipeline.video.container import DECODE_ERRORS, first_video, open_container
from pipeline.video.info import VideoInfo


def decode(
    video: VideoInfo, start_frame: int, stop_frame: int
) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
    """Decode the frames ``start_frame <= k < stop_frame``, in order, one in memory at a time.

    Yields
    ------
        Number and RGB picture of each frame, turned as the video says.

    Raises
    ------
    InputError
        If a frame can't be decoded.
    """
    try:
        yield from _decode(video, start_frame, stop_frame)
    finally:
        # A container and its streams refer to each other: uncollected, decoders with all their pictures pile up.
        # Only out here does nothing else hold them.
        gc.collect()


def _decode(
    video: VideoInfo, start_frame: int, stop_frame: int
) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
    stop_frame = min(stop_frame, video.num_frames)
    wanted = max(start_frame, 0)
    if wanted >= stop_frame:
        return
    try:
        with open_container(video.path) as container:
            stream = first_video(container)
            if stream is None:
                raise _undecodable(video, wanted)
            to_rgb: Graph | None = None
            for frame in _frames_from(container, stream, video, wanted):
                number = _number(video, frame)
                if number is None or number < wanted:
                    continue
                if number > wanted:
                    raise _undecodable(video, wanted)
                to_rgb = to_rgb or _rgb_converter(frame)
                to_rgb.vpush(frame)
                yield number, _upright(to_rgb.vpull(), video, number)
                wanted += 1
                if wanted == stop_frame:
                    return
    except DECODE_ERRORS as error:
        raise _undecodable(video, wanted) from error
    raise _undecodable(video, wanted)


def _frames_from(container: InputContainer, stream: VideoStream, video: VideoInfo, wanted: int) -> Iterator[VideoFrame]:
    """Frames from the last keyframe that is not after the wanted one.

    Frames shown before a keyframe but stored after it need the keyframe before (open GOP); all that is shown after it
    can be decoded from it.
    """
    target = int(video.pts[wanted])
    position = int(np.searchsorted(video.keyframe_pts, target, side="right")) - 1
    keyframe = int(video.keyframe_pts[max(0, position)])
    if wanted > 0 and keyframe > video.pts[0]:
        container.seek(keyframe, stream=stream)
        frames = container.decode(video=0)
        first = next(frames, None)
        if first is not None and first.pts is not None and first.pts <= target:
            yield first
            yield from frames
            return
        # The container's index led past it.
        container.seek(int(video.pts[0]), stream=stream)
    yield from container.decode(video=0)


def _number(video: VideoInfo, frame: VideoFrame) -> int | None:
    """Frame number by timestamp; ``None`` for a picture that is not meant to be shown."""
    stamp = frame.dts if frame.pts is None else frame.pts
    if stamp is None:
        return None
    number = int(np.searchsorted(video.pts, stamp))
    return number if number < video.num_frames and video.pts[number] == stamp else None


def _rgb_converter(frame: VideoFrame) -> Graph:
    """A converter for frames like this one; a filter graph, for it reuses the memory of pictures that were let go."""
    graph = Graph()
    graph.threads = 1
    source = graph.add_buffer(
        width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base or Fraction(1, 1)
    )
    scale = graph.add("scale", "flags=bilinear")
    rgb = graph.add("format", "pix_fmts=rgb24")
    return graph.link_nodes(source, scale, rgb, graph.add("buffersink"))


def _upright(frame_rgb: VideoFrame, video: VideoInfo, number: int) -> UInt8[np.ndarray, "height width 3"]:
    plane = frame_rgb.planes[0]
    # No copy of the frame: a view of its rows, which may be padded.
    rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)  # type: ignore[call-overload]
    image_rgb = rows[:, : 3 * plane.width].reshape(plane.height, plane.width, 3)
    turned = np.rot90(image_rgb, k=video.rotation_deg // 90) if video.rotation_deg else image_rgb
    if (turned.shape[1], turned.shape[0]) != video.size_px:
        raise InputError(
            [
                Problem(
                    "video_changes_size",
                    f"Frame {number} has another size than the first.",
                    file=video.path.name,
                    hint="Cut the video there.",
                )
            ]
        )
    return turned


def _undecodable(video: VideoInfo, number: int) -> InputError:
    return InputError(
        [
            Problem(
                "video_damaged",
                f"Frame {number} of {video.num_frames} can't be decoded.",
                file=video.path.name,
                hint="Copy the file again, or cut it before that frame.",
            )
        ]
    )
