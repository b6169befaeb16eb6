import pytest

from pipeline.run.preflight.hanging import hanging_cameras


@pytest.mark.parametrize(
    ("turn_deg", "words"),
    [
        (180.0, "hangs upside down: its pictures are turned upright, by 180 degrees, before"),
        (90.0, "by 90 degrees counterclockwise"),
        (270.0, "by 90 degrees clockwise"),
        (137.0, "by 137 degrees counterclockwise"),
    ],
)
def test_turned_cameras_are_named_with_their_turn(turn_deg: float, words: str) -> None:
    (finding,) = hanging_cameras({"left": 0.0, "right": turn_deg})
    assert (finding.camera, finding.severity, finding.code) == ("right", "info", "camera_hangs_turned")
    assert words in finding.message
    assert finding.evidence == {"turn_deg": turn_deg}
