"""Which artifact store there is: the only place that chooses."""

from pathlib import Path

import platformdirs

from worker.jobs.files.artifacts import ArtifactStore, LocalArtifacts
from worker.jobs.files.file_cache import FileCache

# What the settings of API and workers take.
ARTIFACTS_URL = r"^(s3://[^/\s]+(/\S*)?)?$"

DEFAULT_CACHE_BYTES = 64 * 2**30
DEFAULT_CACHE_HOURS = 12.0


def default_data_dir() -> Path:
    """Folder of the service unless somebody says else."""
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
        Where that folder is, or the copies of what is elsewhere.
    cache_bytes, cache_hours
        How much of them, and for how long those that nobody uses.

    Raises
    ------
    ValueError
        There is no store for such a URL.
    """
    if not url:
        return LocalArtifacts(data_dir / "artifacts")
    # Whoever needs no distant store does without its library.
    from worker.jobs.files.s3_artifacts import S3Artifacts  # noqa: PLC0415

    return S3Artifacts(url, FileCache(data_dir / "cache", cache_bytes, cache_hours * 3600.0))
