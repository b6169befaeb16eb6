"""Simulated network with part affinity fields: heatmaps and fields, drawn from the truth with a network's faults.

Peaks are found in the maps as in a network's maps; the method gets no other information of the truth. Joints close
to each other merge to one peak, hidden joints are weak, displaced or missing, left joints also appear as right joints,
objects look like joints, and the maps are noisy.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import PafFields
from pipeline.core.joints import COCO_17, COCO_18
from pipeline.core.runtime.jit import kernel
from pipeline.detection.chunk import stack_fields
from pipeline.detection.decoders.fields import ImageFields, find_peaks, grid_on_image
from pipeline.detection.decoders.openpose import LIMBS
from pipeline.detection.letterbox import fit_letterbox
from pipeline.detection.registry import FieldGrid
from pipeline.geometry.fields import quantise
from pipeline.validation.simulation.views.detector import BEST_SCORE, DetectorAccuracy, look, see_joints
from pipeline.validation.simulation.views.faults import lasting_events
from pipeline.validation.simulation.views.occlusion import Box

GRID = FieldGrid(stride_px=8, shift_px=(0.0, 0.0), tau2=0.3)
"""Grid of the simulated network, whose input is ``_HEIGHT_PX`` high."""

_HEIGHT_PX = 480
# Standard deviation of a peak and half of a limb's width, as in OpenPose's training: 7 px and 8 px of its input, with
# cells of 8 px.
_SIGMA_CELLS = 7 / 8
_LIMB_RADIUS_CELLS = 1.0
# Strength of a limb relative to its weaker end, and standard deviation of the maps' noise.
_LIMB_AMPLITUDE = 0.85
_MAP_NOISE = 0.015
# Share of joints that appear on the other side, too, and their strength there.
_CONFUSED_RATE, _CONFUSED_SHARE = 0.15, 0.5
# False peaks: mean number for each joint and image, and range of their strengths.
_CLUTTER_RATE, _CLUTTER_SCORES = 0.3, (0.08, 0.35)


def _mirrored(name: str) -> str:
    other = {"left": "right", "right": "left"}
    side, _, joint = name.partition("_")
    return f"{other[side]}_{joint}" if side in other else name


_OTHER_SIDE, _OTHER_SIDE_18 = (
    np.array(joints.indices(tuple(_mirrored(name) for name in joints.names))) for joints in (COCO_17, COCO_18)
)
_SHOULDERS = COCO_17.indices(("left_shoulder", "right_shoulder"))
_NECK = COCO_18.index("neck")
_BESIDE_NECK = [j for j in range(len(COCO_18.names)) if j != _NECK]
_IN_COCO_17 = COCO_17.indices(tuple(COCO_18.names[j] for j in _BESIDE_NECK))


@dataclass(frozen=True, slots=True, eq=False)
class Sketch:
    """Content of one camera's maps."""

    camera: Camera  # Camera of the maps
    # Position of each joint of ``COCO_18`` with noise, and its strength, 0 for a missing joint
    points_px: Float[np.ndarray, "people frames joints 2"]
    amplitude: Float[np.ndarray, "people frames joints"]
    confused: Bool[np.ndarray, "people frames joints"]  # True if the joint also appears on the other side
    seed: int  # Seed of the noise of single frames


