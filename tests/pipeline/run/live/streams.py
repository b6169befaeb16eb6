"""Frames of a simulated scene sent to a live capture."""

from collections.abc import Iterable

from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.recorded import DetectedFrame, detected_frames
from pipeline.run.live.records import LiveInstant
from pipeline.validation.simulation.scenes import Simulation


def sent_frames(simulation: Simulation) -> list[DetectedFrame]:
    """Frames of all cameras in time order."""
    return detected_frames(simulation.cameras, simulation.times, simulation.detections)


def play(capture: LiveCapture, frames: Iterable[DetectedFrame]) -> list[LiveInstant]:
    """Send frames, then end."""
    instants = []
    for frame in frames:
        instants += capture.push(*frame)
    return instants + capture.flush()
