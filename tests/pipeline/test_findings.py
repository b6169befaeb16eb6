from pipeline.errors import Problem
from pipeline.findings import Finding, documents, from_problem, has_error

DOUBT = Finding("focal_length", "Odd.", "cam\x1b_1", evidence=1.23456)


def test_errors_come_first_and_names_are_printable() -> None:
    problem = Problem("invalid_matrix", "The matrix is missing.", "rig.toml", "cam_2", "matrix", "Add it.")
    assert documents([DOUBT, from_problem(problem)]) == [
        {
            "code": "invalid_matrix",
            "message": "file rig.toml, field matrix: The matrix is missing.",
            "camera": "cam_2",
            "severity": "error",
            "hint": "Add it.",
            "evidence": None,
        },
        {
            "code": "focal_length",
            "message": "Odd.",
            "camera": "cam\N{REPLACEMENT CHARACTER}_1",
            "severity": "warning",
            "hint": None,
            "evidence": 1.2346,
        },
    ]


def test_only_errors_are_errors() -> None:
    assert not has_error([DOUBT])
    assert has_error([DOUBT, from_problem(Problem("invalid_name", "Wrong."))])
