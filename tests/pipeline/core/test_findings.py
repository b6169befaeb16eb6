import json

from pipeline.core.errors import Problem
from pipeline.core.findings import Finding, documents, from_problem, has_error
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import FILE_IGNORED, FOCAL_LENGTH
from pipeline.core.problems.session_codes import INVALID_MATRIX, INVALID_NAME

DOUBT = Finding(FOCAL_LENGTH, "Odd.", "cam\x1b_1", evidence={"angle_deg": 1.23456, "file": "a\x00.mp4", "views": 3})
NOTE = Finding(FILE_IGNORED, "Ignored.", severity="info")


def test_errors_come_first_and_names_are_printable() -> None:
    problem = Problem(INVALID_MATRIX, "The matrix is missing.", "rig.toml", "cam_2", "matrix", "Add it.")
    assert documents([NOTE, DOUBT, from_problem(problem)])[:2] == [
        {
            "code": "invalid_matrix",
            "message": "file rig.toml, field matrix: The matrix is missing.",
            "camera": "cam_2",
            "severity": "error",
            "hint": "Add it.",
            "evidence": {"file": "rig.toml", "field": "matrix"},
        },
        {
            "code": "focal_length",
            "message": "Odd.",
            "camera": "cam\N{REPLACEMENT CHARACTER}_1",
            "severity": "warning",
            "hint": None,
            "evidence": {"angle_deg": 1.2346, "file": "a\N{REPLACEMENT CHARACTER}.mp4", "views": 3},
        },
    ]


def test_json_is_read_back() -> None:
    dark = Finding(Code("video_dark"), "The video is dark.", "left", "error", "Open the aperture.", {"luma": 0.02})
    assert Finding.from_json(json.loads(json.dumps(dark.to_json()))) == dark


def test_only_errors_are_errors() -> None:
    assert not has_error([DOUBT, NOTE])
    assert has_error([DOUBT, from_problem(Problem(INVALID_NAME, "Wrong."))])


def test_finding_names_its_camera_once_and_is_safe_to_print() -> None:
    assert str(Finding(Code("size"), "left: the video is small.", "left")) == "left: the video is small."
    assert str(Finding(Code("pairs"), "left and the others disagree.", "left")) == "left and the others disagree."
    assert str(Finding(Code("dark"), "lefthand walls are dark.", "left")) == "left: lefthand walls are dark."
    assert (
        str(Finding(Code("dark"), "It is dark.", "a\x1b[31m", hint="Light it.")) == "a\ufffd[31m: It is dark. Light it."
    )
