"""Share of true heads that a reconstruction covers where faces are blurred, by its people alone."""

from collections.abc import Mapping

import numpy as np

from pipeline.core.data.cameras import FrameTimes
from pipeline.core.data.heads import SeenHeads
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.export.privacy.heads import head_regions
from pipeline.export.privacy.people import FACE, head_path
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.datasets.rendered import RenderedTruth

_NOBODY = SeenHeads(np.empty(0, np.int64), np.empty((0, 4)))


def score_covered_heads(
    take: Reconstruction, times: Mapping[str, FrameTimes], truth: RenderedTruth
) -> dict[str, float | None]:
    """Score the regions of heads that follow from the people of a take, without any detection beside them.

    Each frame of a camera is compared with the truth of the nearest time within half a period, and each true nose, eye
    and ear whose projection lies in the picture counts, hidden ones too. ``times`` are those of the cameras' frames by
    name. Returns ``heads_covered``, the share inside a region; ``None`` without any.
    """
    tracks = [*take.located, *take.tracks]
    people = [path for track in tracks if (path := head_path(track, take.joints, take.timebase)) is not None]
    face = [truth.names.index(name) for name in FACE if name in truth.names]
    half_s = 0.5 / take.timebase.frame_rate_hz
    num_inside = num_shown = 0
    for camera in take.cameras:
        time_s = times[camera.name].time_s
        regions = head_regions(camera, range(len(time_s)), time_s, people, _NOBODY)
        for frame, now_s in enumerate(time_s):
            nearest = int(np.abs(truth.time_s - now_s).argmin())
            if abs(truth.time_s[nearest] - now_s) > half_s:
                continue
            points_px = project(camera, truth.xyz_m[:, nearest, face].reshape(-1, 3))
            with np.errstate(invalid="ignore"):
                shown_px = points_px[((points_px >= -0.5) & (points_px <= np.array(camera.size_px) - 0.5)).all(axis=1)]
            ellipse_px = regions.in_frame(frame, camera.size_px)
            away = (shown_px[:, None] - ellipse_px[None, :, :2]) / ellipse_px[None, :, 2:]
            num_inside += int(((away**2).sum(axis=2) <= 1.0).any(axis=1).sum())
            num_shown += len(shown_px)
    return {"heads_covered": num_inside / num_shown if num_shown else None}
