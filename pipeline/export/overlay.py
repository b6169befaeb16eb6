"""Draw skeletons over a camera's frame."""

import unicodedata
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.calibration.sizes import scaled
from pipeline.capture.session import Session
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.detections import HeadRegions
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import FINGER_JOINTS, JointSet
from pipeline.export.privacy.blur import blur_ellipses
from pipeline.export.scene import Rgb, color_rgb
from pipeline.geometry.camera import project
from pipeline.video.decode import decode
from pipeline.video.playback.h264 import even_size_px
from pipeline.video.playback.write_pictures import write_pictures
from pipeline.video.timeline import frames_in

_BLACK: Rgb = (0, 0, 0)
# cv2 draws with this many fractional bits.
_SHIFT = 4
_MAX_LABEL = 24
NO_NAMES: Mapping[int, str] = MappingProxyType({})


def _drawable(points_px: Float[np.ndarray, "joints 2"], size_px: tuple[int, int]) -> dict[int, tuple[int, int]]:
    """Points in the image, or outside of it by up to one image size, as fixed-point numbers of cv2, by joint.

    Farther points are dropped: there lens models fold over, and fixed-point numbers overflow.
    """
    size = np.array(size_px)
    with np.errstate(invalid="ignore"):
        near = ((points_px > -size) & (points_px < 2 * size)).all(-1)
    return {
        int(joint): (round(points_px[joint, 0] * 2**_SHIFT), round(points_px[joint, 1] * 2**_SHIFT))
        for joint in np.flatnonzero(near)
    }


def people_at(tracks: Sequence[Track3D], timebase: Timebase, time_s: float) -> dict[int, Float[np.ndarray, "joints 3"]]:
    """Joint positions of everybody at a time between two output frames, by the person's number.

    Positions are interpolated linearly. A joint that is known in one of the two frames alone has its position there if
    this frame is the nearer one, else none. People are there up to half a frame before their first frame and after
    their last one. Returns world coordinates in metres, NaN for unknown joints.
    """
    place = (time_s - timebase.start_time_s) * timebase.frame_rate_hz
    found = {}
    for track in tracks:
        row = place - track.start_frame
        if not -0.5 <= row < track.num_frames - 0.5:
            continue
        row = min(max(row, 0.0), track.num_frames - 1.0)
        before, share = int(row), row % 1.0
        behind = min(before + 1, track.num_frames - 1)
        between_m = (1 - share) * track.xyz_m[before] + share * track.xyz_m[behind]
        nearest_m = track.xyz_m[before if share < 0.5 else behind]
        found[track.track_id] = np.where(np.isfinite(between_m).all(-1, keepdims=True), between_m, nearest_m)
    return found


