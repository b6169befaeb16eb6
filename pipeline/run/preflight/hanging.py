"""Findings about cameras that hang turned: their pictures are turned upright before people are detected."""

from collections.abc import Iterator, Mapping

from pipeline.core.findings import Finding
from pipeline.core.problems.findings import CAMERA_HANGS_TURNED


def hanging_cameras(turns_deg: Mapping[str, float]) -> Iterator[Finding]:
    """Say which cameras hang turned.

    ``turns_deg`` are the counterclockwise turns that brought the pictures upright, by camera, from 0 to 360 degrees.
    """
    for name, turn_deg in turns_deg.items():
        if turn_deg:
            way = "counterclockwise" if turn_deg < 180.0 else "clockwise"
            by = f"{min(turn_deg, 360.0 - turn_deg):.0f} degrees {way}"
            how = "upside down" if turn_deg == 180.0 else "turned"
            turned = "180 degrees" if turn_deg == 180.0 else by
            message = (
                f"The camera hangs {how}: its pictures are turned upright, by {turned}, before people are detected."
            )
            yield Finding(CAMERA_HANGS_TURNED, message, name, "info", evidence={"turn_deg": turn_deg})
