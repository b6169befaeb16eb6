"""Names of downloads: they tell takes apart, every file system takes them, and a header states them (RFC 6266)."""

import unicodedata
from urllib.parse import quote

_MAX_BYTES = 120
"""Longest name of a take; file systems take names of 255 bytes."""

_MAX_PERSON_BYTES = 60

_KEPT = frozenset(
    "LNM"
)  # first letters of the Unicode categories of letters, numbers, and marks that belong to letters


def take_name(session_name: str) -> str:
    """Name of a take for files: letters and digits of the session's name in lower case, hyphens between words.

    >>> take_name("Handshake, take 3")
    'handshake-take-3'
    """
    return _words(session_name, _MAX_BYTES) or "take"


def _words(text: str, max_bytes: int) -> str:
    """Letters and digits of a text in lower case, hyphens between words; empty without any."""
    lower = unicodedata.normalize("NFC", text.lower())
    words = "".join(char if unicodedata.category(char)[0] in _KEPT else " " for char in lower).split()
    return "-".join(words).encode()[:max_bytes].decode(errors="ignore").rstrip("-")


def download_stem(session_name: str, revision: int = 0) -> str:
    """Beginning of the names of a job's downloads: the take, and the revision of the edits of its people.

    >>> download_stem("Handshake, take 3")
    'handshake-take-3'
    >>> download_stem("Handshake, take 3", revision=2)
    'handshake-take-3_revision-2'
    """
    return take_name(session_name) + (f"_revision-{revision}" if revision else "")


def named_person(person: str, person_name: str | None = None) -> str:
    """Person in the name of a file: the number, and the name that edits gave.

    >>> named_person("person-1", "Anna K.")
    'person-1-anna-k'
    """
    words = "" if person_name in {None, person} else _words(person_name or "", _MAX_PERSON_BYTES)
    return f"{person}-{words}" if words else person


def result_name(session_name: str, name: str, revision: int = 0, person_name: str | None = None) -> str:
    """Name under which clients save a result file of a session.

    >>> result_name("Handshake, take 3", "person-1.bvh")
    'handshake-take-3_person-1.bvh'
    >>> result_name("Handshake, take 3", "person-1.bvh", 2, "Anna")
    'handshake-take-3_revision-2_person-1-anna.bvh'
    >>> result_name("Handshake", "person-1.events.csv", person_name="Anna")
    'handshake_person-1-anna.events.csv'
    >>> result_name("Handshake", "person-1.angles.csv", person_name="Anna")
    'handshake_person-1-anna.angles.csv'
    """
    stem, _, suffix = name.partition(".")
    return f"{download_stem(session_name, revision)}_{named_person(stem, person_name)}.{suffix}"


def archived_name(
    session_name: str, name: str, folder: str | None, revision: int = 0, person_name: str | None = None
) -> str:
    """Path of a result file in the archive of all of them: a folder for each person."""
    inside = "" if folder is None else f"{take_name(named_person(folder, person_name))}/"
    return inside + result_name(session_name, name, revision, person_name)


def content_disposition(name: str, disposition: str = "attachment") -> dict[str, str]:
    """Header with the name of a file: in ASCII, and with all its characters (RFC 6266, section 4.3)."""
    ascii_name = "".join(char if char.isascii() and char.isprintable() and char not in '"\\%' else "_" for char in name)
    both = f"filename=\"{ascii_name}\"; filename*=utf-8''{quote(name, safe='')}"
    return {"Content-Disposition": f"{disposition}; {both}"}
