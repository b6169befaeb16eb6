"""The stored JSON of a preflight is the same after it was read, and other JSON is refused."""

import json
from dataclasses import replace

import pytest

from pipeline.capture.preflight_record import LayoutRead, Preflight, PreflightThumbnail, Recording

PRINTED = (
    '{"cameras": [{"name": "cam_0", "file": "GX01.mp4", "size_px": [1280, 720], "frame_rate_hz": 25.0, '
    '"num_frames": 300, "start_time_s": -0.48, "media_type": "video/mp4", "media_start_s": 0.04}, '
    '{"name": "cam \\u00e4", "file": "b.zip", "size_px": [640, 480], '
    '"frame_rate_hz": 29.97002997002997, "num_frames": 1, "start_time_s": 0.0, "media_type": null, '
    '"media_start_s": 0.0}], '
    '"timebase": {"start_time_s": 0.04, "frame_rate_hz": 29.97002997002997, "num_frames": 300}, '
    '"stretches": [[0, 100], [200, 300]], '
    '"recordings": [{"camera": "cam_0", "file": null, "offset_s": 0.48, "frame_rate_hz": null}], "units": "mm", '
    '"findings": [{"code": "clock_drift", "message": "The clocks drift.", "camera": null, "severity": "warning", '
    '"hint": null, "evidence": {"drift_ppm": 100.0}}]}'
)


def test_json_is_same_after_reading() -> None:
    read = Preflight.from_json(json.loads(PRINTED))
    full = replace(
        read,
        cameras=tuple(
            replace(camera, thumbnails=(PreflightThumbnail(0.5, 100, "0" * 64),), more_files=("b.mp4",), num_bodies=3)
            for camera in read.cameras
        ),
        recordings=(Recording("cam_0", "a.mp4", 0.5, None, ("b.mp4",), 0.01),),
        layout=LayoutRead("coco", "number"),
        names={"LHip": "left_hip"},
        laboratory={"clock": "trigger", "channel": None},
    )
    for preflight in (read, full):
        assert Preflight.from_json(json.loads(json.dumps(preflight.to_json()))) == preflight


def test_fields_are_those_of_json() -> None:
    preflight = Preflight.from_json(json.loads(PRINTED))
    assert [(one.name, one.file, one.size_px) for one in preflight.cameras] == [
        ("cam_0", "GX01.mp4", (1280, 720)),
        ("cam ä", "b.zip", (640, 480)),
    ]
    assert (preflight.timebase.num_frames, preflight.timebase.start_time_s) == (300, 0.04)
    assert preflight.duration_s == 300 / 29.97002997002997
    assert preflight.stretches == (range(100), range(200, 300))
    assert (preflight.recordings[0].camera, preflight.recordings[0].offset_s, preflight.units) == ("cam_0", 0.48, "mm")


@pytest.mark.parametrize(
    "document",
    [{}, {"problems": []}, {"cameras": 1, "timebase": {}}, [], "text", None, json.loads(PRINTED) | {"cameras": 1}],
)
def test_other_json_is_refused(document: object) -> None:
    with pytest.raises(ValueError, match="preflight record"):
        Preflight.from_json(document)
