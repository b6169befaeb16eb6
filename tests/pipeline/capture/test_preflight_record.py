"""The stored JSON of a preflight is the same after it was read, and older JSON can be read."""

import json

import pytest

from pipeline.capture.preflight_record import Preflight

# As a version before this record printed it.
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
    again = json.dumps(Preflight.from_json(json.loads(PRINTED)).to_json())
    of_today = PRINTED
    for start_s in ("0.04", "0.0"):
        added = f'"media_start_s": {start_s}, "thumbnails": [], "more_files": []}}'
        of_today = of_today.replace(f'"media_start_s": {start_s}}}', added)
    of_today = of_today.replace('"frame_rate_hz": null}', '"frame_rate_hz": null, "more_files": []}')
    assert again == of_today[:-1] + ', "clock": "declared", "sync": "declared", "timeline": "take", "up": "z"}'


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


def test_rows_of_first_versions_can_be_read() -> None:
    document = json.loads(PRINTED)
    for key in ("stretches", "recordings", "units", "findings"):
        del document[key]
    for camera in document["cameras"]:
        for key in ("start_time_s", "media_type", "media_start_s"):
            del camera[key]
    preflight = Preflight.from_json(document)
    assert preflight.stretches == (range(300),)
    assert (preflight.recordings, preflight.units, preflight.cameras[0].start_time_s) == ((), "m", 0.0)
    assert (preflight.findings, preflight.up) == ((), "z")


@pytest.mark.parametrize("document", [{}, {"problems": []}, {"cameras": 1, "timebase": {}}, [], "text", None])
def test_other_json_is_refused(document: object) -> None:
    with pytest.raises(ValueError, match="preflight record"):
        Preflight.from_json(document)
