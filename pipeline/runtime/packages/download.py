"""Download over HTTP: resumable, checked, under a size limit, one process at a time."""

from collections.abc import Callable, Collection
from pathlib import Path

import httpx2

from pipeline.errors import ModelError
from pipeline.runtime.packages.storage import exclusive, part_of, sha256_of, storage_errors

# Told after every piece: bytes so far, and bytes in all where known.
OnBytes = Callable[[int, int | None], None]

_PIECE_BYTES = 256 * 1024
# A connection that breaks is taken up again where it broke, this often.
_MAX_ATTEMPTS = 3


def silent(_done: int, _total: int | None) -> None:
    """Report nothing."""


def download(
    client: httpx2.Client,
    url: str,
    target: Path,
    sha256: Collection[str],
    max_bytes: int,
    on_bytes: OnBytes = silent,
) -> Path:
    """Download a file unless it is there, going on from where an earlier attempt stopped.

    The checksum is what tells whether a resumed file is whole and of one piece: where it is not, the file is downloaded
    once more from the start. So no validator of the server's has to be kept.

    Parameters
    ----------
    url
        An ``http``, ``https`` or ``file`` URL.
    target
        Where it goes; until it is whole and checked it is named ``<target>.part``.
    sha256
        Checksums of which the file must have one.
    max_bytes
        Size above which it is refused.

    Returns
    -------
        ``target``.

    Raises
    ------
    ModelError
        If the server can't be reached or has no such file, the file is too large or has a wrong checksum (it is
        removed), or the disk is full.
    """
    with exclusive(target), storage_errors():
        if target.is_file() and sha256_of(target) in sha256:
            return target
        part = part_of(target)
        resumed = _num_bytes(part) > 0
        _receive_all(client, url, part, max_bytes, on_bytes)
        if resumed and sha256_of(part) not in sha256:
            part.unlink()
            _receive_all(client, url, part, max_bytes, on_bytes)
        if sha256_of(part) not in sha256:
            part.unlink()
            raise ModelError(
                f"{target.name} has a wrong checksum and was removed: it was changed on the way, or is another file. "
                "Try again, or get it from elsewhere."
            )
        part.replace(target)
        return target


def _num_bytes(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _receive_all(client: httpx2.Client, url: str, part: Path, max_bytes: int, on_bytes: OnBytes) -> None:
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
        "Check the network and the proxy, then try again: it goes on from there."
    )


def _receive(client: httpx2.Client, url: str, part: Path, max_bytes: int, on_bytes: OnBytes) -> None:
    """Append to ``part`` what is missing of it, or write it anew where the server sends everything."""
    start = _num_bytes(part)
    # Compressed on the way, offsets would mean something else.
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-"} if start else {})
    with client.stream("GET", url, headers=headers) as response:
        if start and response.status_code == httpx2.codes.RANGE_NOT_SATISFIABLE:
            return  # nothing is missing, or the file is another one by now: the checksum tells
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


def _continues_at(response: httpx2.Response, start: int) -> bool:
    if response.status_code != httpx2.codes.PARTIAL_CONTENT:
        return False
    return response.headers.get("Content-Range", "").startswith(f"bytes {start}-")