def sketch(
    camera: Camera,
    period_s: float,
    people_m: Float[np.ndarray, "people frames joints 3"],
    boxes: Sequence[Box],
    detector: DetectorAccuracy,
    rng: np.random.Generator,
) -> Sketch:
    """Draw the content of a camera's maps; for the arguments see ``detector.detect``.

    Faults of the detector that occur after the grouping of joints to bodies do not apply.
    """
    view = look(camera, people_m, boxes)
    shape, noise_frames = view.hidden.shape, detector.noise_memory_s / period_s
    who = np.broadcast_to(np.arange(shape[0])[:, None, None], shape)
    swapped = lasting_events(rng, shape[:2], detector.faults.swap, noise_frames)[..., None]
    which = np.where(swapped, _OTHER_SIDE, np.broadcast_to(np.arange(shape[2]), shape))
    points_px, amplitude = see_joints(view, who, which, detector, noise_frames, rng)
    missed = lasting_events(rng, shape[:2], detector.faults.miss_body, noise_frames)
    amplitude = np.where(missed[..., None], 0.0, amplitude)
    joint_first = (shape[0], len(COCO_18.names), shape[1])
    confused = np.moveaxis(lasting_events(rng, joint_first, _CONFUSED_RATE, noise_frames), 1, -1)
    return Sketch(
        camera=camera,
        points_px=_with_neck(points_px),
        amplitude=_with_neck(amplitude[..., None])[..., 0],
        confused=confused,
        seed=int(rng.integers(2**32)),
    )


def _with_neck(values: Float[np.ndarray, "people frames 17 axes"]) -> Float[np.ndarray, "people frames 18 axes"]:
    """Convert values of ``COCO_17`` to ``COCO_18``; the neck is the mean of the shoulders."""
    every = np.empty((*values.shape[:2], len(COCO_18.names), values.shape[3]))
    every[:, :, _BESIDE_NECK] = values[:, :, _IN_COCO_17]
    every[:, :, _NECK] = values[:, :, _SHOULDERS].mean(2)
    return every


def render(
    sketches: Sequence[Sketch], times: Mapping[str, FrameTimes], span_s: tuple[float, float]
) -> dict[str, PafFields]:
    """Draw the maps of all cameras for a range of time, and read peaks and fields from them.

    Frame times, peaks and fields are by camera name; the range is ``[t0, t1)``.
    """
    rendered = {}
    for content in sketches:
        first, stop = np.searchsorted(times[content.camera.name].time_s, span_s)
        rendered[content.camera.name] = stack_fields(
            content.camera.name, [(frame, _draw(content, frame)) for frame in range(int(first), int(stop))]
        )
    return rendered


def _draw(content: Sketch, frame: int) -> ImageFields:
    rng = np.random.default_rng([content.seed, frame])
    letterbox = fit_letterbox(content.camera.size_px, _HEIGHT_PX / content.camera.size_px[1], GRID.stride_px)
    width, height = (side // GRID.stride_px for side in letterbox.padded_size_px)
    grid = grid_on_image(GRID, letterbox)
    heatmaps = np.zeros((len(COCO_18.names), height, width), np.float32)
    fields, count = np.zeros((len(LIMBS), 2, height, width), np.float32), np.zeros((len(LIMBS), height, width))

    cells, amplitude = grid.map_from_image(content.points_px[:, frame]), content.amplitude[:, frame]
    for joint, points, strength in _peaks(cells, amplitude, content.confused[:, frame], (width, height), rng):
        draw_peaks(joint, points, strength, _SIGMA_CELLS, heatmaps)
    person, limb = np.nonzero((amplitude[:, LIMBS] > 0).all(-1))
    ends = cells[person[:, None], LIMBS[limb]]
    strength = _LIMB_AMPLITUDE / BEST_SCORE * amplitude[person[:, None], LIMBS[limb]].min(-1)
    draw_limbs(limb, ends[:, 0].copy(), ends[:, 1].copy(), strength, _LIMB_RADIUS_CELLS, fields, count)
    heatmaps += _MAP_NOISE * rng.standard_normal(heatmaps.shape, np.float32)
    fields += _MAP_NOISE * rng.standard_normal(fields.shape, np.float32)
    joint, places, score = find_peaks(heatmaps)
    return ImageFields(joint, grid.image_from_map(places), score, quantise(fields), grid)


def _peaks(
    cells: Float[np.ndarray, "people joints 2"],
    amplitude: Float[np.ndarray, "people joints"],
    confused: Bool[np.ndarray, "people joints"],
    size: tuple[int, int],
    rng: np.random.Generator,
) -> Iterator[tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]]:
    """Joints, positions and strengths of the peaks: true joints, joints on the wrong side, and clutter."""
    person, joint = np.nonzero(amplitude > 0)
    yield joint, cells[person, joint], amplitude[person, joint]
    person, joint = np.nonzero((amplitude > 0) & confused)
    yield _OTHER_SIDE_18[joint], cells[person, joint], _CONFUSED_SHARE * amplitude[person, joint]
    clutter = np.repeat(np.arange(len(COCO_18.names)), rng.poisson(_CLUTTER_RATE, len(COCO_18.names)))
    yield (
        clutter,
        rng.uniform(-0.5, np.array(size) - 0.5, (len(clutter), 2)),
        rng.uniform(*_CLUTTER_SCORES, len(clutter)),
    )


