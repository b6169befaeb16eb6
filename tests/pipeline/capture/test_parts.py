import json
from pathlib import Path
from typing import Any

import pytest

from pipeline.capture.parts import group_parts, missing_parts

# Also the cases of the page, see tests/api/portal/send.
CASES = json.loads((Path(__file__).parent / "parts_cases.json").read_text())


@pytest.mark.parametrize("case", CASES, ids=[case["about"] for case in CASES])
def test_recordings_by_names_of_their_files(case: dict[str, Any]) -> None:
    assert [list(recording) for recording in group_parts(case["names"])] == case["recordings"]


def test_parts_that_are_missing() -> None:
    assert missing_parts(["GX010119", "GX040119", "GX060119"]) == [2, 3, 5]
    assert missing_parts(["GOPR0119", "GP020119"]) == [1]
    assert missing_parts(["GX020119", "GX030119"]) == []
    assert missing_parts(["C0001", "C0003"]) == []
