"""Bodies that are expected elsewhere than they were looked for: only their crops would show anything new."""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.association.redetection.expect import enough, selected
from pipeline.core.data.detections import Detections
from pipeline.detection.topdown.blazepose import body_region
from pipeline.detection.topdown.regions import Region

# Differences of a crop that shows the same: of its centre as a share of its side, of the logarithm of its side, and of
# its angle.
_SAME_PLACE, _SAME_SIZE, _SAME_ANGLE_RAD = 0.1, 0.15, np.radians(15.0)


def expected_elsewhere(
    expected: Sequence[Detections],
    looked_for: Sequence[Detections],
    turns_deg: Mapping[str, float],
) -> tuple[Detections, ...]:
    """Keep the expected bodies whose crops differ from all crops of the same pictures; see also ``enough``.

    Parameters
    ----------
    expected, looked_for
        Expected joints ``COCO_17`` of each camera, by frame; see ``redetection.expect``. Both have the same cameras.
    turns_deg
        Counterclockwise turns that bring the pictures upright, by name of the camera.

    Returns
    -------
        As many as cameras, in the order of ``expected``.
    """
    kept = []
    for bodies, before in zip(expected, looked_for, strict=True):
        turn_deg = turns_deg[bodies.camera]
        rows = [
            row
            for row, region in enumerate(_regions(bodies, turn_deg))
            if region is not None and not _is_known(region, before.within(_one(bodies.frame[row])), turn_deg)
        ]
        kept.append(enough(selected(bodies, np.array(rows, np.int64))))
    return tuple(kept)


def _one(frame: np.integer) -> range:
    return range(int(frame), int(frame) + 1)


def _regions(bodies: Detections, turn_deg: float) -> list[Region | None]:
    """Region of each body's crop; ``None`` of a body that is too small."""
    marks = zip(bodies.keypoints_px, bodies.score, strict=True)
    return [body_region(points_px, score, turn_deg) for points_px, score in marks]


def _is_known(region: Region, looked_for: Detections, turn_deg: float) -> bool:
    """True if a crop that was read in the same picture shows the same."""
    return any(known is not None and _is_alike(region, known) for known in _regions(looked_for, turn_deg))


def _is_alike(region: Region, known: Region) -> bool:
    away = np.linalg.norm(np.subtract(region.center_px, known.center_px)) / known.side_px
    turn = np.angle(np.exp(1j * (region.angle_rad - known.angle_rad)))
    size = np.log(region.side_px / known.side_px)
    return bool(away < _SAME_PLACE and abs(size) < _SAME_SIZE and abs(turn) < _SAME_ANGLE_RAD)
