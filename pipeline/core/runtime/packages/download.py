"""Download of files over HTTP: resumable, with checksum, size limit and a lock between processes."""

from collections.abc import Callable, Collection
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.core.errors import ModelError
from pipeline.core.runtime.packages.storage import exclusive, file_sha256, partial_path, storage_errors

# Slow to load, and needed for downloads alone.
if TYPE_CHECKING:
    import httpx2

# Callback of a download's progress: bytes so far, and all bytes if known.
OnBytes = Callable[[int, int | None], None]

_PIECE_BYTES = 256 * 1024
# Attempts of a download whose connection breaks; each resumes where the previous one ended.
_MAX_ATTEMPTS = 3


def silent(_done: int, _total: int | None) -> None:
    """Report nothing."""


def download(
    client: "httpx2.Client",
    url: str,
    target: Path,
    sha256: Collection[str],
    max_bytes: int,
    on_bytes: OnBytes = silent,
) -> Path:
    """Download a file unless it exists, and resume an earlier attempt; return ``target``.

    If a resumed file has a wrong checksum, it is downloaded once more from the start. So no validator of the server
    has to be stored.

    - ``url``: URL with scheme ``http``, ``https`` or ``file``.
    - ``target``: path of the file; an incomplete or unchecked file is named ``<target>.part``.
    - ``sha256``: accepted checksums.
    - ``on_bytes``: called after each piece with the bytes so far, and all bytes if known.
    - Raises ``ModelError`` if the server can't be reached or refuses the file, the file is too large or has a wrong
      checksum (it is then removed), or the disk is full.
    """
    with exclusive(target), storage_errors():
        if target.is_file() and file_sha256(target) in sha256:
            return target
        part = partial_path(target)
        resumed = _num_bytes(part) > 0
        _receive_all(client, url, part, max_bytes, on_bytes)
        if resumed and file_sha256(part) not in sha256:
            part.unlink()
            _receive_all(client, url, part, max_bytes, on_bytes)
        if file_sha256(part) not in sha256:
            part.unlink()
            raise ModelError(
                f"{target.name} has a wrong checksum and was removed: it was changed on the way, or is another file. "
                "Try again, or get it from elsewhere."
            )
        part.replace(target)
        return target


def _num_bytes(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _receive_all(client: "httpx2.Client", url: str, part: Path, max_bytes: int, on_bytes: OnBytes) -> None:
    import httpx2  # noqa: PLC0415

    for attempt in range(1, _MAX_ATTEMPTS + 1):
        try:
            _receive(client, url, part, max_bytes, on_bytes)
        except httpx2.ConnectError as error:
            raise _no_connection(part) from error
        except (httpx2.HTTPError, httpx2.InvalidURL) as error:
            if attempt == _MAX_ATTEMPTS or not isinstance(error, httpx2.TransportError):
                raise _no_connection(part) from error
        else:
            return


def _no_connection(part: Path) -> ModelError:
    return ModelError(
        f"{part.stem} can't be downloaded: no connection, or it broke after {_num_bytes(part)} bytes. "
        "Check the network and the proxy, then try again: it continues from there."
    )


def _receive(client: "httpx2.Client", url: str, part: Path, max_bytes: int, on_bytes: OnBytes) -> None:
    """Append the missing bytes to ``part``, or rewrite the file if the server sends all bytes."""
    start = _num_bytes(part)
    # Without compression, so that offsets count bytes of the file.
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-"} if start else {})
    with client.stream("GET", url, headers=headers) as response:
        if start and response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            return  # no byte is missing, or the server has another file by now, which the checksum will show
        if not response.is_success:
            raise ModelError(f"The server refused {part.stem} (status {response.status_code}). Try again later.")
        done = start if _continues_at(response, start) else 0
        length = response.headers.get("Content-Length", "")
        total = done + int(length) if length.isdecimal() else None
        with part.open("ab" if done else "wb") as file:
            for piece in response.iter_raw(_PIECE_BYTES):
                done += len(piece)
                if max(done, total or 0) > max_bytes:
                    part.unlink()
                    raise ModelError(
                        f"{part.stem} is larger than it may be ({max_bytes} bytes). Get it from elsewhere."
                    )
                file.write(piece)
                on_bytes(done, total)


def _continues_at(response: "httpx2.Response", start: int) -> bool:
    if response.status_code != HTTPStatus.PARTIAL_CONTENT:
        return False
    return response.headers.get("Content-Range", "").startswith(f"bytes {start}-")
