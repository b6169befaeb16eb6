"""Client of a Multicap service on the standard library: with time limits, bounded, and without trust in the service.

Calls block; they run in the thread of a task. ``watch`` of a call says after each block whether to go on.
"""

import base64
import hashlib
import http.client
import ipaddress
import json
import re
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote, urljoin, urlsplit

from api.blender.extension.answers import (
    AnswerError,
    AwayError,
    CaptureEntry,
    FileEntry,
    JobEntry,
    RefusedError,
    RequestError,
    identifier,
    no_answer,
    parse,
    plain,
    read_bones,
    read_captures,
    read_files,
    read_job,
    read_jobs,
    refusal,
)

# Seconds without a byte from the service; of the call that checks a whole capture; of an answer as a whole.
_SILENCE_S, _CHECK_S, _ANSWER_S = 20.0, 900.0, 60.0
_MAX_ANSWER_BYTES = 8 << 20
MAX_FILE_BYTES = 4 << 30
"""Largest result file that is downloaded; GLB files are no larger."""
MAX_FRAMES = 2_000_000
"""Most frames of a take."""
_BLOCK_BYTES = 1 << 18
_PIECE_BYTES = 4 << 20
# Tries without progress, and the pauses between them.
_MAX_TRIES, _FIRST_PAUSE_S, _LONGEST_PAUSE_S = 6, 0.5, 8.0
_MAX_REDIRECTS = 3
_CHARACTER = "armature.glb"
_KEY = re.compile(r"[\x21-\x7e]{1,300}")
_UPLOAD = re.compile(r".*/v1/uploads/([0-9A-Za-z_-]{1,64})")
_BUSY = frozenset({409, 423, 429, 500, 502, 503, 504})
# Choices of a job that the extension needs.
_NEEDED = frozenset({"exports", "timeline"})

Watch = Callable[[float], None]


class StoppedTaskError(Exception):
    """The user stopped a task."""


@dataclass(frozen=True, slots=True)
class CallerEntry:
    """Caller of a service."""

    tenant: str
    may_write: bool


def service_address(text: str) -> str:
    """Address of a service as users type or copy it, in its plain form.

    >>> service_address(" 127.0.0.1:8000/#/captures ")
    'http://127.0.0.1:8000'

    Raises ``RequestError`` if it is no address of a web service.
    """
    text = text.strip()
    wrong = RequestError("This is not the address of a service. An example is http://127.0.0.1:8000.")
    try:
        parts = urlsplit(text if "://" in text else f"http://{text}")
        port = parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme not in {"http", "https"} or not parts.hostname or re.search(r"[\x00-\x20\x7f]", text):
        raise wrong
    if parts.username or parts.password:
        raise RequestError("The address has a user or a password. Put the API key into its own field.")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    try:
        host.encode("idna" if not host.startswith("[") else "ascii")
    except UnicodeError:
        raise wrong from None
    return f"{parts.scheme}://{host}{'' if port is None else f':{port}'}{parts.path.rstrip('/')}"


def is_on_this_machine(address: str) -> bool:
    """True for an address of this machine, which needs no network."""
    host = urlsplit(address).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


