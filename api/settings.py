"""Settings of the web API, from environment variables that begin with ``MULTICAP_``."""

import ipaddress
from pathlib import Path

from pydantic import Field, IPvAnyNetwork
from pydantic_settings import BaseSettings, SettingsConfigDict

from pipeline.runtime.child_processes import module_command
from pipeline.stages.plan import DEFAULT_CHUNK_FRAMES
from worker.jobs.files.stores import ARTIFACTS_URL, default_data_dir
from worker.telemetry.logs import LogLevel

KIB, MIB, GIB = 2**10, 2**20, 2**30


def is_loopback(host: str) -> bool:
    """Whether a listening address is reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Settings(BaseSettings):
    """Addresses, storage and limits of the web API."""

    model_config = SettingsConfigDict(env_prefix="MULTICAP_", frozen=True)

    data_dir: Path = Field(
        default_factory=default_data_dir,
        description="Data folder: artifacts, unfinished uploads, and the database unless database_url names another.",
    )
    database_url: str = Field(default="", description="SQLAlchemy URL; empty for SQLite in data_dir.")
    artifacts_url: str = Field(
        default="",
        pattern=ARTIFACTS_URL,
        examples=["s3://bucket/prefix"],
        description="s3://bucket/prefix; empty for a folder in data_dir.",
    )
    signed_downloads_s: float | None = Field(
        default=None,
        gt=0,
        le=7 * 24 * 3600,
        description="Redirect downloads of results to the store at artifacts_url, by addresses that are valid for this "
        "time; without it downloads go through the API.",
    )
    broker_url: str = Field(default="redis://127.0.0.1:6379/0", description="URL of Celery's broker.")

    log_level: LogLevel = Field(default="info", description="Lowest level of the events that are logged.")

    host: str = Field(default="127.0.0.1", description="Address to listen on.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port to listen on; 0 for a free one.")
    trust_network: bool = Field(
        default=False,
        description="Allow an address beyond loopback without keys: only where something else keeps strangers out, "
        "such as a container whose port is published on loopback.",
    )
    allowed_hosts: frozenset[str] = Field(
        default=frozenset(),
        description="Names of the service, besides localhost, that clients may use, as a JSON list.",
    )
    allowed_origins: frozenset[str] = Field(
        default=frozenset(),
        description="Origins, such as https://portal.example, whose pages may call with keys, as a JSON list.",
    )
    trusted_proxies: frozenset[IPvAnyNetwork] = Field(
        default=frozenset(),
        description="Addresses or networks of proxies whose X-Forwarded-For and X-Forwarded-Proto are trusted, as a "
        "JSON list. Without it the peer of a connection is the client.",
    )
    max_connections: int = Field(
        default=4096,
        gt=0,
        description="Open connections of an API process; fewer where the limit on open files allows fewer.",
    )
    max_client_connections: int = Field(
        default=512,
        gt=0,
        description="Open connections of a client's address (of IPv6 its /64), except trusted proxies.",
    )
    max_wrong_keys_per_minute: int = Field(
        default=30,
        gt=0,
        description="Wrong keys from a client's address (of IPv6 its /64), at each API process; more are answered by "
        "429. Valid keys are always served.",
    )

    headroom_bytes: int | None = Field(
        default=None,
        ge=0,
        description="Room on data_dir's disk that is kept free; with less room nothing new is accepted (507). Default: "
        "5 % of the disk, at most 256 MiB.",
    )

    max_file_bytes: int = Field(default=16 * GIB, gt=0, description="Size of a video.")
    max_keypoints_bytes: int = Field(default=1 * GIB, gt=0, description="Size of the archive of a camera's keypoints.")
    max_session_bytes: int = Field(default=64 * GIB, gt=0, description="Size of all files of a session.")
    max_calibration_bytes: int = Field(default=16 * MIB, gt=0, description="Size of a calibration file.")
    max_json_bytes: int = Field(default=64 * KIB, gt=0, description="Size of a JSON body or part.")
    max_session_joints: int = Field(
        default=25_000_000,
        gt=0,
        description="Joints of all keypoint files of a session, found or not; a worker needs some 115 bytes for each.",
    )
    max_cameras: int = Field(default=64, gt=0, description="Videos, or archives of keypoints, of a session.")

    max_duration_s: float | None = Field(
        default=None,
        gt=0,
        description="Duration of a session, from its first frame to its last; without it 43,200 s.",
    )
    max_pixels: int | None = Field(default=None, gt=0, description="Pixels of a frame; without it 8192 x 4320.")

    max_tenant_sessions: int | None = Field(
        default=None, ge=0, description="Sessions of a tenant; without it any number."
    )
    max_tenant_unfinished_jobs: int | None = Field(
        default=None, ge=0, description="Jobs of a tenant that wait or run; without it any number."
    )
    max_tenant_bytes: int | None = Field(
        default=None,
        ge=0,
        description="Size of a tenant's sessions and everything made from them; without it any number.",
    )
    max_tenant_uploads: int | None = Field(
        default=None, ge=0, description="Unfinished or unused uploads of a tenant; without it any number."
    )
    max_requests_per_minute: int | None = Field(
        default=None, gt=0, description="Requests of a tenant, at each API process; without it any number."
    )
    max_tenant_streams: int = Field(
        default=200, gt=0, description="Open event streams of a tenant, at each API process."
    )
    idempotency_lease_s: float = Field(
        default=30.0,
        gt=0,
        description="How long an Idempotency-Key stays taken by a request whose API process was killed.",
    )

    webhook_private: bool = Field(
        default=False, description="Whether webhooks may go to addresses of private networks, and without TLS."
    )
    client_idle_s: float = Field(
        default=60.0,
        gt=0,
        description="How long a client may neither send nor take anything of a body, or take to send headers.",
    )
    client_min_bytes_per_s: float = Field(
        default=1000.0, ge=0, description="Average rate that a client's body must reach, from client_idle_s on."
    )

    upload_hours: float = Field(
        default=48.0, gt=0, le=24 * 365, description="How long an upload is kept that receives nothing and is not used."
    )
    retention_days: float | None = Field(
        default=None, gt=0, le=36_500, description="How long results are kept; without it until they are deleted."
    )
    chunk_frames: int = Field(default=DEFAULT_CHUNK_FRAMES, gt=0, description="Output frames of one chunk of a camera.")

    preflight_command: tuple[str, ...] = Field(
        default=tuple(module_command("pipeline.capture.preflight")),
        description="Program that checks a session's files in a process of its own.",
    )
    preflight_timeout_s: float = Field(
        default=15.0,
        gt=0,
        description="How long the check may take, besides 0.2 s a file, 60 s a GiB of videos and 1800 s a GiB of "
        "keypoints.",
    )
    preflight_wait_s: float = Field(
        default=10.0,
        gt=0,
        description="How long a session waits for its check before it is refused, beside 60 s a GiB of its files.",
    )
    max_preflight_bytes: int = Field(default=4 * MIB, gt=0, description="Size of the check's output.")
    max_record_bytes: int = Field(
        default=1 * GIB,
        gt=0,
        description="Size of the data that the check stores for workers: times of all frames, keypoints.",
    )
    preflight_memory_bytes: int = Field(
        default=3 * GIB, ge=GIB // 2, description="Memory of the check; a session whose check needs more is refused."
    )
    max_parallel_preflights: int = Field(
        default=3,
        gt=0,
        description="Checks at the same time; a tenant, or without keys a client's address, has one less at most.",
    )

    @property
    def is_exposed(self) -> bool:
        """Whether others than this machine may reach the service."""
        return not (self.trust_network or is_loopback(self.host))

    @property
    def resolved_database_url(self) -> str:
        """``database_url``, or SQLite in the data folder."""
        return self.database_url or f"sqlite:///{self.data_dir / 'multicap.db'}"

    @property
    def retention_s(self) -> float | None:
        """``retention_days`` in seconds."""
        return None if self.retention_days is None else self.retention_days * 86_400.0

    @property
    def upload_keep_s(self) -> float:
        """``upload_hours`` in seconds."""
        return self.upload_hours * 3600.0

    @property
    def uploads_dir(self) -> Path:
        """Where files are that come in pieces."""
        return self.data_dir / "uploads"

    @property
    def spool_dir(self) -> Path:
        """Where what a request brings is until it is checked; emptied at each start."""
        return self.data_dir / "spool"
