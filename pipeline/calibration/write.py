"""Write cameras in Multicap's own JSON format, which ``registry.read_calibration`` reads."""

import json
from collections.abc import Sequence

from pipeline.calibration.json_formats import SCHEMA_VERSION
from pipeline.data import Camera


def encode(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras with every digit of their numbers; equal cameras give equal bytes."""
    document = {
        "schema_version": SCHEMA_VERSION,
        "cameras": [
            {
                "name": camera.name,
                "size_px": list(camera.size_px),
                "matrix": camera.matrix.tolist(),
                "distortion": camera.distortion.tolist(),
                "rotation": camera.cam_from_world.rotation.tolist(),
                "translation_m": camera.cam_from_world.translation_m.tolist(),
            }
            for camera in cameras
        ],
    }
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()
