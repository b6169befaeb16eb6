"""Pictures of cameras with the skeletons over them, at moments that tell most about a take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.calibration.sizes import scaled
from pipeline.core.data.cameras import Camera
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import JointSet, without_hands
from pipeline.export.overlay import NO_NAMES, draw_skeletons
from pipeline.export.quality.views import PersonViews
from pipeline.export.viewer.description import mean_of_known

LONG_SIDE_PX = 800
MAX_PICTURES = 32
"""Largest number of pictures of a report; of many cameras there are pictures of one moment, or of the first ones."""

_JPEG_QUALITY = 82
_BACKGROUND = 32


@dataclass(frozen=True, slots=True)
class Moment:
    """Moment of a take."""

    title: str  # Heading of its pictures
    frame: int  # Output frame


@dataclass(frozen=True, slots=True)
class Picture:
    """Picture of a camera at a moment."""

    moment: Moment  # The moment
    camera: str  # Name of the camera
    time_s: float  # Time at which the picture was taken, on the session's clock
    size_px: tuple[int, int]  # Width and height
    jpeg: bytes  # The compressed picture


def presence(
    take: Reconstruction, views: Sequence[PersonViews]
) -> tuple[Int[np.ndarray, " frames"], Float[np.ndarray, " frames"]]:
    """Number of people in each output frame, and mean reprojection error in pixels of the worst of them.

    The error is the error of the body's joints; NaN where no camera sees anybody.
    """
    num_people = np.zeros(take.timebase.num_frames, int)
    error_px = np.full(take.timebase.num_frames, np.nan)
    num_body_joints = len(without_hands(take.joints).names)
    for track, seen in zip(take.tracks, views, strict=True):
        rows = slice(track.start_frame, track.start_frame + track.num_frames)
        num_people[rows] += 1
        mean_px = mean_of_known(mean_of_known(seen.error_px[:, :, :num_body_joints]))
        error_px[rows] = np.fmax(error_px[rows], mean_px)
    return num_people, error_px


def choose_moments(
    num_people: Int[np.ndarray, " frames"], error_px: Float[np.ndarray, " frames"], num_cameras: int
) -> list[Moment]:
    """Moments of a take to show: in the middle of the frames with most people, and the one with the largest error.

    Frames are described by ``presence``.
    """
    if not num_people.any():
        return [Moment("Middle of the take", len(num_people) // 2)]
    fullest = np.flatnonzero(num_people == num_people.max())
    moments = [Moment("Most people at once", int(fullest[len(fullest) // 2]))]
    if np.isfinite(error_px).any():
        worst = int(np.nanargmax(error_px))
        if worst != moments[0].frame and 2 * num_cameras <= MAX_PICTURES:
            moments.append(Moment(f"Largest reprojection error ({error_px[worst]:.1f} px)", worst))
    return moments


def draw_picture(
    image_rgb: UInt8[np.ndarray, "height width 3"] | None,
    camera: Camera,
    people_m: Mapping[int, Float[np.ndarray, "joints 3"]],
    joints: JointSet,
    names: Mapping[int, str] = NO_NAMES,
) -> tuple[tuple[int, int], bytes]:
    """Draw people over a camera's picture.

    ``image_rgb`` has the camera's size; ``None``: a dark ground. Names are by number. Returns width and height, and the
    picture as JPEG, its long side at most ``LONG_SIDE_PX``.
    """
    scale = min(1.0, LONG_SIDE_PX / max(camera.size_px))
    width, height = (max(1, round(scale * side)) for side in camera.size_px)
    if image_rgb is None:
        image_rgb = np.full((height, width, 3), _BACKGROUND, np.uint8)
    ground = cv2.resize(np.ascontiguousarray(image_rgb), (width, height), interpolation=cv2.INTER_AREA)
    drawn = draw_skeletons(
        ground.astype(np.uint8, copy=False), scaled(camera, (width, height)), people_m, joints, names
    )
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(drawn, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return (width, height), bytes(jpeg)
