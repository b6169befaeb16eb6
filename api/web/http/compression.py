"""Static files that are compressed once, when they are first asked for."""

import gzip
from functools import lru_cache
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.responses import FileResponse, Response
from starlette.staticfiles import NotModifiedResponse, StaticFiles
from starlette.types import Scope

_ENDINGS = frozenset({".css", ".html", ".js", ".svg"})
_MIN_BYTES = 1024


class CompressedFiles(StaticFiles):
    """Static files; texts are sent by gzip to clients that accept it, under an entity tag of their own."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with the file in the encoding that the client accepts, or with 304 if it has this version."""
        response = await super().get_response(path, scope)
        if not isinstance(response, FileResponse) or Path(response.path).suffix not in _ENDINGS:
            return response
        response.headers["Vary"] = "Accept-Encoding"
        headers = Headers(scope=scope)
        if not _accepts_gzip(headers.get("accept-encoding", "")) or "range" in headers:
            return response
        file = Path(response.path)
        changed_at = await run_in_threadpool(file.stat)
        if changed_at.st_size < _MIN_BYTES:
            return response
        content = await run_in_threadpool(_compressed, file, changed_at.st_mtime_ns)
        kept = {name: value for name, value in response.headers.items() if name not in {"content-length", "etag"}}
        etag = f'"{response.headers["etag"].strip(chr(34))}-gzip"'
        kept |= {"etag": etag, "content-encoding": "gzip"}
        kept.pop("accept-ranges", None)
        compressed = Response(content, headers=kept, media_type=response.media_type)
        return (
            NotModifiedResponse(compressed.headers) if self.is_not_modified(compressed.headers, headers) else compressed
        )


def _accepts_gzip(header: str) -> bool:
    """Return whether an ``Accept-Encoding`` header names gzip (RFC 9110, section 12.5.3).

    >>> _accepts_gzip("br;q=1.0, gzip;q=0.5"), _accepts_gzip("gzip;q=0"), _accepts_gzip("identity")
    (True, False, False)
    """
    for part in header.lower().split(","):
        coding, _, weight = part.partition(";")
        if coding.strip() in {"gzip", "*"}:
            value = weight.strip().removeprefix("q=")
            return not (value and set(value) <= set("0."))
    return False


@lru_cache(maxsize=256)
def _compressed(path: Path, changed_at_ns: int) -> bytes:
    """Content of a file, compressed; the time of its last change tells versions apart."""
    return gzip.compress(path.read_bytes(), compresslevel=9, mtime=0)
