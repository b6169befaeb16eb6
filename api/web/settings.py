"""Settings of the web API, from environment variables that begin with ``MULTICAP_``."""

import ipaddress
from pathlib import Path

from pydantic import Field, IPvAnyNetwork, ValidationInfo, field_validator

from pipeline.core.options.config import DEFAULT_CHUNK_FRAMES
from pipeline.core.runtime.child_processes import module_command
from worker.run.settings import SharedSettings

KIB, MIB, GIB = 2**10, 2**20, 2**30


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach a listening address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Settings(SharedSettings):
    """Addresses and limits of the web API."""

    signed_downloads_s: float | None = Field(default=None, gt=0, le=7 * 24 * 3600)
    """Validity of the signed addresses of the bucket to which downloads of results are redirected; without it downloads
    go through the API."""

    host: str = Field(default="127.0.0.1", description="Address to listen on; `multicap serve` has an option.")
    port: int = Field(default=8000, ge=0, le=65535)
    """Port to listen on, 0 for a free one; `multicap serve` has an option."""
    trust_network: bool = False
    """Allow a listening address beyond loopback without keys. Only for services that other machines can't reach, such
    as a container whose port is published on loopback."""
    certificate: Path | None = None
    """File of the certificate in PEM, with the certificates between it and its authority, for a service that encrypts
    by itself; without it a proxy encrypts. `multicap serve` has options."""
    certificate_key: Path | None = Field(default=None, validate_default=True)
    """File of the certificate's private key in PEM, without a password; needed with it."""
    certificate_authority: Path | None = None
    """File of the certificate of the service's own authority in PEM, which phones get at /certificate; without it they
    get none."""
    allowed_hosts: frozenset[str] = frozenset()
    """Host names, besides localhost, by which clients may call the service, as a JSON list."""
    allowed_origins: frozenset[str] = frozenset()
    """Origins, such as https://portal.example, whose pages may call with keys, as a JSON list."""
    trusted_proxies: frozenset[IPvAnyNetwork] = frozenset()
    """Addresses or networks of proxies whose X-Forwarded-For and X-Forwarded-Proto are trusted, as a JSON list. Without
    it the client is the peer of the connection."""
    max_connections: int = Field(default=4096, gt=0)
    """Open connections of an API process; requests beyond it get 503. At most half of the process's limit on open files
    counts."""
    max_wrong_keys_per_minute: int = Field(default=30, gt=0)
    """Wrong keys from a client's address (IPv6: its /64) in a minute, at each API process; more get 429. Valid keys are
    always served."""

    max_file_bytes: int = Field(default=16 * GIB, gt=0, description="Largest size of a video.")
    max_keypoints_bytes: int = Field(default=1 * GIB, gt=0)
    """Largest size of the archive of a camera's keypoints."""
    max_session_bytes: int = Field(default=64 * GIB, gt=0, description="Largest size of all files of a session.")
    max_calibration_bytes: int = Field(default=16 * MIB, gt=0, description="Largest size of a calibration file.")
    max_character_bytes: int = Field(default=512 * MIB, gt=0)
    """Largest size of a character's file; files above 512 MiB are never read."""
    max_json_bytes: int = Field(default=64 * KIB, gt=0, description="Largest size of a JSON body or part.")
    max_session_joints: int = Field(default=75_000_000, gt=0)
    """Largest number of joints in all keypoint files of a session, with or without coordinates; a session with more is
    refused (`session_too_large`). A check needs some 36 bytes for each joint, its stored data 22: raise
    preflight_memory_bytes and max_record_bytes with it."""
    max_cameras: int = Field(default=64, gt=0)
    """Largest number of cameras of a session. A recording in parts is one camera; a session has at most 16 parts for
    each camera on average."""

    max_duration_s: float | None = Field(default=None, gt=0)
    """Longest duration of a session, from its first frame to its last; without it 43,200 s."""
    max_pixels: int | None = Field(default=None, gt=0)
    """Largest number of pixels of a frame; without it 8192 x 4320."""

    max_tenant_sessions: int | None = Field(default=None, ge=0)
    """Largest number of sessions of a tenant; a new session beyond it gets 403 `quota_exceeded`; without it any
    number."""
    max_tenant_unfinished_jobs: int | None = Field(default=None, ge=0)
    """Largest number of a tenant's jobs that wait or run; a new job beyond it gets 429 `quota_exceeded`; without it any
    number."""
    max_tenant_bytes: int | None = Field(default=None, ge=0)
    """Largest size of a tenant's characters, unused uploads (by their announced size), and sessions with everything
    made from them. A new session beyond it gets 403 `quota_exceeded`, before it is sent if its length is announced;
    accepted work continues. Without it any size."""
    max_tenant_uploads: int | None = Field(default=None, ge=0)
    """Largest number of a tenant's unfinished or unused uploads; without it any number."""
    max_requests_per_minute: int | None = Field(default=None, gt=0)
    """Largest number of a tenant's requests in a minute, at each API process; more get 429 `too_many_requests`; without
    it any number. With it responses have RateLimit headers."""
    max_tenant_streams: int = Field(default=200, gt=0)
    """Largest number of open event streams of a tenant, or without keys of a client's address, at each API process."""
    max_link_days: float = Field(default=30.0, gt=0, le=3650, description="Longest lifetime of a link.")
    idempotency_lease_s: float = Field(default=30.0, gt=0)
    """Time until an Idempotency-Key can be used again if the API process of its request was killed."""

    client_idle_s: float = Field(default=60.0, gt=0)
    """Longest time in which a client neither sends nor receives a byte of a body; slower clients get 408 or are
    disconnected."""
    client_min_bytes_per_s: float = Field(default=1000.0, ge=0)
    """Smallest average rate of a client's body, checked from client_idle_s on."""

    shared_uploads: bool = False
    """True if uploads are kept in the bucket of artifacts_url, so that every API process continues them; otherwise they
    are in data_dir of the process that began them."""
    upload_hours: float = Field(default=48.0, gt=0, le=24 * 365)
    """Time for which an unused upload is kept after its last piece."""
    fetch_private: bool = False
    """True if videos may be fetched from addresses of private networks and of this machine, also without TLS."""
    retention_days: float | None = Field(default=None, gt=0, le=36_500)
    """Time for which results are kept after a job's end; the reaper then removes them, and the job is `expired`.
    Outputs of its stages stay until the session is deleted. Without it results stay until they are deleted."""
    chunk_frames: int = Field(default=DEFAULT_CHUNK_FRAMES, gt=0)
    """Frames of a camera in a chunk of new sessions: a length for which networks take about 10 s. A quarter of a short
    take is enough. It is doubled for a session that would have more than 20,000 chunks. Results do not depend on it."""

    preflight_command: tuple[str, ...] = tuple(module_command("pipeline.capture.preflight"))
    """Program that checks a session's files, run in a child process."""
    calibration_command: tuple[str, ...] = tuple(module_command("pipeline.calibration.on_request"))
    """Program that makes, writes and plans calibrations, run in a child process with the limits of a session's
    check."""
    character_command: tuple[str, ...] = tuple(module_command("pipeline.export.character.check_character"))
    """Program that checks a character's file, run in a child process with the limits of a session's check."""
    preflight_timeout_s: float = Field(default=60.0, gt=0)
    """Time limit of the check of a session, in addition to 0.2 s a file, 60 s a GiB of videos or of a character, and
    1800 s a GiB of keypoints. After half of it no further picture is looked at."""
    preflight_wait_s: float = Field(default=10.0, gt=0)
    """Longest time that a session waits for its check before it is refused, in addition to 60 s a GiB of its files."""
    max_preflight_bytes: int = Field(default=4 * MIB, gt=0, description="Largest size of a check's output.")
    max_record_bytes: int = Field(default=2 * GIB, gt=0)
    """Largest size of the data that a check stores for workers: times of all frames, keypoints."""
    preflight_memory_bytes: int = Field(default=3 * GIB, ge=GIB // 2)
    """Memory limit of a check; a session whose check needs more is refused (`session_too_large`)."""
    max_parallel_preflights: int = Field(default=3, gt=0)
    """Largest number of checks at the same time, at each API process. A tenant, or without keys a client's address, has
    at most one fewer."""

    live_command: tuple[str, ...] = tuple(module_command("pipeline.run.live.server"))
    """Program from which the processes of live captures are forked, one a connection."""
    live_cameras_command: tuple[str, ...] = tuple(module_command("pipeline.run.live.cameras.program"))
    """Program of a live capture whose cameras the service opens."""
    live_recording_command: tuple[str, ...] = tuple(module_command("pipeline.run.live.cameras.recording"))
    """Program that records cameras for a moment, for their calibration."""
    live_private: bool | None = None
    """True if live captures may open cameras of this machine and streams of private networks, and use outputs; streams
    of public addresses they may. Without it only as long as the service has no keys."""
    max_live_camera_captures: int = Field(default=1, ge=0)
    """Largest number of live captures of an API process whose cameras the service opens; each uses all processors."""
    live_keeping_command: tuple[str, ...] = tuple(module_command("pipeline.run.live.keeping"))
    """Program that writes the keypoints of a live capture as files of a session."""
    live_memory_bytes: int = Field(default=2 * GIB, ge=GIB // 2)
    """Memory limit of the process of a live capture."""
    live_answer_s: float = Field(default=20.0, gt=0)
    """Longest time that the process of a live capture takes for a frame; then the capture ends. It has six times as
    long to start."""
    live_idle_s: float = Field(default=30.0, gt=0)
    """Longest time in which a client of a live capture sends nothing, or takes nothing of what waits."""
    max_live_captures: int = Field(default=8, ge=0)
    """Largest number of live captures of an API process, each with a process of its own."""
    max_tenant_live_captures: int = Field(default=4, ge=0)
    """Largest number of a tenant's live captures, or without keys of a client's address, at each API process."""
    max_bad_live_captures_per_minute: int = Field(default=20, gt=0)
    """Largest number of a tenant's live captures, or without keys of a client's address, that end by problems of the
    client within a minute, at each API process; beyond it 429 `too_many_bad_captures`."""
    max_live_message_bytes: int = Field(default=MIB, gt=0)
    """Largest size of a message of a live capture, the calibration included."""
    max_live_messages_per_s: float = Field(default=4000.0, gt=0)
    """Largest average rate of the messages of a live capture."""
    max_live_people: int = Field(default=32, gt=0, le=128)
    """Largest number of people in a frame of a live capture."""

    public_url: str | None = Field(
        default=None, pattern=r"^https?://[^/?#\s]+$", examples=["https://192.168.1.20:8443"]
    )
    """Address by which phones reach the service, in the links of recordings; without it the address of the host's
    request."""
    max_recording_hours: float = Field(default=72.0, gt=0, le=24 * 365)
    """Longest lifetime of a recording by phones, with its link."""
    max_recording_phones: int = Field(default=32, gt=0, le=1000, description="Largest number of phones of a recording.")
    max_recording_hosts: int = Field(default=8, gt=0)
    """Largest number of hosts that are connected to a recording, at each API process."""
    max_recording_takes: int = Field(default=200, gt=0, description="Largest number of takes of a recording.")
    max_take_s: float = Field(default=3600.0, gt=0, le=43_200)
    """Longest duration of a take; phones stop by themselves then."""
    max_recording_uploads: int = Field(default=2000, gt=0)
    """Largest number of uploads of a recording's phones that no session took; quotas count them too."""
    max_recording_bytes: int = Field(default=256 * GIB, gt=0)
    """Largest size of the uploads of a recording's phones that no session took."""
    max_recording_message_bytes: int = Field(default=16 * KIB, gt=0)
    """Largest size of a message in JSON of a recording's phone or host."""
    max_recording_messages_per_s: float = Field(default=50.0, gt=0)
    """Largest average rate of the messages of a recording's phone or host."""
    max_thumbnail_bytes: int = Field(default=30_000, gt=0, description="Largest size of a phone's thumbnail.")
    max_thumbnails_per_s: float = Field(default=2.0, ge=0)
    """Thumbnails of a phone in a second that are passed on; more are dropped."""
    max_phone_picture_bytes: int = Field(default=150_000, gt=0, le=200_000)
    """Largest size of a phone's picture for live captures."""
    max_phone_pictures_per_s: float = Field(default=15.0, gt=0)
    """Pictures of a phone in a second that live captures get; more are dropped."""
    recording_idle_s: float = Field(default=30.0, gt=0)
    """Longest time in which a phone of a recording sends nothing, or a phone or host takes nothing of what waits."""

    @field_validator("certificate_key")
    @classmethod
    def _require_certificate(cls, key: Path | None, given: ValidationInfo) -> Path | None:
        if (key is None) != (given.data.get("certificate") is None):
            raise ValueError("a certificate and its key belong together: set both or neither")
        return key

    @field_validator("shared_uploads")
    @classmethod
    def _require_bucket(cls, shared: bool, given: ValidationInfo) -> bool:
        if shared and not given.data.get("artifacts_url"):
            raise ValueError("shared uploads need a bucket: set MULTICAP_ARTIFACTS_URL to s3://bucket/prefix too")
        return shared

    @property
    def is_exposed(self) -> bool:
        """Return whether other machines may reach the service."""
        return not (self.trust_network or is_loopback(self.host))

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
        """Folder of the files of uploads."""
        return self.data_dir / "uploads"

    @property
    def spool_dir(self) -> Path:
        """Folder of a request's files until they are checked; emptied at each start."""
        return self.data_dir / "spool"
