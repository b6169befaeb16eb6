"""Examples of calibrations."""

from typing import Any

from api.web.contract.examples import CALIBRATION_ID, JOB_ID, SHA256
from api.web.jobs.examples import JOB, stage
from pipeline.run.engine.stage import CALIBRATE, FIND_BOARD

SPEC: dict[str, Any] = {"method": "board", "name": "Studio B", "board": "charuco:7x5:0.06:0.045:DICT_4X4_50"}
CHANGES = {"name": "Studio B, March"}

_CALIBRATION: dict[str, Any] = {
    "id": CALIBRATION_ID,
    "name": "Studio B",
    "method": "file",
    "state": "ready",
    "created_at": "2026-03-01T09:00:00Z",
    "source": {"file": "Calib.toml", "format": "TOML", "units": "m", "axes": "as calibrated; Z must point up"},
    "warnings": [],
    "cameras": [
        {
            "name": "cam_0",
            "size_px": [1280, 720],
            "matrix": [[1040.0, 0.0, 640.0], [0.0, 1040.0, 360.0], [0.0, 0.0, 1.0]],
            "lens": "standard",
            "distortion": [-0.12, 0.03, 0.0, 0.0, 0.0],
            "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
            "translation_m": [0.0, 1.5, 4.0],
            "position_m": [0.0, -4.0, 1.5],
        }
    ],
    "sha256": SHA256,
    "report": None,
    "error": None,
    "links": {
        "self": f"/v1/calibrations/{CALIBRATION_ID}",
        "file": f"/v1/calibrations/{CALIBRATION_ID}/file",
        "job": None,
        "session": None,
    },
}

_CALIBRATION_JOB: dict[str, Any] = JOB | {
    "kind": "calibration",
    "calibration_id": JOB_ID,
    "state": "queued",
    "stages": [stage(FIND_BOARD, "ready", 0, 600), stage(CALIBRATE, "waiting", 0, 30)],
    "progress": 0.0,
    "queue_position": 1,
    "eta_s": None,
    "started_at": None,
}

ANSWERS: dict[str, Any] = {
    "Calibration": _CALIBRATION,
    "CalibrationPage": {"calibrations": [_CALIBRATION], "next_cursor": None},
    "CalibrationJob": _CALIBRATION_JOB,
}
