"""Schema of the first release.

The number continues from unreleased schemas, so that their databases are told apart.
"""

import sqlalchemy as sa
from alembic import op

revision = "0041"
down_revision = None

_NUMBER = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("files", sa.JSON, nullable=False),
        sa.Column("preflight", sa.JSON, nullable=False),
        sa.Column("client_metadata", sa.JSON, nullable=False, server_default="{}"),
        sa.Column("num_bytes", sa.BigInteger, nullable=False, server_default="0"),
        sa.Column("tenant", sa.String(64), nullable=False, server_default="default"),
        sa.Column("record_sha256", sa.String(64)),
        sa.Column("purpose", sa.String(16), nullable=False, server_default="capture"),
        sa.Column("search_name", sa.String, nullable=False, server_default=""),
        sa.Column("videos_deleted_at", sa.Double),
        sa.Column("chunk_frames", sa.Integer, nullable=False, server_default="100"),
    )
    op.create_index("ix_sessions_tenant_id", "sessions", ["tenant", "id"])
    op.create_table(
        "uploads",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("metadata", sa.String, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False, index=True),
        sa.Column("spool", sa.String, nullable=False),
        sa.Column("recording_id", sa.String(36), index=True),
        sa.Column("phone", sa.Integer),
        sa.Column("source_sha256", sa.String(64)),
        sa.Column("source_url", sa.String),
        sa.Column("source_validator", sa.String),
        sa.Column("fetch_due_at", sa.Double, index=True),
        sa.Column("problem", sa.JSON),
    )
    op.create_index("ix_uploads_tenant_id", "uploads", ["tenant", "id"])
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("session_id", sa.String(36), sa.ForeignKey("sessions.id", ondelete="CASCADE"), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("spec", sa.JSON, nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("problem", sa.JSON),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("queued_at", sa.Double, nullable=False),
        sa.Column("started_at", sa.Double),
        sa.Column("finished_at", sa.Double),
        sa.Column("retention_s", sa.Double),
        sa.Column("expires_at", sa.Double, index=True),
        sa.Column("trace", sa.String(55)),
        sa.Column("tenant", sa.String(64), nullable=False, server_default="default"),
        sa.Column("warnings", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("kind", sa.String(16), nullable=False, server_default="reconstruction"),
        sa.Column("making", sa.JSON),
        sa.Column("edits", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("edits_revision", sa.Integer),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("results_revision", sa.Integer),
        sa.Column("reconstruction_id", sa.String(36), index=True),
        sa.Column("visuals_old_at", sa.Double, index=True),
        sa.Column("precedence", sa.Integer, nullable=False, server_default="1"),
        sa.Column("waiting_for", sa.JSON),
        sa.Column("provider", sa.String, nullable=False, server_default=""),
        sa.Column("character", sa.JSON),
    )
    op.create_index("ix_jobs_session_id_id", "jobs", ["session_id", "id"])
    op.create_index("ix_jobs_session_id_kind_id", "jobs", ["session_id", "kind", "id"])
    op.create_index("ix_jobs_tenant_id", "jobs", ["tenant", "id"])
    op.create_index("ix_jobs_state_queued_at", "jobs", ["state", "queued_at"])
    op.create_index("ix_jobs_state_tenant_precedence_queued_at", "jobs", ["state", "tenant", "precedence", "queued_at"])
    if op.get_context().dialect.name == "postgresql":
        blurs = sa.text("CAST((spec ->> 'blur_faces') AS BOOLEAN) IS true")
        op.create_index("ix_jobs_session_id_blurs", "jobs", ["session_id"], postgresql_where=blurs)
    op.create_table(
        "edits",
        sa.Column("session_id", sa.String(36), sa.ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("list", sa.JSON, nullable=False),
    )
    op.create_table(
        "found_people",
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("start_frame", sa.Integer, nullable=False),
        sa.Column("num_frames", sa.Integer, nullable=False),
        sa.Column("places", sa.JSON, nullable=False),
    )
    op.create_table(
        "calibrations",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("method", sa.String(16), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("source", sa.JSON, nullable=False),
        sa.Column("files", sa.JSON),
        sa.Column("report", sa.JSON),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("session_id", sa.String(36), index=True),
    )
    op.create_index("ix_calibrations_tenant_id", "calibrations", ["tenant", "id"])
    op.create_table(
        "characters",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("file", sa.JSON, nullable=False),
        sa.Column("facts", sa.JSON, nullable=False),
        sa.Column("bones", sa.JSON, nullable=False),
        sa.Column("corrections", sa.JSON, nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
    )
    op.create_index("ix_characters_tenant_id", "characters", ["tenant", "id"])
    op.create_table(
        "chunks",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
        sa.Column("stage_index", sa.Integer, nullable=False),
        sa.Column("stage", sa.String(32), nullable=False),
        sa.Column("code", sa.String(64), nullable=False),
        sa.Column("chunk_index", sa.Integer, nullable=False),
        sa.Column("payload", sa.JSON, nullable=False),
        sa.Column("output_key", sa.String(128), nullable=False),
        sa.Column("unit_count", sa.Integer, nullable=False),
        sa.Column("done_units", sa.Integer, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("reused", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("memory_bytes", sa.BigInteger, nullable=False, server_default="0"),
        sa.Column("worker", sa.String),
        sa.Column("lease_token", sa.String(36)),
        sa.Column("lease_until", sa.Double),
        sa.Column("started_at", sa.Double),
        sa.Column("claimed_at", sa.Double),
        sa.Column("moved_at", sa.Double),
        sa.Column("lost_tries", sa.Integer, nullable=False, server_default="0"),
        sa.Column("due_at", sa.Double),
        sa.Column("finished_at", sa.Double),
        sa.UniqueConstraint("job_id", "stage_index", "chunk_index"),
        sqlite_autoincrement=True,
    )
    ready_order = ["state", "job_id", "stage_index", "chunk_index"]
    op.create_index(f"ix_chunks_{'_'.join(ready_order)}", "chunks", ready_order)
    is_lost = sa.text("lost_tries > 0")
    op.create_index("ix_chunks_lost_tries", "chunks", ["state"], sqlite_where=is_lost, postgresql_where=is_lost)
    op.create_table(
        "turns",
        sa.Column("tenant", sa.String(64), primary_key=True),
        sa.Column("claimed_at", sa.Double, nullable=False),
    )
    op.create_table(
        "results",
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("name", sa.String(255), primary_key=True),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("person", sa.Integer),
        sa.Column("media_type", sa.String, nullable=False),
        sa.Column("key", sa.String, nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("person_name", sa.String),
    )
    op.create_table(
        "artifacts",
        sa.Column("session_id", sa.String(36), sa.ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("output_key", sa.String(128), primary_key=True),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
    )
    op.create_table(
        "events",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("value", sa.String(32), nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_events_job_id_id", "events", ["job_id", "id"])
    op.create_table(
        "attempts",
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("attempt", sa.Integer, primary_key=True),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("problem", sa.JSON),
        sa.Column("queued_at", sa.Double, nullable=False),
        sa.Column("started_at", sa.Double),
        sa.Column("finished_at", sa.Double),
    )
    op.create_table(
        "failures",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("stage", sa.String(32), nullable=False),
        sa.Column("chunk_index", sa.Integer, nullable=False),
        sa.Column("chunk_try", sa.Integer, nullable=False),
        sa.Column("problem", sa.JSON, nullable=False),
        sa.Column("failed_at", sa.Double, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_failures_job_id_id", "failures", ["job_id", "id"])
    op.create_table(
        "removals",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("prefix", sa.String, nullable=False, index=True),
        sa.Column("due_at", sa.Double, nullable=False, index=True),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "totals",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("label", sa.String(32), primary_key=True),
        sa.Column("value", sa.Double, nullable=False),
    )
    op.create_table(
        "keys",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("scopes", sa.JSON, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sa.Column("revoked_at", sa.Double),
    )
    op.create_table(
        "idempotency_keys",
        sa.Column("tenant", sa.String(64), primary_key=True),
        sa.Column("key", sa.String(200), primary_key=True),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("token", sa.String(36), nullable=False),
        sa.Column("claimed_until", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False, index=True),
        sa.Column("answer", sa.JSON),
    )
    op.create_table(
        "deliveries",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("message_id", sa.String(40), nullable=False),
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False, index=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("url", sa.String, nullable=False),
        sa.Column("body", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("due_at", sa.Double, nullable=False, index=True),
        sa.Column("tries", sa.Integer, nullable=False),
        sa.Column("problem", sa.String),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "webhook_secrets",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False, index=True),
        sa.Column("secret", sa.String(100), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "workers",
        sa.Column("id", sa.String(300), primary_key=True),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("activity", sa.String, nullable=False),
        sa.Column("done", sa.Integer, nullable=False),
        sa.Column("total", sa.Integer, nullable=False),
        sa.Column("detectors", sa.JSON, nullable=False),
        sa.Column("bodies", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("formats", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("codes", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("provider", sa.JSON, nullable=False, server_default="{}"),
        sa.Column("memory_bytes", sa.BigInteger, nullable=False, server_default="0"),
        sa.Column("seen_at", sa.Double, nullable=False),
    )
    op.create_table(
        "browser_sessions",
        sa.Column("sha256", sa.String(64), primary_key=True),
        sa.Column("key_id", sa.String(36), sa.ForeignKey("keys.id", ondelete="CASCADE"), nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
    )
    op.create_table(
        "links",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("job_id", sa.String(36), sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False, index=True),
        sa.Column("key_id", sa.String(36), sa.ForeignKey("keys.id", ondelete="CASCADE")),
        sa.Column("scope", sa.String(16), nullable=False),
        sa.Column("name", sa.String),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False, index=True),
    )
    op.create_table(
        "recordings",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False, index=True),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("join_id", sa.String(36), nullable=False),
        sa.Column("join_sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("join_key_id", sa.String(36)),
    )
    op.create_index("ix_recordings_tenant_id", "recordings", ["tenant", "id"])
    op.create_table(
        "phones",
        sa.Column("recording_id", sa.String(36), sa.ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("device", sa.String(100), nullable=False),
        sa.Column("joined_at", sa.Double, nullable=False),
        sa.Column("removed_at", sa.Double),
        sa.UniqueConstraint("recording_id", "sha256"),
    )
    op.create_table(
        "takes",
        sa.Column("recording_id", sa.String(36), sa.ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("start_s", sa.Double, nullable=False),
        sa.Column("stop_s", sa.Double, nullable=False),
        sa.Column("is_stopped", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("settings", sa.JSON, nullable=False),
        sa.Column("is_upload_wanted", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("is_discarded", sa.Boolean(create_constraint=False), nullable=False),
        sa.Column("session_id", sa.String(36)),
        sa.Column("job_id", sa.String(36)),
        sa.Column("calibration_id", sa.String(36)),
    )
    op.create_table(
        "clips",
        sa.Column("recording_id", sa.String(36), sa.ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("take", sa.Integer, primary_key=True),
        sa.Column("phone", sa.Integer, primary_key=True),
        sa.Column("started", sa.JSON),
        sa.Column("stopped", sa.JSON),
        sa.Column("files", sa.JSON, nullable=False),
    )
    op.create_table(
        "audit",
        sa.Column("id", _NUMBER, primary_key=True),
        sa.Column("done_at", sa.Double, nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("key_id", sa.String(36)),
        sa.Column("request_id", sa.String(36)),
        sa.Column("act", sa.String(32), nullable=False),
        sa.Column("subject", sa.String(36), nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_audit_tenant_id", "audit", ["tenant", "id"])
