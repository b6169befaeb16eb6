"""Messages of clients of live captures. Few imports: hostile clients begin in processes of their own."""

from typing import Any

from pipeline.run.live.packets import encode_keypoints

CAMERAS = ("left", "right")
CALIBRATION = {"cameras": [{"name": name} for name in CAMERAS]}


def start_message(**changes: Any) -> dict[str, Any]:
    return {"type": "start", "calibration": CALIBRATION, "layout": "coco-17", "frame_rate_hz": 25.0} | changes


def keypoints_message(
    camera: str | int = "left", time_s: float = 0.0, people: int = 1, **changes: Any
) -> dict[str, Any]:
    points = [[[100.0, 200.0, 0.9]] * 17] * people
    return {"type": "keypoints", "camera": camera, "time_s": time_s, "people": points} | changes


def packet(camera: int = 0, people: int = 1, points: int = 17, time_s: float = 0.0, number: float = 0.5) -> bytes:
    return encode_keypoints(camera, points, time_s, [number] * people * points * 3, people)


# Head of a program in the place of the one that opens cameras: it answers, and reads how the capture starts.
CAMERA_PROGRAM = """
import json, select, socket, struct, sys, time

def answer(kind, content):
    content = kind + json.dumps(content, separators=(",", ":")).encode()
    sys.stdout.buffer.write(struct.pack("<I", len(content)) + content)
    sys.stdout.buffer.flush()

start = json.loads(sys.stdin.buffer.read(struct.unpack("<I", sys.stdin.buffer.read(4))[0]))
"""
