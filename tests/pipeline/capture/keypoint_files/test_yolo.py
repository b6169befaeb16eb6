"""YOLO's labels of poses: forms of lines, and lines that can't be read."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoint_files import people
from pipeline.capture.keypoint_files.folders import Contents, read_folder
from pipeline.capture.keypoint_files.readers.yolo import LINES
from pipeline.core.errors import Problem
from pipeline.core.layouts import LAYOUTS

SIZE_PX = (640, 480)


def labels(folder: Path, *texts: str | bytes) -> tuple[Contents, list[Problem]]:
    folder = folder / "cam"
    folder.mkdir()
    for k, text in enumerate(texts):
        (folder / f"walk_{k + 1}.txt").write_bytes(text.encode() if isinstance(text, str) else text)
    problems: list[Problem] = []
    return read_folder(folder, "left", SIZE_PX, 10**9, [], problems), problems


def line(count: int, *more: float, scores: bool = True) -> str:
    """Line of labels: point k is at pixel (10 k, 5 k) of 640 x 480."""
    points_of_line = [(10 * k / 640, 5 * k / 480, *([0.5] if scores else [])) for k in range(count)]
    return " ".join(map(str, [0, 0.5, 0.5, 0.2, 0.2, *(value for point in points_of_line for value in point), *more]))


@pytest.mark.parametrize("more", [(), (0.9,), (0.9, 3), (3,)])
@pytest.mark.parametrize(("count", "scores"), [(17, True), (17, False), (26, True), (133, True)])
def test_lines_of_yolo(tmp_path: Path, count: int, scores: bool, more: tuple[float, ...]) -> None:
    layout = {17: "coco-17", 26: "halpe-26", 133: "coco-wholebody-133"}[count]
    text = line(count, *more, scores=scores)
    contents, problems = labels(tmp_path, f"{text}\n{text}\n", "", f"{text}\r\n\n")
    assert not problems
    assert contents.forms == {"YOLO"}
    assert [len(contents.frames[number]) for number in (1, 2, 3)] == [2, 0, 1]
    joints = LAYOUTS[layout].joints
    expected = [10.0 * LAYOUTS[layout].points.index(name) for name in joints.names]
    np.testing.assert_allclose(contents.frames[3][0, :, 0], expected, atol=1e-9)
    np.testing.assert_allclose(contents.frames[3][0, :, 1], np.array(expected) / 2, atol=1e-9)
    # Ultralytics moves points that it did not find to (0, 0): the nose.
    np.testing.assert_array_equal(
        contents.frames[3][0, :, 2], np.r_[0.0, [0.5 if scores else 1.0] * (len(expected) - 1)]
    )


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        ("0 0.5 0.5 0.1 0.1", None, "boxes without points"),
        ("0 0.5 0.5 0.1 0.1 0.9 4", None, "boxes without points"),
        (line(20), None, "65 numbers"),
        (line(17) + "\n" + line(26), None, "56, 83"),
        (line(17) + "\n1" + line(17)[1:], "class", "several classes"),
        (line(17).replace("0.5", "half", 1), None, "not numbers"),
        (line(17).replace(" 0.015625 ", " 611.5 ", 1), None, "from 0 to 1"),
        (line(17).replace(" 0.015625 ", " inf ", 1), None, ""),
        (b"0 0.5 0.5 0.1 0.1 \xff\xfe", None, "known format"),
        ("\n".join([line(17)] * 129), None, "129 people"),
        ("\n".join(["0 0 0 0 0" + " 0" * 51] * 1001), None, "1001 people"),
    ],
    ids=map(str, range(11)),
)  # fmt: skip
def test_wrong_labels(tmp_path: Path, text: str | bytes, field: str | None, words: str) -> None:
    contents, problems = labels(tmp_path, line(17), text)
    if not words:  # a point that is not finite was not found
        assert not problems
        assert not people.is_detected(contents.frames[2])[0, 1]
        return
    (problem,) = problems
    assert list(contents.frames) == [1]
    assert problem.field == field
    assert words in problem.message


def test_lines_of_yolo_are_of_one_form() -> None:
    assert sorted(LINES) == [*range(39, 42), *range(56, 59), *range(74, 77), *range(83, 86), *range(404, 407),
                             *range(413, 416)]  # fmt: skip
    assert sum(form.has_scores for form in LINES.values()) == 15


def test_labels_need_size_of_image(tmp_path: Path) -> None:
    (tmp_path / "1.txt").write_text(line(17))
    problems: list[Problem] = []
    read_folder(tmp_path, "left", None, 10**9, [], problems)
    assert "whose size" in problems[0].message
