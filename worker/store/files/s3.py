"""Bucket of S3, or of another service with its protocol, and what its errors mean."""

import contextlib
import os
import re
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import obstore
from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError
from obstore.store import S3Store

from worker.store.errors import ArtifactsRefused, ArtifactsUnavailable, NotFound
from worker.store.files.secret_files import S3_KEYS, file_variable

# Callers try again by themselves, so the library need not try for longer.
_RETRY: Any = {"max_retries": 4, "retry_timeout": timedelta(seconds=10)}
# Times without a connection, and without a byte of a response. A part of a large file is sent meanwhile.
_CONNECT_TIMEOUT, _READ_TIMEOUT = "5s", "20s"
# Time of a whole request, a large part on a slow line.
_TIMEOUT = "120s"
# Firewalls forget idle connections after minutes: a new one costs less than one that is dead.
_IDLE_TIMEOUT = "30s"

_STATUS = re.compile(r"status code: (\d{3})")
# Statuses of a store that asks to try again later, or whose object was replaced meanwhile.
_TRY_AGAIN = frozenset({408, 409, 412, 425, 429})
_MISSING = 404
# Message of the library for a bucket of another region.
_REDIRECT = "Received redirect"
_NO_BUCKET = "NoSuchBucket"


def open_bucket(url: str) -> S3Store:
    """Bucket at ``s3://bucket`` or ``s3://bucket/prefix``; else ``ValueError`` is raised.

    Keys and address come from the environment: ``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY``, ``AWS_REGION``,
    ``AWS_ENDPOINT_URL``; keys also from files, such as ``AWS_SECRET_ACCESS_KEY_FILE``.
    """
    if not url.startswith("s3://"):
        raise ValueError(f"{url!r} does not begin with s3://")
    # An address without TLS was set on purpose.
    plain = os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://")
    client: Any = {
        "connect_timeout": _CONNECT_TIMEOUT,
        "read_timeout": _READ_TIMEOUT,
        "timeout": _TIMEOUT,
        "pool_idle_timeout": _IDLE_TIMEOUT,
        "allow_http": plain,
    }
    keys: Any = {name.lower(): key for name in S3_KEYS if (key := file_variable(name)) is not None}
    return S3Store.from_url(url, config=keys, client_options=client, retry_config=_RETRY)


@contextlib.contextmanager
def reached(store: S3Store, key: str) -> Iterator[None]:
    """Turn errors of the library at a key into those of the job store."""
    try:
        yield
    except FileNotFoundError as error:  # raised by the library for a missing object, and for a missing bucket
        if _NO_BUCKET in str(error) or _is_bucket_missing(store):
            raise ArtifactsRefused("The bucket of the artifact store is missing.") from error
        raise NotFound(f"There is no artifact {key}.") from error
    except (BaseError, PermissionError) as error:
        if _is_refusal(error):
            raise ArtifactsRefused(f"The artifact store refuses {key}.") from error
        raise ArtifactsUnavailable(f"The artifact store does not respond at {key}.") from error


def list_any(store: S3Store) -> None:
    """Ask the bucket for any object; raises what the library raises."""
    for _ in obstore.list(store, "ping", chunk_size=1):
        break


def _is_refusal(error: Exception) -> bool:
    """Return whether the store refuses a request that it understood; else it is away, or asks to try again."""
    if isinstance(error, PermissionError | PermissionDeniedError | UnauthenticatedError) or _REDIRECT in str(error):
        return True
    status = _STATUS.search(str(error))
    return status is not None and status[1].startswith("4") and int(status[1]) not in _TRY_AGAIN


def _is_bucket_missing(store: S3Store) -> bool:
    """Return whether the bucket is missing; a response to HEAD does not say so."""
    try:
        list_any(store)
    except (BaseError, OSError) as error:
        status = _STATUS.search(str(error))
        return status is not None and int(status[1]) == _MISSING
    return False
