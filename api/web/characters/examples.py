"""Examples of characters."""

from typing import Any

from api.web.contract.examples import CHARACTER_ID, SHA256

SPEC: dict[str, Any] = {"name": "Robot", "bones": {"LeftShoulder": None}}
CHANGES: dict[str, Any] = {"name": "Robot, March", "bones": {"LeftArm": "upperarm_l", "LeftShoulder": None}}

_ADDRESS = f"/v1/characters/{CHARACTER_ID}"
_SUMMARY: dict[str, Any] = {
    "id": CHARACTER_ID,
    "name": "Robot",
    "created_at": "2026-03-01T09:00:00Z",
    "file": "robot.vrm",
    "num_bytes": 5242880,
    "sha256": SHA256,
    "format": "VRM 1.0",
    "method": "table",
    "stature": 1.72,
    "num_bones": 3,
    "num_vertices": 12480,
    "links": {"self": _ADDRESS, "file": f"{_ADDRESS}/file"},
}
_CHARACTER: dict[str, Any] = _SUMMARY | {
    "joints": [
        {"joint": "Hips", "bone": "hips", "recognised_by": "shape", "is_required": False},
        {"joint": "LeftArm", "bone": "upperarm_l", "recognised_by": "vrm", "is_required": True},
        {"joint": "LeftShoulder", "bone": None, "recognised_by": None, "is_required": False},
    ],
    "spine": ["spine"],
    "neck": [],
    "twists": {},
    "at_rest": ["tail"],
    "notes": [],
    "skeleton": [
        {"bone": "hips", "parent": None, "position": [0.0, 0.0, 0.95]},
        {"bone": "spine", "parent": "hips", "position": [0.0, 0.02, 1.1]},
        {"bone": "upperarm_l", "parent": "spine", "position": [0.18, 0.02, 1.4]},
    ],
    "corrections": {"LeftShoulder": None},
}

ANSWERS: dict[str, Any] = {
    "Character": _CHARACTER,
    "CharacterPage": {"characters": [_SUMMARY], "next_cursor": None},
}
