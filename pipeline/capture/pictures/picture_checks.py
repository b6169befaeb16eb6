"""Check a session's pictures, a few of each camera: too dark, blurred, frozen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.capture.pictures.figures import PictureFigures, largest_change
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import PICTURE_BLURRED, PICTURE_DARK, PICTURE_FROZEN

# In a picture with so many dark pixels even what is bright is dark.
_DARK_SHARE = 0.98
# Width of edges from which on hands and feet are lost: a person of a third of the picture has wrists of 0.5 % of it,
# and a network that reduces the picture to 640 pixels sees edges of 2 pixels. Small pictures have coarser edges.
_BLUR_SHARE, _BLUR_PX = 0.003, 2.0
# Change of a cell, 2 % of the picture's longer side, in grey levels: codecs of low quality change it by up to 10, a
# person of a tenth of the picture's height, of common contrast, by 30.
STILL = 12.0
# Time for which a picture must stand still, as a share of the camera's time and in seconds.
_FROZEN_SHARE, _FROZEN_S = 0.5, 1.0
_MIN_SAME = 3

PICTURES = "pictures"
"""Name of the evidence that lists pictures of the camera, by their numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraPictures:
    """Figures of some pictures of a camera."""

    camera: str  # Name of the camera
    time_s: Float[np.ndarray, " pictures"]  # Times of the pictures on the session's clock, ascending
    figures: tuple[PictureFigures, ...]  # Figures of each picture

    @property
    def middle(self) -> int:
        """Number of the picture in the middle."""
        return len(self.figures) // 2


def check_pictures(cameras: Sequence[CameraPictures]) -> list[Finding]:
    """Check the pictures of each camera.

    Cameras without pictures are left out. The evidence ``pictures`` of a finding has numbers of pictures of the camera.
    """
    findings: list[Finding] = []
    for camera in cameras:
        if dark := list(_check_dark(camera)):
            # A dark picture has no edges, and does not move.
            findings += dark
        elif camera.figures:
            findings += [*_check_blurred(camera), *_check_frozen(camera, cameras)]
    return findings


def is_dark(figures: PictureFigures) -> bool:
    """True if a picture is too dark for people to be seen."""
    return figures.dark_share >= _DARK_SHARE


def _check_dark(camera: CameraPictures) -> Iterator[Finding]:
    dark = [number for number, picture in enumerate(camera.figures) if is_dark(picture)]
    if 2 * len(dark) > len(camera.figures):
        share = float(np.median([camera.figures[number].dark_share for number in dark]))
        message = (
            f"The picture is too dark: {_percent(share)} of it is darker than 16 % of white, in {len(dark)} of "
            f"{len(camera.figures)} pictures."
        )
        hint = "Light the scene, open the aperture or expose longer; or brighten the video before."
        yield Finding(
            PICTURE_DARK, message, camera.camera, "warning", hint, {"dark_share": share, **_seen(camera, dark)}
        )


def _check_blurred(camera: CameraPictures) -> Iterator[Finding]:
    blurred = [
        number
        for number, picture in enumerate(camera.figures)
        if picture.blur_share >= _BLUR_SHARE and picture.blur_px >= _BLUR_PX
    ]
    if 2 * len(blurred) > len(camera.figures):
        share = float(np.median([camera.figures[number].blur_share for number in blurred]))
        message = (
            f"The picture is blurred: its sharpest edges are {100 * share:.2g} % of its longer side wide, in "
            f"{len(blurred)} of {len(camera.figures)} pictures."
        )
        hint = "Focus on the place where people are, clean the lens, or send the video as the camera recorded it."
        yield Finding(
            PICTURE_BLURRED, message, camera.camera, "warning", hint, {"blur_share": share, **_seen(camera, blurred)}
        )


def _check_frozen(camera: CameraPictures, cameras: Sequence[CameraPictures]) -> Iterator[Finding]:
    first, last = _longest_still(camera)
    start_s, stop_s = float(camera.time_s[first]), float(camera.time_s[last])
    whole_s = float(camera.time_s[-1] - camera.time_s[0])
    if last - first + 1 < _MIN_SAME or stop_s - start_s < max(_FROZEN_S, _FROZEN_SHARE * whole_s):
        return
    moving = [other.camera for other in cameras if other is not camera and _moves(other, start_s, stop_s)]
    if moving:
        message = (
            f"The picture stays the same from {start_s:.1f} to {stop_s:.1f} s, while {moving[0]} sees motion: the "
            "video is frozen, or no person is in its view."
        )
        hint = "Look at the video; export it again, or leave the camera out."
        seen = _seen(camera, [first, last])
        evidence = {"start_s": start_s, "stop_s": stop_s, "other_camera": moving[0], **seen}
        yield Finding(PICTURE_FROZEN, message, camera.camera, "warning", hint, evidence)


def _longest_still(camera: CameraPictures) -> tuple[int, int]:
    """First and last picture of the longest time in which no picture differs from the first one."""
    best = (0, 0)
    for first, picture in enumerate(camera.figures):
        last = first
        while last + 1 < len(camera.figures) and _is_still(picture, camera.figures[last + 1]):
            last += 1
        if camera.time_s[last] - camera.time_s[first] > camera.time_s[best[1]] - camera.time_s[best[0]]:
            best = first, last
    return best


def _is_still(first: PictureFigures, second: PictureFigures) -> bool:
    return largest_change(first.cells, second.cells) < STILL


def _moves(camera: CameraPictures, start_s: float, stop_s: float) -> bool:
    """True if a camera sees motion within a time."""
    inside = [
        picture for time_s, picture in zip(camera.time_s, camera.figures, strict=True) if start_s <= time_s <= stop_s
    ]
    return any(not _is_still(inside[0], picture) for picture in inside[1:])


def _seen(camera: CameraPictures, numbers: Sequence[int]) -> dict[str, Any]:
    """Evidence of pictures: at most two of them, and how many there are."""
    return {"num_pictures": len(camera.figures), PICTURES: sorted({numbers[0], numbers[-1]})}


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
