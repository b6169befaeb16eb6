"""What a worker process is told by its environment; every variable begins with ``MULTICAP_``."""

import sys
from pathlib import Path
from typing import TypeVar

import platformdirs
from pydantic import Field, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from worker.jobs.artifacts import ArtifactStore
from worker.jobs.stores import ARTIFACTS_URL, DEFAULT_CACHE_BYTES, DEFAULT_CACHE_HOURS, open_artifacts

_Settings = TypeVar("_Settings", bound=BaseSettings)


def read_settings(kind: type[_Settings]) -> _Settings:
    """Read the environment; a program that finds it wrong ends with a sentence a variable."""
    try:
        return kind()
    except ValidationError as error:
        sys.exit("\n".join(f"error: {sentence}" for sentence in explain(error)))


def explain(error: ValidationError) -> list[str]:
    """What is wrong with the environment's variables, a sentence each."""
    return [
        f"MULTICAP_{'_'.join(map(str, detail['loc'])).upper()}={detail['input']!r}: {detail['msg']}."
        for detail in error.errors()
    ]


class WorkerSettings(BaseSettings):
    """Where the jobs are, and how a worker holds on to its piece of one."""

    model_config = SettingsConfigDict(env_prefix="MULTICAP_", frozen=True)

    data_dir: Path = Field(
        default_factory=lambda: platformdirs.user_data_path("multicap", appauthor=False) / "service",
        description="Folder of the artifacts, and of the database unless database_url says else.",
    )
    database_url: str = Field(default="", description="SQLAlchemy URL; empty for SQLite in data_dir.")
    artifacts_url: str = Field(
        default="", pattern=ARTIFACTS_URL, description="s3://bucket/prefix; empty for a folder in data_dir."
    )
    cache_bytes: int = Field(
        default=DEFAULT_CACHE_BYTES, gt=0, description="Copies in data_dir of files that are at artifacts_url."
    )
    cache_hours: float = Field(
        default=DEFAULT_CACHE_HOURS, gt=0, description="How long such a copy stays that nobody uses."
    )
    broker_url: str = Field(default="redis://127.0.0.1:6379/0", description="Where Celery's messages go.")
    lease_s: float = Field(default=20.0, gt=0, description="A worker that is silent for longer has lost its chunk.")
    heartbeat_s: float = Field(default=2.0, gt=0, description="How often a worker says how far it is.")
    webhook_private: bool = Field(
        default=False, description="Whether webhooks may go to addresses of private networks and of this machine."
    )
    reap_interval_s: float = Field(default=5.0, gt=0, description="How often the reaper looks for what was lost.")
    nice: int = Field(
        default=10, ge=0, le=19, description="How far workers stand back for all else on their machine, the API first."
    )
    claim_for_s: float = Field(default=300.0, gt=0, description="How long one message keeps a worker claiming.")

    @property
    def resolved_database_url(self) -> str:
        """``database_url``, or SQLite in the data folder."""
        return self.database_url or f"sqlite:///{self.data_dir / 'multicap.db'}"

    def open_artifacts(self) -> ArtifactStore:
        """Open the artifact store."""
        return open_artifacts(self.artifacts_url, self.data_dir, self.cache_bytes, self.cache_hours)
