"""Cameras for a size of picture: guessed, or fitted by padding, scales, quarter turns and the shape of pixels."""

from dataclasses import replace

import numpy as np

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import twelve_coefficients

_MAX_OFF_CENTRE = 0.25
# Codecs store whole blocks: 1080 rows become 1088 rows.
_BLOCKS_PX = (8, 16)
# Sides of the shown picture that the stored picture's right and bottom come to, by the turn for display. A picture that
# is mirrored before has the sides of a quarter turn less.
_SIDES = {0: ("right", "bottom"), 90: ("right", "top"), 180: ("left", "top"), 270: ("left", "bottom")}
# From the axes of a camera to the axes of the camera turned with the picture, a quarter counterclockwise.
_QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def guessed_camera(name: str, size_px: tuple[int, int]) -> Camera:
    """Guess the intrinsics of a camera from the size of its picture; its pose is the identity.

    The focal length is the longer side, a horizontal field of view of 53 degrees, between the fields of phones and of
    action cameras without a wide lens.
    """
    width, height = size_px
    focal_px = float(max(size_px))
    matrix = [[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]]
    pose = Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))
    return Camera(name, size_px, read_only(np.array(matrix)), read_only(np.zeros(0)), pose)


def fit_to_video(
    camera: Camera,
    size_px: tuple[int, int],
    rotation_deg: int,
    stored_size_px: tuple[int, int],
    is_mirrored: bool = False,
) -> tuple[Camera, str] | None:
    """Adapt a camera to a video, whose stored pixels may be other than square.

    ``size_px``, ``rotation_deg``, ``is_mirrored``: see ``fit_to_picture``. ``stored_size_px``: width and height of the
    stored picture, before its pixels become square and before rotation. Returns camera of the shown picture and a
    sentence that says what was done, empty if nothing; ``None`` if the sizes don't fit. The calibration may be of the
    shown picture or of the picture with stored pixels; in the latter case it is stretched as the picture is. A
    calibration without a size is of the pixels that its focal lengths fit.
    """
    unstretched_px = stored_size_px if rotation_deg % 180 == 0 else stored_size_px[::-1]
    is_square = unstretched_px == size_px
    if camera.size_px == UNKNOWN_SIZE and not is_square:
        wide = size_px[0] / unstretched_px[0] * unstretched_px[1] / size_px[1]
        focal_ratio = float(camera.matrix[1, 1] / camera.matrix[0, 0])
        is_square = abs(np.log(focal_ratio)) < abs(np.log(focal_ratio / wide))
    elif camera.size_px == size_px:
        return camera, ""
    is_stored = camera.size_px == unstretched_px
    if is_square or (not is_stored and camera.size_px != UNKNOWN_SIZE):
        fitted = fit_to_picture(camera, size_px, rotation_deg, is_mirrored)
        if is_square or fitted is not None:
            return fitted
    fitted = (camera, "") if is_stored else fit_to_picture(camera, unstretched_px, rotation_deg, is_mirrored)
    if fitted is None:
        return None
    done = "the calibration is stretched as the pixels are, which are not square"
    return scaled(fitted[0], size_px), f"{fitted[1]}, and {done}" if fitted[1] else done


