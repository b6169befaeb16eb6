"""Schema of the first release.

The number continues from unreleased schemas, so that their databases are told apart.
"""

import sqlalchemy as sa
from alembic import op

revision = "0041"
down_revision = None

_NUMBER = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:  # noqa: PLR0915 - one statement a table and an index
    """Make the tables."""
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(36), nullable=False),
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
        sa.PrimaryKeyConstraint("id", name="pk_sessions"),
    )
    op.create_index("ix_sessions_tenant_id", "sessions", ["tenant", "id"])
    op.create_table(
        "uploads",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("metadata", sa.String, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.Column("spool", sa.String, nullable=False),
        sa.Column("recording_id", sa.String(36)),
        sa.Column("phone", sa.Integer),
        sa.PrimaryKeyConstraint("id", name="pk_uploads"),
    )
    op.create_index("ix_uploads_recording_id", "uploads", ["recording_id"])
    op.create_index("ix_uploads_tenant_id", "uploads", ["tenant", "id"])
    op.create_index("ix_uploads_expires_at", "uploads", ["expires_at"])
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("session_id", sa.String(36), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("spec", sa.JSON, nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("problem", sa.JSON),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("queued_at", sa.Double, nullable=False),
        sa.Column("started_at", sa.Double),
        sa.Column("finished_at", sa.Double),
        sa.Column("retention_s", sa.Double),
        sa.Column("expires_at", sa.Double),
        sa.Column("trace", sa.String(55)),
        sa.Column("tenant", sa.String(64), nullable=False, server_default="default"),
        sa.Column("warnings", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("kind", sa.String(16), nullable=False, server_default="reconstruction"),
        sa.Column("making", sa.JSON),
        sa.Column("edits", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("people", sa.JSON),
        sa.Column("results_revision", sa.Integer),
        sa.Column("reconstruction_id", sa.String(36)),
        sa.Column("visuals_old_at", sa.Double),
        sa.Column("precedence", sa.Integer, nullable=False, server_default="1"),
        sa.Column("waiting_for", sa.JSON),
        sa.Column("provider", sa.String, nullable=False, server_default=""),
        sa.Column("character", sa.JSON),
        sa.PrimaryKeyConstraint("id", name="pk_jobs"),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name="fk_jobs_session_id", ondelete="CASCADE"),
    )
    op.create_index("ix_jobs_reconstruction_id", "jobs", ["reconstruction_id"])
    op.create_index("ix_jobs_visuals_old_at", "jobs", ["visuals_old_at"])
    op.create_index("ix_jobs_session_id_id", "jobs", ["session_id", "id"])
    op.create_index("ix_jobs_session_id_kind_id", "jobs", ["session_id", "kind", "id"])
    op.create_index("ix_jobs_tenant_id", "jobs", ["tenant", "id"])
    op.create_index("ix_jobs_state_queued_at", "jobs", ["state", "queued_at"])
    op.create_index("ix_jobs_state_tenant_precedence_queued_at", "jobs", ["state", "tenant", "precedence", "queued_at"])
    op.create_index("ix_jobs_expires_at", "jobs", ["expires_at"])
    if op.get_context().dialect.name == "postgresql":
        blurs = sa.text("CAST((spec ->> 'blur_faces') AS BOOLEAN) IS true")
        op.create_index("ix_jobs_session_id_blurs", "jobs", ["session_id"], postgresql_where=blurs)
    op.create_table(
        "calibrations",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("method", sa.String(16), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("source", sa.JSON, nullable=False),
        sa.Column("files", sa.JSON),
        sa.Column("report", sa.JSON),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("session_id", sa.String(36)),
        sa.PrimaryKeyConstraint("id", name="pk_calibrations"),
    )
    op.create_index("ix_calibrations_session_id", "calibrations", ["session_id"])
    op.create_index("ix_calibrations_tenant_id", "calibrations", ["tenant", "id"])
    op.create_table(
        "characters",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("file", sa.JSON, nullable=False),
        sa.Column("facts", sa.JSON, nullable=False),
        sa.Column("bones", sa.JSON, nullable=False),
        sa.Column("corrections", sa.JSON, nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_characters"),
    )
    op.create_index("ix_characters_tenant_id", "characters", ["tenant", "id"])
    op.create_table(
        "chunks",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
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
        sa.PrimaryKeyConstraint("id", name="pk_chunks"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_chunks_job_id", ondelete="CASCADE"),
        sa.UniqueConstraint("job_id", "stage_index", "chunk_index", name="uq_chunks_job_id_stage_index_chunk_index"),
        sqlite_autoincrement=True,
    )
    ready_order = ["state", "job_id", "stage_index", "chunk_index"]
    op.create_index(f"ix_chunks_{'_'.join(ready_order)}", "chunks", ready_order)
    is_lost = sa.text("lost_tries > 0")
    op.create_index("ix_chunks_lost_tries", "chunks", ["state"], sqlite_where=is_lost, postgresql_where=is_lost)
    op.create_table(
        "turns",
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("claimed_at", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("tenant", name="pk_turns"),
    )
    op.create_table(
        "results",
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("name", sa.String(255), nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("person", sa.String),
        sa.Column("media_type", sa.String, nullable=False),
        sa.Column("key", sa.String, nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("person_name", sa.String),
        sa.PrimaryKeyConstraint("job_id", "name", name="pk_results"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_results_job_id", ondelete="CASCADE"),
    )
    op.create_table(
        "artifacts",
        sa.Column("session_id", sa.String(36), nullable=False),
        sa.Column("output_key", sa.String(128), nullable=False),
        sa.Column("num_bytes", sa.BigInteger, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("session_id", "output_key", name="pk_artifacts"),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name="fk_artifacts_session_id", ondelete="CASCADE"),
    )
    op.create_table(
        "events",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("value", sa.String(32), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_events"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_events_job_id", ondelete="CASCADE"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_events_job_id_id", "events", ["job_id", "id"])
    op.create_table(
        "attempts",
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("problem", sa.JSON),
        sa.Column("queued_at", sa.Double, nullable=False),
        sa.Column("started_at", sa.Double),
        sa.Column("finished_at", sa.Double),
        sa.PrimaryKeyConstraint("job_id", "attempt", name="pk_attempts"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_attempts_job_id", ondelete="CASCADE"),
    )
    op.create_table(
        "failures",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("stage", sa.String(32), nullable=False),
        sa.Column("chunk_index", sa.Integer, nullable=False),
        sa.Column("chunk_try", sa.Integer, nullable=False),
        sa.Column("problem", sa.JSON, nullable=False),
        sa.Column("failed_at", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_failures"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_failures_job_id", ondelete="CASCADE"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_failures_job_id_id", "failures", ["job_id", "id"])
    op.create_table(
        "removals",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("prefix", sa.String, nullable=False),
        sa.Column("due_at", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_removals"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_removals_prefix", "removals", ["prefix"])
    op.create_index("ix_removals_due_at", "removals", ["due_at"])
    op.create_table(
        "totals",
        sa.Column("name", sa.String(32), nullable=False),
        sa.Column("label", sa.String(32), nullable=False),
        sa.Column("value", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("name", "label", name="pk_totals"),
    )
    op.create_table(
        "keys",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("scopes", sa.JSON, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sa.Column("revoked_at", sa.Double),
        sa.PrimaryKeyConstraint("id", name="pk_keys"),
        sa.UniqueConstraint("sha256", name="uq_keys_sha256"),
    )
    op.create_table(
        "idempotency_keys",
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("key", sa.String(200), nullable=False),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("token", sa.String(36), nullable=False),
        sa.Column("claimed_until", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.Column("answer", sa.JSON),
        sa.PrimaryKeyConstraint("tenant", "key", name="pk_idempotency_keys"),
    )
    op.create_index("ix_idempotency_keys_expires_at", "idempotency_keys", ["expires_at"])
    op.create_table(
        "deliveries",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("message_id", sa.String(40), nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("url", sa.String, nullable=False),
        sa.Column("body", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("due_at", sa.Double, nullable=False),
        sa.Column("tries", sa.Integer, nullable=False),
        sa.Column("problem", sa.String),
        sa.PrimaryKeyConstraint("id", name="pk_deliveries"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_deliveries_job_id", ondelete="CASCADE"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_deliveries_job_id", "deliveries", ["job_id"])
    op.create_index("ix_deliveries_due_at", "deliveries", ["due_at"])
    op.create_table(
        "webhook_secrets",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("secret", sa.String(100), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sa.PrimaryKeyConstraint("id", name="pk_webhook_secrets"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_webhook_secrets_tenant", "webhook_secrets", ["tenant"])
    op.create_table(
        "workers",
        sa.Column("id", sa.String(300), nullable=False),
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
        sa.PrimaryKeyConstraint("id", name="pk_workers"),
    )
    op.create_table(
        "browser_sessions",
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("key_id", sa.String(36), nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("sha256", name="pk_browser_sessions"),
        sa.ForeignKeyConstraint(["key_id"], ["keys.id"], name="fk_browser_sessions_key_id", ondelete="CASCADE"),
    )
    op.create_table(
        "links",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("key_id", sa.String(36)),
        sa.Column("scope", sa.String(16), nullable=False),
        sa.Column("name", sa.String),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_links"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_links_job_id", ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["key_id"], ["keys.id"], name="fk_links_key_id", ondelete="CASCADE"),
        sa.UniqueConstraint("sha256", name="uq_links_sha256"),
    )
    op.create_index("ix_links_job_id", "links", ["job_id"])
    op.create_index("ix_links_expires_at", "links", ["expires_at"])
    op.create_table(
        "recordings",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False, server_default="0"),
        sa.Column("join_id", sa.String(36), nullable=False),
        sa.Column("join_sha256", sa.String(64), nullable=False),
        sa.Column("join_key_id", sa.String(36)),
        sa.PrimaryKeyConstraint("id", name="pk_recordings"),
        sa.UniqueConstraint("join_sha256", name="uq_recordings_join_sha256"),
    )
    op.create_index("ix_recordings_expires_at", "recordings", ["expires_at"])
    op.create_index("ix_recordings_tenant_id", "recordings", ["tenant", "id"])
    op.create_table(
        "phones",
        sa.Column("recording_id", sa.String(36), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("device", sa.String(100), nullable=False),
        sa.Column("joined_at", sa.Double, nullable=False),
        sa.Column("removed_at", sa.Double),
        sa.PrimaryKeyConstraint("recording_id", "number", name="pk_phones"),
        sa.ForeignKeyConstraint(["recording_id"], ["recordings.id"], name="fk_phones_recording_id", ondelete="CASCADE"),
        sa.UniqueConstraint("recording_id", "sha256", name="uq_phones_recording_id_sha256"),
    )
    op.create_table(
        "takes",
        sa.Column("recording_id", sa.String(36), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
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
        sa.PrimaryKeyConstraint("recording_id", "number", name="pk_takes"),
        sa.ForeignKeyConstraint(["recording_id"], ["recordings.id"], name="fk_takes_recording_id", ondelete="CASCADE"),
    )
    op.create_table(
        "clips",
        sa.Column("recording_id", sa.String(36), nullable=False),
        sa.Column("take", sa.Integer, nullable=False),
        sa.Column("phone", sa.Integer, nullable=False),
        sa.Column("started", sa.JSON),
        sa.Column("stopped", sa.JSON),
        sa.Column("files", sa.JSON, nullable=False),
        sa.PrimaryKeyConstraint("recording_id", "take", "phone", name="pk_clips"),
        sa.ForeignKeyConstraint(["recording_id"], ["recordings.id"], name="fk_clips_recording_id", ondelete="CASCADE"),
    )
    op.create_table(
        "audit",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("done_at", sa.Double, nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("key_id", sa.String(36)),
        sa.Column("request_id", sa.String(36)),
        sa.Column("act", sa.String(32), nullable=False),
        sa.Column("subject", sa.String(36), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_audit"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_audit_tenant_id", "audit", ["tenant", "id"])
