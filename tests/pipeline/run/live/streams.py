"""Frames of a simulated scene sent to a live capture."""

from collections.abc import Iterable

from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import DetectedFrame, LiveInstant, detected_frames
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
