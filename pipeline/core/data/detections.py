"""Detections in the pictures of one camera: bodies, or peaks and fields, heads, and damage of its frames."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from pipeline.core.data.arrays import no_changes, no_colours, no_frames, no_samples, short_text
from pipeline.core.data.turns import turned_axes


@dataclass(frozen=True, slots=True, eq=False)
class PictureChanges:
    """Changes of a camera's pictures from one frame to the next, see ``detect.doubled``."""

    # Numbers of the frames that were decoded, ascending
    frame: Int[np.ndarray, " frames"] = field(default_factory=no_frames)
    # Difference of each picture from the picture of the frame before, in grey levels; NaN where that is unknown
    change: Float[np.ndarray, " frames"] = field(default_factory=no_changes)
    # Samples of the first and the last picture
    first: UInt8[np.ndarray, " samples"] = field(default_factory=no_samples)
    last: UInt8[np.ndarray, " samples"] = field(default_factory=no_samples)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """2D bodies in the frames of one camera, sorted by frame.

    Parameters
    ----------
    camera
        Name of the camera.
    frame
        The camera's frame number of each body, ascending.
    keypoints_px
        Joints in full-image pixels (distorted, as seen), NaN where the detector found no joint.
    score
        The detector's confidence in [0, 1], 0 where the joint is NaN.
    box_px
        x0, y0, x1, y1 around each body.
    damaged
        Numbers of the frames whose picture is damaged or missing, ascending.
    colour
        Histograms of the colours of each body's parts, see ``detect.appearance``; zeros where a part is unknown. No
        rows: colours were not measured.
    changes
        Changes of the pictures; none in detections of other programs.

    Examples
    --------
    >>> joints_px, score = np.zeros((2, 17, 2)), np.ones((2, 17))
    >>> len(Detections("left", np.array([0, 3]), joints_px, score, np.zeros((2, 4))).within(range(2)).frame)
    1
    """

    camera: str
    frame: Int[np.ndarray, " n"]
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]
    box_px: Float[np.ndarray, "n 4"]
    damaged: Int[np.ndarray, " damaged"] = field(default_factory=no_frames)
    colour: UInt8[np.ndarray, "coloured parts bins"] = field(default_factory=no_colours)
    changes: PictureChanges = field(default_factory=PictureChanges, kw_only=True)

    __repr__ = short_text

    def select(self, rows: Int[np.ndarray, " rows"] | Bool[np.ndarray, " n"] | slice) -> "Detections":
        """Select bodies by their rows; damaged pictures and changes stay."""
        return replace(
            self,
            frame=self.frame[rows],
            keypoints_px=self.keypoints_px[rows],
            score=self.score[rows],
            box_px=self.box_px[rows],
            colour=self.colour[rows] if len(self.colour) else self.colour,
        )

    def within(self, frames: range) -> "Detections":
        """Select the bodies in a range of the camera's frame numbers, without the changes of the pictures."""
        ends = [frames.start, frames.stop]
        damaged = self.damaged[slice(*np.searchsorted(self.damaged, ends))]
        bodies = self.select(slice(*np.searchsorted(self.frame, ends)))
        return replace(bodies, damaged=damaged, changes=PictureChanges())