def fit_to_picture(
    camera: Camera, size_px: tuple[int, int], rotation_deg: int, is_mirrored: bool = False
) -> tuple[Camera, str] | None:
    """Adapt a camera to a video of another size, where one way alone explains the difference.

    ``size_px``: width and height of the video's picture as shown; not the size of ``camera``. ``rotation_deg``:
    counterclockwise turn of the stored picture for display: 0, 90, 180 or 270. ``is_mirrored``: whether left and right
    of the stored picture are exchanged before the turn. Returns camera of the shown picture and a sentence that says
    what was done; ``None`` if the sizes don't fit. A camera of unknown size fits if its principal point is near the
    middle of the picture. A transposed size fits only if the file turns its picture by a quarter: else either quarter
    turn is possible. It does not fit a mirrored picture: no camera of the stored picture is one of the shown picture.
    """
    width, height = camera.size_px
    if camera.size_px == UNKNOWN_SIZE:
        sized = replace(camera, size_px=size_px)
        return (sized, "the video's size is taken") if _is_central(sized) else None
    if _is_padding(camera.size_px, size_px):
        right, bottom = _SIDES[(rotation_deg - 90 * is_mirrored) % 360]
        padding = f"{abs(size_px[0] - width)} columns at the {right}"
        if size_px[0] == width:
            padding = f"{abs(size_px[1] - height)} rows at the {bottom}"
        return _cropped(camera, size_px, (right, bottom)), f"{padding} are taken as the codec's padding"
    if (size_px[0] - width, size_px[1] - height) in {(1, 1), (-1, -1)}:
        return replace(camera, size_px=size_px), "the calibration counts the sides of the picture one pixel off"
    if size_px[0] * height == size_px[1] * width:
        return scaled(camera, size_px), f"the calibration is scaled by {size_px[0] / width:.6g}"
    if size_px == (height, width) and rotation_deg % 180 == 90 and not is_mirrored and camera.matrix[0, 1] == 0:
        turned = camera
        for _ in range(rotation_deg // 90):
            turned = _turned(turned)
        return turned, f"the calibration is turned by {rotation_deg} degrees counterclockwise, as the video file says"
    return None


def _is_central(camera: Camera) -> bool:
    """Return whether the principal point is in the middle half of the picture's width and height."""
    share = (camera.matrix[:2, 2] + 0.5) / np.array(camera.size_px)
    return bool((np.abs(share - 0.5) < _MAX_OFF_CENTRE).all())


def _is_padding(calibrated_px: tuple[int, int], shown_px: tuple[int, int]) -> bool:
    """Return whether one side is equal, and the other is one of the two sizes rounded up to whole blocks."""
    differing = [sorted(sides) for sides in zip(calibrated_px, shown_px, strict=True) if sides[0] != sides[1]]
    if len(differing) != 1:
        return False
    ((small, large),) = differing
    return any(large == -(-small // block) * block for block in _BLOCKS_PX)


def _cropped(camera: Camera, size_px: tuple[int, int], padded: tuple[str, str]) -> Camera:
    """Camera of a picture with more or fewer pixels at the padded sides."""
    shift_px = np.zeros((3, 3))
    right, bottom = padded
    if right == "left":
        shift_px[0, 2] = size_px[0] - camera.size_px[0]
    if bottom == "top":
        shift_px[1, 2] = size_px[1] - camera.size_px[1]
    return replace(camera, size_px=size_px, matrix=read_only(camera.matrix + shift_px))


def scaled(camera: Camera, size_px: tuple[int, int]) -> Camera:
    """Camera of a scaled picture; the outer edges of the pictures, half a pixel from the centres, stay together."""
    factors = np.array(size_px) / np.array(camera.size_px)
    matrix = camera.matrix * np.array([[factors[0]], [factors[1]], [1.0]])
    matrix[:2, 2] = factors * (camera.matrix[:2, 2] + 0.5) - 0.5
    return replace(camera, size_px=size_px, matrix=read_only(matrix))


def _turned(camera: Camera) -> Camera:
    """Camera of the picture turned by a quarter counterclockwise: pixel (x, y) becomes (y, width - 1 - x)."""
    width, height = camera.size_px
    k = camera.matrix
    matrix = np.array([[k[1, 1], 0.0, k[1, 2]], [0.0, k[0, 0], width - 1 - k[0, 2]], [0.0, 0.0, 1.0]])
    distortion = camera.distortion
    if camera.lens == "standard":
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = twelve_coefficients(camera.distortion)
        distortion = np.array([k1, k2, -p2, p1, k3, k4, k5, k6, s3, s4, -s1, -s2])[: len(camera.distortion)]
    pose = camera.cam_from_world
    turned = Rigid3(read_only(_QUARTER @ pose.rotation), read_only(_QUARTER @ pose.translation_m))
    return replace(
        camera,
        size_px=(height, width),
        matrix=read_only(matrix),
        distortion=read_only(distortion),
        cam_from_world=turned,
    )
