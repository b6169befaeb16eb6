"""Names of downloads, for file systems and headers."""

from urllib.parse import unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.web.downloads import archived_name, content_disposition, result_name, take_name

# Characters that Windows, macOS or a header would not take, and those with a meaning in paths.
_FORBIDDEN = set('<>:"/\\|?*%;\x7f') | {chr(code) for code in range(32)}


@pytest.mark.parametrize(
    ("session", "name"),
    [
        ("Handshake, take 3", "handshake-take-3"),
        ("  __Tanz_2__ ", "tanz-2"),
        ("e\u0301cole", "\u00e9cole"),
        ("हिन्दी ٣", "हिन्दी-٣"),
        ("撮影", "撮影"),
        ("../../etc/passwd", "etc-passwd"),
        ("C:\\NUL", "c-nul"),
        ("\u202e\u200b...", "take"),
        ("", "take"),
    ],
)
def test_names_of_takes(session: str, name: str) -> None:
    assert take_name(session) == name


@given(st.text(max_size=200))
def test_name_is_safe_everywhere(session: str) -> None:
    name = result_name(session, "person-1.bvh")
    assert name.endswith("_person-1.bvh")
    assert len(name.encode()) <= 255
    assert not _FORBIDDEN & set(name)
    assert name[0] not in " .-"
    assert take_name(take_name(session)) == take_name(session)


@given(st.text(max_size=50))
def test_header_holds_every_character(session: str) -> None:
    name = result_name(session, "person-1.bvh")
    header = content_disposition(name)["Content-Disposition"]
    assert header.isascii()
    assert header.isprintable()
    assert unquote(header.partition("filename*=utf-8''")[2]) == name
    assert header.partition("filename=")[2].split(";")[0].count('"') == 2


@given(st.text(max_size=200), st.text(max_size=200))
def test_names_of_people_are_safe_too(session: str, person: str) -> None:
    name = result_name(session, "person-12.bvh", 3, person)
    assert "_revision-3_person-12" in name
    assert name.endswith(".bvh")
    assert len(name.encode()) <= 255
    assert not _FORBIDDEN & set(name)


def test_people_have_their_number_and_name_that_was_given() -> None:
    assert result_name("Walk 2", "person-1.bvh", 3, "Anna K.") == "walk-2_revision-3_person-1-anna-k.bvh"
    assert result_name("Walk 2", "person-1.bvh", 0, "person-1") == "walk-2_person-1.bvh"
    assert result_name("Walk 2", "person-1.bvh", 3, "...") == "walk-2_revision-3_person-1.bvh"
    assert archived_name("Walk 2", "person-1.glb", "person-1", 3, "Zoë") == (
        "person-1-zoë/walk-2_revision-3_person-1-zoë.glb"
    )


def test_archives_have_folder_for_each_person() -> None:
    assert archived_name("Walk 2", "person-1.bvh", "person-1") == "person-1/walk-2_person-1.bvh"
    assert archived_name("Walk 2", "person-1.bvh", "person-1", 3) == "person-1/walk-2_revision-3_person-1.bvh"
    assert archived_name("Walk 2", "metrics.json", None) == "walk-2_metrics.json"
    assert archived_name("Walk 2", "x.bvh", "../..") == "take/walk-2_x.bvh"
