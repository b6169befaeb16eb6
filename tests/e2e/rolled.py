"""Captures whose cameras hang turned: videos turned without loss, and their calibration turned likewise."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.video.plane import VideoPlane

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.sizes import fit_to_picture
from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera


@dataclass(frozen=True, slots=True)
class RolledCapture:
    """Capture of cameras that hang turned."""

    videos: Mapping[str, Path]  # Video files by camera name
    calibration: Path  # Calibration file


def roll(videos: Mapping[str, Path], calibration: Path, quarters: Mapping[str, int], folder: Path) -> RolledCapture:
    """Turn the pictures of cameras counterclockwise by quarters, as if the cameras had been turned clockwise.

    Cameras without a number of quarters keep their videos. The folder must be empty.
    """
    turned = dict(videos)
    for name, number in quarters.items():
        turned[name] = folder / f"{name}.mp4"
        _turn_video(videos[name], number, turned[name])
    cameras = [_turn_camera(camera, quarters.get(camera.name, 0)) for camera in read_calibration(calibration)]
    written = folder / "calibration.json"
    written.write_bytes(encode(cameras))
    return RolledCapture(turned, written)


def _turn_camera(camera: Camera, quarters: int) -> Camera:
    for _ in range(quarters):
        fitted = fit_to_picture(camera, camera.size_px[::-1], 90)
        if fitted is None:
            raise ValueError(f"The camera {camera.name} can't be turned.")
        camera = fitted[0]
    return camera


def _turn_video(video: Path, quarters: int, target: Path) -> None:
    """Turn the pictures of a video; its samples are kept as they are, and so are the times of its frames."""
    with av.open(video) as source, av.open(target, "w") as sink:
        stream = source.streams.video[0]
        width, height = stream.width, stream.height
        if quarters % 2:
            width, height = height, width
        options = {"qp": "0", "preset": "ultrafast", "bf": "0"}
        encoder = sink.add_stream("libx264", rate=stream.average_rate, options=options)
        encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
        if stream.time_base is not None:
            encoder.codec_context.time_base = stream.time_base
        for attribute in ("color_range", "colorspace", "color_primaries", "color_trc"):
            setattr(encoder.codec_context, attribute, getattr(stream.codec_context, attribute))
        for frame in source.decode(stream):
            planes = [_plane(plane) for plane in frame.reformat(format="yuv420p").planes]
            stacked = np.concatenate([np.rot90(plane, quarters).ravel() for plane in planes])
            turned = av.VideoFrame.from_ndarray(stacked.reshape(height * 3 // 2, width), "yuv420p")
            turned.pts, turned.time_base = frame.pts, frame.time_base
            sink.mux(encoder.encode(turned))
        sink.mux(encoder.encode())


def _plane(plane: VideoPlane) -> np.ndarray:
    return np.frombuffer(bytes(plane), np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]
