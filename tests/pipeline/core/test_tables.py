"""Tables as editors and spreadsheets store them."""

import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.core.parsing import open_table

TEXT = "camera,frame,time_s\ncam_1,0,0.25\ncam_1,1,-1.5e-2\n"
ROWS = [
    (2, {"camera": "cam_1", "frame": "0", "time_s": "0.25"}),
    (3, {"camera": "cam_1", "frame": "1", "time_s": "-1.5e-2"}),
]


def rows(path: Path, content: bytes) -> list[tuple[int, dict[str, str]]]:
    path.write_bytes(content)
    with open_table(path) as table:
        return [(line, dict(row)) for line, row in table.rows]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "table.csv"


@pytest.mark.parametrize(
    "change",
    [
        str,
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(",", ";").replace(".", ","),
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace(",", " , ").replace("camera", "Camera"),
        lambda text: text.replace("cam_1", '"cam_1"').replace("\n", ",\n", 1) + "\n,,\n",
    ],
    ids=["plain", "mark", "Windows", "old Mac", "decimal commas", "tabs", "spaces", "quoted"],
)
def test_one_table_in_forms_of_many_programs(path: Path, change: Callable[[str], str]) -> None:
    content = change(TEXT)
    assert [(line, {name: row[name] for name in ROWS[0][1]}) for line, row in rows(path, content.encode())] == ROWS
    assert [row["frame"] for _, row in rows(path, content.removeprefix("\ufeff").encode("utf-16"))] == ["0", "1"]


def test_comma_in_table_with_commas_is_no_decimal_comma(path: Path) -> None:
    assert rows(path, b'name,note\na,"1,5"\n') == [(2, {"name": "a", "note": "1,5"})]


def test_short_rows_are_filled(path: Path) -> None:
    assert rows(path, b"name;x_m\np1\n") == [(2, {"name": "p1", "x_m": ""})]
    assert rows(path, b"") == []


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"name;x_m\n", "lacks y_m: its first line must name the columns name, x_m, y_m."),
        (b"", "lacks name, x_m, y_m: "),
        (b"name;x_m;X_M;y_m;note;note\n", "more than one column x_m."),
    ],
)
def test_columns_that_lack_or_occur_twice_are_named(path: Path, content: bytes, fault: str) -> None:
    path.write_bytes(content)
    with open_table(path) as table:
        assert fault in str(table.fault(("name", "x_m", "y_m")))
        assert table.fault(()) is None


@pytest.mark.parametrize("content", [b"name\n\xff\xff\n", b"\xff\xfen", b'name\n"' + b"x" * 200_000])
def test_other_content_is_error(path: Path, content: bytes) -> None:
    with pytest.raises((ValueError, csv.Error)):
        rows(path, content)