@dataclass(frozen=True, slots=True)
class BlenderClient:
    """Client of a service.

    ``address``: address from ``service_address``. ``key``: API key; empty for a service without keys. Raises
    ``RequestError``: from every method: the service is away, refuses, or answers what is not understood.
    """

    address: str
    key: str = field(default="", repr=False)

    def connect(self) -> CallerEntry:
        """Check address, key and version; nothing changes in the service."""
        if self.key and not _KEY.fullmatch(self.key):
            raise RequestError("The key has characters that no key has. Copy it again.")
        try:
            is_alive = self._json("GET", "/healthz", has_key=False).get("status") == "ok"
        except (RefusedError, AnswerError):
            is_alive = False
        if not is_alive:
            raise RequestError(f"The server at {self.address} is not a Multicap service. Check the address.")
        try:
            caller = self._json("GET", "/v1/caller")
        except RefusedError as error:
            if error.status == http.client.NOT_FOUND:
                raise AnswerError from error
            raise
        options = self._json("GET", "/v1/options").get("choices")
        scopes = caller.get("scopes")
        if not isinstance(scopes, list) or not isinstance(options, list):
            raise AnswerError
        if not _NEEDED.issubset(str(option.get("name")) for option in options if isinstance(option, dict)):
            raise RequestError(
                "The service is older than this extension. Update the service, or install the extension of its version."
            )
        return CallerEntry(plain(caller.get("tenant")), "write" in scopes)

    def captures(self, name: str = "", cursor: str = "") -> tuple[list[CaptureEntry], str]:
        """Captures whose names contain a text, the newest first: a page, and the cursor of the next one."""
        texts = {"name": name[:200], "cursor": cursor}
        query = "".join(f"&{word}={quote(text, safe='')}" for word, text in texts.items() if text)
        return read_captures(self._json("GET", f"/v1/sessions?limit=50{query}"))

    def jobs(self, capture_id: str) -> list[JobEntry]:
        """Newest reconstructions of a capture."""
        return read_jobs(self._json("GET", f"/v1/sessions/{identifier(capture_id)}/jobs?limit=50"))

    def job(self, job_id: str) -> JobEntry:
        """State of a job."""
        return read_job(self._json("GET", f"/v1/jobs/{identifier(job_id)}"))

    def files(self, job_id: str) -> list[FileEntry]:
        """Result files of a job."""
        return read_files(self._json("GET", f"/v1/jobs/{identifier(job_id)}/results"))

    def timeline(self, job_id: str) -> tuple[float, int] | None:
        """Frame rate (hertz) and number of frames of a job's take; ``None`` if the service does not say it."""
        try:
            description = self._json("GET", f"/v1/jobs/{identifier(job_id)}/motion/description")
        except RefusedError:
            return None
        rate_hz, num_frames = description.get("frame_rate_hz"), description.get("num_frames")
        if not isinstance(rate_hz, (int, float)) or not isinstance(num_frames, int):
            return None
        return (float(rate_hz), num_frames) if 0.0 < rate_hz <= 10_000.0 and 0 < num_frames <= MAX_FRAMES else None

    def cancel(self, job_id: str) -> None:
        """Cancel a job."""
        self._json("POST", f"/v1/jobs/{identifier(job_id)}/cancel", body=b"")

    def page_address(self, job_id: str = "") -> str:
        """Address of the page of a job in a browser, or of the list of captures."""
        return f"{self.address}/#/jobs/{identifier(job_id)}" if job_id else f"{self.address}/#/captures"

    def recognised_bones(self, content: bytes, stated: Mapping[str, str]) -> dict[str, str]:
        """Bones by joint that the service recognises in the GLB of a character; ``stated`` ones go before.

        The service stores the character for the moment of the request alone.
        """
        boundary = uuid.uuid4().hex
        parts = (
            (f'name="character"; filename="{_CHARACTER}"', content),
            ('name="spec"', json.dumps({"name": _CHARACTER, "bones": dict(stated)}).encode()),
        )
        form = b"".join(
            f"--{boundary}\r\nContent-Disposition: form-data; {head}\r\n\r\n".encode() + part + b"\r\n"
            for head, part in parts
        )
        character = self._json(
            "POST",
            "/v1/characters",
            form + f"--{boundary}--\r\n".encode(),
            {"Content-Type": f"multipart/form-data; boundary={boundary}"},
            silence_s=_ANSWER_S,
        )
        self._json("DELETE", f"/v1/characters/{identifier(character.get('id'))}")
        return read_bones(character)

    def download(self, job_id: str, file: FileEntry, path: Path, watch: Watch) -> None:
        """Download a result file to a path of ours; after a break the download continues where it broke.

        ``watch`` is called with the bytes that are there.
        """
        if file.num_bytes > MAX_FILE_BYTES:
            raise RequestError(f"The file {file.name} is larger than {MAX_FILE_BYTES >> 30} GiB.")
        address = f"{self.address}/v1/jobs/{identifier(job_id)}/results/{quote(file.name, safe='')}"
        pauses = _Pauses(watch)
        with path.open("w+b") as content:
            while content.tell() < file.num_bytes:
                start = content.tell()
                try:
                    self._receive(address, file, content, watch)
                except (AwayError, RefusedError) as error:
                    _raise_unless_busy(error)
                    if content.tell() > start:
                        pauses = _Pauses(watch)
                    pauses.wait(error, content.tell())
            content.seek(0)
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        if digest != file.sha256:
            path.unlink()
            raise RequestError(f"The downloaded file {file.name} is damaged. Try again.")

    def _receive(self, address: str, file: FileEntry, content: BinaryIO, watch: Watch) -> None:
        """Receive the rest of a file, which may be in the bucket that the service sends the client to."""
        start = content.tell()
        headers = {"Range": f"bytes={start}-", "If-Range": f'"{file.sha256}"'} if start else {}
        for _ in range(_MAX_REDIRECTS):
            try:
                response = self._open("GET", address, headers=headers, has_key=address.startswith(f"{self.address}/"))
                break
            except RefusedError as error:
                target = urljoin(address, error.location)
                is_secure = target.startswith("https://") or not address.startswith("https://")
                if not error.location or not target.startswith(("http://", "https://")) or not is_secure:
                    raise
                address = target
        else:
            raise AnswerError
        with response:
            if start and response.status != http.client.PARTIAL_CONTENT:
                content.seek(0)
                content.truncate()
            while block := _read_block(response, _BLOCK_BYTES):
                if content.tell() + len(block) > file.num_bytes:
                    raise RequestError(f"The file {file.name} is larger than the service said.")
                content.write(block)
                watch(content.tell())
        if content.tell() < file.num_bytes:
            raise AwayError("The connection to the service broke off.")

    def send(
        self, name: str, videos: Sequence[Path], calibration: Path, spec: Mapping[str, Any], watch: Watch
    ) -> JobEntry:
        """Send a capture in pieces, and have it reconstructed; after a break a file continues where it broke.

        ``watch`` is called with the bytes of all files that are there. Uploads of a capture that is stopped or refused
        are deleted.
        """
        uploads: list[str] = []
        done = 0
        try:
            for path in (*videos, calibration):
                done += self._upload(path, uploads, _after(done, watch))
            body = {
                "videos": uploads[:-1],
                "calibration": uploads[-1],
                "manifest": {"name": name},
                "spec": dict(spec),
            }
            return read_job(self._json("POST", "/v1/jobs/from-uploads", json.dumps(body).encode(), silence_s=_CHECK_S))
        except BaseException:
            for upload in uploads:
                try:
                    self._json("DELETE", f"/v1/uploads/{upload}", headers={"Tus-Resumable": "1.0.0"})
                except RequestError:
                    break  # The service removes unused uploads by itself.
            raise

    def _upload(self, path: Path, uploads: list[str], watch: Watch) -> int:
        """Send a file by tus; append its id to ``uploads``, and return its size in bytes."""
        tus = {"Tus-Resumable": "1.0.0"}
        with path.open("rb") as file:
            num_bytes = file.seek(0, 2)
            shown = base64.b64encode(path.name.encode()).decode()
            begin = tus | {"Upload-Length": str(num_bytes), "Upload-Metadata": f"filename {shown}"}
            begin["Idempotency-Key"] = str(uuid.uuid4())
            pauses = _Pauses(watch)
            while True:
                try:
                    with self._open("POST", f"{self.address}/v1/uploads", b"", begin) as response:
                        place = _UPLOAD.fullmatch(response.headers.get("Location", ""))
                    break
                except (AwayError, RefusedError) as error:
                    _raise_unless_busy(error)
                    pauses.wait(error, 0)
            if place is None:
                raise AnswerError
            uploads.append(place[1])
            address, offset, pauses = f"{self.address}/v1/uploads/{place[1]}", 0, _Pauses(watch)
            while offset < num_bytes:
                try:
                    file.seek(offset)
                    piece = file.read(_PIECE_BYTES)
                    if not piece:
                        raise RequestError(f"The file {path.name} became shorter while it was sent.")
                    headers = tus | {"Upload-Offset": str(offset), "Content-Type": "application/offset+octet-stream"}
                    with self._open("PATCH", address, piece, headers, silence_s=_ANSWER_S) as response:
                        offset = _offset(response, offset + 1, offset + len(piece))
                    pauses = _Pauses(watch)
                except (AwayError, RefusedError) as error:
                    _raise_unless_busy(error)
                    pauses.wait(error, offset)
                    try:
                        with self._open("HEAD", address, None, tus) as response:
                            offset = _offset(response, 0, num_bytes)
                    except (AwayError, RefusedError) as again:
                        _raise_unless_busy(again)
                watch(offset)
        return num_bytes

    def _json(
        self,
        method: str,
        path: str,
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        *,
        has_key: bool = True,
        silence_s: float = _SILENCE_S,
    ) -> Mapping[str, Any]:
        stated = {"Accept": "application/json"}
        if method == "POST":
            stated |= {"Content-Type": "application/json", "Idempotency-Key": str(uuid.uuid4())}
        stated |= headers or {}
        with self._open(method, self.address + path, body, stated, has_key=has_key, silence_s=silence_s) as response:
            content = _read_all(response, _MAX_ANSWER_BYTES)
        return parse(content) if content or method == "GET" else {}

    def _open(
        self,
        method: str,
        address: str,
        body: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        *,
        has_key: bool = True,
        silence_s: float = _SILENCE_S,
    ) -> http.client.HTTPResponse:
        request = urllib.request.Request(  # noqa: S310 - the scheme of addresses is checked
            address, data=body, headers={"User-Agent": "Multicap-Blender", **(headers or {})}, method=method
        )
        if has_key and self.key:
            request.add_unredirected_header("Authorization", f"Bearer {self.key}")
        host = urlsplit(address).netloc
        try:
            response: http.client.HTTPResponse = _opener(address).open(request, timeout=silence_s)
        except urllib.error.HTTPError as error:
            with error:
                raise refusal(error, host, has_key=bool(self.key)) from None
        except urllib.error.URLError as error:
            raise no_answer(error.reason, host) from None
        except (OSError, http.client.HTTPException) as error:
            raise no_answer(error, host) from None
        except ValueError:
            raise RequestError("The address or the key has characters that neither has.") from None
        return response


