"""Find cameras that have the same video, whatever it was encoded with."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.capture.pictures.figures import DETAIL_MIN, PictureFigures, correlation, detail, largest_change
from pipeline.capture.pictures.picture_checks import PICTURES, STILL, CameraPictures, is_dark
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import SAME_VIDEO

# Correlation of the detail of two views: a camera with itself at other times is 0.7 to 1, since people cover
# parts of it; two cameras have 0 up to chance, unless the place is symmetric.
_SAME_VIEW = 0.5
# Correlation of the changes between the same instants.
_SAME_MOTION = 0.6
# Changes of fewer instants may be alike by chance.
MIN_INSTANTS = 3


def similar_views(cameras: Sequence[CameraPictures]) -> list[tuple[int, int]]:
    """Pairs of cameras with similar views, as numbers; for each camera the earlier one that is most alike."""
    views = [_view(camera) for camera in cameras]
    pairs = []
    for later, view in enumerate(views):
        alike = {
            earlier: correlation(view, other)
            for earlier, other in enumerate(views[:later])
            if view is not None and other is not None and view.shape == other.shape
        }
        best = max(alike, key=lambda number: alike[number], default=None)
        if best is not None and alike[best] >= _SAME_VIEW:
            pairs.append((best, later))
    return pairs


def _view(camera: CameraPictures) -> Float[np.ndarray, "rows columns"] | None:
    """Detail of what stands still in a camera's view; ``None`` if there is none."""
    views = [picture.view for picture in camera.figures if not is_dark(picture)]
    still = detail(np.median(views, axis=0)) if views else np.zeros((1, 1))
    return still if still.std() >= DETAIL_MIN else None


def same_video(
    first: CameraPictures, later: CameraPictures, of_first: Sequence[PictureFigures], of_later: Sequence[PictureFigures]
) -> Finding | None:
    """Compare the changes of two cameras with similar views.

    ``of_first`` and ``of_later`` are figures of their pictures at the same times since the starts of their files, at
    least three. Returns a finding about ``later``; ``None`` if the cameras see other motion.
    """
    if len(of_first) < MIN_INSTANTS or of_first[0].cells.shape != of_later[0].cells.shape:
        return None
    changes = [
        np.diff(np.array([picture.cells for picture in of_camera]), axis=0) for of_camera in (of_first, of_later)
    ]
    stands_still = [
        all(largest_change(of_camera[0].cells, picture.cells) < STILL for picture in of_camera)
        for of_camera in (of_first, of_later)
    ]
    # Where nothing moves, the same view is the same video.
    similarity = 1.0 if all(stands_still) else correlation(*changes)
    if similarity < _SAME_MOTION:
        return None
    message = f"The pictures are like the pictures of {first.camera}: one video may have been given twice."
    evidence = {
        "other_camera": first.camera,
        "similarity": similarity,
        "num_pictures": len(of_first),
        PICTURES: [later.middle],
    }
    # Cameras side by side see nearly the same: the people decide, whose points are the same in one video alone.
    return Finding(SAME_VIDEO, message, later.camera, "warning", "Give each camera its own.", evidence)
