"""Examples of the motion of a job."""

from typing import Any

_MOTION: dict[str, Any] = {
    "revision": 0,
    "schema_version": 1,
    "frame_rate_hz": 25.0,
    "start_time_s": 0.0,
    "first_source_frame": 0,
    "num_frames": 3,
    "joint_names": ["nose", "left_eye"],
    "bones": [["nose", "left_eye"]],
    "skeleton": {"names": ["Hips", "Spine"], "parents": [None, 0]},
    "angle_names": ["left_knee_flexion", "right_knee_flexion"],
    "record": {
        "num_bytes": 48,
        "offsets": {
            "origin_m": 0,
            "joints": 12,
            "skeleton": 24,
            "angles": 36,
            "source_views": 40,
            "score": 42,
            "error": 44,
            "camera_error": 46,
            "identity": 47,
        },
        "absent": -32768,
        "angle_step_deg": 0.1,
        "error_step_px": 0.5,
        "unknown_error": 255,
    },
    "people": [
        {
            "id": 1,
            "name": "person-1",
            "color": "#2626ff",
            "start_frame": 0,
            "num_frames": 3,
            "offset_bytes": 0,
            "position_step_m": 0.0001,
            "coverage": 1.0,
            "stature_m": 1.78,
            "reprojection_error_px": 3.1,
            "identity": {"confidence": 1.0, "doubts": []},
            "contacts": [[0, 0, 1, 2]],
            "gait": None,
            "movements": [],
        }
    ],
    "cameras": [
        {
            "name": "cam_0",
            "size_px": [1920, 1080],
            "matrix": [[1500.0, 0.0, 959.5], [0.0, 1500.0, 539.5], [0.0, 0.0, 1.0]],
            "distortion": [-0.1, 0.02, 0.0, 0.0],
            "lens": "standard",
            "cam_from_world": {
                "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
                "translation_m": [0.0, 1.2, 4.0],
            },
            "video": "cam_0.mp4",
            "clock": [[0, 0.0, 0.0], [2, 0.08, 0.08]],
        }
    ],
    "clocks": None,
    "is_refined": False,
    "floor": {"height_m": 0.0, "slope_x": 0.0, "slope_y": 0.0},
    "reprojection_error_px": {"median": 3.1, "p95": 8.2, "by_camera": {"cam_0": 3.1}, "by_joint": {"nose": 3.1}},
    "warnings": [],
    "strips": {
        "frames_per_bucket": 1,
        "columns": ["measured", "interpolated", "predicted", "error", "cameras", "identity"],
        "people": ["////AAAAAAAADAwMAQEB////"],
    },
}

ANSWERS: dict[str, Any] = {
    "MotionDescription": _MOTION,
}