@kernel
@no_type_check
def draw_peaks(joint, cells, amplitude, sigma, maps):
    """Draw a Gaussian for each point; overlapping Gaussians give their maximum, as in OpenPose's training.

    Joint, position (x, y) in cells, and height of each peak are (n,), (n, 2), (n,); ``sigma`` is in cells. The heatmaps
    ``maps`` (joints, height, width) are changed in place.
    """
    height, width = maps.shape[1], maps.shape[2]
    reach = 4.0 * sigma
    for k in range(len(joint)):
        x, y = cells[k, 0], cells[k, 1]
        first_row, last_row = max(int(y - reach), 0), min(int(y + reach) + 2, height)
        first_column, last_column = max(int(x - reach), 0), min(int(x + reach) + 2, width)
        for row in range(first_row, last_row):
            for column in range(first_column, last_column):
                squared = (column - x) * (column - x) + (row - y) * (row - y)
                value = amplitude[k] * np.exp(-0.5 * squared / (sigma * sigma))
                maps[joint[k], row, column] = max(maps[joint[k], row, column], value)


@kernel
@no_type_check
def draw_limbs(limb, begin, end, amplitude, radius, fields, count):
    """Draw the unit vector of each limb along the limb; overlapping limbs give their mean.

    ``limb``, ``begin``, ``end``, ``amplitude``: field, end points (x, y) in cells, and strength of each limb: (n,), (n,
    2), (n, 2), (n,). ``radius``: half of a limb's width, in cells. ``fields``: zeros (limbs, 2, height, width), changed
    in place. ``count``: work array, zeros (limbs, height, width).
    """
    height, width = fields.shape[2], fields.shape[3]
    for k in range(len(limb)):
        x0, y0, x1, y1 = begin[k, 0], begin[k, 1], end[k, 0], end[k, 1]
        along_x, along_y = x1 - x0, y1 - y0
        length = max(np.sqrt(along_x * along_x + along_y * along_y), 1e-6)
        unit_x, unit_y = along_x / length, along_y / length
        first_row, last_row = max(int(min(y0, y1) - radius), 0), min(int(max(y0, y1) + radius) + 2, height)
        first_column, last_column = max(int(min(x0, x1) - radius), 0), min(int(max(x0, x1) + radius) + 2, width)
        for row in range(first_row, last_row):
            for column in range(first_column, last_column):
                offset_x, offset_y = column - x0, row - y0
                along = offset_x * unit_x + offset_y * unit_y
                across = abs(offset_x * unit_y - offset_y * unit_x)
                if -radius <= along <= length + radius and across <= radius:
                    fields[limb[k], 0, row, column] += amplitude[k] * unit_x
                    fields[limb[k], 1, row, column] += amplitude[k] * unit_y
                    count[limb[k], row, column] += 1.0
    for number in range(fields.shape[0]):
        for row in range(height):
            for column in range(width):
                if count[number, row, column] > 1.0:
                    fields[number, 0, row, column] /= count[number, row, column]
                    fields[number, 1, row, column] /= count[number, row, column]
