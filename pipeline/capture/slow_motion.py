"""Slow motion: videos that last a whole number of times as long as the other cameras' videos."""

from collections.abc import Mapping

import numpy as np

from pipeline.core.data.cameras import FrameTimes
from pipeline.core.findings import Finding
from pipeline.core.parsing import FRAME_RATE_HZ
from pipeline.core.problems.finding_codes import SLOW_MOTION
from pipeline.video.frame_rate import measured_rate_hz

# 50 in 25 frames a second up to 1000 in 25: factors of cameras and phones.
_FACTORS = (2, 4, 5, 8, 10, 16, 20, 32, 40)
# Cameras that are started and stopped by hand differ in length by a second in twenty.
_TOLERANCE = 0.05


def slow_motion(times: Mapping[str, FrameTimes], files: Mapping[str, str]) -> list[Finding]:
    """Name videos that were filmed at a higher rate than they are stored at.

    ``times``: frame times of all cameras, by camera name. ``files``: names of the videos whose rates are not stated, by
    camera name. Returns a finding of each such video with both rates, if more cameras than not agree on the length.
    """
    rates_hz = {name: measured_rate_hz(of_camera.time_s) for name, of_camera in times.items()}
    lengths_s = {name: len(of_camera.time_s) / rates_hz[name] for name, of_camera in times.items()}
    usual_s = min(lengths_s.values())
    alike_s = [length_s for length_s in lengths_s.values() if length_s <= (1 + 2 * _TOLERANCE) * usual_s]
    usual_s = float(np.median(alike_s))
    if 2 * len(alike_s) < len(lengths_s):
        return []
    findings = []
    for name, file in files.items():
        ratio = lengths_s[name] / usual_s
        factor = min(_FACTORS, key=lambda factor: abs(ratio / factor - 1))
        filmed_hz = factor * rates_hz[name]
        if abs(ratio / factor - 1) > _TOLERANCE or not FRAME_RATE_HZ.holds(filmed_hz):
            continue
        message = (
            f"{file} lasts {lengths_s[name]:.1f} s, {factor} times as long as the others ({usual_s:.1f} s). It seems "
            f"to be slow motion: filmed at {filmed_hz:.6g} Hz, stored at {rates_hz[name]:.6g} Hz."
        )
        hint = (
            f"State the rate at which it was filmed: --rate {name}={filmed_hz:.6g}, or rate of the camera in the "
            "manifest and on the page. If the camera only ran longer, nothing is to be done."
        )
        evidence = {"file": file, "factor": factor, "filmed_hz": filmed_hz, "stored_hz": rates_hz[name]}
        findings.append(Finding(SLOW_MOTION, message, name, hint=hint, evidence=evidence))
    return findings
