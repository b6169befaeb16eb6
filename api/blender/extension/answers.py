"""Answers of a service, checked, and errors: a service may be of another version, broken, hostile, or away.

Nothing of an answer becomes a path, and no link of an answer is followed. Texts are cut and lose control characters;
numbers are finite and bounded; ids have the form of ids.
"""

import http.client
import json
import math
import re
import socket
import ssl
import unicodedata
import urllib.error
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MAX_NAME_BYTES = 60
"""Longest name of an object: Blender before 5.0 takes 63 bytes."""
MAX_TEXT = 400

_ID = re.compile(r"[0-9A-Za-z][0-9A-Za-z_-]{0,63}")
_RESULT = re.compile(r"[0-9A-Za-z][0-9A-Za-z_.-]{0,119}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_MAX_ITEMS = 500
_MAX_PROBLEM_BYTES = 1 << 18
_MAX_COUNT = 10**15
ENDED = frozenset({"succeeded", "failed", "canceled", "expired"})
_STATES = ENDED | {"queued", "running", "canceling"}


class RequestError(Exception):
    """A request came to nothing; the text is a sentence for the user."""


class AnswerError(RequestError):
    """The service answered in a form that the extension does not know."""

    def __init__(self) -> None:
        super().__init__(
            "The service's answer is not understood: it is of another version than this extension, or no Multicap."
        )


@dataclass(frozen=True, slots=True)
class CaptureEntry:
    """Capture in a list."""

    id: str
    name: str
    created_at: str
    duration_s: float
    num_jobs: int


@dataclass(frozen=True, slots=True)
class JobEntry:
    """Job in a list, or while it runs."""

    id: str
    capture_id: str
    capture_name: str
    state: str
    progress: float  # Share of the work that is done, from 0 to 1
    stage: str  # Label of the stage that runs; empty between stages
    eta_s: float | None
    queue_position: int | None
    created_at: str
    error: str  # Sentences about the error of a failed job; else empty

    @property
    def is_over(self) -> bool:
        """True if the job has ended."""
        return self.state in ENDED

    def sentence(self) -> str:
        """State of the job in words.

        >>> JobEntry("1", "2", "Take", "running", 0.25, "Tracking people", 90.0, None, "", "").sentence()
        '25 %, tracking people, about 2 min left'
        """
        if self.state == "queued" and self.queue_position:
            return f"queued, number {self.queue_position}"
        if self.state != "running":
            return self.state
        words = [f"{self.progress:.0%}".replace("%", " %"), self.stage[:1].lower() + self.stage[1:]]
        if self.eta_s is not None:
            words.append(f"about {math.ceil(self.eta_s / 60)} min left" if self.eta_s >= 60 else "less than 1 min left")
        return ", ".join(filter(None, words))


@dataclass(frozen=True, slots=True)
class FileEntry:
    """Result file of a job."""

    name: str  # Name in the service, for the address alone
    format: str
    person: str  # Name of the person for objects; empty for files of the take
    num_bytes: int
    sha256: str


def parse(content: bytes) -> Mapping[str, Any]:
    """JSON object of an answer. Raises ``AnswerError`` for anything else."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        raise AnswerError from None
    if not isinstance(document, dict):
        raise AnswerError
    return document


def plain(text: Any, max_bytes: int = MAX_NAME_BYTES, default: str = "") -> str:
    r"""Text without control characters and marks of the writing direction, on one line, cut to some bytes of UTF-8.

    >>> plain("  Zoë\n\u202eK. ")
    'Zoë K.'
    """
    if not isinstance(text, str):
        return default
    # Longer texts are cut first: normalization of a huge one takes long.
    short = unicodedata.normalize("NFC", text[: 4 * max_bytes])
    kept = "".join(
        " " if character.isspace() else character
        for character in short
        if character.isspace() or unicodedata.category(character)[0] != "C"
    )
    cut = " ".join(kept.split()).encode()[:max_bytes].decode(errors="ignore").strip()
    return cut or default


def identifier(value: Any) -> str:
    """Id in an answer. Raises ``AnswerError`` for anything that is none."""
    if isinstance(value, str) and _ID.fullmatch(value):
        return value
    raise AnswerError


def _number(value: Any, low: float, high: float, default: float | None = None) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high:
        return float(value)
    if default is not None:
        return default
    raise AnswerError


def _items(document: Mapping[str, Any], name: str) -> Sequence[Mapping[str, Any]]:
    items = document.get(name)
    if not isinstance(items, list) or not all(isinstance(item, dict) for item in items[:_MAX_ITEMS]):
        raise AnswerError
    return items[:_MAX_ITEMS]


def read_captures(document: Mapping[str, Any]) -> tuple[list[CaptureEntry], str]:
    """Captures of a page of the list, and the cursor of the next page, empty at the end."""
    captures = [
        CaptureEntry(
            identifier(item.get("id")),
            plain(item.get("name"), default="(no name)"),
            plain(item.get("created_at"), 16).replace("T", " "),
            _number(item.get("duration_s"), 0.0, _MAX_COUNT, default=0.0),
            int(_number(item.get("num_jobs"), 0, _MAX_COUNT, default=0)),
        )
        for item in _items(document, "sessions")
    ]
    cursor = document.get("next_cursor")
    return captures, "" if cursor is None else identifier(cursor)


def read_job(item: Mapping[str, Any]) -> JobEntry:
    """Job of an answer."""
    stages = item.get("stages")
    running = [
        plain(stage.get("label"))
        for stage in (stages if isinstance(stages, list) else [])[:_MAX_ITEMS]
        if isinstance(stage, dict) and stage.get("state") == "running"
    ]
    state, error = item.get("state"), item.get("error")
    if not isinstance(state, str) or state not in _STATES:
        raise AnswerError
    eta_s, place = item.get("eta_s"), item.get("queue_position")
    return JobEntry(
        identifier(item.get("id")),
        identifier(item.get("session_id")),
        plain(item.get("session_name"), default="take"),
        state,
        _number(item.get("progress"), 0.0, 1.0, default=0.0),
        running[0] if running else "",
        None if eta_s is None else _number(eta_s, 0.0, _MAX_COUNT, default=0.0),
        None if place is None else int(_number(place, 0, _MAX_COUNT, default=0)),
        plain(item.get("created_at"), 16).replace("T", " "),
        sentences(error) if isinstance(error, dict) else "",
    )


def read_jobs(document: Mapping[str, Any]) -> list[JobEntry]:
    """Reconstructions of a list of jobs, the newest first."""
    return [
        read_job(item) for item in _items(document, "jobs") if item.get("kind", "reconstruction") == "reconstruction"
    ]


def read_files(document: Mapping[str, Any]) -> list[FileEntry]:
    """Result files of a job; files with names of another form are left out, nothing of ours has them."""
    files = []
    for item in _items(document, "results"):
        name, digest = item.get("name"), item.get("sha256")
        if not (isinstance(name, str) and _RESULT.fullmatch(name) and ".." not in name):
            continue
        if not (isinstance(digest, str) and _SHA256.fullmatch(digest)):
            raise AnswerError
        is_of_person = item.get("person") is not None
        files.append(
            FileEntry(
                name,
                plain(item.get("format") or item.get("kind"), 20),
                plain(item.get("person_name"), default="person") if is_of_person else "",
                int(_number(item.get("num_bytes"), 0, _MAX_COUNT)),
                digest,
            )
        )
    return files


def read_bones(document: Mapping[str, Any]) -> dict[str, str]:
    """Bones by joint of a character. They are compared with names of bones alone, so they are taken as they are."""
    items = _items(document, "joints")
    return {
        item["joint"]: item["bone"]
        for item in items
        if isinstance(item.get("joint"), str) and isinstance(item.get("bone"), str)
    }


def sentences(problem: Mapping[str, Any]) -> str:
    """Sentences of a problem for the user, cut; empty without any."""
    errors = problem.get("errors")
    items = [
        ": ".join(filter(None, [plain(item.get("file")), plain(item.get("message"), MAX_TEXT)]))
        for item in (errors if isinstance(errors, list) else [])[:5]
        if isinstance(item, dict)
    ]
    parts = [plain(problem.get("detail"), MAX_TEXT), *items, plain(problem.get("hint"), MAX_TEXT)]
    return plain(" ".join(filter(None, parts)), 3 * MAX_TEXT)


class RefusedError(RequestError):
    """The service refused a request."""

    def __init__(self, status: int, text: str, location: str = "", retry_after_s: float = 0.0) -> None:
        super().__init__(text)
        self.status, self.location, self.retry_after_s = status, location, retry_after_s


class AwayError(RequestError):
    """The service does not answer; a later try may succeed."""


def refusal(error: urllib.error.HTTPError, host: str, *, has_key: bool) -> RefusedError:
    """Error with the service's sentences; a proxy answers without any."""
    try:
        content = error.read(_MAX_PROBLEM_BYTES)
        text = sentences(parse(content))
    except (OSError, http.client.HTTPException, AnswerError):
        text = ""
    if error.code == http.client.UNAUTHORIZED:
        text = (
            "The service does not know this key, or the key has expired or was revoked. Check the key."
            if has_key
            else "The service asks for a key. Put it into the extension's preferences."
        )
    after = error.headers.get("Retry-After", "")
    return RefusedError(
        error.code,
        text or f"The server at {host} answered {error.code}.",
        error.headers.get("Location", "")
        if http.client.MULTIPLE_CHOICES <= error.code < http.client.BAD_REQUEST
        else "",
        float(after) if re.fullmatch(r"\d{1,6}", after, re.ASCII) else 0.0,
    )


def no_answer(reason: object, host: str) -> RequestError:
    """Error of a connection that could not be made, or broke."""
    is_wrong = True
    match reason:
        case ssl.SSLCertVerificationError():
            text = f"The certificate of {host} can't be verified, so nothing was sent. Check the address."
        case ssl.SSLError():
            text = f"The server at {host} does not speak https. Check the address: http or https?"
        case http.client.BadStatusLine() | http.client.LineTooLong() if not isinstance(reason, ConnectionError):
            text = f"The server at {host} is not a Multicap service. Check the address: http or https?"
        case _:
            is_wrong = False
            texts = {
                socket.gaierror: f"There is no server {host}, or no network. Check the address.",
                ConnectionRefusedError: f"Nothing answers at {host}. Is the service running? Check address and port.",
                TimeoutError: f"The server at {host} did not answer in time.",
            }
            broken = f"The connection to {host} broke off."
            text = next((words for kind, words in texts.items() if isinstance(reason, kind)), broken)
    return RequestError(text) if is_wrong else AwayError(text)