@dataclass(frozen=True, slots=True)
class MapGrid:
    """Positions of the cells of a network's maps on an image."""

    offset_px: tuple[float, float]  # Centre of cell (0, 0) in x and y, pixels of the full image
    pitch_px: tuple[float, float]  # Distance of neighbouring cells along the maps' x and y, pixels of the full image
    turn_deg: float = 0.0  # Counterclockwise turn of the image before the network saw it

    def image_from_map(self, cells: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map positions in cells to pixels of the full image."""
        steps_px = cells * np.array(self.pitch_px)
        return self._turned(steps_px, turned_axes(self.turn_deg).T) + np.array(self.offset_px)

    def map_from_image(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the full image to positions in cells."""
        steps_px = self._turned(points_px - np.array(self.offset_px), turned_axes(self.turn_deg))
        return steps_px / np.array(self.pitch_px)

    def _turned(
        self, vectors_px: Float[np.ndarray, "*batch 2"], rotation: Float[np.ndarray, "2 2"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Vectors after a rotation, unchanged to the last digit if the image was not turned."""
        return vectors_px if self.turn_deg == 0.0 else vectors_px @ rotation


@dataclass(frozen=True, slots=True, eq=False)
class PafFields:
    """Heatmap peaks and part affinity fields in frames of one camera, not yet grouped to bodies (Cao et al. 2017)."""

    camera: str  # The camera's name
    frame: Int[np.ndarray, " frames"]  # The camera's frame numbers, ascending
    # Row of each peak in ``frame``, ascending, and its joint
    peak_row: Int[np.ndarray, " n"]
    peak_joint: Int[np.ndarray, " n"]
    peak_px: Float[np.ndarray, "n 2"]  # Position of each peak in pixels of the full image (distorted, as seen)
    peak_score: Float[np.ndarray, " n"]  # Value of the heatmap at each peak: the detector's confidence
    # Unit vectors along each limb in x and y of the maps, in the order of ``limbs``; bytes made by
    # ``geometry.fields.quantise``
    fields: UInt8[np.ndarray, "frames limbs 2 height width"]
    limbs: Int[np.ndarray, "limbs 2"]  # First and second joint of each field's limb, as numbers on the joint axis
    grid: MapGrid  # Positions of the fields' cells on the image
    # Numbers of the frames whose picture is damaged or missing, ascending; a missing frame is not in ``frame``
    damaged: Int[np.ndarray, " damaged"] = field(default_factory=no_frames)
    changes: PictureChanges = field(default_factory=PictureChanges, kw_only=True)  # Changes of the pictures


DetectionsByCamera = Mapping[str, Detections] | Mapping[str, PafFields]
"""Bodies, or peaks and fields, by name of the camera."""


@dataclass(frozen=True, slots=True)
class DamagedVideo:
    """A video with damaged, missing or doubled pictures among the frames that a reconstruction uses."""

    # Name of the camera, and base name of the video file
    camera: str
    file: str
    # Number of damaged frames, and of all frames that are used
    num_damaged: int
    num_frames: int
    # Times of the first and the last damaged frame since the start of the video; 0 if none is damaged
    first_s: float
    last_s: float
    # Times of the frames that show the picture before once more, since the start of the video
    doubled_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SeenHeads:
    """Heads that a detector saw in the frames of a camera, sorted by frame."""

    frame: Int[np.ndarray, " n"]  # The camera's frame number of each head, ascending
    # Centre in x and y, half of the width and half of the height of an ellipse, distorted pixels; NaN for the last two
    # of a head of unknown size
    ellipse_px: Float[np.ndarray, "n 4"]


@dataclass(frozen=True, slots=True, eq=False)
class HeadRegions:
    """Ellipses around the heads in the frames of one camera, sorted by frame; their axes are the picture's."""

    camera: str  # Name of the camera
    size_px: tuple[int, int]  # Width and height of the pictures whose pixels are meant
    # Numbers of the first frame whose heads are known, and of the one after the last
    start_frame: int
    stop_frame: int
    frame: Int[np.ndarray, " n"]  # The camera's frame number of each ellipse, ascending
    # Centre in x and y, half of the width and half of the height, distorted pixels. An ellipse may reach out of the
    # picture, or lie outside of it.
    ellipse_px: Float[np.ndarray, "n 4"]

    def in_frame(self, frame: int, size_px: tuple[int, int]) -> Float[np.ndarray, "here 4"]:
        """Ellipses in a frame, in pixels of a copy of the picture of some size, whose outer edges are the same.

        An ellipse around the whole picture in a frame whose heads are not known.
        """
        if not self.start_frame <= frame < self.stop_frame:
            width, height = size_px
            return np.array([[width / 2, height / 2, width, height]])
        rows = slice(*np.searchsorted(self.frame, [frame, frame + 1]))
        scale = np.array(size_px) / self.size_px
        ellipse_px = self.ellipse_px[rows]
        # Pixel (0, 0) is the centre of the first pixel, and the edge of the picture half a pixel before.
        return np.concatenate([(ellipse_px[:, :2] + 0.5) * scale - 0.5, ellipse_px[:, 2:] * scale], axis=1)
