"""Examples of options."""

from typing import Any

ANSWERS: dict[str, Any] = {
    "Sample": {
        "installed": True,
        "install": "Run: multicap samples install",
        "attribution": "Sample capture: demo of several people of Pose2Sim.",
        "files": [
            {"name": "cam01.mp4", "media_type": "video/mp4", "num_bytes": 950272, "link": "/v1/sample/cam01.mp4"}
        ],
    },
    "Options": {
        "profiles": [
            {
                "name": "fast",
                "default_joints": "body",
                "joints": [
                    {
                        "joints": "body",
                        "networks": ["movenet-multipose-int8"],
                        "camera_frame_s": 0.023,
                        "installed": True,
                        "install": "Run: multicap models install movenet-multipose-int8",
                    }
                ],
            }
        ],
        "detectors": [
            {
                "name": "movenet-multipose",
                "installed": True,
                "install": "Run: multicap models install movenet-multipose",
            }
        ],
        "choices": [
            {
                "name": "method",
                "label": "Method",
                "description": "Method that matches detections to people.",
                "group": "advanced",
                "kind": "one",
                "values": [
                    {"name": "tracking", "label": "Tracking of whole bodies", "note": ""},
                    {
                        "name": "clustering",
                        "label": "Clustering of joints for crowds and people who touch",
                        "note": "",
                    },
                ],
                "default": "tracking",
                "unset": None,
                "minimum": None,
                "exclusive_minimum": None,
                "maximum": None,
            }
        ],
        "purposes": [
            {
                "name": "unreal",
                "label": "Unreal Engine",
                "note": "FBX and BVH in the names of the mannequin and of MetaHuman.",
                "spec": {"exports": ["bvh", "fbx"], "bvh": "unreal"},
            }
        ],
    },
}