def draw_skeletons(
    image_rgb: UInt8[np.ndarray, "height width 3"],
    camera: Camera,
    people_m: Mapping[int, Float[np.ndarray, "joints 3"]],
    joints: JointSet,
    names: Mapping[int, str] = NO_NAMES,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the people of an instant over a camera's picture, each in their own colour with a label above.

    The label is the person's name, without accents and at most 24 characters of it; of people without a name, and with
    one in letters that the drawing does not have, the number.

    Fingers are drawn thinner than the rest of the body. The picture is of size ``camera.size_px`` and not changed.
    Positions are in world coordinates (metres) by the person's number; NaN joints are left out.
    """
    image = np.ascontiguousarray(image_rgb).copy()
    thickness = max(2, round(np.hypot(*camera.size_px) / 600))
    thin = max(1, thickness // 2)
    # Width of the bone that ends at a joint, and radius of the joint.
    width = [thin if name in FINGER_JOINTS else thickness for name in joints.names]
    for number, xyz_m in people_m.items():
        points = _drawable(project(camera, xyz_m), camera.size_px)
        color = color_rgb(number)
        for start, end in ((joints.index(a), joints.index(b)) for a, b in joints.bones):
            if start in points and end in points:
                # The dark outline keeps the line visible on any background.
                cv2.line(image, points[start], points[end], _BLACK, width[end] + 2, cv2.LINE_AA, _SHIFT)
                cv2.line(image, points[start], points[end], color, width[end], cv2.LINE_AA, _SHIFT)
        for joint, point in points.items():
            cv2.circle(image, point, (width[joint] + 1) << _SHIFT, _BLACK, -1, cv2.LINE_AA, _SHIFT)
            cv2.circle(image, point, width[joint] << _SHIFT, color, -1, cv2.LINE_AA, _SHIFT)
        if points:
            label = _drawable_text(names.get(number, "")) or str(number)
            _label(image, label, min(points.values(), key=lambda point: point[1]), color, thickness)
    return image


def given_names(motions: Iterable[SkeletonMotion]) -> dict[int, str]:
    """Names that people were given, by number."""
    return {motion.track_id: motion.name for motion in motions if motion.name != f"person-{motion.track_id}"}


def _drawable_text(name: str) -> str:
    """Name in the letters that cv2 draws (ASCII), without accents; empty if it has others."""
    plain = "".join(char for char in unicodedata.normalize("NFKD", name) if not unicodedata.combining(char))
    return plain[:_MAX_LABEL] if plain.isascii() and plain.isprintable() else ""


def _label(
    image: UInt8[np.ndarray, "height width 3"], text: str, above: tuple[int, int], color: Rgb, thickness: int
) -> None:
    """Write a label centred above a point, in place."""
    scale = 0.35 * thickness
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
    origin = ((above[0] >> _SHIFT) - width // 2, (above[1] >> _SHIFT) - 5 * thickness)
    cv2.putText(image, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, _BLACK, thickness + 3, cv2.LINE_AA)
    cv2.putText(image, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, color, thickness, cv2.LINE_AA)


def encode_png(image_rgb: UInt8[np.ndarray, "height width 3"]) -> bytes:
    """Compress a picture as PNG."""
    _, encoded = cv2.imencode(".png", cv2.cvtColor(image_rgb, cv2.COLOR_RGB2BGR))
    return bytes(encoded)


LONG_SIDE_PX = 1280
"""Longest side of an overlay's pictures; smaller videos keep their size."""

_MAX_NAME = 60


def overlay_names(cameras: Sequence[str]) -> tuple[str, ...]:
    """Names of the overlay videos of cameras: letters and digits of ASCII, all different.

    >>> overlay_names(["Cam 1", "cam/1", "left"])
    ('overlay-Cam-1.mp4', 'overlay-cam-1-2.mp4', 'overlay-left.mp4')
    """
    names: list[str] = []
    taken: set[str] = set()
    for camera in cameras:
        kept = "".join(
            letter if letter.isascii() and (letter.isalnum() or letter in "_-") else " " for letter in camera
        )
        word = "-".join(kept.split())[:_MAX_NAME] or "camera"
        name, number = word, 1
        while name.lower() in taken:
            number += 1
            name = f"{word}-{number}"
        taken.add(name.lower())
        names.append(f"overlay-{name}.mp4")
    return tuple(names)


def draw_video(
    session: Session,
    take: Reconstruction,
    camera: str,
    path: Path,
    on_frame: Callable[[], object],
    heads: HeadRegions | None = None,
) -> bool:
    """Write the overlay video of a camera, frame by frame: the memory does not grow with its length.

    The skeletons are at the time of each frame: between output frames, and on the session's clock.

    - ``session``: session of the take, on measured clocks if they were measured.
    - ``on_frame``: called after each frame; an exception from it ends the work.
    - ``heads``: heads that are blurred below the skeletons; ``None``: none are.
    - Returns whether the camera took frames of the take; otherwise there is no video.
    - Raises ``InputError``: see ``pipeline.video.decode.decode``.
    """
    video, times = session.camera_videos[camera], session.times[camera]
    timebase = take.timebase
    frames = frames_in(times, timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
    if not frames:
        return False
    (shown,) = (known for known in take.cameras if known.name == camera)
    size_px = even_size_px(shown.size_px, LONG_SIDE_PX)
    small, time_s = scaled(shown, size_px), times.time_s[frames.start : frames.stop]

    names = given_names(take.motions)

    def drawn() -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
        with closing(decode(video, frames.start, frames.stop)) as decoded:
            for frame, image_rgb in decoded:
                picture = cv2.resize(np.ascontiguousarray(image_rgb), size_px, interpolation=cv2.INTER_AREA)
                if heads is not None:
                    picture = blur_ellipses(picture, heads.in_frame(frame, size_px))
                people_m = people_at(take.tracks, timebase, float(times.time_s[frame]))
                yield frame - frames.start, draw_skeletons(picture, small, people_m, take.joints, names)
                on_frame()

    with closing(drawn()) as pictures:
        return write_pictures(path, pictures, time_s, size_px) > 0
