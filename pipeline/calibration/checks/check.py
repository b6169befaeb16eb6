"""Check the cameras of a calibration against each other and against what lenses and rigs can be."""

from collections.abc import Sequence

from pipeline.calibration.checks.lenses import check_lens
from pipeline.calibration.checks.places import check_places
from pipeline.calibration.checks.views import check_views
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.data.cameras import Camera
from pipeline.findings import Finding

MIN_CAMERAS = 2


def check_cameras(cameras: Sequence[Camera]) -> list[Finding]:
    """Check a calibration without any picture.

    Parameters
    ----------
    cameras
        Cameras of a file or of a session, in metres. Lenses are checked at the size of the picture, where it is known.

    Returns
    -------
        Findings about lenses, places, the unit, the up axis and common views; empty if nothing is wrong.
    """
    findings = [*_check_number(cameras), *check_places(cameras)]
    for camera in cameras:
        findings += check_lens(camera)
    # Cameras of another unit, or without poses, see no common place because of that.
    is_placed = not any(finding.code in {"calibration_unposed", "world_unit"} for finding in findings)
    if is_placed and all(camera.size_px != UNKNOWN_SIZE for camera in cameras):
        findings += check_views(cameras)
    return findings


def _check_number(cameras: Sequence[Camera]) -> list[Finding]:
    if len(cameras) >= MIN_CAMERAS:
        return []
    message = f"The calibration has {len(cameras)} camera{'s' * (len(cameras) != 1)}: nobody can be located."
    hint = "Give a calibration of at least two cameras."
    return [Finding("too_few_cameras", message, None, "error", hint, {"num_cameras": len(cameras)})]
