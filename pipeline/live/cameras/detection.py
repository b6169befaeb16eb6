"""Detection of bodies in the newest pictures, in processes that open the networks once."""

import os
import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.config import MotionChoices, detected_joints, networks_of
from pipeline.detect.profiles.detection import open_detection
from pipeline.detect.providers.find import current_provider
from pipeline.video.rotation import Rotator

# Below the processes that decode, which must not fall behind.
_NICE = 5


class DetectionJob(NamedTuple):
    """Picture in which bodies are to be detected."""

    choices: MotionChoices  # Choices of the networks
    path: str  # File of the pictures
    shape: tuple[int, int, int, int]  # Number of pictures, height, width and channels
    slot: int  # Number of the picture in the file
    rotation_deg: int  # Counterclockwise turn of the picture for display
    turn_deg: float  # Counterclockwise turn that brings the shown picture upright


class DetectedBodies(NamedTuple):
    """Bodies in a picture."""

    keypoints_px: Float[np.ndarray, "bodies joints 2"]  # NaN where a joint was not found
    score: Float[np.ndarray, "bodies joints"]
    duration_s: float  # Time that the detection took: of a core, which other programs don't lengthen, or of the GPU


def num_processes() -> int:
    """Number of processes that detect: one on a GPU, else one for each processor."""
    return 1 if current_provider().is_gpu else os.cpu_count() or 1


def start_detecting(choices: MotionChoices) -> None:
    """Open the networks in this process, which yields to others."""
    os.nice(_NICE)
    open_detection(networks_of(choices), detected_joints(choices))


def detect_bodies(job: DetectionJob) -> DetectedBodies:
    """Detect the bodies in a picture."""
    clock = time.perf_counter if current_provider().is_gpu else time.thread_time
    started_s = clock()
    pictures = np.memmap(job.path, np.uint8, "r", shape=job.shape)
    image_rgb = Rotator()(pictures[job.slot], job.rotation_deg // 90)
    detector = open_detection(networks_of(job.choices), detected_joints(job.choices), turn_deg=job.turn_deg)
    bodies = detector.detect(image_rgb)
    return DetectedBodies(bodies.keypoints_px, bodies.score, clock() - started_s)
