"""Examples of the people of a job."""

from typing import Any

EDITS: dict[str, Any] = {
    "edits": [
        {"action": "merge", "person": 1, "other": 3},
        {"action": "rename", "person": 1, "name": "Anna"},
        {"action": "cut", "start_frame": 25, "stop_frame": 250},
    ]
}

_PEOPLE: dict[str, Any] = {
    "revision": 1,
    "num_frames": 300,
    "found": [
        {"id": 1, "start_frame": 0, "num_frames": 120},
        {"id": 2, "start_frame": 0, "num_frames": 300},
        {"id": 3, "start_frame": 140, "num_frames": 160},
    ],
    "edits": EDITS["edits"],
    "people": [
        {
            "id": 1,
            "name": "Anna",
            "pieces": [
                {"person": 1, "start_frame": 0, "stop_frame": 120},
                {"person": 3, "start_frame": 140, "stop_frame": 300},
            ],
        },
        {"id": 2, "name": "person-2", "pieces": [{"person": 2, "start_frame": 0, "stop_frame": 300}]},
    ],
    "start_frame": 25,
    "stop_frame": 250,
}

ANSWERS: dict[str, Any] = {
    "People": _PEOPLE,
}
