"""``python -m pipeline.run.live.server``: server from which the processes of live captures are forked.

It has loaded what a capture needs, the compiled kernels too, and waits for requests as ``pipeline.core.runtime.forks``
says. Its programs are ``capture``, which computes a live capture, and ``calibration``, which checks a stranger's
calibration with the arguments of ``pipeline.capture.preflight``.
"""

import numpy as np

from pipeline.capture import preflight
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import COCO_17
from pipeline.core.runtime.forks import serve
from pipeline.geometry.camera import project
from pipeline.run.live import program
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.settings import LiveSettings

_RATE_HZ = 25.0
_LEARN_S = 0.2
_NUM_INSTANTS = 15


def load_kernels() -> None:
    """Load compiled kernels, or compile them: a capture of a person until the bones are learnt and feet are held."""
    body_m = np.random.default_rng(0).uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (len(COCO_17.names), 3))
    cameras = [_camera(number) for number in range(3)]
    capture = LiveCapture(cameras, COCO_17, LiveSettings(_RATE_HZ, learn_s=_LEARN_S))
    for instant in range(_NUM_INSTANTS):
        for number, camera in enumerate(cameras):
            capture.push(number, instant / _RATE_HZ, project(camera, body_m)[None], np.ones((1, len(body_m))))


def _camera(number: int) -> Camera:
    """Camera 4 m from the origin, with a distorting lens, 1 m above the floor."""
    cos, sin = np.cos(number), np.sin(number)
    rotation = np.array([[-sin, cos, 0.0], [0.0, 0.0, -1.0], [-cos, -sin, 0.0]])
    matrix = np.array([[800.0, 0.0, 639.5], [0.0, 800.0, 359.5], [0.0, 0.0, 1.0]])
    translation_m = np.array([0.0, 1.0, 4.0])
    return Camera(f"cam{number}", (1280, 720), matrix, np.array([-0.1, 0.0, 0.0, 0.0]), Rigid3(rotation, translation_m))


if __name__ == "__main__":
    load_kernels()
    serve({"capture": program.main, "calibration": preflight.main})