class _Pauses:
    """Growing pauses between tries without progress."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._num_tries = watch, 0

    def wait(self, error: AwayError | RefusedError, done: float) -> None:
        """Wait for the next try; raise the error after the last one."""
        self._num_tries += 1
        if self._num_tries == _MAX_TRIES:
            raise error
        pause_s = min(_FIRST_PAUSE_S * 2.0**self._num_tries, _LONGEST_PAUSE_S)
        if isinstance(error, RefusedError):
            pause_s = max(pause_s, min(error.retry_after_s, _ANSWER_S))
        end_s = time.monotonic() + pause_s
        while time.monotonic() < end_s:
            time.sleep(0.05)
            self._watch(done)


def _opener(address: str) -> urllib.request.OpenerDirector:
    """Opener of web addresses alone, which follows no redirect; a service on this machine is behind no proxy."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler({} if is_on_this_machine(address) else None),
        urllib.request.HTTPHandler(),
        urllib.request.HTTPSHandler(),
        urllib.request.HTTPDefaultErrorHandler(),
        urllib.request.HTTPErrorProcessor(),
        urllib.request.UnknownHandler(),
    ):
        opener.add_handler(handler)
    return opener


def _read_block(response: http.client.HTTPResponse, num_bytes: int) -> bytes:
    try:
        return response.read1(num_bytes)
    except (OSError, http.client.HTTPException) as error:
        raise AwayError("The connection to the service broke off.") from error


def _read_all(response: http.client.HTTPResponse, max_bytes: int) -> bytes:
    end_s = time.monotonic() + _ANSWER_S
    content = bytearray()
    while block := _read_block(response, _BLOCK_BYTES):
        content += block
        if len(content) > max_bytes or time.monotonic() > end_s:
            raise AnswerError
    return bytes(content)


def _offset(response: http.client.HTTPResponse, low: int, high: int) -> int:
    text = response.headers.get("Upload-Offset", "")
    if re.fullmatch(r"\d{1,18}", text, re.ASCII) and low <= int(text) <= high:
        return int(text)
    raise AnswerError


def _after(done: float, watch: Watch) -> Watch:
    """Progress of one step, offset by the finished steps."""
    return lambda part: watch(done + part)


def _raise_unless_busy(error: AwayError | RefusedError) -> None:
    """Raise an error that another try would not change."""
    if isinstance(error, RefusedError) and error.status not in _BUSY:
        raise error
