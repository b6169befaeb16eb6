"""Choice of the artifact store by its URL."""

from pathlib import Path

import platformdirs

from worker.store.files.artifacts import ArtifactStore, LocalArtifacts
from worker.store.files.file_cache import FileCache

# Allowed URLs in the settings of API and workers.
ARTIFACTS_URL = r"^(s3://[^/\s]+(/\S*)?)?$"

DEFAULT_CACHE_BYTES = 64 * 2**30
DEFAULT_CACHE_HOURS = 12.0


def default_data_dir() -> Path:
    """Default data folder of the service."""
    return platformdirs.user_data_path("multicap", appauthor=False) / "service"


def open_artifacts(
    url: str, data_dir: Path, cache_bytes: int = DEFAULT_CACHE_BYTES, cache_hours: float = DEFAULT_CACHE_HOURS
) -> ArtifactStore:
    """Open the artifact store at a URL.

    Parameters
    ----------
    url
        ``s3://bucket/prefix``; empty: a folder of ``data_dir``.
    data_dir
        Data folder, which holds the artifacts, or copies of those in a bucket.
    cache_bytes, cache_hours
        Maximum size of the copies, and time that unused copies are kept.

    Raises
    ------
    ValueError
        The URL is of no known store.
    """
    if not url:
        return LocalArtifacts(data_dir / "artifacts")
    # The library is loaded only where it is needed.
    from worker.store.files.s3_artifacts import S3Artifacts  # noqa: PLC0415

    return S3Artifacts(url, FileCache(data_dir / "cache", cache_bytes, cache_hours * 3600.0))
