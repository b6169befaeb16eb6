"""Tables of the database. Times are seconds since 1970 in UTC, from the clock of the database only."""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Dialect,
    Double,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    TypeDecorator,
    UniqueConstraint,
    true,
)

from worker.store.model.rights import DEFAULT_TENANT


class UtcTimestamp(TypeDecorator[datetime]):
    """Time: a number in the database, so that seconds can be added to it, and a ``datetime`` in UTC when it is read."""

    impl = Double
    cache_ok = True

    def process_result_value(self, value: Any | None, dialect: Dialect) -> datetime | None:
        """Read a time."""
        return None if value is None else datetime.fromtimestamp(value, UTC)


metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)

sessions = Table(
    "sessions",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("name", String, nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("files", JSON, nullable=False),
    Column("preflight", JSON, nullable=False),
    Column("client_metadata", JSON, nullable=False, server_default="{}"),
    Column("num_bytes", BigInteger, nullable=False, server_default="0"),  # of all files that are there
    Column("tenant", String(64), nullable=False, server_default=DEFAULT_TENANT),
    Column("record_sha256", String(64)),  # of the preflight's file for the workers; null: it is not compared
    Column("purpose", String(16), nullable=False, server_default="capture"),  # or "calibration": not listed
    Column("search_name", String, nullable=False, server_default=""),  # name as ``searchable`` makes it
    Column("videos_deleted_at", UtcTimestamp),  # null: the videos are there
    Column("chunk_frames", Integer, nullable=False, server_default="100"),  # frames of a camera in a chunk of its jobs
    # Of a session whose videos the service fetches: the request, and when an API process may check its files
    Column("arrival", JSON(none_as_null=True)),  # null: the files are there, or can't be used
    Column("arrival_due_at", UtcTimestamp, index=True),
    Column("errors", JSON(none_as_null=True)),  # why they can't be used
    Index(None, "tenant", "id"),
)

# Files that arrive in pieces. A row is deleted in the transaction that adds a session with the complete file.
uploads = Table(
    "uploads",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant", String(64), nullable=False),
    Column("name", String, nullable=False),
    Column("num_bytes", BigInteger, nullable=False),  # of the complete file
    Column("metadata", String, nullable=False),
    Column("expires_at", UtcTimestamp, nullable=False),
    Column("spool", String, nullable=False),  # host and folder that hold its bytes
    Column("recording_id", String(36), index=True),  # whose phone sends it; null: a key sends it
    Column("phone", Integer),  # number of the phone
    Column("session_id", ForeignKey("sessions.id", ondelete="CASCADE"), index=True),  # that waits for it
    Column("source_url", String),  # a secret; null once the fetch has ended, or if a client sends the file
    Column("source_validator", String),  # its ETag or Last-Modified; null: it has none, or did not answer yet
    Column("fetch_due_at", UtcTimestamp),  # when an API process takes the fetch up; null: nothing is fetched
    Column("fetched_bytes", BigInteger, nullable=False, server_default="0"),  # for readers: up to seconds old
    Column("problem", JSON(none_as_null=True)),  # why the fetch failed
    Index(None, "tenant", "id"),
    Index(None, "expires_at"),
    Index(None, "fetch_due_at"),
)

jobs = Table(
    "jobs",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("session_id", ForeignKey("sessions.id", ondelete="CASCADE"), nullable=False),
    Column("state", String(16), nullable=False),
    Column("spec", JSON, nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("problem", JSON(none_as_null=True)),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("queued_at", UtcTimestamp, nullable=False),  # this attempt: a retry goes to the end of the queue
    Column("started_at", UtcTimestamp),
    Column("finished_at", UtcTimestamp),
    Column("retention_s", Double),  # time that results are kept after the end; null: until they are deleted
    Column("expires_at", UtcTimestamp),
    Column("trace", String(55)),  # W3C traceparent of the request for this attempt
    Column("tenant", String(64), nullable=False, server_default=DEFAULT_TENANT),  # of its session
    Column("warnings", JSON, nullable=False, server_default="[]"),  # about its results: objects with code and message
    Column(
        "kind", String(16), nullable=False, server_default="reconstruction"
    ),  # or "calibration", "proxies", "visuals"
    Column("making", JSON(none_as_null=True)),  # choices of a calibration, proxies or visuals; null: it reconstructs
    Column("edits", JSON, nullable=False, server_default="[]"),  # of the capture, as its files apply them
    Column("edits_revision", Integer),  # of these edits; null: the job leaves the edits of the capture out
    Column("revision", Integer, nullable=False, server_default="0"),  # number of times that its files were made again
    Column("results_revision", Integer),  # revision whose files can be read; null before the first success
    Column("reconstruction_id", String(36), index=True),  # whose visuals it makes; deleted with it
    Column("visuals_old_at", UtcTimestamp, index=True),  # last edit; null: no visuals, or they are new or being made
    Column("precedence", Integer, nullable=False, server_default="1"),  # ``Precedence``
    Column("waiting_for", JSON(none_as_null=True)),  # problem of an outage; null: nothing keeps it waiting
    Column("provider", String, nullable=False, server_default=""),  # execution provider of its networks; empty: the CPU
    Column("character", JSON(none_as_null=True)),  # that it moves: id, copy of the file, corrections; null: none
    Index(None, "session_id", "id"),
    Index(None, "session_id", "kind", "id"),
    Index(None, "tenant", "id"),
    Index(None, "state", "queued_at"),
    Index(None, "state", "tenant", "precedence", "queued_at"),
    Index(None, "expires_at"),
)
# The few jobs that blur faces have an index of their own: no other spec is read for them. Backups read SQLite's files
# without trust in their schema, which then may have no functions of JSON.
BLURS_FACES = jobs.c.spec["blur_faces"].as_boolean().is_(true())
Index(
    "ix_jobs_session_id_blurs", jobs.c.session_id, postgresql_where=BLURS_FACES, info={"dialect": "postgresql"}
).ddl_if(dialect="postgresql")

# Edits of the people of a session, for all of its jobs. Without a row there are none, and their revision is 0.
edits = Table(
    "edits",
    metadata,
    Column("session_id", ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True),
    Column("revision", Integer, nullable=False),  # number of times that the list was changed
    Column("list", JSON, nullable=False),
)

# People that jobs found, before any edit. Their places are read for edits alone.
found_people = Table(
    "found_people",
    metadata,
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("start_frame", Integer, nullable=False),
    Column("num_frames", Integer, nullable=False),
    Column("places", JSON, nullable=False),  # frame, x, y, z
)

# A calibration that is made has the id of the job that makes it. It stays when its job or its session is deleted.
calibrations = Table(
    "calibrations",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant", String(64), nullable=False),
    Column("name", String, nullable=False),
    Column("method", String(16), nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("source", JSON, nullable=False),  # file and what its format says, or choices of the calibration
    Column("text", String),  # in Multicap's format; null until it is made
    Column("report", JSON(none_as_null=True)),
    Column("num_bytes", BigInteger, nullable=False),  # of text and report
    Column("session_id", String(36), index=True),  # from which it is made; it may be deleted
    Index(None, "tenant", "id"),
)

# Characters of users: files with a skeleton, and its recognised bones.
characters = Table(
    "characters",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant", String(64), nullable=False),
    Column("name", String, nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("file", JSON, nullable=False),  # name, key, size and digest
    Column("facts", JSON, nullable=False),  # format, size, numbers of bones and vertices: what lists show
    Column("bones", JSON, nullable=False),  # bones as they were recognised, and the skeleton
    Column("corrections", JSON, nullable=False),  # bones by joint that a user stated; null: the joint has none
    Column("num_bytes", BigInteger, nullable=False),  # of the file and the bones
    Index(None, "tenant", "id"),
)

chunks = Table(
    "chunks",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
    Column("stage_index", Integer, nullable=False),
    Column("stage", String(32), nullable=False),
    Column("code", String(64), nullable=False),  # digest of the code that can run it
    Column("chunk_index", Integer, nullable=False),
    Column("payload", JSON, nullable=False),
    Column("output_key", String(128), nullable=False),
    Column("unit_count", Integer, nullable=False),
    Column("done_units", Integer, nullable=False, default=0),  # maximum over all tries: progress never goes back
    Column("state", String(16), nullable=False),
    Column("attempt", Integer, nullable=False, default=1),
    Column("reused", Boolean(create_constraint=False), nullable=False, default=False),
    Column("memory_bytes", BigInteger, nullable=False, server_default="0"),  # that it is foreseen to need
    Column("worker", String),
    Column("lease_token", String(36)),
    Column("lease_until", UtcTimestamp),
    Column("started_at", UtcTimestamp),  # of the first try
    Column("claimed_at", UtcTimestamp),  # of the last try
    Column("moved_at", UtcTimestamp),  # last progress, or begin of the last try
    Column("lost_tries", Integer, nullable=False, server_default="0"),  # tries that cost their workers
    Column("due_at", UtcTimestamp),  # earliest begin of the next try; null: at once
    Column("finished_at", UtcTimestamp),
    UniqueConstraint("job_id", "stage_index", "chunk_index"),
    Index(None, "state", "job_id", "stage_index", "chunk_index"),
    sqlite_autoincrement=True,  # a retry replaces a job's chunks: an old number must not come to mean a new chunk
)

# Chunks with lost tries are few, and each claim reads them.
Index(
    "ix_chunks_lost_tries",
    chunks.c.state,
    sqlite_where=chunks.c.lost_tries > 0,
    postgresql_where=chunks.c.lost_tries > 0,
)

# Last turn of each tenant at the workers.
turns = Table(
    "turns",
    metadata,
    Column("tenant", String(64), primary_key=True),
    Column("claimed_at", UtcTimestamp, nullable=False),
)

results = Table(
    "results",
    metadata,
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("name", String(255), primary_key=True),
    Column("kind", String(32), nullable=False),
    Column("person", Integer),
    Column("media_type", String, nullable=False),
    Column("key", String, nullable=False),
    Column("num_bytes", BigInteger, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("revision", Integer, nullable=False, server_default="0"),  # of the edits that the file shows
    Column("person_name", String),  # null: not of a single person
)

# Outputs of finished chunks. They stay when their job is deleted, until their session is.
artifacts = Table(
    "artifacts",
    metadata,
    Column("session_id", ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True),
    Column("output_key", String(128), primary_key=True),
    Column("num_bytes", BigInteger, nullable=False),
    Column("sha256", String(64), nullable=False),
)

# Events of jobs, in order for each job: the job is locked when a row is added. Rows are never changed, and are deleted
# with the job.
events = Table(
    "events",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("kind", String(16), nullable=False),  # "state", "stage" or "waiting"; ``value`` is the new one
    Column("value", String(32), nullable=False),
    Index(None, "job_id", "id"),
    sqlite_autoincrement=True,  # ids grow, also after deletions
)

# Earlier attempts of jobs; the last one is in ``jobs``.
attempts = Table(
    "attempts",
    metadata,
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("attempt", Integer, primary_key=True),
    Column("state", String(16), nullable=False),
    Column("problem", JSON(none_as_null=True)),
    Column("queued_at", UtcTimestamp, nullable=False),
    Column("started_at", UtcTimestamp),
    Column("finished_at", UtcTimestamp),
)

# Failed tries of chunks: a problem for each time that a chunk was begun again, or ended its job.
failures = Table(
    "failures",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
    Column("attempt", Integer, nullable=False),  # of the job
    Column("stage", String(32), nullable=False),
    Column("chunk_index", Integer, nullable=False),
    Column("chunk_try", Integer, nullable=False),
    Column("problem", JSON, nullable=False),
    Column("failed_at", UtcTimestamp, nullable=False),
    Index(None, "job_id", "id"),
    sqlite_autoincrement=True,
)

# Files to be removed from the artifact store, added in the transaction that deletes the rows that name them.
removals = Table(
    "removals",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("prefix", String, nullable=False, index=True),  # of keys, with a slash at its end; or a whole key
    Column("due_at", UtcTimestamp, nullable=False, index=True),
    sqlite_autoincrement=True,
)

# Totals since the database was made. They never shrink, not even when jobs are deleted.
totals = Table(
    "totals",
    metadata,
    Column("name", String(32), primary_key=True),
    Column("label", String(32), primary_key=True),
    Column("value", Double, nullable=False),
)

keys = Table(
    "keys",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant", String(64), nullable=False),
    Column("name", String(200), nullable=False),
    Column("scopes", JSON, nullable=False),
    Column("sha256", String(64), nullable=False, unique=True),  # of the secret, which is not stored
    Column("created_at", UtcTimestamp, nullable=False),
    Column("expires_at", UtcTimestamp),
    Column("revoked_at", UtcTimestamp),
)

# Requests that may be sent again, with their answers; null: the request is at work.
idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("tenant", String(64), primary_key=True),
    Column("key", String(200), primary_key=True),
    Column("fingerprint", String(64), nullable=False),  # SHA-256 of the request
    Column("token", String(36), nullable=False),
    Column("claimed_until", UtcTimestamp, nullable=False),
    Column("expires_at", UtcTimestamp, nullable=False, index=True),
    Column("answer", JSON(none_as_null=True)),
)

# Webhook messages of jobs' ends that were not delivered.
deliveries = Table(
    "deliveries",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("message_id", String(40), nullable=False),
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("tenant", String(64), nullable=False),
    Column("url", String, nullable=False),
    Column("body", String, nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("due_at", UtcTimestamp, nullable=False, index=True),
    Column("tries", Integer, nullable=False),
    Column("problem", String),  # problem of the last try
    sqlite_autoincrement=True,
)

# Secrets that sign the messages of a tenant. A signature needs the secret itself, not its digest.
webhook_secrets = Table(
    "webhook_secrets",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("tenant", String(64), nullable=False, index=True),
    Column("secret", String(100), nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("expires_at", UtcTimestamp),  # null: valid until there is a newer one
    sqlite_autoincrement=True,
)

# Worker processes. Each renews its row every few seconds; old rows belong to processes that have ended.
workers = Table(
    "workers",
    metadata,
    Column("id", String(300), primary_key=True),  # host and process id
    Column("state", String(16), nullable=False),
    Column("activity", String, nullable=False),  # sentence without the full stop
    Column("done", Integer, nullable=False),  # steps of the activity
    Column("total", Integer, nullable=False),
    Column("detectors", JSON, nullable=False),  # names of the installed detectors
    Column("bodies", JSON, nullable=False, server_default="[]"),  # names of the installed bodies of people
    Column("formats", JSON, nullable=False, server_default="[]"),  # names of the formats that it can write
    Column("codes", JSON, nullable=False, server_default="[]"),  # digests of the code of its stages
    Column("provider", JSON, nullable=False, server_default="{}"),  # of its networks; empty: the CPU
    Column("memory_bytes", BigInteger, nullable=False, server_default="0"),  # limit of the process; 0: not stated
    Column("seen_at", UtcTimestamp, nullable=False),
)

# Browsers that have shown a key, and got a cookie.
browser_sessions = Table(
    "browser_sessions",
    metadata,
    Column("sha256", String(64), primary_key=True),  # of the cookie's secret
    Column("key_id", ForeignKey("keys.id", ondelete="CASCADE"), nullable=False),
    Column("expires_at", UtcTimestamp, nullable=False),
)

# Links: addresses that open something of a job without a key, for a while. Old rows are deleted when a link is made.
links = Table(
    "links",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("sha256", String(64), nullable=False, unique=True),  # of the secret, which is not stored
    Column("tenant", String(64), nullable=False),
    Column("job_id", ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("key_id", ForeignKey("keys.id", ondelete="CASCADE")),  # that made it; null: the service had no keys
    Column("scope", String(16), nullable=False),
    Column("name", String),  # of the file or of the camera that it opens; null: the scope has none
    Column("created_at", UtcTimestamp, nullable=False),
    Column("expires_at", UtcTimestamp, nullable=False, index=True),
)

# Recordings: rooms in which browsers of phones record takes. Only digests of secrets are stored: of the link by which
# phones join, and of the id that a phone's browser keeps. ``revision`` counts the changes of a recording's rows.
recordings = Table(
    "recordings",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant", String(64), nullable=False),
    Column("name", String, nullable=False),
    Column("created_at", UtcTimestamp, nullable=False),
    Column("expires_at", UtcTimestamp, nullable=False, index=True),
    Column("revision", Integer, nullable=False, server_default="0"),
    Column("join_id", String(36), nullable=False),  # of the link; a new link has another one
    Column("join_sha256", String(64), nullable=False, unique=True),
    Column("join_key_id", String(36)),  # key that made the link; null: the service had no keys
    Index(None, "tenant", "id"),
)

phones = Table(
    "phones",
    metadata,
    Column("recording_id", ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("sha256", String(64), nullable=False),
    Column("name", String(64), nullable=False),
    Column("device", String(100), nullable=False),
    Column("joined_at", UtcTimestamp, nullable=False),
    Column("removed_at", UtcTimestamp),  # null: the host did not remove it
    UniqueConstraint("recording_id", "sha256"),
)

# Takes of recordings. Starts and stops are seconds since 1970 by the clock that the service tells phones.
takes = Table(
    "takes",
    metadata,
    Column("recording_id", ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("name", String(200), nullable=False),
    Column("start_s", Double, nullable=False),
    Column("stop_s", Double, nullable=False),  # until the take is stopped, the latest possible stop
    Column("is_stopped", Boolean(create_constraint=False), nullable=False),
    Column("settings", JSON, nullable=False),  # size and rate of the video that phones are asked for
    Column("is_upload_wanted", Boolean(create_constraint=False), nullable=False),
    Column("is_discarded", Boolean(create_constraint=False), nullable=False),
    Column("session_id", String(36)),  # made from it; it may be deleted since
    Column("job_id", String(36)),  # queued with the session
    Column("calibration_id", String(36)),  # made from it, by the job of the same id
)

# Clips: what a phone recorded of a take, as it says itself, and the uploads of its parts.
clips = Table(
    "clips",
    metadata,
    Column("recording_id", ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
    Column("take", Integer, primary_key=True),
    Column("phone", Integer, primary_key=True),
    Column("started", JSON(none_as_null=True)),  # null: it did not say that it started
    Column("stopped", JSON(none_as_null=True)),  # null: it records, or was cut off
    Column("files", JSON, nullable=False),  # finished uploads with their times
)

# Audit events. Rows are never changed, and stay when their subject is deleted.
audit = Table(
    "audit",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("done_at", UtcTimestamp, nullable=False),
    Column("tenant", String(64), nullable=False),
    Column("key_id", String(36)),  # null: the service had no keys, or the command line was used
    Column("request_id", String(36)),  # null: the command line was used
    Column("act", String(32), nullable=False),
    Column("subject", String(36), nullable=False),  # id of a session, a job or a key
    Index(None, "tenant", "id"),
    sqlite_autoincrement=True,
)
